"""The smallest box of a turned box is that box; it holds what it says."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.export.export import export_objects_stage
from gaga_core.geometry import axes_of_points, quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.scene.selection.bounds import oriented_box
from tests.core.scene.edits.edit_walk import walk_scene

_SIZE = np.array([3.0, 2.0, 0.5])


@pytest.mark.parametrize("seed", range(4))
def test_a_turned_box_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = quats_to_matrices(rng.normal(size=(1, 4)))[0]
    middle = rng.normal(size=3)
    points = (rng.uniform(-0.5, 0.5, (6000, 3)) * _SIZE) @ turn.T + middle
    box = oriented_box(points, share=1.0)
    assert box is not None
    np.testing.assert_allclose(box.size, _SIZE, rtol=0.03)
    np.testing.assert_allclose(box.centre, middle, atol=0.03)
    np.testing.assert_allclose(np.abs(box.axes.T @ turn), np.eye(3), atol=0.05)
    assert np.linalg.det(box.axes) == pytest.approx(1.0)
    places = (points - box.centre) @ box.axes
    assert (np.abs(places) <= box.size / 2 + 1e-9).all()
    corners = (box.corners() - box.centre) @ box.axes
    np.testing.assert_allclose(np.abs(corners), np.tile(box.size / 2, (8, 1)), atol=1e-9)


def test_a_few_strays_do_not_blow_it_up() -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (5000, 3)) * _SIZE
    points[:10] *= 50
    box = oriented_box(points)
    assert box is not None
    np.testing.assert_allclose(box.size, _SIZE, rtol=0.1)


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.zeros((9, 3)), np.eye(3)[:2]])
def test_points_that_span_no_space_have_a_flat_box(points: np.ndarray) -> None:
    box = oriented_box(points)
    assert box is not None
    assert np.isfinite(box.size).all()
    assert np.prod(box.size) == pytest.approx(0)
    assert oriented_box(np.full((4, 3), np.nan)) is None


_CUBE = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5)] * 3), axis=-1).reshape(-1, 3)
_TURN = quats_to_matrices(np.array([[0.9, 0.3, -0.2, 0.1]]))[0]
_SYMMETRIC = {
    "cube": _CUBE,
    "ball": _CUBE[np.linalg.norm(_CUBE, axis=1) <= 1],
    "square": _CUBE[_CUBE[:, 2] == 0],
    "turned square": _CUBE[_CUBE[:, 2] == 0] @ _TURN.T,
    "turned column": (_CUBE * [1, 1, 3]) @ _TURN.T,
}


@pytest.mark.parametrize("name", _SYMMETRIC)
def test_last_bits_and_the_order_of_points_do_not_turn_a_symmetric_box(name: str) -> None:
    points, rng = _SYMMETRIC[name], np.random.default_rng(0)
    axes, found = axes_of_points(points), oriented_box(points, share=1.0)
    assert found is not None
    for _ in range(20):
        order = rng.permutation(len(points))
        same = points[order] + 1e-12 * rng.normal(size=points.shape)
        np.testing.assert_allclose(axes_of_points(same), axes, atol=1e-8)
        box = oriented_box(same, share=1.0)
        assert box is not None
        np.testing.assert_allclose(box.axes, found.axes, atol=1e-8)


def test_exported_objects_say_their_boxes(tmp_path: Path) -> None:
    manifest = run_stage(export_objects_stage(walk_scene(), tmp_path))
    for entry in json.loads(manifest.read_text())["groups"]:
        box, lo_hi = entry["oriented_box"], np.array(entry["bbox"])
        axes = np.array(box["axes"])
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-9)
        assert box["size"] == sorted(box["size"], reverse=True)
        assert ((np.array(box["centre"]) >= lo_hi[0]) & (np.array(box["centre"]) <= lo_hi[1])).all()
