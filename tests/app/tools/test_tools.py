"""Tools and pointing: a gesture is one edit at its end, Escape is none."""

import time
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.by_volume import SurfacePoint, map_between
from gaga_core.scene.tint import mean_color
from gaga_studio.features import objects, selection, split_view, transform
from gaga_studio.features.commands import command, for_shortcut, run
from gaga_studio.features.find import association, click_object, memory_bank
from gaga_studio.session.session import NO_GROUPS, Session
from gaga_studio.session.view import PhotoCompareMode, Side, ToolName
from gaga_studio.tools.base import RectShape
from gaga_studio.tools.controller import ToolController
from gaga_studio.tools.gestures import KeyState
from gaga_studio.ui.chrome.status import status_text
from tests.app.looks import snapshot
from tests.app.tools.hand import H, Hand, W, state, surface, titles


def _pixels(session: Session, group: int) -> DoubleArray:
    """Where the splats of a group are drawn (K, 2)."""
    points = world_means(session.need().scene, group_indices(session.need().scene, group)).astype(
        np.float64
    )
    return session.rig.camera(W, H).project(points)[0]


def _objects(session: Session) -> IntArray:
    ids = session.objects().ids
    return ids[ids > 0]


def _apart(session: Session) -> tuple[int, DoubleArray]:
    """An object that can be clicked at its middle, and that pixel (pixel centre)."""
    for group in _objects(session):
        middle = np.floor(_pixels(session, int(group)).mean(axis=0)) + 0.5
        found = session.pick(float(middle[0]), float(middle[1]), W, H)
        if found is not None and found.group == group:
            return int(group), middle
    raise AssertionError("no object can be clicked")


def test_click_selects_the_whole_object(associated: Session) -> None:
    hand = Hand(associated)
    group, at = _apart(associated)
    hand.click_at(at)
    assert associated.selected_groups() == (group,)
    np.testing.assert_array_equal(
        associated.selected_indices(), group_indices(associated.need().scene, group)
    )
    assert titles(associated)[-1] == "Select an object"  # it has no name yet
    assert associated.focus == group


def test_what_shows_an_earlier_scene_is_only_looked_at(associated: Session) -> None:
    session, hand = associated, Hand(associated)
    group, at = _apart(session)
    selection.select_groups(session, (group,))
    assert transform.recolor(session, (0.0, 1.0, 0.0))
    split_view.compare_version(session, 0)
    for line, selected in ((1.0, ()), (0.0, (group,))):  # right of the object, then left of it
        session.view.swipe = line
        selection.select_groups(session, ())
        session.notices = session.notices[:0]
        hand.click_at(at)
        assert session.selected_groups() == selected
        assert ["as it was" in notice.text for notice in session.notices] == [True] * (not selected)
    session.view.swipe = 1.0
    session.view.holds_photo = True
    assert split_view.earlier_to(session, W, H) == 0, "the photo lies over both"
    session.view.holds_photo = False
    session.view.sides = Side.BEFORE, Side.PICTURE
    assert split_view.earlier_to(session, W, H) == W
    while session.undo():
        pass
    assert split_view.earlier_to(session, W, H) == 0, "nothing earlier is drawn"


def test_a_rectangle_ends_at_the_line_of_compare(associated: Session) -> None:
    session, hand = associated, Hand(associated)
    assert session.need().do(edits.hide(session.need().scene, np.arange(3, dtype=np.int32)))
    split_view.compare_version(session, 0)
    session.view.swipe, session.tool = 0.5, ToolName.RECT
    session.view.takes_splats = True
    right, left = np.array([W - 5.0, 5.0]), np.array([5.0, H - 5.0])
    hand.press(*right)
    hand.move(0.6 * W, 0.5 * H)
    hand.move(*left)
    shape = hand.controller.overlay
    assert isinstance(shape, RectShape)
    assert min(shape.u0, shape.u1) == 0.6 * W, "it shows where it was right of the line"
    hand.release()
    first = session.selected_indices()
    session.view.compare = PhotoCompareMode.OFF
    hand.drag(right, np.array([0.5 * W, H - 5.0]))
    np.testing.assert_array_equal(first, session.selected_indices())


def test_shift_adds_control_removes_and_a_click_on_nothing_clears(associated: Session) -> None:
    hand = Hand(associated)
    group, at = _apart(associated)
    other = next(int(g) for g in _objects(associated) if g != group)
    selection.select_groups(associated, (other,))
    hand.click_at(at, KeyState(shift=True))
    assert set(associated.selected_groups()) == {group, other}
    hand.click_at(at, KeyState(ctrl=True))
    assert associated.selected_groups() == (other,)
    associated.rig.zoom(-20)
    hand.click(1.5, 1.5, KeyState(shift=True))
    assert associated.selected_groups() == (other,)
    hand.click(1.5, 1.5)
    assert associated.selected_groups() == ()


@pytest.mark.parametrize("takes_splats", [False, True])
@pytest.mark.parametrize("tool", [ToolName.RECT, ToolName.LASSO, ToolName.BRUSH, ToolName.ERASE])
def test_a_region_of_locked_things_says_so(
    associated: Session, tool: ToolName, takes_splats: bool
) -> None:
    """It selected nothing and said nothing."""
    associated.view.takes_splats = takes_splats
    for group in associated.objects().ids.tolist():
        if group > 0:
            objects.set_locked(associated, group, True)
    associated.tool = tool
    assert "ocked" in _swept(associated)
    assert associated.selected_groups() == ()
    assert run("object.unlock_all", associated)
    before = associated.need().history.cursor
    assert "ocked" not in _swept(associated)
    assert associated.need().history.cursor == before + 1


@pytest.mark.parametrize("tool", [ToolName.RECT, ToolName.LASSO, ToolName.POLYGON, ToolName.BRUSH])
def test_a_region_of_splats_of_no_object_says_so(associated: Session, tool: ToolName) -> None:
    """It selected nothing and said nothing; a click on the same said what to do."""
    scene = associated.need().scene
    chosen = group_indices(scene, [int(_objects(associated)[0])])
    rest = np.setdiff1d(np.arange(len(scene)), chosen)
    associated.edit(lambda scene: edits.set_labels(scene, rest, 0, "Ungroup"))
    associated.edit(lambda scene: edits.hide(scene, chosen))
    associated.tool = tool
    assert _swept(associated) == selection.NO_OBJECTS
    assert len(associated.selected_indices()) == 0
    associated.view.takes_splats = True
    assert _swept(associated) != selection.NO_OBJECTS
    assert len(associated.selected_indices()) > 0
    associated.rig.zoom(-20)
    associated.view.takes_splats = False
    selection.select_none(associated)
    assert _swept(associated, 4.0) != selection.NO_OBJECTS, "nothing is there"


def test_a_rectangle_around_less_than_half_of_an_object_says_so(associated: Session) -> None:
    scene = associated.need().scene
    associated.edit(lambda scene: edits.set_labels(scene, np.arange(len(scene)), 1, "Group"))
    associated.tool, hand = ToolName.RECT, Hand(associated)
    u, v = np.floor(_pixels(associated, 1).mean(axis=0))
    hand.press(u - 12, v - 12)
    hand.move(u + 12, v + 12)
    hand.release()
    assert len(associated.selected_indices()) == 0 < len(scene)
    assert status_text(associated, hand.controller.tool(associated)) == selection.LESS_THAN_HALF


@pytest.mark.parametrize("edge", [0.75, 0.9, 1.5])
def test_a_brush_over_loose_splats_says_so_whatever_its_rim_touches(
    associated: Session, edge: float
) -> None:
    """It takes what its middle sees; half of an object was asked for."""
    scene, radius = associated.need().scene, 24.0
    associated.view.brush_radius = radius
    pixels, _ = associated.rig.camera(W, H).project(world_means(scene).astype(np.float64))
    _, at = _apart(associated)
    labels = (pixels[:, 0] > at[0] + edge * radius).astype(np.int32)
    associated.edit(lambda scene: edits.set_labels(scene, np.arange(len(scene)), labels, "Group"))
    associated.tool, hand = ToolName.BRUSH, Hand(associated)
    hand.press(at[0], 2)
    hand.move(at[0], H - 3)
    hand.release()
    assert len(associated.selected_indices()) == 0 < labels.sum()
    assert status_text(associated, hand.controller.tool(associated)) == selection.NO_OBJECTS


def _swept(session: Session, side: float = np.inf) -> str:
    """Go over the picture, or a corner of it, with the tool; what is said then."""
    hand, tool = Hand(session), session.tool
    u1, v1 = min(W - 3.0, side), min(H - 3.0, side)
    corners = ((2.0, 2.0), (u1, 2.0), (u1, v1), (2.0, v1), (min(W / 2, side), min(H / 2, side)))
    if tool is ToolName.POLYGON:
        for corner in corners[:4]:
            hand.click(*corner)
        selection.close_outline(session)
    else:
        hand.press(*corners[0])
        for u, v in corners[1:] if tool is not ToolName.RECT else corners[2:3]:
            hand.move(u, v)
        hand.release()
    return status_text(session, hand.controller.tool(session))


@pytest.mark.parametrize("tool", [ToolName.PICK, ToolName.OBJECT])
@pytest.mark.parametrize("keys", [KeyState(), KeyState(shift=True)])
def test_a_click_on_what_is_locked_says_so_until_something_else_is_clicked(
    associated: Session, tool: ToolName, keys: KeyState
) -> None:
    group, at = _apart(associated)
    objects.set_locked(associated, group, True)
    run("object.separate", associated)  # nothing is selected: another thing to say
    associated.tool = tool
    hand = Hand(associated)
    hand.click_at(at, keys)
    assert associated.selected_groups() == ()
    said = status_text(associated, hand.controller.tool(associated))
    assert said == selection.locked_hint(associated.need().name_of(group))
    assert run("object.unlock_all", associated)
    hand.click_at(at, keys)
    assert associated.jobs.wait()
    assert associated.selected_groups() != ()
    assert "ocked" not in status_text(associated, hand.controller.tool(associated))


def test_the_first_click_where_there_are_no_objects_is_the_tool_objects(session: Session) -> None:
    hand, at = Hand(session), surface(session)

    def tool() -> ToolName:
        return session.tool

    pose = session.rig.pose
    session.rig.zoom(-20)
    hand.click(1.5, 1.5)
    assert tool() is ToolName.PICK, "a click on nothing changes no tool"
    session.rig.pose = pose
    hand.click_at(at)
    assert tool() is ToolName.OBJECT
    assert session.jobs.why_busy == "", "preparing clicks holds nothing up"
    assert run("edit.cancel", session)
    assert click_object.waiting(session) == [], "Escape drops what waits"
    hand.click_at(at)
    assert session.jobs.wait()
    assert len(session.selected_indices()) > 0
    assert "Enter makes it an object" in status_text(session, hand.controller.tool(session))
    assert run("object.make", session)
    session.tool = ToolName.PICK
    selection.select_none(session)
    hand.click_at(at)
    assert tool() is ToolName.PICK, "now there is an object to select"
    assert len(session.selected_groups()) == 1


def test_a_tool_that_a_click_took_is_given_back_when_objects_are_found(session: Session) -> None:
    for by_click in (True, False):
        session.tool = ToolName.PICK
        if by_click:
            Hand(session).click_at(surface(session))
        else:
            assert run("tool.object", session)
        assert session.tool is ToolName.OBJECT
        assert run("object.associate", session)
        assert session.jobs.wait()
        assert session.tool is (ToolName.PICK if by_click else ToolName.OBJECT)
        assert run("edit.undo", session)


def test_what_is_said_of_objects_fits_what_is_open(session: Session) -> None:
    assert session.no_groups_text == NO_GROUPS
    session.need().project.folder = None
    text = session.no_groups_text
    assert "tool Object" in text
    assert command("object.hide").enabled(session) != NO_GROUPS
    assert command("file.export_objects").enabled(session) == text
    offer = association.stage_offer(session)
    assert offer is not None
    assert offer.reason == text


def test_masks_are_of_what_is_selected(associated: Session) -> None:
    """Not of what was; a part that was cut off shows the masks that made the whole."""
    hand = Hand(associated)
    group, at = _apart(associated)
    hand.click_at(at)
    assert memory_bank.group_of_panel(associated) == group
    assert memory_bank.made_from(associated, group) == group
    assert memory_bank.split_from(associated, group) == 0
    rows = associated.selected_indices()
    document = associated.need()
    document.select(rows[: len(rows) // 3], "set", "A part")
    objects.separate(associated)
    part = int(document.scene.labels[rows[0]])
    assert part != group
    selection.select_groups(associated, (part,))
    assert memory_bank.group_of_panel(associated) == part
    assert not associated.decisions(part)
    assert memory_bank.made_from(associated, part) == group
    assert memory_bank.split_from(associated, group) == 1
    assert memory_bank.split_from(associated, part) == 0
    assert not memory_bank.is_copy(document, part)
    assert run("edit.duplicate", associated)
    (copy,) = associated.selected_groups()
    assert memory_bank.made_from(associated, copy) == group
    assert memory_bank.split_from(associated, group) == 1
    assert memory_bank.is_copy(document, copy), "it was never a part of it"
    associated.undo()
    objects.hide(associated)
    assert memory_bank.group_of_panel(associated) == 0
    selection.select_none(associated)
    assert associated.focus
    assert memory_bank.group_of_panel(associated) == 0
    selection.select_groups(associated, (group,))
    associated.need().focus = 0
    assert memory_bank.group_of_panel(associated) == group, "the only one that is selected"


def test_drag_with_the_pick_tool_orbits_and_edits_nothing(associated: Session) -> None:
    hand = Hand(associated)
    _, at = _apart(associated)
    before, listed = associated.rig.pose, titles(associated)
    hand.drag(at, at + np.array([60.0, 10.0]))
    assert associated.rig.pose.yaw != before.yaw
    assert titles(associated) == listed


def test_double_click_turns_around_the_surface(associated: Session) -> None:
    hand = Hand(associated)
    _, at = _apart(associated)
    found = associated.pick(float(at[0]), float(at[1]), W, H)
    assert found is not None
    hand.press(at[0], at[1], is_double=True)
    hand.release()
    while associated.rig.update(0.05):
        pass
    np.testing.assert_allclose(associated.rig.pivot, found.point, atol=1e-6)


def test_rectangle_selects_the_objects_inside(associated: Session) -> None:
    hand = Hand(associated)
    associated.tool = ToolName.RECT
    group, _ = _apart(associated)
    most = np.percentile(_pixels(associated, group), [10, 90], axis=0)
    hand.drag(most[0], most[1])
    assert group in associated.selected_groups()
    assert len(associated.selected_groups()) < len(_objects(associated))
    assert len(titles(associated)) == 1
    hand.drag(np.array([1.0, 1.0]), np.array([W - 1.0, H - 1.0]))
    assert set(associated.selected_groups()) == set(_objects(associated).tolist())
    hand.drag(np.array([1.0, 1.0]), np.array([W - 1.0, H - 1.0]), KeyState(ctrl=True))
    assert associated.selected_groups() == ()
    assert len(titles(associated)) == 3


def test_rectangle_takes_single_splats_when_told_so(associated: Session) -> None:
    hand = Hand(associated)
    associated.tool = ToolName.RECT
    associated.view.takes_splats = True
    hand.drag(np.array([100.0, 100.0]), np.array([300.0, 250.0]))
    chosen = associated.selected_indices()
    points = world_means(associated.need().scene).astype(np.float64)
    pixels, depth = associated.rig.camera(W, H).project(points)
    lo, hi = np.array([100, 100]), np.array([300, 250])
    inside = ((pixels >= lo) & (pixels <= hi)).all(axis=1) & (depth > 0.01)
    np.testing.assert_array_equal(chosen, np.flatnonzero(inside))
    assert len(chosen) > 0


def test_the_rectangle_is_drawn_while_it_is_dragged_and_escape_forgets_it(
    associated: Session,
) -> None:
    hand = Hand(associated)
    associated.tool = ToolName.RECT
    before = state(associated)
    hand.press(10.0, 20.0)
    assert hand.controller.overlay is None
    hand.move(400.0, 300.0)
    shape = hand.controller.overlay
    assert shape is not None
    assert (shape.u0, shape.v0, shape.u1, shape.v1) == (10, 20, 400, 300)
    assert hand.controller.cancel(associated)
    assert hand.controller.overlay is None
    hand.play(u=500.0)
    hand.release()
    assert state(associated) == before
    assert titles(associated) == []


def test_another_tool_ends_the_gesture(associated: Session) -> None:
    hand = Hand(associated)
    associated.tool = ToolName.RECT
    hand.press(10.0, 20.0)
    hand.move(400.0, 300.0)
    associated.tool = ToolName.PICK
    hand.play(u=410.0)
    hand.release()
    assert hand.controller.overlay is None
    assert titles(associated) == []
    hand.play(left=True)
    hand.play(u=450.0)
    pose = associated.rig.pose
    associated.tool = ToolName.RECT
    hand.play(u=500.0)
    assert associated.rig.pose is pose  # the orbit has ended, too


@pytest.mark.parametrize("name", [ToolName.MOVE, ToolName.ROTATE, ToolName.SCALE])
def test_a_drag_of_the_handles_is_one_edit(associated: Session, name: ToolName) -> None:
    tool = ToolController().move_tools[name]
    group, _ = _apart(associated)
    assert tool.handles(associated) is None
    selection.select_groups(associated, (group,))
    scene, handles = associated.scene, tool.handles(associated)
    assert scene is not None
    assert handles is not None
    splats = group_indices(scene, group)
    start, before = world_means(scene, splats).astype(np.float64), state(associated)
    tool.begin(associated)
    end = handles.copy()
    for step in range(1, 4):
        end = handles.copy()
        if name is ToolName.MOVE:
            end[:3, 3] += [0.1 * step, 0, 0]
        elif name is ToolName.ROTATE:
            end[:2, :2] = [[0, -1], [1, 0]]
        else:
            end[:3, :3] *= 1 + 0.2 * step
        tool.move_to(associated, end)
        assert associated.is_previewing
        np.testing.assert_array_equal(tool.handles(associated), handles)  # they stand still
    motion = end @ np.linalg.inv(handles)
    assert tool.finish(associated)
    assert not associated.is_previewing
    assert titles(associated)[1:] == [f"{name.title()} an object"]
    wanted = start @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(world_means(scene, splats), wanted, atol=1e-5)
    associated.undo()
    assert state(associated) == before


def test_escape_while_a_handle_is_held_edits_nothing(associated: Session) -> None:
    tool = ToolController().move_tools[ToolName.MOVE]
    group, _ = _apart(associated)
    selection.select_groups(associated, (group,))
    handles, before = tool.handles(associated), state(associated)
    assert handles is not None
    tool.begin(associated)
    moved = handles.copy()
    moved[:3, 3] += 0.1
    tool.move_to(associated, moved)
    tool.cancel(associated)
    assert not tool.finish(associated)
    assert state(associated) == before
    assert len(titles(associated)) == 1


def test_fly_keys_move_and_a_drag_then_looks(associated: Session) -> None:
    hand = Hand(associated)
    eye = associated.rig.eye
    hand.play(KeyState(held=frozenset("W")))
    assert (associated.rig.eye - eye) @ associated.rig.camera(W, H).forward > 0
    eye = associated.rig.eye
    associated.rig.is_flying = True
    hand.drag(np.array([50.0, 50.0]), np.array([150.0, 80.0]))
    np.testing.assert_allclose(associated.rig.eye, eye, atol=1e-9)


def test_status_tells_what_is_under_the_mouse(associated: Session) -> None:
    hand = Hand(associated)
    group, at = _apart(associated)
    objects.rename(associated, group, "red mug")
    for _ in range(400):
        hand.move(at[0], at[1])
        associated.tick(1 / 60)
        if associated.hovered_group:
            break
        time.sleep(0.01)
    assert associated.hovered_group == group
    assert status_text(associated, hand.controller.tool(associated)).startswith("red mug")
    hand.play(is_over=False)
    assert associated.hovered_group == 0


def test_nothing_open_is_no_error(new_session: Any, tmp_path: Path) -> None:
    session = new_session()
    hand = Hand(session)
    hand.click(10, 10)
    hand.drag(np.array([50.0, 50.0]), np.array([150.0, 80.0]))
    assert "drop" in status_text(session, hand.controller.tool(session))


# --- Lasso, polygon, brush and rectangle: what a region takes, and one edit at the end.


def _region(session: Session, tool: ToolName) -> tuple[Hand, IntArray]:
    """A hand with a tool that selects single splats, and what lies in the middle of the picture."""
    session.view.takes_splats = True
    session.tool = tool
    hand = Hand(session)
    scene = session.need().scene
    pixels, depth = session.rig.camera(W, H).project(world_means(scene).astype(np.float64))
    inside = (np.abs(pixels - [W / 2, H / 2]) < [80, 60]).all(axis=1) & (depth > 0)
    return hand, np.flatnonzero(inside).astype(np.int32)


_SQUARE = np.array([[240, 180], [400, 180], [400, 300], [240, 300.0]])


def test_a_lasso_selects_what_it_surrounds(associated: Session) -> None:
    hand, want = _region(associated, ToolName.LASSO)
    hand.press(240, 180)
    for u, v in [*_SQUARE[1:], (240, 184)]:
        hand.move(u, v)
    assert hand.controller.overlay is not None
    hand.release()
    assert associated.selected_indices().tolist() == want.tolist()
    assert titles(associated) == [f"Select {len(want):,} splats"]
    assert hand.controller.overlay is None


@pytest.mark.parametrize("ending", ["enter", "double click", "first corner"])
def test_a_polygon_selects_what_its_corners_surround(associated: Session, ending: str) -> None:
    hand, want = _region(associated, ToolName.POLYGON)
    for u, v in _SQUARE:
        hand.click(float(u), float(v))
    if ending == "enter":
        hand.click(100, 400)
        wrong = for_shortcut("Backspace", associated)
        assert wrong is not None
        assert run(wrong.id, associated)
        assert run("edit.confirm", associated)
    elif ending == "double click":
        hand.play(left=True, is_double=True)
        hand.release()
    else:
        hand.click(242, 178)
    assert associated.selected_indices().tolist() == want.tolist()
    assert associated.view.outline is None
    back = for_shortcut("Backspace", associated)
    assert back is not None
    assert back.id == "edit.delete"


def test_a_polygon_ends_with_escape_or_when_the_camera_moves(associated: Session) -> None:
    hand, _ = _region(associated, ToolName.POLYGON)
    for leave in (lambda: run("edit.cancel", associated), lambda: associated.rig.orbit(30, 0)):
        hand.click(240, 180)
        hand.click(400, 180)
        assert associated.view.outline is not None
        leave()
        associated.tick(1.0)
        hand.move(300, 300)
        assert associated.view.outline is None
        assert associated.tool is ToolName.POLYGON
    assert titles(associated) == []


def test_a_brush_shows_its_selection_and_commits_once(associated: Session) -> None:
    hand, _ = _region(associated, ToolName.BRUSH)
    before = state(associated)
    middle = np.array([W / 2, H / 2])
    hand.press(320, 200)
    hand.move(320, 240)
    assert associated.is_previewing
    assert len(associated.selected_indices())
    associated.need().history.preview(None)
    assert state(associated) == before
    hand.move(320, 280)
    hand.release()
    assert len(titles(associated)) == 1
    scene = associated.need().scene
    pixels, depth = associated.rig.camera(W, H).project(world_means(scene).astype(np.float64))
    off = pixels - middle
    far = np.hypot(off[:, 0], np.maximum(np.abs(off[:, 1]) - 40, 0))
    want = np.flatnonzero((far <= 24) & (depth > 0))
    chosen = associated.selected_indices()
    assert len(np.setxor1d(chosen, want)) <= 0.1 * len(want)  # centres on the edge of a pixel
    hand.click(320, 240, KeyState(ctrl=True))
    assert len(associated.selected_indices()) < len(chosen)


def test_escape_in_a_stroke_leaves_nothing(associated: Session) -> None:
    hand, _ = _region(associated, ToolName.BRUSH)
    before = state(associated)
    hand.press(320, 200)
    hand.move(320, 240)
    assert hand.controller.cancel(associated)
    assert state(associated) == before
    hand.release()
    assert titles(associated) == []


def test_the_visible_surface_is_a_part_of_what_lies_behind_each_other(associated: Session) -> None:
    hand, want = _region(associated, ToolName.RECT)
    associated.view.visible_only = True
    hand.drag(_SQUARE[0], _SQUARE[2])
    surface = associated.selected_indices()
    assert 0 < len(surface) < len(want)
    assert set(surface.tolist()) <= set(want.tolist())


def test_brackets_change_the_brush(associated: Session) -> None:
    for keys, factor in (("[", 0.8), ("]", 1.25)):
        radius = associated.view.brush_radius
        chosen = for_shortcut(keys, associated)
        assert chosen is not None
        assert run(chosen.id, associated)
        assert associated.view.brush_radius == pytest.approx(radius * factor)


# --- Erase, color and clone brushes: one edit a stroke, and nothing on Escape.

_FROM, _TO = np.array([280.0, 240]), np.array([360.0, 250])


def _hand(session: Session, tool: ToolName) -> Hand:
    session.tool = tool
    session.view.brush_radius = 20.0
    return Hand(session)


def test_a_stroke_erases_what_is_seen_and_undo_brings_it_back(associated: Session) -> None:
    scene = associated.need().scene
    before = snapshot(scene)
    _hand(associated, ToolName.ERASE).drag(_FROM, _TO)
    gone = scene.has(State.DELETED)
    pixels, depth = associated.rig.camera(W, H).project(world_means(scene).astype(np.float64))
    across = pixels - _FROM
    along = np.clip(across @ (_TO - _FROM) / np.sum((_TO - _FROM) ** 2), 0, 1)
    under = np.linalg.norm(across - along[:, None] * (_TO - _FROM), axis=1) < 21
    assert gone.any()
    assert not gone[~under].any()
    assert (under & ~gone & (depth > np.median(depth[gone]) * 1.1)).any(), "what is behind stays"
    assert titles(associated) == [f"Erase {gone.sum():,} splats"]
    associated.need().undo()
    assert snapshot(scene) == before


def test_a_press_does_not_wait_for_the_surface(associated: Session) -> None:
    """Nor do the previews of a drag: the picture goes on while the depth is rendered."""
    go_on = Event()
    busy = selection._worker.submit(go_on.wait, 5)
    hand = _hand(associated, ToolName.ERASE)
    scene = associated.need().scene
    hand.move(_FROM[0], _FROM[1])
    hand.play(left=True)
    hand.move(_TO[0], _TO[1])
    assert not scene.has(State.DELETED).any()
    go_on.set()
    assert busy.result()
    hand.release()
    assert scene.has(State.DELETED).any()


def test_a_stroke_colors_and_ctrl_click_takes_a_color(associated: Session) -> None:
    hand = _hand(associated, ToolName.COLOR)
    associated.view.brush_color = (0.1, 0.7, 0.2)
    hand.drag(_FROM, _TO)
    scene = associated.need().scene
    painted = np.flatnonzero(scene.placement > 0)
    assert len(painted) > 5
    assert np.allclose(mean_color(scene, painted), (0.1, 0.7, 0.2), atol=1e-3)
    assert len(titles(associated)) == 1
    associated.view.brush_color = (0.0, 0.0, 0.0)
    hand.click(320, 245, KeyState(ctrl=True))
    assert associated.view.brush_color[1] > 0.5
    assert len(titles(associated)) == 1


def test_a_stroke_clones_from_the_source_and_escape_leaves_nothing(associated: Session) -> None:
    hand = _hand(associated, ToolName.CLONE)
    scene = associated.need().scene
    n = len(scene)
    hand.drag(_FROM, _TO)
    assert len(scene) == n, "there is no source yet"
    assert hand.controller.clone_source(associated) is None
    hand.click(320, 245, KeyState(ctrl=True))
    assert "source is set" in associated.hint
    source = hand.controller.clone_source(associated)
    assert source is not None
    camera = associated.rig.camera(W, H)
    assert np.allclose(camera.project(source[None])[0], (320, 245), atol=1)
    before = snapshot(scene)
    hand.press(250, 300)
    hand.move(270, 300)
    moved = hand.controller.clone_source(associated)
    assert moved is not None
    assert np.linalg.norm(moved - source) > 1e-3, "it goes along with the stroke"
    assert associated.hint == "", "the tool says what a drag does"
    assert len(scene) > n
    hand.controller.cancel(associated)
    assert snapshot(scene) == before
    at_rest = hand.controller.clone_source(associated)
    assert at_rest is not None
    assert np.array_equal(at_rest, source)
    hand.release()
    hand.drag(np.array([250.0, 300]), np.array([270.0, 300]))
    assert len(scene) > n
    assert titles(associated) == [f"Clone {len(scene) - n:,} splats"]
    copies = world_means(scene)[n:].astype(np.float64)
    pixels, _ = associated.rig.camera(W, H).project(copies)
    assert np.abs(np.median(pixels, axis=0) - [260, 300]).max() < 40
    assert not scene.has(State.SELECTED).any()
    associated.tool = ToolName.PICK
    hand.play()
    assert hand.controller.clone_source(associated) is None


def test_a_map_between_surfaces_lines_up_points_and_normals() -> None:
    rng = np.random.default_rng(0)
    for normal in (*rng.normal(size=(20, 3)), np.array([0, 0, -1.0])):
        a = SurfacePoint(rng.normal(size=3), np.array([0, 0, 1.0]), 1)
        b = SurfacePoint(rng.normal(size=3), normal / np.linalg.norm(normal), 2)
        found = map_between(a, b)
        turn = found[:, :3]
        assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.isclose(np.linalg.det(turn), 1)
        assert np.allclose(turn @ a.normal, b.normal)
        assert np.allclose(turn @ a.point + found[:, 3], b.point)
