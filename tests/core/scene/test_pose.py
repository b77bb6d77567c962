"""Absolute position, rotation and scale: what is set is read again, and reset is exact."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.edit_script import run_script
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import degrees_of, motion_between, pose_of, with_degrees
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.edits.edit_walk import snapshot, walk_scene


def _centre(scene: Scene, splats: IntArray) -> DoubleArray:
    middle: DoubleArray = world_means(scene, splats).astype(np.float64).mean(axis=0)
    return middle


@pytest.mark.parametrize("local", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_angles_that_are_set_are_read_again(seed: int, local: bool) -> None:
    rng = np.random.default_rng(seed)
    scene = walk_scene()
    start = pose_of(scene, np.arange(5, dtype=np.int32), np.zeros(3))
    for degrees in (rng.uniform(-85, 85, 3), np.array([170.0, -20, -100]), np.array([0, 90.0, 0])):
        turned = with_degrees(start, degrees, local=local)
        again = with_degrees(start, degrees_of(turned, local=local), local=local)
        np.testing.assert_allclose(again.turn, turned.turn, atol=1e-7)
        if abs(degrees[1]) < 89:
            np.testing.assert_allclose(degrees_of(turned, local=local), degrees, atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_a_pose_that_is_set_is_the_pose_that_is_read(seed: int) -> None:
    """Also after the scene was moved as a whole, and from a pose that was set before."""
    rng = np.random.default_rng(seed)
    scene = walk_scene()
    history, splats = History(scene), group_indices(scene, 3)
    for step in range(3):
        start = pose_of(scene, splats, _centre(scene, splats))
        wanted = replace(
            with_degrees(start, rng.uniform(-80, 80, 3), local=False),
            centre=rng.normal(size=3),
            scale=rng.uniform(0.3, 3, 3),
        )
        history.do(edits.transform(scene, splats, motion_between(start, wanted)))
        found = pose_of(scene, splats, _centre(scene, splats))
        np.testing.assert_allclose(found.centre, wanted.centre, atol=1e-5)
        np.testing.assert_allclose(found.turn, wanted.turn, atol=1e-7)
        np.testing.assert_allclose(found.scale, wanted.scale, rtol=1e-7)
        turn = quats_to_matrices(rng.normal(size=(1, 4)))[0]
        history.do(edits.move_scene(scene, np.column_stack([0.5 * turn, [1, 2, 3]]), f"{step}"))
        carried = pose_of(scene, splats, _centre(scene, splats))
        np.testing.assert_allclose(carried.scale, wanted.scale, rtol=1e-6)


def test_a_mirrored_object_keeps_its_mirror() -> None:
    scene = walk_scene()
    splats = group_indices(scene, 2)
    mirror = np.column_stack([np.diag([-1.0, 1, 1]), np.zeros(3)])
    History(scene).do(edits.transform(scene, splats, mirror))
    found = pose_of(scene, splats, np.zeros(3))
    assert np.linalg.det(found.turn) > 0
    assert np.prod(np.sign(found.scale)) == -1
    still = motion_between(found, found)
    np.testing.assert_allclose(still, np.eye(3, 4), atol=1e-12)


def test_reset_puts_splats_back_bit_for_bit_wherever_they_were() -> None:
    scene = walk_scene()
    history, start = History(scene), world_means(scene)
    some = np.concatenate([group_indices(scene, 2), group_indices(scene, 4)[:7]])
    shift = np.column_stack([np.diag([2.0, 1, 0.5]), [1, 0, 0]])
    history.do(edits.transform(scene, group_indices(scene, 2), shift))
    history.do(edits.transform(scene, group_indices(scene, 4), shift))
    moved = snapshot(scene)
    assert history.do(edits.reset_placement(scene, some))
    assert np.array_equal(world_means(scene, some), start[some])
    others = group_indices(scene, 4)[7:]
    assert not np.allclose(world_means(scene, others), start[others])
    assert edits.reset_placement(scene, some) is None, "nothing would change"
    history.undo()
    assert snapshot(scene) == moved


def test_a_script_places_and_resets() -> None:
    scene = walk_scene()
    splats, start = group_indices(scene, 3), world_means(scene)
    steps: list[dict[str, object]] = [
        {"op": "place", "groups": [3], "rotation": [0, 0, 90], "scale": 2},
        {"op": "place", "groups": [3], "position": [5, 5, 5]},
    ]
    assert run_script(scene, steps) == ("Place", "Place")
    found = pose_of(scene, splats, np.zeros(3))
    np.testing.assert_allclose(degrees_of(found, local=False), [0, 0, 90], atol=1e-9)
    np.testing.assert_allclose(found.scale, 2)
    run_script(scene, [{"op": "reset_placement", "groups": [3]}])
    assert np.array_equal(world_means(scene), start)


def test_a_pose_of_several_placements_says_so() -> None:
    scene = walk_scene()
    shift = np.column_stack([np.eye(3), [1.0, 0, 0]])
    History(scene).do(edits.transform(scene, group_indices(scene, 2), shift))
    both = np.concatenate([group_indices(scene, 2), group_indices(scene, 3)])
    assert not pose_of(scene, both, np.zeros(3)).is_one
    assert pose_of(scene, group_indices(scene, 2), np.zeros(3)).is_one
