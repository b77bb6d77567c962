"""Laws of the sentences that quote files."""

import re
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaga_core.errors import LONGEST_SENTENCE, GagaError, counted, cure_without, plain_text
from gaga_core.export.simulation.bodies import library
from gaga_core.io.cameras.colmap import POINTS_LEFT_OUT
from gaga_core.io.cameras.given import GivenPose, GivenPoses
from gaga_core.io.splats.packing import LEFT_OUT, SET, say_changes
from gaga_core.io.splats.ply import SWAPPED
from gaga_core.io.splats.usd import usd
from gaga_core.pipeline.mask_dataset import MaskDataset
from gaga_core.scene.cleanup import CleanPreview, CleanReason

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


@pytest.mark.parametrize("extra", ["models", "usd", "simulation", "executors"])
def test_the_program_folder_names_no_extra_that_it_cannot_have(
    extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its folder of models alone brings packages: those that `make app-models` puts there."""
    assert cure_without(extra) == f"pip install 'gaga-studio[{extra}]'"
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    root = Path(__file__).parents[2]
    recipe = re.search(r"--target dist/models (.*)", (root / "Makefile").read_text("utf-8"))
    extras = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    needed = {re.split(r"[\[>]", one)[0] for one in extras["optional-dependencies"][extra]}
    assert recipe is not None
    if needed <= set(recipe[1].split()):
        assert str(Path(sys.executable).parent / "models") in cure_without(extra)
    else:
        assert "this program folder cannot have it" in cure_without(extra)


def test_packages_for_simulators_are_missed_in_one_sentence_that_is_true(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    for name in ("coacd", "manifold3d", "mujoco", "pxr"):
        monkeypatch.setitem(sys.modules, name, None)
        extra = "usd" if name == "pxr" else "simulation"
        with pytest.raises(GagaError) as said:
            usd() if name == "pxr" else library(name)
        assert str(said.value).endswith(f"Install it: {cure_without(extra)}.")


def test_one_of_a_thing_is_no_things() -> None:
    counts = [counted(n, "loose splat") for n in (0, 1, 2, 5999)]
    assert counts == ["0 loose splats", "1 loose splat", "2 loose splats", "5,999 loose splats"]


_THINGS = {"splats", "floaters", "views", "photos", "masks", "points", "rotations", "numbers"}
_PLURALS = _THINGS | {"are", "were", "their"}


@pytest.mark.parametrize("n", [1, 2])
def test_what_is_told_of_one_says_so(n: int, caplog: pytest.LogCaptureFixture) -> None:
    rows = np.arange(n, dtype=np.int32)
    reasons = np.full(n, CleanReason.STRAY, np.int32)
    pose = GivenPose("a.jpg", None, np.eye(4), mask=Path("a.png"))
    told = (
        CleanPreview(1, rows, rows, reasons, rows, reasons, rows).sentence(),
        MaskDataset(Path("out"), ("b",), ("a",) * n, 3, 3).sentence,
        GivenPoses("nerfstudio", Path("transforms.json"), (pose,) * n).told,
        *_said_of_changes(n, caplog),
    )
    for sentence in told:
        plurals = set(re.findall(r"\w+", sentence)) & _PLURALS
        assert bool(plurals) == (n > 1), sentence


def _said_of_changes(n: int, caplog: pytest.LogCaptureFixture) -> list[str]:
    for what in (LEFT_OUT, SET, POINTS_LEFT_OUT, SWAPPED):
        say_changes(Path("odd.ply"), {what: n})
    return [re.sub("numbers that are", "", one) for one in caplog.messages]
