"""Colors of both themes: none is left to the toolkit, words stand out from what is behind them."""

import itertools
import re
import threading
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec4, imgui

from gaga_core import kernels
from gaga_core.errors import plain_text
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster import backend_report
from gaga_core.scene.folders import Folders
from gaga_core.scene.objects import folder_colors, group_colors
from gaga_studio.features.commands import new_session
from gaga_studio.session import stages
from gaga_studio.session.jobs import Job
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.settings import Settings
from gaga_studio.ui.chrome import status
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import visual
from tests.app.folders import write_scene


def luminance(rgb: Sequence[float]) -> float:
    """Relative luminance of sRGB (WCAG 2.2)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: Sequence[float], b: Sequence[float]) -> float:
    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


def values(color: ImVec4) -> tuple[theme.Rgba, theme.Rgba]:
    """Dark and light."""
    return next((dark, light) for held, dark, light in theme._BOTH if held is color)


def test_every_color_of_the_toolkit_is_the_themes() -> None:
    assert {name for name in imgui.Col_.__members__ if name != "count"} == theme._COLORS.keys()


@pytest.mark.parametrize("is_light", [False, True], ids=["dark", "light"])
def test_words_stand_out(is_light: bool) -> None:
    """4.5 to 1 for words (WCAG 2.2, AA); 3 to 1 for what is faint on purpose."""
    for text in ("TEXT", "DIM", "GOOD", "WARN", "BAD", "FAINT"):
        least = 3.0 if text == "FAINT" else 4.5
        for ground in ("PANEL", "BACK", "POPUP"):
            front = values(getattr(theme, text))[is_light]
            behind = values(getattr(theme, ground))[is_light]
            assert contrast(front, behind) >= least, f"{text} on {ground}"


@pytest.mark.parametrize("is_light", [False, True], ids=["dark", "light"])
def test_values_are_read_over_the_knobs_of_sliders(is_light: bool) -> None:
    """At rest, hovered and dragged: the value of a slider is drawn over its knob."""
    text = values(theme.TEXT)[is_light]
    for field, knob in (
        ("frame_bg", "slider_grab"),
        ("frame_bg_hovered", "slider_grab"),
        ("frame_bg_active", "slider_grab_active"),
    ):
        ground, over = (values(theme._COLORS[name])[is_light] for name in (field, knob))
        seen = [a * over[3] + b * (1 - over[3]) for a, b in zip(over[:3], ground[:3], strict=True)]
        assert contrast(text, seen) >= 4.5, f"value over {knob} on {field}"


@pytest.fixture
def either(request: pytest.FixtureRequest) -> Iterator[bool]:
    """Whether the panels are those of the light theme."""
    held = theme.PANEL
    held.x, held.y, held.z, _ = values(held)[request.param]
    yield request.param
    held.x, held.y, held.z, _ = values(held)[False]


@pytest.mark.parametrize("either", [False, True], ids=["dark", "light"], indirect=True)
def test_dots_of_objects_are_seen(either: bool) -> None:
    """A rim of 3 to 1 around those that the panel hides: in no folder, dark ones of the palette."""
    panel = values(theme.PANEL)[either]
    none = folder_colors(Folders(), np.array([1], np.int32))
    palette = group_colors(np.arange(1, 300, dtype=np.int32))
    for color in (*none, (0, 0, 0), (1, 1, 1), panel[:3], *palette):
        rim = theme.rim(color)
        seen = values(rim)[either] if rim is not None else color
        assert contrast(seen, panel) >= 3, color
    assert theme.rim(panel[:3]) is not None
    plain = [contrast(color, panel) >= 3 for color in palette]
    assert [theme.rim(color) is None for color in palette] == plain, "no rim that is not needed"


# --- Names in Arabic and Hebrew as they are drawn from left to right.


@pytest.mark.parametrize("name", ["bad\x1b name.ply", "a\nb", "a\u202eb", "\ud800", "a\x9bb"])
def test_names_are_drawn_as_notices_and_the_command_show_them(name: str) -> None:
    assert visual(name) == plain_text(name)
    with_icon = f"{icons.FILE_PLAIN}  {visual(name)}"
    assert theme.plain(with_icon) == with_icon
    assert theme.plain(f"Two\nlines of {visual(name)}") == f"Two\nlines of {plain_text(name)}"


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


# --- What the status bar says: who computes and why, and that kernels are compiled in the quiet.


@pytest.fixture(autouse=True)
def _look_again() -> None:
    status._look.cache_clear()


def test_it_names_the_backend_and_the_reason() -> None:
    name, reason = backend_report(wait=False)
    found = status.backend()
    assert (found.name, found.reason) == (name.upper(), reason)
    assert found.sentence.endswith(f"{reason}.")
    assert name.upper() in found.sentence


def test_a_choice_by_the_user_is_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GAGA_BACKEND", "cpu")
    assert status.backend() == status.Backend("CPU", "GAGA_BACKEND says so")


def test_it_is_not_asked_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def report(*, wait: bool) -> tuple[str, str]:
        asked.append(wait)
        return "cuda", "a card"

    monkeypatch.setattr(status, "backend_report", report)
    monkeypatch.setattr(status, "_LOOK_EVERY", 1e9)
    assert {status.backend() for _ in range(100)} == {status.Backend("CUDA", "a card")}
    assert asked == [False]  # and no self-test is started


def test_kernels_are_compiled_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With progress that names its steps; what is compiled in this process costs nothing again."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))  # where the note of the end is kept
    seen: list[Progress] = []
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))
    rates = KnownRates()
    run_stage(stages.kernels_stage(rates), seen.append)
    assert {step.stage for step in seen} == {"Prepare kernels"}
    assert len({step.message for step in seen}) > 5
    assert kernels.is_compiled()
    assert list(stages.kernels_stage(rates)) == []
    assert 0 < rates.of("Prepare kernels") < 1, "no time here: it was compiled before"
    assert KnownRates().rates == rates.rates, "kept"


def test_opening_a_scene_prepares_the_kernels_beside(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started: list[str] = []
    write_scene(tmp_path / "scene", n_objects=2)
    session = new_session(Settings())
    monkeypatch.setattr(session.jobs, "prepare", lambda title, stage: started.append(title))
    session.open(tmp_path / "scene")
    assert session.jobs.wait()
    session.tick(0.1)
    assert session.scene is not None
    assert started == ["Prepare kernels"]
    assert session.jobs.running is None


def test_the_title_says_what_runs_once_a_second_and_goes_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path))
    session, title = new_session(Settings()), status.WindowTitle()
    turn, heard = threading.Semaphore(0), threading.Semaphore(0)
    total = 400  # steps, more than frames

    def stage() -> Stage[None]:
        for done in range(total):
            assert turn.acquire(timeout=60)
            yield Progress("Train", done, total)
            heard.release()

    def walk(begin: float, seconds: int) -> list[str]:
        """The title of each frame, sixty a second, after one step of the task each."""
        found = []
        for k in range(60 * seconds):
            turn.release()
            assert heard.acquire(timeout=60)
            found.append(title.text(session, begin + k / 60))
        return found

    assert title.text(session, 10.0) == "gaga-studio"
    assert session.jobs.start("Make splats", stage())
    first, rest = walk(10.0, 1), walk(11.0, 5)
    assert set(first) == {"gaga-studio"}, "not yet of one that may end at once"
    changes = [k for k, (one, two) in enumerate(itertools.pairwise(rest)) if one != two]
    assert len(changes) == 4
    assert all(two - one >= 59 for one, two in itertools.pairwise(changes))
    assert all(re.fullmatch(r"\d+ % Make splats - gaga-studio", text) for text in rest)
    turn.release(total)
    assert session.jobs.wait()
    assert title.text(session, 99.0) == "gaga-studio"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.2, "under a minute"),
        (59, "under a minute"),
        (61, "about 1 min"),
        (200, "about 3 min"),
        (7300, "about 2 h"),
    ],
)
def test_a_running_job_says_what_how_far_and_how_long(seconds: float, text: str) -> None:
    job = Job("Find objects", "Find objects", "", -1.0, None, False, False)
    assert status.job_text(job) == "Find objects", "not known how far"
    prepares = replace(job, stage="Prepare kernels")
    assert status.job_text(prepares) == "Find objects: prepare kernels"
    job = replace(job, fraction=0.456)
    assert status.job_text(job) == "Find objects  46 %"
    assert status.job_text(replace(job, eta_s=seconds)) == f"Find objects  46 %, {text} left"
    assert status.job_text(replace(job, is_cancelling=True)) == "Find objects: stopping"


def _fits(room: int, text: str) -> bool:
    return len(text) <= room


@pytest.mark.parametrize(
    "stem", ["orange object in front", "a", "cup 2", "white-box-small-in-front"]
)
def test_a_name_is_cut_in_its_middle(stem: str) -> None:
    """A .glb and a .usd of one name were both "orange object in ..."."""
    for ending in (".glb", ".usd", ".gaga", ""):
        name = f"{stem}{ending}"
        for room in range(len(ending) + 2, len(name) + 3):
            shown = widgets.cut_middle(name, partial(_fits, room))
            assert len(shown) == min(len(name), room)
            assert shown.endswith(ending)
            before, _, after = shown.partition("…")
            assert name.startswith(before)
            assert name.endswith(after)
            if room < len(name):
                assert len(after) >= len(before) - 1, "its end is as much of it"
