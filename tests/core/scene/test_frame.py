"""The scene moved as a whole: cameras, shots and paths see the same picture of it, lengths grow."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.camera_path import Bookmark, CameraPath, Keyframe, Shot, carried_shot
from gaga_core.scene.edits.history import History
from gaga_core.scene.frame import (
    Frame,
    carried_camera,
    inverse,
    length_text,
    lengths_text,
    metres_of,
    scale_of,
)
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import degrees_of, motion_between, pose_of, with_degrees
from gaga_core.scene.project import open_path_stage, save_project
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.edits.edit_walk import snapshot, walk_scene
from tests.scenes import orbit_cameras


def _similarity(seed: int) -> DoubleArray:
    rng = np.random.default_rng(seed)
    world = np.eye(4)
    world[:3, :3] = quats_to_matrices(rng.normal(size=(1, 4)))[0] * rng.uniform(0.01, 50)
    world[:3, 3] = rng.normal(size=3)
    return world


@pytest.mark.parametrize("seed", range(4))
def test_a_carried_camera_sees_the_moved_scene_as_before(seed: int) -> None:
    world = _similarity(seed)
    points = np.random.default_rng(seed).normal(size=(50, 3))
    moved = points @ world[:3, :3].T + world[:3, 3]
    for camera in orbit_cameras(3):
        carried = carried_camera(camera, world)
        rotation = carried.cam_from_world[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        before, depth = camera.project(points)
        after, far = carried.project(moved)
        np.testing.assert_allclose(after, before, atol=1e-6)
        np.testing.assert_allclose(far, depth * scale_of(world), rtol=1e-9)
        back = carried_camera(carried, inverse(world))
        np.testing.assert_allclose(back.cam_from_world, camera.cam_from_world, atol=1e-9)
        shot = carried_shot(Shot.of_camera(camera, 2.0), world)
        again = Shot.of_camera(carried, 2.0 * scale_of(world))
        np.testing.assert_allclose(
            shot.camera(99, 99).cam_from_world, again.camera(99, 99).cam_from_world, atol=1e-6
        )
        assert shot.distance == pytest.approx(again.distance)


def test_what_is_no_motion_of_a_whole_scene_is_refused() -> None:
    scene = walk_scene()
    for bad in (np.diag([1.0, 2, 1]), np.diag([1.0, 1, -1]), np.zeros((3, 3)), np.eye(3) * np.nan):
        with pytest.raises(ValueError, match="world"):
            edits.move_scene(scene, np.column_stack([bad, np.zeros(3)]), "x")


def test_a_known_length_scales_everything_and_undo_is_exact() -> None:
    scene = walk_scene()
    scene.state[:50] |= 2 | 4  # hidden and locked splats come along
    history, start = History(scene), snapshot(scene)
    before = world_means(scene).astype(np.float64)
    far = float(np.linalg.norm(before[3] - before[200]))
    edit = edits.set_scale(scene, far, 0.25, before[3])
    assert history.do(edit)
    after = world_means(scene).astype(np.float64)
    assert float(np.linalg.norm(after[3] - after[200])) == pytest.approx(0.25, rel=1e-4)
    np.testing.assert_allclose(after[3], before[3], atol=1e-5)
    assert scene.frame.is_metric
    world = scene.frame.world
    np.testing.assert_allclose(before @ world[:3, :3].T + world[:3, 3], after, atol=1e-5)
    moved = snapshot(scene)
    history.undo()
    assert snapshot(scene) == start
    history.redo()
    assert snapshot(scene) == moved
    history.do(edits.set_origin(scene, after[7]))
    assert np.abs(world_means(scene)[7]).max() < 1e-5
    assert scene.frame.is_metric


@pytest.mark.parametrize("metres", [0.0, -1.0, float("nan"), float("inf"), 1e300])
def test_a_length_that_no_thing_has_is_a_sentence(metres: float) -> None:
    with pytest.raises(GagaError):
        edits.set_scale(walk_scene(), 1.0, metres, np.zeros(3))


def test_a_script_and_its_recording_do_the_same() -> None:
    scene, again = walk_scene(), walk_scene()
    history = History(scene)
    steps = [
        {"op": "set_scale", "points": [[0, 0, 0], [2, 0, 0]], "metres": 1},
        {"op": "align_to_ground", "points": [[0, 0, 0], [1, 0, 0], [0, 1, 1]],
         "seen_from": [0, 0, 9]},
        {"op": "set_origin", "point": [1, 2, 3]},
    ]  # fmt: skip
    assert run_script(scene, steps, history) == ("Set scale", "Align to ground", "Set origin")
    assert scale_of(scene.frame.world) == pytest.approx(0.5)
    run_script(again, json.loads(json.dumps(history.recorded())))
    assert again.frame.equals(scene.frame)
    assert np.array_equal(world_means(again), world_means(scene))


def test_a_saved_project_keeps_how_the_scene_was_moved(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", walk_scene().gaussians)
    project = run_stage(open_path_stage(tmp_path / "a.ply"))
    shot = Shot.of_camera(orbit_cameras(1)[0], 2.0)
    project.bookmarks = (Bookmark("here", shot),)
    project.film = CameraPath((Keyframe(shot), Keyframe(shot)))
    History(project.scene).do(edits.move_scene(project.scene, _similarity(1), "x", is_metric=True))
    save_project(project)
    again = run_stage(open_path_stage(tmp_path / "a.gaga"))
    assert again.scene.frame.equals(project.scene.frame)
    assert again.bookmarks == project.bookmarks
    assert again.placed_film == project.placed_film
    assert again.placed_film.keyframes[0].shot == carried_shot(shot, _similarity(1))


@pytest.mark.parametrize(
    ("typed", "metres"),
    [
        ("2", 2.0),
        (" 1,5 M", 1.5),
        ("80cm", 0.8),
        ("12 in", 0.3048),
        (".5 feet", 0.1524),
        ("3 mm", 3e-3),
        ("0,125 m", 0.125),
        ("1e-2", 0.01),
        ("2 ft 10 in", 2 * 0.3048 + 10 * 0.0254),
        ("1m  20 cm 5mm", 1.205),
    ],
)
def test_a_length_is_read_with_its_unit(typed: str, metres: float) -> None:
    assert metres_of(typed) == pytest.approx(metres)


@pytest.mark.parametrize(
    "typed",
    [
        "",
        "m",
        "0",
        "1,5,5",
        "5 3",
        "-2 m",
        "2 parsecs",
        "1 2",
        "nan",
        "9" * 400,
        "1,000",
        "12,345 m",
        "10 in 2 ft",
        "2 ft 3 ft",
        "2 ft 10",
        "2 ft -10 in",
    ],
)
def test_what_is_no_length_is_none(typed: str) -> None:
    assert metres_of(typed) is None


def test_lengths_are_told_in_the_unit_that_is_known() -> None:
    told = [length_text(m, is_metric=True) for m in (0.0031, 0.123, 2.4, 2400.0)]
    assert told == ["3.1 mm", "12.3 cm", "2.40 m", "2.40 km"]
    told = [length_text(x, is_metric=False) for x in (0.8174, 4.6312e-06, -3e-09, 0.0, 12345.6)]
    assert told == [
        *("0.817 units", "0.00000463 units", "-0.000000003 units", "0.0 units", "12,345.6 units"),
    ]


@pytest.mark.parametrize(
    ("sides", "is_metric", "told"),
    [
        ((0.527, 0.22, 0.1758), False, "0.527 × 0.220 × 0.176 units"),
        ((12.34, 0.5, 0.04), False, "12.3 × 0.5 × 0.0 units"),
        ((0.99999, 0.5), False, "1.000 × 0.500 units"),
        ((250.0, 3.26), False, "250.0 × 3.3 units"),
        ((1.2, 0.45, 0.009), True, "1.20 × 0.45 × 0.01 m"),
        ((0.12, 0.007), True, "12.0 × 0.7 cm"),
        ((0.004, 0.0), True, "4.0 × 0.0 mm"),
        ((0.0, 0.0), False, "0.0 × 0.0 units"),
    ],
)
def test_sides_of_a_box_have_one_unit_and_the_same_decimals(
    sides: tuple[float, ...], is_metric: bool, told: str
) -> None:
    assert lengths_text(sides, is_metric=is_metric) == told


def test_a_frame_of_a_damaged_file_is_refused() -> None:
    with pytest.raises(ValueError, match="world"):
        Frame(np.diag([1.0, 1, 3, 1]))
    assert replace(Frame(), is_metric=True).world.shape == (4, 4)


# --- Absolute position, rotation and scale: what is set is read again, and reset is exact.


def _centre(scene: Scene, splats: IntArray) -> DoubleArray:
    return world_means(scene, splats).astype(np.float64).mean(axis=0)


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
