"""Samples of the surfaces that the views see, with fused normals and the region seen in each view.

Normals of single splats are too rough to tell a crease from noise. Those of planes fitted to the
rendered depth maps, averaged over all views that see a point, are not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.geometry import along, axes_of_points, turned
from gaga_core.grouping.robust.surface_graph import edges_once
from gaga_core.grouping.robust.surface_points import (
    DepthMaps,
    LoadMasks,
    full_size,
    in_picture,
    lifted,
    to_world,
)
from gaga_core.grouping.surfaces.surfels_kernels import (
    choose_seeds,
    count_on_planes,
    keep_apart,
    normals_at,
)
from gaga_core.progress import Progress, Stage
from gaga_core.threads import n_threads

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
    """About ``wanted`` samples at most, evenly over what the views show, near objects finer.

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
    inside, rows, columns, z = in_picture(camera, points)
    shown = depth[rows, columns]
    seen = np.abs(z - shown) < miss * shown
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
    points = to_world(camera, lifted(camera, rows, columns, z))
    return points, stride * z / camera.K[0, 0]


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
    normals = turned(normals, camera.world_from_cam[:3, :3])
    ray = camera.position - points
    distance = np.linalg.norm(ray, axis=1, keepdims=True)
    facing = np.clip((normals * ray).sum(axis=1, keepdims=True) / distance, 0, 1)
    result: DoubleArray = normals * facing / distance
    return result


# --- Small pieces of surface: a few neighbouring samples that face one way and share their
# regions.


_EDGES = 10  # nearest samples that a sample has edges to
_AROUND = 16  # ... that are its surroundings
_FAR = 3.0  # an edge is at most so many times longer than the spacing around either end
_TURN, _PARTED = 3.0, 2.0  # cost of an edge that turns by 90 degrees, that all views part ...
_ALONG = 0.3  # ... next to that of its length
_RECOLORED = 0.075  # cost of an edge for a unit of CIE Lab, where color counts ...
_OTHER_COLOR = 60.0  # ... up to so many
_SLICE = 1 << 16  # edges compared at once
_OUTLINE = 3.0  # edges along the border of a piece of n samples, times sqrt(n)


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """Which samples are next to which."""

    around: LongArray  # (S, 16) nearest ones
    spacing: DoubleArray  # (S,) median distance to the nearest, scene units
    first: LongArray  # (E,) < second
    second: LongArray  # (E,)
    length: DoubleArray  # (E,) scene units

    @staticmethod
    def of(points: DoubleArray) -> "Neighbourhood":
        """Neighbours among points (S, 3); S must be over 16."""
        found = cKDTree(points).query(points, k=_AROUND + 1, workers=n_threads())
        distance, nearest = np.asarray(found[0])[:, 1:], np.asarray(found[1], np.int64)[:, 1:]
        spacing = np.median(distance[:, :_EDGES], axis=1)
        a, b, length = edges_once(nearest[:, :_EDGES], distance[:, :_EDGES])
        near = (length > 0) & (length <= _FAR * np.minimum(spacing[a], spacing[b]))
        return Neighbourhood(nearest, spacing, a[near], b[near], length[near])

    def adjacency(self, rows: LongArray) -> csr_matrix:
        """The edges among some samples (K,), as a sparse matrix (K, K)."""
        n = len(self.spacing)
        place = np.full(n, -1, np.int64)
        place[rows] = np.arange(len(rows))
        a, b = place[self.first], place[self.second]
        both = (a >= 0) & (b >= 0)
        ones = np.ones(int(both.sum()), np.int8)
        return coo_matrix((ones, (a[both], b[both])), shape=(len(rows), len(rows))).tocsr()


def dense(ids: AnyArray) -> LongArray:
    """The same ids as 0, 1, ... in their order."""
    return np.unique(ids, return_inverse=True)[1].astype(np.int64)


def outlines(n_samples: AnyArray) -> DoubleArray:
    """Edges (n,) along the outline of compact pieces of surface of so many samples (n,)."""
    return _OUTLINE * np.sqrt(n_samples)


def small_pieces(
    surfels: Surfels, near: Neighbourhood, color: DoubleArray | None = None
) -> LongArray:
    """The piece (S,) of each sample, dense ids from 0: some seven samples each.

    Samples go to the seed that is nearest along the surface, where turning and leaving a region
    make the way longer, so that pieces end at creases and outlines; with colors (S, 3), CIE Lab,
    also where these change.
    """
    n = len(surfels.points)
    a, b = near.first, near.second
    cosine = (surfels.normals[a] * surfels.normals[b]).sum(axis=1)
    cost = _ALONG + _TURN * np.clip(1 - cosine, 0, 1.5) + _PARTED * _parted(surfels, a, b)
    if color is not None:
        cost += _RECOLORED * np.minimum(np.linalg.norm(color[a] - color[b], axis=1), _OTHER_COLOR)
    cost *= near.length / np.sqrt(near.spacing[a] * near.spacing[b])
    graph = coo_matrix((cost, (a, b)), shape=(n, n)).tocsr()
    seeds = np.empty(n, np.bool_)
    order = np.random.default_rng(0).permutation(n)
    choose_seeds(order, np.ascontiguousarray(near.around[:, :_EDGES]), seeds)
    source = _sources(graph, seeds)
    return dense(source)


def _sources(graph: csr_matrix, seeds: BoolArray) -> LongArray:
    """The seed (S,) from which the way to each sample is shortest; itself where no way leads."""
    indices = np.flatnonzero(seeds)
    found = dijkstra(
        graph, directed=False, indices=indices, min_only=True, return_predecessors=True
    )[2]
    return np.where(found < 0, np.arange(len(seeds)), found)


def _parted(surfels: Surfels, a: LongArray, b: LongArray) -> DoubleArray:
    """Share (E,) of the views of both ends that show them in two regions; 1/3 if there are none."""
    shares, regions = np.empty(len(a)), surfels.all_regions
    for start in range(0, len(a), _SLICE):
        rows = slice(start, start + _SLICE)
        one, other = regions[a[rows]], regions[b[rows]]
        both = (one > 0) & (other > 0)
        n_parted = (both & (one != other)).sum(axis=1)
        shares[rows] = (n_parted + 0.5) / (both.sum(axis=1) + 1.5)
    return shares


# --- Large planes: what other objects stand on, found first so that noise does not break it to
# pieces.
# Planes are sought from single samples outwards, not from three points of the whole scene, so
# shelves and seats are found like floors.


_FLAT = 0.6  # length of the mean normal around a sample that may be part of a plane
_AWAY = 1.5  # times the spacing around: distance from the plane of a sample on it
_TURNED = np.cos(np.radians(30.0))  # cosine between normals of the plane and of a sample on it
_TRIED, _PROBED = 150, 8000  # planes tried at a time, and samples counted for each
_FITTED, _FITS = 6, 4  # best ones that are fitted, and how often
_PLANE_SAMPLES_MIN = 150  # samples of a plane
_PLANES_MAX = 24  # planes
_MISSES = 3  # searches in vain that end it
_FIT_POINTS = 3000


def planes_of(surfels: Surfels, near: Neighbourhood) -> IntArray:
    """The plane (S,) that each sample lies on, ids from 1 in the order found, large ones first;
    0 = none. A plane hangs together."""
    points = surfels.points
    mean = surfels.normals + surfels.normals[near.around].mean(axis=1)
    length = np.linalg.norm(mean, axis=1)
    normals = mean / np.maximum(length, 1e-9)[:, None]
    free = length > 2 * _FLAT
    plane, n_planes, n_misses = np.zeros(len(points), np.int32), 0, 0
    rng = np.random.default_rng(0)
    while n_planes < _PLANES_MAX and n_misses < _MISSES and int(free.sum()) >= _PLANE_SAMPLES_MIN:
        rows = np.flatnonzero(free)
        best, most = np.zeros(0, np.int64), 0.0
        for seed in _promising(points, normals, near.spacing, rows, rng):
            found = _grown(points, normals, near, free, seed)
            area = float((near.spacing[found] ** 2).sum())
            if area > most:
                best, most = found, area
        if len(best) == 0:
            n_misses += 1
            continue
        n_planes += 1
        plane[best], free[best] = n_planes, False
    return plane


def _promising(
    points: DoubleArray,
    normals: DoubleArray,
    spacing: DoubleArray,
    rows: LongArray,
    rng: np.random.Generator,
) -> LongArray:
    """Samples whose tangent planes hold most others of ``rows``, best first."""
    probe = rows[rng.integers(0, len(rows), min(len(rows), _PROBED))]
    tried = rng.choice(rows, min(_TRIED, len(rows)), replace=False)
    count = np.empty(len(tried), np.int64)
    count_on_planes(points, normals, _AWAY * spacing, _TURNED, probe, tried, count)
    return tried[np.argsort(-count, kind="stable")[:_FITTED]]


def _grown(
    points: DoubleArray, normals: DoubleArray, near: Neighbourhood, free: BoolArray, seed: int
) -> LongArray:
    """Samples of the plane through a seed after some fits; none if it is too small."""
    origin, normal = points[seed], normals[seed]
    found = np.zeros(0, np.int64)
    for _ in range(_FITS):
        on = free & (np.abs(along(points - origin, normal)) < _AWAY * near.spacing)
        rows = np.flatnonzero(on & (along(normals, normal) > _TURNED))
        if len(rows) < _PLANE_SAMPLES_MIN:
            return np.zeros(0, np.int64)
        part = connected_components(near.adjacency(rows), directed=False)[1]
        found = rows[part == np.bincount(part, near.spacing[rows] ** 2).argmax()]
        if len(found) < _PLANE_SAMPLES_MIN:
            return np.zeros(0, np.int64)
        origin = points[found].mean(axis=0)
        fitted = axes_of_points(points[found[:: max(1, len(found) // _FIT_POINTS)]])[:, 0]
        normal = fitted if (fitted * normal).sum() > 0 else -fitted
    return found
