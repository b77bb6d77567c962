"""Names in Arabic and Hebrew as they are drawn from left to right."""

import unicodedata

import pytest

from gaga_studio.ui.kit.theme import visual


@pytest.mark.parametrize("text", ["", "mug 2", "Tasse à café", "чашка", "茶杯", "😀 mug"])
def test_other_scripts_stay_as_they_are(text: str) -> None:
    assert visual(text) == text


@pytest.mark.parametrize(
    ("text", "drawn"),
    [
        ("שלום", "םולש"),
        ("שלום 12 abc", "12 abc םולש"),
        ("abc שלום", "abc םולש"),
        ("(שלום)", "(םולש)"),
    ],
)
def test_runs_are_turned_and_numbers_are_not(text: str, drawn: str) -> None:
    assert visual(text) == drawn


def test_arabic_letters_take_the_form_of_their_place() -> None:
    places = [unicodedata.decomposition(letter).split()[0] for letter in visual("قهوة")]
    assert places == ["<isolated>", "<final>", "<medial>", "<initial>"]
    assert unicodedata.normalize("NFKC", visual("قهوة"))[::-1] == "قهوة"
