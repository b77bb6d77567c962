"""What the surface between two clusters of points says: creases part, bulges and borders join."""

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.robust.consensus import Contacts, contacts_of, surface_normals
from gaga_core.grouping.robust.surface_points import DepthMaps, masks_of_points, sample_points
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import true_map
from tests.scenes import objects_scene


def _roof(slope: float) -> tuple[DoubleArray, DoubleArray, IntArray]:
    """Points and normals of two planes that meet at x = 0, and their sides; slope > 0: a ridge."""
    x, y = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20))
    points = np.stack([x, y, -slope * np.abs(x)], axis=2).reshape(-1, 3)
    normals = np.stack([slope * np.sign(x), 0 * x, 1 + 0 * x], axis=2).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return points, normals, (1 + (points[:, 0] > 0)).astype(np.int32)


def _chance(slope: float) -> float:
    points, normals, side = _roof(slope)
    contacts = contacts_of(points, normals)
    assert _between(contacts, side) == _between(contacts, (3 - side).astype(np.int32))
    return _between(contacts, side)


def _between(contacts: Contacts, side: IntArray) -> float:
    """The chance of the clusters 1 and 2."""
    priors = contacts.priors(side)
    return float(priors.of(np.array([priors.width + 2]))[0])


def test_a_ridge_joins_more_than_a_plane_and_a_plane_more_than_a_crease() -> None:
    assert _chance(1.0) > _chance(0.0) + 0.05
    assert _chance(0.0) > _chance(-1.0) + 0.05


def test_a_long_border_joins_more_than_a_touch() -> None:
    points, normals, side = _roof(0.0)
    corner = 1 + ((points[:, 0] > 0.7) & (points[:, 1] > 0.7)).astype(np.int32)
    contacts = contacts_of(points, normals)
    assert _between(contacts, side) < _between(contacts, corner)


def test_clusters_that_do_not_touch_are_rather_two() -> None:
    points, normals, side = _roof(0.0)
    points[side == 2, 0] += 5
    assert _between(contacts_of(points, normals), side) == pytest.approx(0.34)


def test_few_points_and_unknown_normals_do_no_harm() -> None:
    for n in (0, 1, 2):
        found = contacts_of(np.zeros((n, 3)), np.zeros((n, 3)))
        assert (found.convexity == 0).all()
        assert np.isfinite(found.priors(np.arange(1, n + 1, dtype=np.int32)).value).all()


def test_normals_of_balls_point_outwards() -> None:
    scene = objects_scene(n_objects=5, n_cameras=4, seed=4)
    maps = {camera.name: ViewMasks.of(true_map(scene, camera)) for camera in scene.cameras}
    depths = DepthMaps(scene.cameras)
    for camera in scene.cameras:
        frame = choose().render(scene.gaussians, camera)
        depths.add(camera.name, frame.median_depth, frame.alpha, 0.5)
    arguments = (scene.cameras, lambda camera: maps[camera.name], depths)
    points = run_stage(sample_points(*arguments, 8, 8192))
    mask_of = run_stage(masks_of_points(points, *arguments))
    normals = run_stage(surface_normals(points, mask_of, *arguments))
    length = np.linalg.norm(normals, axis=1)
    assert length[length > 0] == pytest.approx(1, abs=1e-6)
    assert (length > 0).mean() > 0.8
    means = scene.gaussians.means
    centres = np.array([means[scene.labels == k].mean(axis=0) for k in range(1, 6)])
    away = points[:, None] - centres
    ball = np.linalg.norm(away, axis=2).argmin(axis=1)
    out = away[np.arange(len(points)), ball]
    on_ball = (np.abs(np.linalg.norm(out, axis=1) - 0.28) < 0.03) & (length > 0)
    assert ((out * normals).sum(axis=1)[on_ball] > 0).mean() > 0.95
    floor = (np.abs(points[:, 2] + 0.3) < 0.02) & ~on_ball & (length > 0)
    assert np.median(normals[floor, 2]) > 0.9
