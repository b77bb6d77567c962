"""Which way is up where no camera tells, and the box that shows a lone thing whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.export.export import export_objects_stage
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at, quats_to_matrices
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.values import joined
from gaga_core.scene.export_manifest import read_manifest
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import (
    estimate_up,
    guess_up,
    motion_between,
    up_of_moved,
    views_around,
    with_degrees,
)
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.bounds import (
    main_parts,
    middle_pose,
    object_box,
    object_points,
    oriented_box,
    splat_box,
    subject_box,
    whole_box,
)
from gaga_core.scene.selection.clear_view import clearest_view, clearest_view_of
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

_Z_TO = {  # rotations (3, 3) that bring z to an axis
    "+x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
    "-x": [[0, 0, -1], [-1, 0, 0], [0, 1, 0]],
    "+y": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "-y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "+z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
}


def _splats(means: DoubleArray, log_scales: DoubleArray | float = -4.0) -> Gaussians:
    """Opaque splats (N), unturned."""
    n = len(means)
    quats, scales = np.zeros((n, 4), np.float32), np.zeros((n, 3), np.float32)
    quats[:, 0], scales[:] = 1, log_scales
    return Gaussians(
        means=means.astype(np.float32),
        quats=quats,
        log_scales=scales,
        logit_opacities=np.full(n, 5, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )


@pytest.mark.parametrize("axis", _Z_TO)
def test_the_ground_tells_which_way_is_up(axis: str) -> None:
    """A floor of flat splats, and balls of round ones above it."""
    turn = np.array(_Z_TO[axis], np.float64)
    scene = objects_scene(5, 220, n_cameras=2)
    floor = scene.labels == 0
    log_scales = np.full((len(floor), 3), -3.0)
    log_scales[floor, 2] = -7.0
    made = _splats(scene.gaussians.means @ turn.T, -np.abs(log_scales @ turn.T))
    np.testing.assert_array_equal(guess_up(made), turn @ [0, 0, 1])


def test_what_is_long_stands_and_else_y_points_down() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(500, 3))
    np.testing.assert_array_equal(guess_up(_splats(ball)), [0, -1, 0])
    np.testing.assert_array_equal(guess_up(_splats(ball * [1, 3, 1])), [0, -1, 0])
    np.testing.assert_array_equal(guess_up(_splats(ball * [1, 1, 3])), [0, 0, 1])
    np.testing.assert_array_equal(guess_up(_splats(ball[:0])), [0, -1, 0])


def test_a_lone_thing_is_shown_whole_and_a_far_background_is_not() -> None:
    rng = np.random.default_rng(0)
    thing = rng.uniform(-1, 1, (2000, 3))
    lo, hi = whole_box(Scene.of(_splats(thing)))
    assert (lo < -0.98).all()
    assert (hi > 0.98).all()
    scene = Scene.of(_splats(np.concatenate([thing, rng.uniform(-30, 30, (60, 3))])))
    np.testing.assert_array_equal(whole_box(scene), splat_box(scene))


def test_the_whole_scene_is_what_photos_show_before_a_far_background() -> None:
    """Half of the splats of a garden are far behind its table: that was a dot."""
    rng, cameras = np.random.default_rng(0), orbit_cameras(12)
    thing, ways = rng.uniform(-1, 1, (2000, 3)), rng.normal(size=(2000, 3))
    far = 20 * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    scene = Scene.of(_splats(np.concatenate([thing, far])))
    lo, hi = subject_box(scene, cameras)
    assert (np.abs([lo, hi]) < 1).all()
    assert (hi - lo > 1.7).all()
    np.testing.assert_array_equal(subject_box(scene), splat_box(scene))
    for whole in (thing, far):  # nothing is far behind something else
        made = Scene.of(_splats(whole))
        np.testing.assert_array_equal(subject_box(made, cameras), splat_box(made))


@pytest.mark.parametrize("turned_over", [False, True])
def test_last_bits_of_poses_do_not_turn_the_scene(turned_over: bool) -> None:
    """Cameras that all look one way, and cameras half of which are upside down."""
    rng, steps = np.random.default_rng(0), np.arange(8)
    turn = quats_to_matrices(np.array([[0.9, 0.3, -0.2, 0.1]]))[0]
    poses = []
    for k in steps:
        angle = np.pi / 4 * k if turned_over else 0.0
        eye = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        up = np.array([0.0, -1.0 if k % 2 and turned_over else 1.0, 0.0])
        poses.append(look_at(turn @ eye, np.zeros(3), turn @ up))
    found = []
    for _ in range(20):
        near = [pose + 1e-12 * rng.normal(size=(4, 4)) for pose in rng.permutation(poses)]
        found.append(estimate_up([Camera(np.eye(3), pose, 4, 4) for pose in near]))
    np.testing.assert_allclose(found, np.tile(found[0], (20, 1)), atol=1e-9)


def test_the_up_of_cameras_follows_a_scene_that_is_turned_but_not_one_that_is_levelled() -> None:
    cameras = objects_scene(2, 220, n_cameras=6).cameras
    up = estimate_up(cameras)
    for degrees, follows in ((10, False), (90, True)):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        world = np.eye(4)
        across = np.eye(3)[np.abs(up).argmin()]
        first = np.cross(up, across) / np.linalg.norm(np.cross(up, across))
        basis = np.stack([first, np.cross(up, first), up], axis=1)
        world[:3, :3] = basis @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ basis.T
        found = up_of_moved(cameras, carried_cameras(cameras, world))
        expected = world[:3, :3] @ up if follows else up
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_box_of_several_objects_holds_each_of_theirs() -> None:
    """Also that of a small object next to a large one, of which it is no floater."""
    counts, places = (20_000, 300, 40), np.array([[0, 0, 0], [8, 0, 0], [0, -5, 3.0]])
    parts = [random_gaussians(n, seed=n) for n in counts]
    for part, place in zip(parts, places, strict=True):
        part.means[:] += place.astype(np.float32)
    scene = Scene.of(joined(joined(*parts[:2]), parts[2]), np.repeat([1, 2, 3], counts))
    boxes = np.array([object_box(scene, group_indices(scene, g)) for g in (1, 2, 3)])
    lo, hi = object_box(scene, np.arange(len(scene), dtype=np.int32))
    spacing = 0.02 * np.ptp(boxes, axis=(0, 1)).max()  # of the outermost splats
    np.testing.assert_allclose(lo, boxes[:, 0].min(axis=0), atol=spacing)
    np.testing.assert_allclose(hi, boxes[:, 1].max(axis=0), atol=spacing)


@pytest.mark.parametrize("label", [0, 2])
def test_loose_splats_and_edges_of_neighbours_are_no_objects(label: int) -> None:
    """A rectangle holds an object, and far away some splats of none, or a few of another one."""
    ball, far = random_gaussians(6000, seed=1), random_gaussians(1000, seed=2)
    far = replace(far, means=(far.means + np.array([9, 0, 0])).astype(np.float32))
    scene = Scene.of(joined(ball, far), np.repeat([1, label], [6000, 1000]))
    alone = object_box(scene, group_indices(scene, 1))
    some = np.concatenate([group_indices(scene, 1), np.arange(6000, 6060, dtype=np.int32)])
    np.testing.assert_allclose(object_box(scene, some), alone, atol=0.05)


@pytest.mark.parametrize("n", [30, 400, 20_000])
def test_floaters_change_neither_the_box_nor_the_middle_of_an_object(n: int) -> None:
    """A share of floaters that is larger than the tails of the box, on one side; any density."""
    rng = np.random.default_rng(n)
    ball = random_gaussians(n, seed=1)
    far = random_gaussians(max(n // 20, 1), seed=2)
    far = replace(far, means=(far.means * 0.3 + [9, 0, 0]).astype(np.float32))
    far.logit_opacities[:] = -2  # faint, as floaters are
    ball.log_scales[:] = far.log_scales[:] = -3
    alone, both = Scene.of(ball), Scene.of(joined(ball, far))
    rows = np.arange(len(both), dtype=np.int32)
    lo, hi = object_box(alone, rows[:n])
    for found, wanted in zip(object_box(both, rows), (lo, hi), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-9)
    halves = ball.means + np.where(np.arange(n)[:, None] % 2, [9, 0, 0], 0)
    assert main_parts(halves, np.ones(n)).all(), "an object of two parts keeps both"
    assert main_parts(rng.uniform(size=(1, 3)), np.ones(1)).all()
    assert not main_parts(np.zeros((0, 3)), np.zeros(0)).size


@pytest.mark.parametrize("what", ["one", "moved part", "several"])
def test_turning_keeps_the_middle_of_what_has_floaters(what: str, tmp_path: Path) -> None:
    """Which parts are floaters, and the middle of the box, do not change with the angle; an export
    tells the same box."""
    rng, n = np.random.default_rng(1), 3000
    parts = [random_gaussians(n, seed=2)]
    for k in range(40):  # clouds of all sizes around it, some of them floaters at some angles
        cloud = random_gaussians(int(rng.integers(5, 250)), seed=3 + k, extent=0.15)
        place = 2.5 * rng.normal(size=3)
        parts.append(replace(cloud, means=(cloud.means + place).astype(np.float32)))
    every = parts[0]
    for part in parts[1:]:
        every = joined(every, part)
    labels = np.where(np.arange(len(every)) < n, 1, 2 if what == "several" else 1)
    scene, rows = Scene.of(every, labels), np.arange(len(every), dtype=np.int32)
    history = History(scene)
    if what == "moved part":
        history.do(edits.transform(scene, rows[: n // 2], np.eye(4)[:3] + [[0, 0, 0, 0.3]] * 3))
    start = middle_pose(scene, rows, *object_points(scene, rows))
    for degrees in rng.uniform(-180, 180, (12, 3)):
        now = middle_pose(scene, rows, *object_points(scene, rows))
        to = with_degrees(now, degrees, local=False)
        history.do(edits.transform(scene, rows, motion_between(now, to)))
        found = middle_pose(scene, rows, *object_points(scene, rows))
        np.testing.assert_allclose(found.centre, start.centre, atol=2e-5)
    if what == "one":
        (entry,) = read_manifest(run_stage(export_objects_stage(scene, tmp_path))).groups
        box = oriented_box(*object_points(scene, rows))
        assert entry.oriented_box is not None
        assert box is not None
        np.testing.assert_allclose(entry.oriented_box.size, box.size, rtol=1e-5)


@pytest.mark.parametrize("turn", [0, 2, 4, 6])
@pytest.mark.parametrize("is_room", [False, True])
def test_a_room_is_looked_into_and_what_stands_free_is_seen_as_it_comes(
    turn: int, is_room: bool
) -> None:
    rng = np.random.default_rng(turn)
    out = rng.normal(size=(12_000, 3))
    ball = out / np.linalg.norm(out, axis=1, keepdims=True)
    walls = rng.uniform(-2, 2, (3, 8_000, 3))
    for wall, (axis, at) in zip(walls, ((0, 2), (1, -2), (1, 2)), strict=True):
        wall[:, axis] = at
    means = np.concatenate([ball, *walls]) if is_room else ball
    angle = 2 * np.pi * turn / 8
    inwards = np.array([np.cos(angle), np.sin(angle), 0])
    means = means @ np.array([inwards, [-inwards[1], inwards[0], 0], [0, 0, 1.0]])
    splats = replace(
        random_gaussians(len(means)),
        means=means.astype(np.float32),
        log_scales=np.full((len(means), 3), np.log(0.06), np.float32),
        logit_opacities=np.full(len(means), 4.0, np.float32),
    )
    box, up = (np.full(3, -2.0), np.full(3, 2.0)), np.array([0, 0, 1.0])
    views = views_around(box, up, ((20.0, 8),), side=200, field=np.radians(50), room=1.0)
    clearest = clearest_view(Scene.of(splats), box, views)
    assert clearest.share > 0.1
    if is_room:
        eye = views[clearest.number].position
        assert eye @ -inwards > 0.6 * np.linalg.norm(eye)
    else:
        assert clearest.number == 0


@pytest.mark.parametrize("turn", [0, 3, 6])
def test_an_object_is_looked_at_from_where_nothing_hides_it(turn: int) -> None:
    rng = np.random.default_rng(turn)
    ball = rng.normal(size=(300, 3))
    ball *= 0.2 / np.linalg.norm(ball, axis=1, keepdims=True)
    wall = rng.uniform(-1, 1, (20_000, 3)) * [0.02, 1, 1]
    angle = 2 * np.pi * turn / 8
    way = np.array([np.cos(angle), np.sin(angle), 0.0])  # from the ball to the wall
    wall = wall @ np.array([way, [-way[1], way[0], 0], [0, 0, 1.0]]) + 0.6 * way
    splats = _splats(np.concatenate([ball, wall]), float(np.log(0.02)))
    box, up = (np.full(3, -0.5), np.full(3, 0.5)), np.array([0, 0, 1.0])
    views = list(views_around(box, up, ((0.0, 8),), side=200, field=np.radians(50), room=1.0))
    behind = int(np.argmax([view.position @ way for view in views]))
    views = views[behind:] + views[:behind]  # the first has the wall before the ball
    indices = np.arange(300, dtype=np.int32)
    scene = Scene.of(splats)
    chosen = clearest_view_of(scene, indices, views)
    assert views[chosen].position @ way < 0.5
    assert clearest_view_of(scene, indices, views[chosen:]) == 0, "what shows it stays"
    scene.state[300:] = State.HIDDEN
    assert clearest_view_of(scene, indices, views) == 0, "what is hidden hides nothing"
    scene.state[:] = State.HIDDEN
    assert clearest_view_of(scene, indices, views) == 0, "nor is it seen itself"
    one = Scene.of(splats.take(np.array([0])))
    lo = hi = splats.means[0].astype(np.float64)
    assert clearest_view(one, (lo, hi), views).number == 0, "one splat has no size"
