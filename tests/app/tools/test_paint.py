"""Erase, color and clone brushes: one edit a stroke, and nothing on Escape."""

from threading import Event

import numpy as np

from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.by_volume import SurfacePoint, map_between
from gaga_core.scene.tint import mean_color
from gaga_studio.features import selection
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.gestures import KeyState
from tests.app.looks import snapshot
from tests.app.tools.hand import H, Hand, W, titles

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
    hand.play(u=float(_FROM[0]), v=float(_FROM[1]))
    hand.play(left=True)
    hand.play(u=float(_TO[0]), v=float(_TO[1]))
    assert not scene.has(State.DELETED).any()
    go_on.set()
    assert busy.result()
    hand.play(left=False)
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
    hand.play(u=250, v=300)
    hand.play(left=True)
    hand.play(u=270, v=300)
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
    hand.play(left=False)
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
