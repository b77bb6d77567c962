"""Copies go where it is free and where something carries them."""

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene.free_place import step_to_free_place
from gaga_core.scene.scene import Scene, State
from tests.scenes import random_gaussians

_TABLE, _CHAIR, _OTHER = 1, 2, 9
_X, _Y, _Z = np.eye(3)


def _filled(lo: tuple[float, ...], hi: tuple[float, ...], n: int) -> DoubleArray:
    return np.random.default_rng(n).uniform(lo, hi, (n, 3))


def _scene(blocks: tuple[DoubleArray, ...], turn: DoubleArray, *, has_table: bool = True) -> Scene:
    """Two cubes at the origin, 2 x 1 together, on a table of 10 x 10; others at ``blocks``."""
    cubes = [_filled((-1, -0.5, 0), (-0.1, 0.5, 1), 500), _filled((0.1, -0.5, 0), (1, 0.5, 1), 501)]
    parts = [(_CHAIR, cubes[0]), (_CHAIR + 1, cubes[1])]
    if has_table:
        parts.append((_TABLE, _filled((-5, -5, -0.1), (5, 5, -0.02), 8000)))
    for i, at in enumerate(blocks):
        parts.append((_OTHER + i, _filled((-0.4, -0.4, 0), (0.4, 0.4, 1), 400 + i) + at))
    gaussians = random_gaussians(sum(len(points) for _, points in parts))
    gaussians.means[:] = np.concatenate([points for _, points in parts]) @ turn.T
    labels = np.concatenate([np.full(len(points), group, np.int32) for group, points in parts])
    return Scene.of(gaussians, labels)


def _step(scene: Scene, turn: DoubleArray, sideways: DoubleArray = _X) -> DoubleArray | None:
    chosen = np.flatnonzero(np.isin(scene.labels, (_CHAIR, _CHAIR + 1))).astype(np.int32)
    found = step_to_free_place(scene, chosen, turn @ sideways, turn @ _Z)
    return None if found is None else found @ turn


@pytest.mark.parametrize(
    ("blocks", "wanted"),
    [
        ((), _Y),  # the shorter side of the two
        ((_Y,), -_Y),
        ((_Y, -_Y), 2 * _X),
        ((_Y, -_Y, 2 * _X), -2 * _X),
        ((_Y, -_Y, 2 * _X, -2 * _X), None),
        ((_Y + 2 * _Z,), _Y),  # over it there is room
    ],
)
def test_the_nearest_place_that_is_free_is_taken(
    blocks: tuple[DoubleArray, ...], wanted: DoubleArray | None
) -> None:
    turn = quats_to_matrices(np.array([[0.9, 0.3, -0.2, 0.4]]))[0]
    for frame in (np.eye(3), turn):
        found = _step(_scene(blocks, frame), frame)
        assert (found is None) == (wanted is None)
        if found is not None and wanted is not None:
            np.testing.assert_allclose(found, wanted, atol=0.1)


@pytest.mark.parametrize("way", [_X, -_X, _Y, -_Y])
def test_nothing_is_put_where_the_table_ends(way: DoubleArray) -> None:
    """The table goes on in one direction only."""
    scene = _scene((), np.eye(3))
    edge = np.array([1.05, 0.55, 1.0])  # as far as what stands there
    lo, hi = np.minimum(way * 5, -edge), np.maximum(way * 5, edge)
    points = scene.gaussians.means
    gone = (scene.labels == _TABLE) & ~((points >= lo) & (points <= hi))[:, :2].all(axis=1)
    gone |= (scene.labels == _TABLE) & (np.abs(points @ np.cross(way, _Z)) > 0.6)
    state = scene.state.copy()
    state[gone] |= np.uint8(State.DELETED)
    scene.state = state
    found = _step(scene, np.eye(3))
    assert found is not None
    assert found @ way > 0.8
    np.testing.assert_allclose(np.delete(found, np.abs(way).argmax()), 0, atol=1e-9)


def test_what_stands_on_nothing_goes_to_any_place_that_is_free() -> None:
    scene = _scene((_Y,), np.eye(3), has_table=False)
    found = _step(scene, np.eye(3))
    assert found is not None
    np.testing.assert_allclose(found, -_Y, atol=0.1)
    assert _step(scene, np.eye(3), _Z) is None


def test_where_nothing_else_is_seen_no_place_is_told() -> None:
    scene = _scene((), np.eye(3), has_table=False)
    every = np.arange(len(scene), dtype=np.int32)
    assert step_to_free_place(scene, every, _X, _Z) is None
    assert step_to_free_place(scene, every[:1], _X, _Z) is not None, "one splat has no size"
