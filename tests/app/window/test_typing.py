"""What was typed is what happens, however slow the frames are: real X11 events, real window."""

from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from imgui_bundle import imgui

from gaga_core.progress import Progress, Stage
from gaga_core.scene.scene import State
from gaga_studio.features.commands import new_session
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.selection import select_groups
from gaga_studio.session.document import Document
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName
from gaga_studio.studio import Studio
from gaga_studio.system.window import WindowOptions
from tests.app.window.typist import Stroke, strokes, type_into

pytestmark = pytest.mark.window
SCRIPT = [
    # Ctrl+A with Ctrl let go first: the A that is still down does not fly.
    ("Control_L", True), ("a", True), ("Control_L", False), ("a", False),
    # Two tools, the second before the first is let go: the second stays.
    ("r", True), ("b", True), ("r", False), ("b", False),
    # A letter, then a chord before it is let go: M, then Ctrl+Z; never Ctrl+M.
    ("m", True), ("Control_L", True), ("m", False), ("z", True), ("z", False), ("Control_L", False),
    *strokes("Control_L+a"),
    # What is typed into the list of commands reaches no tool and no camera.
    *strokes("Control_L+p l a s s o Return"),
    *strokes("m"),
]  # fmt: skip


def _see(studio: Studio) -> dict[str, Any]:
    session = studio.session
    return {
        "tool": session.tool,
        "mode": session.view.mode,
        "splats": len(session.need().scene),
        "selected": len(session.selected_indices()),
        "history": [entry.title for entry in session.need().history.entries()],
        "pose": session.rig.camera(64, 64).cam_from_world.round(9).tolist(),
    }


@pytest.mark.parametrize(("in_a_frame", "frame_s"), [(1, 0.005), (6, 0.2), (len(SCRIPT), 1.5)])
def test_a_typed_script_gives_the_same_result_at_any_frame_rate(
    display: str, grouped_copy: Path, in_a_frame: int, frame_s: float
) -> None:
    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    before, after = type_into(studio, SCRIPT, in_a_frame=in_a_frame, frame_s=frame_s, see=_see)
    wanted = {"tool": ToolName.LASSO, "mode": list(Mode)[2], "history": ["Select all"]}
    assert after == {**before, **wanted, "selected": before["splats"]}


def test_a_mouse_that_comes_back_where_it_left_is_there(display: str, grouped_copy: Path) -> None:
    """GLFW says nothing of the same place: a click there did nothing until the mouse moved."""
    script: list[Stroke] = [("Mouse", (0.25, 0.25)), ("Rest", True), ("Inside", False)]
    script += [("Rest", True), ("Inside", True)]
    studio = Studio(grouped_copy, session=new_session(Settings(first_steps_done=True)))

    def place(_: Studio) -> tuple[float, float]:
        return imgui.get_io().mouse_pos.x, imgui.get_io().mouse_pos.y

    _, there, gone, back = type_into(studio, script, in_a_frame=1, frame_s=0.05, see=place)
    assert gone != there
    assert back == there


@pytest.mark.parametrize(
    ("keys", "wanted"),
    [
        ("Return", {"quits": True, "unsaved": False}),
        # The Enter that opens the question does not answer it.
        ("Escape Control_L+p q u i t Return", {"quits": False, "unsaved": True}),
        ("Escape b", {"tool": ToolName.BRUSH}),
        ("Escape Control_L+z", {"undo": "Select all"}),
    ],
)
def test_alt_f4_leaves_the_keyboard_alive(
    display: str, grouped_copy: Path, keys: str, wanted: dict[str, Any]
) -> None:
    """Alt goes down, the window is asked to close; the release goes to the window manager."""
    script = [*strokes("Control_L+a m Delete"), ("Alt_L", True), ("Close", True), ("Rest", True)]

    def see(studio: Studio) -> dict[str, Any]:
        session = studio.session
        return {
            **_see(studio),
            "quits": session.should_quit,
            "unsaved": session.unsaved,
            "undo": history.undo_title if (history := session.history) else "",
        }

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    *_, after = type_into(studio, [*script, *strokes(keys)], in_a_frame=1, frame_s=0.02, see=see)
    assert {name: after[name] for name in wanted} == wanted


def _along(places: list[tuple[float, float]], n: int = 40) -> list[Stroke]:
    """A left drag through ``places`` in ``n`` steps, as a mouse tells it."""
    at = np.linspace(0, len(places) - 1, n)
    way = [np.interp(at, range(len(places)), [place[i] for place in places]) for i in (0, 1)]
    moves: list[Stroke] = [("Mouse", (float(u), float(v))) for u, v in zip(*way, strict=True)]
    return [moves[0], ("Button1", True), *moves[1:], ("Button1", False)]


GESTURES = {
    "r": _along([(0.02, 0.3), (0.6, 0.97)]),
    "l": _along([(0.1, 0.2), (0.7, 0.3), (0.6, 0.9), (0.12, 0.8), (0.11, 0.22)]),
    "b": _along([(0.2, 0.4), (0.7, 0.6), (0.2, 0.7)]),
    "Escape": _along([(0.3, 0.4), (0.6, 0.45)]),  # an orbit
}


def _chosen(studio: Studio) -> dict[str, Any]:
    session = studio.session
    pose = session.rig.camera(64, 64).cam_from_world.round(6).tolist()
    return {"chosen": session.selected_indices().tolist(), "pose": pose}


def _gestures(scene: Path, in_a_frame: int, frame_s: float) -> list[Any]:
    session = new_session(Settings(first_steps_done=True))
    session.view.takes_splats = True
    studio = Studio(scene, session=session, options=WindowOptions(size=(800, 500)))
    drags = [
        [*strokes(key), ("Rest", True), *drag, ("Rest", True)] for key, drag in GESTURES.items()
    ]
    script = [stroke for drag in drags for stroke in drag]
    return type_into(studio, script, in_a_frame=in_a_frame, frame_s=frame_s, see=_chosen)


def test_fast_drags_do_what_slow_ones_do(display: str, grouped_copy: Path) -> None:
    """Streams of 42 events in 0.1 to 2 s, at frames of 10 ms to 1 s."""
    slow = _gestures(grouped_copy, 1, 0.01)
    taken = [len(seen["chosen"]) for seen in slow]
    assert len(set(taken[2:7:2])) == 3, "each tool selects something else"
    assert min(taken[2:7:2]) > 10
    assert slow[-1]["pose"] != slow[0]["pose"], "it orbits"
    for in_a_frame, frame_s in ((8, 0.2), (42, 1.0)):
        fast = _gestures(grouped_copy, in_a_frame, frame_s)
        assert [len(seen["chosen"]) for seen in fast] == taken, (in_a_frame, frame_s)
        assert fast == slow, (in_a_frame, frame_s)


def _describe_as(document: Document, words: str) -> None:
    """What the chosen group is called from now on, whether it has been measured or will be."""
    search = document.feature(SearchState)
    search.words = {**search.words, document.history.state_id: {document.focus: words}}


@pytest.mark.parametrize(
    ("keys", "names", "unsaved"),
    [
        ("Return", [], False),  # nothing was typed: nothing is named
        ("Escape", [], False),  # nor does it bring back what the box was opened with
        ("m Control_L+z Return", [], False),  # undo belongs to the field
        ("m u g Control_L+s", ["mug"], False),
        ("m u g Control_L+p", ["mug"], True),
        ("End s Return", ["orange things"], True),
        ("Control_L+s", [], False),
    ],
)
def test_a_name_that_is_typed_is_kept_by_what_is_done_next(
    display: str, grouped_copy: Path, keys: str, names: list[str], unsaved: bool
) -> None:
    """Ctrl+S in the field enters the name and saves.
    A field that nobody touched shows the name that comes while it is open."""

    def see(studio: Studio) -> dict[str, Any]:
        document, rows = studio.session.need(), studio.ui.scene.objects.rows
        if not studio.session.selected_groups():
            select_groups(studio.session, (1,))
        seen = {
            "names": list(document.scene.names.values()),
            "unsaved": document.unsaved,
            "is_open": rows.renaming is not None,
            "text": rows.text,
        }
        if rows.renaming is not None and not document.scene.names:  # as when it is described
            _describe_as(document, "orange thing")
        return seen

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    rest: Stroke = ("Rest", True)
    script = [*strokes("F2"), rest, rest, *strokes(keys)]
    _, opened, described, after = type_into(studio, script, in_a_frame=1, frame_s=0.02, see=see)
    assert opened["is_open"]
    assert described["is_open"]
    assert opened["text"] != described["text"] == "orange thing"
    del after["text"]
    assert after == {"names": names, "unsaved": unsaved, "is_open": False}


def test_a_search_is_typed_while_objects_are_found(display: str, scene_folder: Path) -> None:
    """Ctrl+F did nothing and said nothing, and the letters were keys: one moved, one colored."""
    session = new_session(Settings(first_steps_done=True))

    def finds() -> Stage[None]:
        pause = Event()
        for _ in range(1000):  # until all is typed, or it will not be
            yield Progress("Find objects", 0, 1)
            pause.wait(0.01)
            if session.need().feature(SearchState).text == "mug":
                return

    def see(studio: Studio) -> dict[str, Any]:
        text = session.need().feature(SearchState).text
        if not text:
            session.jobs.start("Find objects", finds())
        return {"text": text, "tool": session.tool, "mode": session.view.mode}

    studio = Studio(scene_folder, session=session, options=WindowOptions(size=(800, 500)))
    script = strokes("Control_L+f m u g")
    *_, after = type_into(studio, script, in_a_frame=1, frame_s=0.02, see=see)
    assert after == {"text": "mug", "tool": ToolName.PICK, "mode": Mode.COLOR}


@pytest.mark.parametrize(("before", "name"), [("m u", "mug"), ("End", None)])
def test_a_name_that_is_being_typed_is_left_alone(
    display: str, grouped_copy: Path, before: str, name: str | None
) -> None:
    """What has a description while the field is edited, or the cursor moved in it, keeps both."""

    def see(studio: Studio) -> tuple[str, dict[int, str]]:
        document, rows = studio.session.need(), studio.ui.scene.objects.rows
        if not studio.session.selected_groups():
            select_groups(studio.session, (1,))
        if rows.text:
            _describe_as(document, "orange thing")
        return rows.text, dict(document.scene.names)

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    rest: Stroke = ("Rest", True)
    script = [*strokes(f"F2 {before}"), rest, rest, *strokes("g Return" if name else "Return")]
    *_, typed, described, after = type_into(studio, script, in_a_frame=1, frame_s=0.02, see=see)
    assert described[0] == typed[0]
    assert list(after[1].values()) == ([name] if name else [])


@pytest.mark.parametrize("keys", ["F2 m u g Return", "Control_L+f m u g Return"])
@pytest.mark.parametrize("hidden", ["", "Tab "], ids=["covered", "hidden"])
def test_a_field_in_an_unseen_list_comes_to_the_front_and_gets_what_is_typed(
    display: str, grouped_copy: Path, hidden: str, keys: str
) -> None:
    """It opened under another panel, and "mug" went to the picture, as keys."""

    def see(studio: Studio) -> tuple[list[str], str]:
        session = studio.session
        if not session.selected_groups():
            select_groups(session, (1,))
            session.view.asked_panel = "History"  # in the place of the list
        document = session.need()
        return list(document.scene.names.values()), document.feature(SearchState).text

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    rest: Stroke = ("Rest", True)
    script = [rest, *strokes(hidden + keys)]
    *_, after = type_into(studio, script, in_a_frame=len(script), frame_s=0.5, see=see)
    assert after == ((["mug"], "") if keys.startswith("F2") else ([], "mug"))


_CLICK: list[Stroke] = [("Button1", True), ("Button1", False)]


@pytest.mark.parametrize(
    ("script", "moved"),
    [
        (strokes("g x 2 Return"), (2.0, 0.0, 0.0)),
        ([*strokes("g x x y minus 1 period 5"), ("Rest", True), *strokes("Return")], (0, -1.5, 0)),
        (strokes("g x Escape"), None),
        (strokes("g x 9 Escape g x 2 Return"), (2.0, 0.0, 0.0)),  # the mouse has not moved
        (strokes("r z 9 0 Escape"), None),
        (strokes("g x 2 Control_L+s"), (2.0, 0.0, 0.0)),  # applied and saved
        (strokes("g x 2 Control_L+Shift_L+s Return"), (2.0, 0.0, 0.0)),
        ([*strokes("g z"), ("Mouse", (0.6, 0.3)), ("Rest", True), *_CLICK], "up"),
    ],
)
def test_g_r_and_s_of_blender_follow_the_mouse_and_no_key_deletes(
    display: str, grouped_copy: Path, script: list[Stroke], moved: Any
) -> None:
    def see(studio: Studio) -> Any:
        session = studio.session
        if not session.selected_groups():
            select_groups(session, (1,))
        centre, history = session.need().selected_centre(), session.need().history
        assert not session.need().scene.has(State.DELETED).any()
        return centre, history.cursor, history.is_previewing, studio.picture.follow_hint

    session = new_session(Settings(first_steps_done=True, keys="blender"))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    at_rest: list[Stroke] = [("Mouse", (0.5, 0.5)), ("Rest", True)]
    before, *_, shown, (centre, n_done, is_previewing, hint) = type_into(
        studio, [*at_rest, *script], in_a_frame=1, frame_s=0.02, see=see
    )
    if moved == (0, -1.5, 0):
        assert shown[-1].startswith("Move -1.5 along Y: Enter applies")
    assert (is_previewing, hint) == (False, "")
    assert n_done == (1 if moved is None else 2)
    keys = {key for key, _ in script}
    if "Control_L" in keys:
        assert session.need().unsaved is ("Shift_L" in keys), "Ctrl+S applies and saves, no other"
    way = centre - before[0]
    if moved == "up":
        assert np.abs(way[:2]).max() < 1e-6
        assert abs(way[2]) > 0.05
    else:
        np.testing.assert_allclose(way, moved or (0, 0, 0), atol=1e-5)


@pytest.mark.parametrize(
    ("keys", "titles", "moved"),
    [
        ("Escape", ["Duplicate"], (0, 0, 0)),  # the copy stays where the original is
        ("x 2 Return", ["Duplicate", "Move"], (2, 0, 0)),
    ],
)
def test_shift_d_of_blender_makes_a_copy_that_follows_the_mouse(
    display: str, grouped_copy: Path, keys: str, titles: list[str], moved: Any
) -> None:
    def see(studio: Studio) -> Any:
        session = studio.session
        if not session.need().history.can_undo:
            select_groups(session, (1,))
        document = session.need()
        done = [entry.title.split()[0] for entry in document.history.entries()]
        of_first = document.scene.labels == 1
        return document.selected_centre(), document.read.selected_groups(), done, of_first.sum()

    session = new_session(Settings(first_steps_done=True, keys="blender"))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    away: list[Stroke] = [("Mouse", (0.6, 0.3)), ("Rest", True)]
    script = [*away, *strokes("Shift_L+d"), ("Mouse", (0.4, 0.5)), *strokes(keys)]
    first, _, (centre, selected, done, n) = type_into(
        studio, script, in_a_frame=1, frame_s=0.02, see=see
    )
    assert done == ["Select", *titles]
    assert n == first[-1]
    assert first[1] == (1,) != selected
    np.testing.assert_allclose(centre - first[0], moved, atol=1e-5)
    assert not studio.picture.is_following


def test_home_goes_back_and_the_whole_scene_keeps_the_direction(
    display: str, grouped_copy: Path
) -> None:
    def see(studio: Studio) -> dict[str, Any]:
        pose = studio.session.rig.pose
        lens = {name: getattr(pose, name) for name in ("distance", "roll", "fov_x", "fov_y")}
        return {"turn": (pose.yaw, pose.pitch), "pivot": list(pose.pivot), **lens}

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    rest: Stroke = ("Rest", True)
    drag = [*_along([(0.3, 0.4), (0.6, 0.45)]), rest]
    script = [*drag, *strokes("Shift_L+f"), rest, *strokes("Home")]
    start, turned, whole, home = type_into(studio, script, in_a_frame=1, frame_s=0.02, see=see)
    assert start["turn"] != turned["turn"] == pytest.approx(whole["turn"])
    assert whole["distance"] != pytest.approx(turned["distance"])
    assert home == {name: pytest.approx(value) for name, value in start.items()}
    assert session.active_view == 0


@pytest.mark.parametrize(
    ("keys", "script"),
    [
        ("supersplat", "Control_L+d Control_L+Shift_L+a"),
        ("blender", "Control_L+d Control_L+Shift_L+a"),
        ("blender", "Shift_L+d Escape Alt_L+a"),
    ],
)
def test_one_chord_duplicates_and_another_deselects(
    display: str, grouped_copy: Path, keys: str, script: str
) -> None:
    def see(studio: Studio) -> tuple[int, list[str]]:
        document = studio.session.need()
        if not document.history.can_undo:
            select_groups(studio.session, (1,))
        titles = [entry.title.split()[0] for entry in document.history.entries()]
        return len(document.scene), [*titles, str(len(studio.session.selected_indices()))]

    session = new_session(Settings(first_steps_done=True, keys=keys))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    both = strokes(script)
    (before, _), (after, seen) = type_into(studio, both, in_a_frame=1, frame_s=0.02, see=see)
    assert after > before
    assert seen == ["Select", "Duplicate", "Select", "0"]


@pytest.mark.parametrize(
    "typed", ["", "space space", pytest.param("o b j Return", id="obj, Enter")]
)
def test_escape_clears_the_search_and_leaves_it_where_it_is_empty(
    display: str, grouped_copy: Path, typed: str
) -> None:
    """Once it has left, keys are the view's: B is the brush, and not a word to look for."""

    def see(studio: Studio) -> tuple[str, bool, bool]:
        session = studio.session
        is_typing = imgui.get_io().want_text_input
        return session.need().feature(SearchState).text, is_typing, session.tool is ToolName.BRUSH

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    rest: Stroke = ("Rest", True)
    script = [*strokes(f"Control_L+f {typed}"), rest, *strokes("Escape"), rest]
    script += [*strokes("Escape b" if typed else "b"), rest]
    _, found, cleared, left, _ = type_into(studio, script, in_a_frame=1, frame_s=0.02, see=see)
    assert (bool(found[0]), found[1]) == (bool(typed), True)
    assert cleared == ("", bool(typed), False)
    assert left == ("", False, True)


def test_a_function_key_leaves_the_search_box(display: str, grouped_copy: Path) -> None:
    """F3 did nothing there, and what was typed next went into the search."""

    def see(studio: Studio) -> tuple[str, bool]:
        search = studio.session.need().feature(SearchState)
        return search.text, imgui.is_popup_open("", imgui.PopupFlags_.any_popup)

    session = new_session(Settings(first_steps_done=True))
    studio = Studio(grouped_copy, session=session, options=WindowOptions(size=(800, 500)))
    rest: Stroke = ("Rest", True)
    script = [*strokes("Control_L+f r e d"), rest, *strokes("F3"), rest, rest, *strokes("x"), rest]
    seen = type_into(studio, script, in_a_frame=1, frame_s=0.02, see=see)
    assert seen[1] == ("red", False)
    assert seen[-1] == ("red", True)
