"""Lasso, polygon, brush and rectangle: what a region takes, and one edit at the end."""

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features.commands import for_shortcut, run
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.gestures import KeyState
from tests.app.tools.hand import H, Hand, W, state, titles


def _region(session: Session, tool: ToolName) -> tuple[Hand, IntArray]:
    """A hand with a tool that selects single splats, and what lies in the middle of the picture."""
    session.view.takes_splats = True
    session.tool = tool
    hand = Hand(session)
    scene = session.scene
    assert scene is not None
    pixels, depth = session.rig.camera(W, H).project(world_means(scene).astype(np.float64))
    inside = (np.abs(pixels - [W / 2, H / 2]) < [80, 60]).all(axis=1) & (depth > 0)
    return hand, np.flatnonzero(inside).astype(np.int32)


_SQUARE = np.array([[240, 180], [400, 180], [400, 300], [240, 300.0]])


def test_a_lasso_selects_what_it_surrounds(associated: Session) -> None:
    hand, want = _region(associated, ToolName.LASSO)
    hand.play(u=240, v=180)
    hand.play(left=True)
    for u, v in [*_SQUARE[1:], (240, 184)]:
        hand.play(u=float(u), v=float(v))
    assert hand.controller.overlay is not None
    hand.play(left=False)
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
        hand.play(left=False)
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
        hand.play(u=300, v=300)
        assert associated.view.outline is None
        assert associated.tool is ToolName.POLYGON
    assert titles(associated) == []


def test_a_brush_shows_its_selection_and_commits_once(associated: Session) -> None:
    hand, _ = _region(associated, ToolName.BRUSH)
    before = state(associated)
    middle = np.array([W / 2, H / 2])
    hand.play(u=320, v=200)
    hand.play(left=True)
    hand.play(u=320, v=240)
    assert associated.is_previewing
    assert len(associated.selected_indices())
    associated.need().history.preview(None)
    assert state(associated) == before
    hand.play(u=320, v=280)
    hand.play(left=False)
    assert len(titles(associated)) == 1
    scene = associated.scene
    assert scene is not None
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
    hand.play(u=320, v=200)
    hand.play(left=True)
    hand.play(u=320, v=240)
    assert hand.controller.cancel(associated)
    assert state(associated) == before
    hand.play(left=False)
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
