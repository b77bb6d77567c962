"""Laws of the sentences that quote files."""

import time

from hypothesis import given
from hypothesis import strategies as st

from gaga_core.errors import LONGEST_SENTENCE, GagaError, plain_text

_TEXTS = st.text(max_size=1200)


@given(_TEXTS)
def test_a_sentence_is_one_short_line_without_commands_to_a_terminal(text: str) -> None:
    said = str(GagaError(text))
    assert len(said) <= LONGEST_SENTENCE
    assert all(c.isprintable() or c.isspace() or c in "\u200c\u200d" for c in said)
    assert len(said.splitlines()) <= 1


@given(st.text(st.characters(exclude_categories=["C", "Z"]), max_size=LONGEST_SENTENCE))
def test_text_that_can_be_shown_stays_as_it_is(text: str) -> None:
    assert plain_text(text) == text


def test_scripts_and_emoji_that_join_characters_stay() -> None:
    assert plain_text("नमस्‍ते 👩‍🚀 日本") == "नमस्‍ते 👩‍🚀 日本"


@given(st.text(st.characters(codec="ascii", categories=["L"]), min_size=500, max_size=5000))
def test_a_long_name_loses_its_middle_and_the_cure_stays(name: str) -> None:
    said = plain_text(f"{name} is damaged. Copy it again.")
    assert said.startswith(name[:30])
    assert said.endswith(f"{name[-30:]} is damaged. Copy it again.")


def test_words_of_unlike_lengths_are_cut_in_time_that_grows_with_them() -> None:
    start = time.process_time()
    text = " ".join("x" * (300_000 - 1000 * i) for i in range(3))
    assert len(plain_text(text)) <= LONGEST_SENTENCE
    assert time.process_time() - start < 2  # seconds; its square takes minutes
