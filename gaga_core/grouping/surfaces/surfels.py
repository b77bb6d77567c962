"""Samples of the surfaces that the views see, with fused normals and the region seen in each view.

Normals of single splats are too rough to tell a crease from noise. Those of planes fitted to the
rendered depth maps, averaged over all views that see a point, are not.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import ConvexHull, cKDTree

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.geometry import principal_axes, turned
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
    add_parted,
    choose_seeds,
    keep_apart,
    normals_at,
)
from gaga_core.progress import Progress, Stage
from gaga_core.threads import n_threads

N_LEVELS = 4  # of detail, of regions without a model
LoadFurther = Callable[[Camera], Sequence[IntArray]]  # label maps (H, W) of a view, dense

_ACROSS = 213  # samples along the longer side of a view
_MISS = 0.02  # share of its depth by which a sample may miss the surface that a view shows
_COVERED = 0.03  # ... within which a sample covers its surroundings in another view
_WINDOW = 0.007  # of the width of a view: radius of the window of a normal
_SHARES = np.array([0.06, 0.03, 0.015])  # of 1 / depth, round by round of the fit
_GRIDS = 12  # most levels of cells, each of twice the side, when samples are thinned out
_OVER = 1.1  # times the wanted number of samples that are accepted


@dataclass(frozen=True, eq=False)
class Surfels:
    """Samples of the surfaces."""

    points: DoubleArray  # (S, 3) world
    normals: DoubleArray  # (S, 3) unit, towards the cameras; 0 = unknown
    regions: IntArray  # (S, V) dense mask id that each view shows there, 0 = none or hidden
    n_views: IntArray  # (S,) views that see it
    further: IntArray  # (S, F) the same at other levels of detail, view by view

    def maps_of(self, v: int) -> Iterator[tuple[int | None, IntArray]]:
        """The maps (S,) of a view with their levels of detail, 0 = that of `regions`; None where
        views do not have `N_LEVELS` of them."""
        n, odd = divmod(self.further.shape[1], self.regions.shape[1])
        has_levels = not odd and n == N_LEVELS - 1
        yield (0 if has_levels else None), self.regions[:, v]
        for k in range(0 if odd else n):
            yield (1 + k if has_levels else None), self.further[:, v * n + k]

    def parted(self, support: BoolArray, near: "Neighbourhood", level: int) -> "Surfels":
        """The same, where regions at a level of detail end at a ``support`` (S,), and what stands
        apart on it has regions of its own."""
        further = self.further.copy()
        n = further.shape[1] // self.regions.shape[1]
        if n == N_LEVELS - 1 and support.any():
            own = ~support[near.first] & ~support[near.second]
            pairs = (np.ones(int(own.sum())), (near.first[own], near.second[own]))
            thing = connected_components(coo_matrix(pairs, shape=(len(support),) * 2))[1]
            size = np.bincount(thing, ~support)
            thing[size[thing] < _LEAST_GROUND * len(support)] = size.argmax()  # crumbs at edges
            thing[support] = len(size)
            for column in further.T[level - 1 :: n]:
                seen = column > 0
                both = column[seen].astype(np.int64) * (len(size) + 1) + thing[seen]
                column[seen] = 1 + dense(both)
        return replace(self, further=further)

    def maps(self) -> Iterator[tuple[int | None, IntArray]]:
        """Those of all views."""
        for v in range(self.regions.shape[1]):
            yield from self.maps_of(v)


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
            # Small numbers: these are most of the memory of an association of a thousand views.
            further.append(np.zeros(len(points), np.min_scalar_type(int(labels.max(initial=0)))))
            further[-1][seen] = labels[rows, columns]
        normals[seen] += _weighted_normals(camera, depth, points[seen], rows, columns)
        n_views[seen] += 1
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    table = np.zeros((len(points), len(further)), np.int32)
    for k, column in enumerate(further):
        table[:, k] = column
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
        kept = apart(points, reach * size)
        if int(kept.sum()) <= _OVER * wanted:
            return points[kept]
        reach *= max(1.1, float(np.sqrt(kept.sum() / wanted)))


def apart(points: DoubleArray, reach: DoubleArray) -> BoolArray:
    """Which points (S,) stay when those go that have another within their reach (S,), which stays;
    those of the least reach are asked first."""
    kept = np.ones(len(points), np.bool_)
    if len(points) == 0:
        return kept
    least = max(float(reach.min()), float(reach.max()) / 2 ** (_GRIDS - 1), 1e-300)
    level = np.maximum(np.ceil(np.log2(reach / least) + 1e-9), 0).astype(np.int32)
    side = least * 2.0 ** np.arange(int(level.max()) + 1)
    head = np.full(1 << (4 * len(points)).bit_length(), -1, np.int64)
    following = np.empty(len(points) * len(side), np.int64)
    keep_apart(points, np.argsort(reach, kind="stable"), reach, level, side, head, following, kept)
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


# --- What an object stands on: it turns along with it, and both have one outline.


# Set by hand on seven of the twelve drawn turntables of `bench_turntables`, see experiments.md;
# three others chose nothing.
_FACES = 0.9  # least cosine of a flat surface's normals with that of its plane: 25 degrees
_NEAR_PLANE = 2.0  # times the spacing of samples: distance from a plane of what lies on it
_LEAST_GROUND = 0.01  # least share of all samples of a layer of the ground, and of a thing on it
_LEAST_SAMPLES = 8  # of a layer of the ground: fewer have no outline
_WITHIN = 0.8  # least share of what is just above the ground that lies inside of its outline
_BELOW = 0.04  # most of what lies inside of its outline that is below: noise


def support_of(points: DoubleArray, normals: DoubleArray) -> BoolArray:
    """Which of the points (S, 3) with normals (S, 3) are a flat surface that all else stands on.

    What lies within its outline is on the side to which it faces: no surface of an object that
    stands on its own is like that, but the ground under it. And what stands on it is within its
    outline: the side of a bowl is not within its floor. Most of the rest is above it. What is below
    the surface goes with it; none where there is no such surface.
    """
    best, largest, least = np.zeros(len(points), np.bool_), 0, _LEAST_GROUND * len(points)
    ways = np.unique(np.round(2 * normals), axis=0)
    reach = _NEAR_PLANE * float(np.median(np.asarray(cKDTree(points).query(points, k=2)[0])[:, 1]))
    for way in ways[ways.any(axis=1)]:
        normal = normals[normals @ way > _FACES * np.linalg.norm(way)].sum(axis=0)
        normal /= max(np.linalg.norm(normal), 1e-12)
        height, faces = points @ normal, normals @ normal > _FACES
        layer = np.floor((height - height.min()) / reach).astype(np.int64)
        for k in np.flatnonzero(np.bincount(layer[faces], minlength=1) > least):
            flat = faces & (layer >= k - 1) & (layer <= k + 1)
            if flat.sum() < _LEAST_SAMPLES:
                continue
            centre = points[flat].mean(axis=0)
            moments, axes = principal_axes(np.cov(points[flat].T)[None])
            axis = axes[0, :, 0] * np.where(axes[0, :, 0] @ normal > 0, 1, -1)
            above = (points - centre) @ axis
            flat = faces & (np.abs(above) < reach)
            is_strip = moments[0, 1] < reach**2 or flat.sum() < _LEAST_SAMPLES
            if is_strip or (above > reach).sum() <= (above < -reach).sum():
                continue
            if flat.sum() <= largest:
                continue
            within = _is_within(points[flat], points, axis, 2 * reach)
            foot = (above > reach) & (above < 3 * reach)
            is_below = above < -reach
            if within[foot].sum() > _WITHIN * max(foot.sum(), 1) and (
                is_below[within].sum() < _BELOW * within.sum()
            ):
                best, largest = flat | is_below, int(flat.sum())
    return best


def _is_within(
    ground: DoubleArray, points: DoubleArray, axis: DoubleArray, margin: float
) -> BoolArray:
    """Which points (S, 3) lie over the convex outline of others (K, 3), by a margin."""
    first = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across = np.stack([first, np.cross(axis, first)]).T / np.linalg.norm(first)
    hull = ConvexHull(ground @ across).equations
    result: BoolArray = ((points @ across) @ hull[:, :2].T + hull[:, 2] < -margin).all(axis=1)
    return result


# --- Small pieces of surface: a few neighbouring samples that face one way and share their
# regions.


_EDGES = 10  # nearest samples that a sample has edges to
_AROUND = 16  # ... that are its surroundings
_FAR = 3.0  # an edge is at most so many times longer than the spacing around either end
_TURN, _PARTED = 3.0, 2.0  # cost of an edge that turns by 90 degrees, that all views part ...
_ALONG = 0.3  # ... next to that of its length
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


def dense(ids: AnyArray) -> LongArray:
    """The same ids as 0, 1, ... in their order."""
    return np.unique(ids, return_inverse=True)[1].astype(np.int64)


def outlines(n_samples: AnyArray) -> DoubleArray:
    """Edges (n,) along the outline of compact pieces of surface of so many samples (n,)."""
    return _OUTLINE * np.sqrt(n_samples)


def small_pieces(surfels: Surfels, near: Neighbourhood) -> LongArray:
    """The piece (S,) of each sample, dense ids from 0: some seven samples each.

    Samples go to the seed that is nearest along the surface, where turning and leaving a region
    make the way longer, so that pieces end at creases and outlines.
    """
    n = len(surfels.points)
    a, b = near.first, near.second
    cosine = (surfels.normals[a] * surfels.normals[b]).sum(axis=1)
    cost = _ALONG + _TURN * np.clip(1 - cosine, 0, 1.5) + _PARTED * _parted(surfels, a, b)
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
    parted, both = np.zeros(len(a), np.int64), np.zeros(len(a), np.int64)
    for regions in (surfels.regions, surfels.further):
        add_parted(regions, a, b, parted, both)
    return (parted + 0.5) / (both + 1.5)
