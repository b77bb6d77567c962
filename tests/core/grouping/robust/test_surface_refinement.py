"""Where few views are, surfaces say what is one thing: creases part, even surfaces go on."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.robust.surface_graph import SurfaceConfig, along_surfaces, follow_surfaces
from gaga_core.masks import MaskSet
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.scenes import orbit_cameras

_STEP = 0.03
_TABLE, _BOX, _BALL = 1, 2, 3
_BOX_AT, _BALL_AT, _RADIUS = (-0.6, 0.0), (0.6, 0.0), 0.3


def _splats(points: DoubleArray, normals: DoubleArray) -> Gaussians:
    """Opaque flat discs; to which side a disc's thin axis points says nothing."""
    normals = normals * np.random.default_rng(0).choice([-1, 1], (len(normals), 1))
    side = np.cross(normals, np.where(np.abs(normals[:, [2]]) > 0.9, [[1.0, 0, 0]], [[0, 0, 1.0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([side, np.cross(normals, side), normals], axis=2)
    n = len(points)
    return Gaussians(
        means=points.astype(np.float32),
        quats=matrices_to_quats(axes).astype(np.float32),
        log_scales=np.tile(np.log([0.7 * _STEP, 0.7 * _STEP, 0.05 * _STEP]), (n, 1)).astype(
            np.float32
        ),
        logit_opacities=np.full(n, 4, np.float32),
        sh=np.zeros((n, 1, 3), np.float32),
    )


def _square(half: float, up: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """A square about the origin, at right angles to ``up``."""
    at = np.arange(-half + _STEP / 2, half, _STEP)
    x, y = (axis.ravel() for axis in np.meshgrid(at, at))
    one, other = np.eye(3)[np.argsort(np.abs(up))[:2]]
    points = x[:, None] * one + y[:, None] * other
    return points, np.tile(up, (len(points), 1))


def _things(rotation: DoubleArray) -> tuple[Gaussians, IntArray]:
    """A box and a ball on a table, all turned by ``rotation``, and what is what."""
    points, normals = _square(1.5, np.array([0, 0, 1.0]))
    found = [(points, normals, _TABLE)]
    for axis in range(3):
        for sign in (-1.0, 1.0):
            up = sign * np.eye(3)[axis]
            if up[2] >= 0:
                points, normals = _square(0.25, up)
                found.append((points + 0.25 * up + [*_BOX_AT, 0.25], normals, _BOX))
    k = np.arange(1300)
    z, angle = 1 - 2 * (k + 0.5) / 1300, k * np.pi * (3 - np.sqrt(5))
    out = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], 1)
    found.append((_RADIUS * out + [*_BALL_AT, _RADIUS], out, _BALL))
    points, normals = (np.concatenate([f[i] for f in found]) for i in (0, 1))
    labels = np.concatenate([np.full(len(f[0]), f[2], np.int32) for f in found])
    return _splats(points @ rotation.T, normals @ rotation.T), labels


def _views(n: int, rotation: DoubleArray) -> tuple[Camera, ...]:
    turn = np.eye(4)
    turn[:3, :3] = rotation.T
    cameras = orbit_cameras(n, width=320, height=240)
    return tuple(replace(c, cam_from_world=c.cam_from_world @ turn) for c in cameras)


def _pictures(
    gaussians: Gaussians, labels: IntArray, cameras: tuple[Camera, ...]
) -> dict[str, IntArray]:
    return {c.name: choose("cpu").label_splat(gaussians, c, labels).labels for c in cameras}


def _masks(pictures: dict[str, IntArray]) -> MaskSet:
    return MaskSet({name: partial(pictures.__getitem__, name) for name in pictures})


def _associate(
    gaussians: Gaussians, cameras: tuple[Camera, ...], masks: MaskSet, preset: str = "robust"
) -> Association:
    config = AssociateConfig.of(preset)
    return run_stage(associate_stage(gaussians, cameras, masks, choose("cpu"), config))


def _share(labels: IntArray, rows: IntArray | np.ndarray) -> tuple[int, float]:
    """The label of most of these rows, and their share."""
    counts = np.bincount(labels[rows])
    return int(counts.argmax()), float(counts.max() / counts.sum())


def _turns() -> list[DoubleArray]:
    c, s = np.cos(0.7), np.sin(0.7)
    about_x = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    return [np.eye(3), about_x @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])]


@pytest.mark.parametrize("rotation", _turns(), ids=["upright", "turned"])
def test_what_melts_with_the_table_in_every_mask_is_a_group_of_its_own(
    rotation: DoubleArray,
) -> None:
    gaussians, truth = _things(rotation)
    cameras = _views(3, rotation)
    melted = np.where(truth == _BALL, _TABLE, truth).astype(np.int32)
    found = _associate(gaussians, cameras, _masks(_pictures(gaussians, melted, cameras)))
    (table, a), (box, b), (ball, c) = (_share(found.labels, truth == k) for k in (1, 2, 3))
    assert len({table, box, ball}) == 3
    assert min(a, b, c) > 0.85
    assert found.bank.n_groups >= int(found.labels.max())


def test_what_is_one_thing_in_true_masks_stays_one() -> None:
    gaussians, truth = _things(np.eye(3))
    cameras = _views(4, np.eye(3))
    found = _associate(gaussians, cameras, _masks(_pictures(gaussians, truth, cameras)))
    assert set(np.unique(found.labels)) == {1, 2, 3}
    for k in (_TABLE, _BOX, _BALL):
        assert _share(found.labels, truth == k)[1] > 0.95


def test_a_rim_of_the_table_in_the_balls_mask_goes_back_to_the_table() -> None:
    """The votes give a ring of the table to the ball; the surface goes on, the ball does not."""
    gaussians, truth = _things(np.eye(3))
    cameras = _views(3, np.eye(3))
    away = np.linalg.norm(gaussians.means[:, :2] - _BALL_AT, axis=1)
    rim = (truth == _TABLE) & (away < 0.5) & (away > 0.35)
    labels = np.where(rim, _BALL, truth).astype(np.int32)
    blank = _masks({c.name: np.zeros((c.height, c.width), np.int32) for c in cameras})
    config = SurfaceConfig()
    found = run_stage(follow_surfaces(gaussians, cameras, blank, labels, choose("cpu"), config))
    assert _share(found, rim) == (_TABLE, 1.0)
    ball, share = _share(found, truth == _BALL)
    assert ball == _BALL
    assert share > 0.95


def test_masks_outvote_the_crease() -> None:
    """Views that show table and ball in one mask, one after another, keep them together."""
    gaussians, truth = _things(np.eye(3))
    one = np.ones_like(truth)
    parts = []
    for n in (3, 12):
        cameras = _views(n, np.eye(3))
        pictures = _masks(_pictures(gaussians, one, cameras))
        found = run_stage(
            follow_surfaces(gaussians, cameras, pictures, one, choose("cpu"), SurfaceConfig())
        )
        parts.append(len(np.unique(found)))
    assert parts[0] == 3
    assert parts[1] == 1


def test_hidden_gaussians_follow_their_surface_not_the_nearest_label() -> None:
    """A wall meets a floor; of the wall only the top is labelled: its foot is the wall's."""
    floor, up = _square(1.0, np.array([0, 0, 1.0]))
    wall, across = _square(1.0, np.array([1.0, 0, 0]))
    wall += [-1.0, 0, 1.0]
    gaussians = _splats(np.concatenate([floor, wall]), np.concatenate([up, across]))
    truth = np.repeat(np.array([1, 2], np.int32), [len(floor), len(wall)])
    known = (truth == 1) | (gaussians.means[:, 2] > 1.5)
    found = along_surfaces(gaussians, np.where(known, truth, np.int32(0)), 10, 40)
    assert np.array_equal(found, truth)


def test_a_thing_that_no_mask_shows_is_a_group_of_its_own() -> None:
    """Only the table is labelled; the box is not its, unless one may not open groups so small."""
    gaussians, truth = _things(np.eye(3))
    labels = np.where(truth == _TABLE, np.int32(_TABLE), np.int32(0))
    found = along_surfaces(gaussians, labels, 10, 40)
    assert (found[truth == _TABLE] == _TABLE).all()
    assert (found[truth == _BOX] != _TABLE).mean() > 0.9
    few = along_surfaces(gaussians, labels, 10, 10_000)
    assert set(np.unique(few)) == {_TABLE}


def test_labels_that_are_there_stay_and_everyone_with_a_place_gets_one() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (400, 3))
    points[300:] += 100  # an island
    gaussians = _splats(points, np.tile([0, 0, 1.0], (400, 1)))
    gaussians.means[7] = np.nan
    labels = np.where(np.arange(400) < 300, rng.integers(0, 4, 400), 0).astype(np.int32)
    found = along_surfaces(gaussians, labels, 6, 1000)
    assert np.array_equal(found[labels > 0], labels[labels > 0])
    assert (found[np.arange(400) != 7] > 0).all()
    assert found[7] == labels[7]


def test_the_same_scene_gives_the_same_labels_whatever_the_number_of_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gaussians, truth = _things(np.eye(3))
    cameras = _views(3, np.eye(3))
    melted = np.where(truth == _BALL, _TABLE, truth).astype(np.int32)
    masks = _masks(_pictures(gaussians, melted, cameras))
    found = []
    for threads in ("1", "2", "2"):
        monkeypatch.setenv("GAGA_THREADS", threads)
        found.append(_associate(gaussians, cameras, masks).labels)
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[1], found[2])


def test_only_robust_asks_the_surfaces_and_only_where_views_are_few() -> None:
    assert AssociateConfig.of("paper").surfaces is None
    gaussians, truth = _things(np.eye(3))
    cameras = _views(3, np.eye(3))
    melted = np.where(truth == _BALL, _TABLE, truth).astype(np.int32)
    masks = _masks(_pictures(gaussians, melted, cameras))
    config = AssociateConfig.of("robust")
    never = replace(config, surfaces=replace(SurfaceConfig(), max_views=2))
    off = replace(config, surfaces=None)
    labels = [
        run_stage(associate_stage(gaussians, cameras, masks, choose("cpu"), c)).labels
        for c in (config, never, off)
    ]
    assert np.array_equal(labels[1], labels[2])
    assert not np.array_equal(labels[0], labels[1])


def test_settings_that_make_no_sense_are_refused() -> None:
    for wrong in ({"neighbours": 0}, {"crease": -1.0}, {"least_share": 2.0}, {"same_mask": -1.0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            SurfaceConfig(**wrong)
