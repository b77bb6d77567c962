"""Samples of the surfaces that the views see, with fused normals and the region seen in each view.

Normals of single splats are too rough to tell a crease from noise. Those of planes fitted to the
rendered depth maps, averaged over all views that see a point, are not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.hierarchy.surfels_kernels import keep_apart, normals_at
from gaga_core.grouping.robust.surface_points import DepthMaps, LoadMasks, full_size
from gaga_core.kernels import n_threads
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import NEAR

LoadFurther = Callable[[Camera], Sequence[IntArray]]  # label maps (H, W) of a view, dense

_ACROSS = 213  # samples along the longer side of a view
_MISS = 0.02  # share of its depth by which a sample may miss the surface that a view shows
_COVERED = 0.03  # ... within which a sample covers its surroundings in another view
_WINDOW = 0.007  # of the width of a view: radius of the window of a normal
_SHARES = np.array([0.06, 0.03, 0.015])  # of 1 / depth, round by round of the fit
_NEAREST = 20  # neighbours looked at when samples are thinned out
_ROUNDS = 4  # of thinning
_ENOUGH = 0.97  # share of samples kept at which thinning is done
_OVER = 1.1  # times the wanted number of samples that are accepted


@dataclass(frozen=True, eq=False)
class Surfels:
    """Samples of the surfaces."""

    points: DoubleArray  # (S, 3) world
    normals: DoubleArray  # (S, 3) unit, towards the cameras; 0 = unknown
    regions: IntArray  # (S, V) dense mask id that each view shows there, 0 = none or hidden
    n_views: IntArray  # (S,) views that see it
    further: IntArray  # (S, F) the same at other levels of detail, view by view

    @property
    def all_regions(self) -> IntArray:
        """Regions (S, V + F) at all levels of detail."""
        return np.concatenate([self.regions, self.further], axis=1)

    def maps_of(self, v: int) -> IntArray:
        """Regions (S, 1 + F / V) of one view at all levels of detail, where views have equally
        many."""
        levels, odd = divmod(self.further.shape[1], self.regions.shape[1])
        levels = 0 if odd else levels
        further = self.further[:, v * levels : (v + 1) * levels]
        return np.concatenate([self.regions[:, v : v + 1], further], axis=1)


def sample_surfels(
    views: Sequence[Camera],
    load_masks: LoadMasks,
    load_further: LoadFurther,
    depths: DepthMaps,
    wanted: int,
) -> Stage[Surfels]:
    """About ``wanted`` samples at most, evenly over what the views show, near things finer.

    ``depths`` has the median depth of every view. View by view, pixels on a grid become samples
    where no earlier one lies; then those closer than a grid cell to another go.
    """
    points, size = np.zeros((0, 3)), np.zeros(0)  # size: of a grid cell, in scene units
    for i, camera in enumerate(views):
        yield Progress("Sample surfaces", i, 2 * len(views), camera.name)
        added, cells = _uncovered(camera, full_size(camera, depths), points)
        points, size = np.concatenate([points, added]), np.concatenate([size, cells])
    points = _thinned(points, size, wanted)
    normals, n_views = np.zeros((len(points), 3)), np.zeros(len(points), np.int32)
    regions, further = np.zeros((len(points), len(views)), np.int32), []
    for v, camera in enumerate(views):
        yield Progress("Sample surfaces", len(views) + v, 2 * len(views), camera.name)
        depth = full_size(camera, depths)
        seen, rows, columns = _seen(camera, depth, points, _MISS)
        regions[seen, v] = load_masks(camera).labels[rows, columns]
        for labels in load_further(camera):
            further.append(np.zeros(len(points), np.int32))
            further[-1][seen] = labels[rows, columns]
        normals[seen] += _weighted_normals(camera, depth, points[seen], rows, columns)
        n_views[seen] += 1
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    table = np.stack(further, axis=1) if further else np.zeros((len(points), 0), np.int32)
    return Surfels(points, normals / np.maximum(length, 1e-12), regions, n_views, table)


def _seen(
    camera: Camera, depth: FloatArray, points: DoubleArray, miss: float
) -> tuple[LongArray, LongArray, LongArray]:
    """Indices (K,) of the points that a view shows, and their pixels: rows (K,), columns (K,)."""
    pixels, z = camera.project(points)
    size = (camera.width, camera.height)
    inside = np.flatnonzero((z > NEAR) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1))
    columns, rows = pixels[inside].astype(np.int64).T
    shown = depth[rows, columns]
    seen = np.abs(z[inside] - shown) < miss * shown
    return inside[seen], rows[seen], columns[seen]


def _uncovered(
    camera: Camera, depth: FloatArray, points: DoubleArray
) -> tuple[DoubleArray, DoubleArray]:
    """New samples (K, 3) at grid pixels around which no earlier one lies, and their cells' size."""
    stride = max(1, round(max(camera.width, camera.height) / _ACROSS))
    rows, columns = np.meshgrid(
        np.arange(stride // 2, camera.height, stride),
        np.arange(stride // 2, camera.width, stride),
        indexing="ij",
    )
    z = depth[rows, columns].astype(np.float64)
    _, seen_rows, seen_columns = _seen(camera, depth, points, _COVERED)
    cells = np.minimum(seen_rows // stride, z.shape[0] - 1)
    covered = np.zeros(z.shape)
    at = (cells, np.minimum(seen_columns // stride, z.shape[1] - 1))
    covered[at] = z[at]
    near = ndimage.maximum_filter(covered, 3)
    new = (z > 0) & (covered == 0) & ~((near > 0) & (np.abs(near - z) < _COVERED * z))
    z, rows, columns = z[new], rows[new], columns[new]
    x = (columns + 0.5 - camera.K[0, 2]) / camera.K[0, 0] * z
    y = (rows + 0.5 - camera.K[1, 2]) / camera.K[1, 1] * z
    pose = camera.world_from_cam
    lifted: DoubleArray = np.stack([x, y, z], axis=1) @ pose[:3, :3].T + pose[:3, 3]
    return lifted, stride * z / camera.K[0, 0]


def _thinned(points: DoubleArray, size: DoubleArray, wanted: int) -> DoubleArray:
    """The points of which none lies within the cell of another; fewer, wider apart, if need be."""
    reach = 1.0
    while True:
        kept = _apart(points, reach * size)
        if int(kept.sum()) <= _OVER * wanted:
            return points[kept]
        reach *= max(1.1, float(np.sqrt(kept.sum() / wanted)))


def _apart(points: DoubleArray, reach: DoubleArray) -> BoolArray:
    """Which points (S,) stay when those within the reach (S,) of another go."""
    kept = np.ones(len(points), np.bool_)
    for _ in range(_ROUNDS):
        rows = np.flatnonzero(kept)
        if len(rows) <= _NEAREST:
            break
        distance, nearest = cKDTree(points[rows]).query(
            points[rows], k=_NEAREST, workers=n_threads()
        )
        stays = np.empty(len(rows), np.bool_)
        order = np.argsort(reach[rows], kind="stable")
        apart = np.asarray(distance, np.float64)
        keep_apart(order, np.asarray(nearest, np.int64), apart, reach[rows], stays)
        kept[rows[~stays]] = False
        if stays.mean() > _ENOUGH:
            break
    return kept


def _weighted_normals(
    camera: Camera, depth: FloatArray, points: DoubleArray, rows: LongArray, columns: LongArray
) -> DoubleArray:
    """Normals (K, 3), world, of what a view shows at pixels; longer the better it is seen."""
    radius = max(2, round(_WINDOW * camera.width))
    lens = np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]])
    normals = np.zeros((len(rows), 3))
    normals_at(depth, rows, columns, lens, radius, max(1, radius // 4), _SHARES, normals)
    normals = normals @ camera.world_from_cam[:3, :3].T
    ray = camera.position - points
    distance = np.linalg.norm(ray, axis=1, keepdims=True)
    facing = np.clip((normals * ray).sum(axis=1, keepdims=True) / distance, 0, 1)
    result: DoubleArray = normals * facing / distance
    return result
