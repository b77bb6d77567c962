"""Beyond the paper: the surfaces that Gaussians form, as a graph of neighbours.

A Gaussian's normal is its thinnest axis; where it has none, that of the plane through its
neighbours. Over an edge the surface is smooth, convex, or has a crease: two objects that touch
mostly meet in a crease (local convexity: Stein et al., CVPR 2014).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.grouping.robust.surfaces_kernels import flood
from gaga_core.kernels import n_threads

_FLAT = 0.5  # a splat whose thinnest axis has at most this share of the next one has a normal
_FAR = 3.0  # an edge is at most so many times longer than the median edge of either end
_ALIKE = 0.7  # cosine of normals that are averaged
_CREASE = 0.25  # summed sine of the two normals at which a crease weighs nothing
_DEEPEST = -2.0
_BACK_TO_BACK = -0.5  # cosine of normals of two sheets that lie on each other
_SPREADS = 30  # steps that orientations spread over the graph
_EVEN = 0.5  # how far an edge runs within the planes of both ends that joins a surface
_SOLID = -2.2  # logit of the opacity, a tenth, from which on a splat makes a surface
_NEARNESS = 0.3  # weight of distance next to evenness, when labels spread


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Edges between neighbouring points, each once."""

    nearest: LongArray  # (N, k)
    first: LongArray  # (E,) < second
    second: LongArray  # (E,)
    way: DoubleArray  # (E, 3) unit vector from first to second
    distance: DoubleArray  # (E,)
    is_near: BoolArray  # (E,) not too long for the spacing around either end

    @staticmethod
    def of(points: DoubleArray, k: int, *, only_near: bool = True) -> "Neighbours":
        """Edges from each of ``points`` (N, 3) to its ``k`` nearest."""
        k = min(k, len(points) - 1)
        found = cKDTree(points).query(points, k=range(2, k + 2), workers=n_threads())
        distance, nearest = np.asarray(found[0]), np.asarray(found[1], np.int64)
        spacing = np.median(distance, axis=1)
        a, b = np.repeat(np.arange(len(points)), k), nearest.ravel()
        key = np.minimum(a, b) * len(points) + np.maximum(a, b)
        _, once = np.unique(key, return_index=True)
        a, b = key[once] // len(points), key[once] % len(points)
        length = distance.ravel()[once]
        near = length <= _FAR * np.minimum(spacing[a], spacing[b])
        kept = (length > 0) & (a != b) & (near | (not only_near))
        a, b, length, near = a[kept], b[kept], length[kept], near[kept]
        way = (points[b] - points[a]) / length[:, None]
        return Neighbours(nearest, a, b, way, length, near)


def splat_normals(gaussians: Gaussians, nearest: LongArray) -> DoubleArray:
    """Unit normals (N, 3) of either sign, from neighbours ``nearest`` (N, k)."""
    order = np.argsort(gaussians.log_scales, axis=1)
    axes = quats_to_matrices(gaussians.quats)
    normals = axes[np.arange(len(order)), :, order[:, 0]]
    scales = np.take_along_axis(gaussians.log_scales, order, axis=1)
    unclear = np.flatnonzero(~(scales[:, 0] - scales[:, 1] <= np.log(_FLAT)))
    around = gaussians.means[nearest[unclear]].astype(np.float64)
    offsets = around - around.mean(axis=1, keepdims=True)
    if len(unclear) > 0:
        normals[unclear] = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]
    result: DoubleArray = np.nan_to_num(normals)
    return result


def towards_cameras(
    normals: DoubleArray,  # (N, 3)
    points: DoubleArray,  # (N, 3)
    views: Sequence[Camera],
    weights: DoubleArray,  # (N, V) how well each view sees each point
    nearest: LongArray,  # (N, k)
) -> DoubleArray:
    """The normals (N, 3), turned to the side from which they are seen and averaged over neighbours
    of like direction."""
    facing = np.zeros(len(points))
    for v, camera in enumerate(views):
        away = camera.world_from_cam[:3, 3] - points
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        facing += weights[:, v] * (normals * away).sum(axis=1)
    side = np.sign(facing)
    for _ in range(_SPREADS):
        open_ = np.flatnonzero(side == 0)
        cosine = np.einsum("ni,nki->nk", normals[open_], normals[nearest[open_]])
        signs = np.sign((side[nearest[open_]] * cosine).sum(axis=1))
        if not signs.any():
            break
        side[open_] = signs
    turned = normals * np.where(side == 0, 1, side)[:, None]
    cosine = np.einsum("ni,nki->nk", turned, turned[nearest])
    weight = np.where(np.abs(cosine) > _ALIKE, cosine, 0)
    mean = turned + 0.5 * np.einsum("nk,nki->ni", weight, turned[nearest])
    result: DoubleArray = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    return result


def evenness(graph: Neighbours, normals: DoubleArray) -> DoubleArray:
    """1 for edges (E,) over which the surface is even or bulges, down to -2 in a deep crease."""
    one, other = normals[graph.first], normals[graph.second]
    bulge = ((other - one) * graph.way).sum(axis=1)
    even = np.maximum(1 + np.minimum(bulge, 0) / _CREASE, _DEEPEST)
    back = (one * other).sum(axis=1) < _BACK_TO_BACK
    result: DoubleArray = np.where(back, np.minimum(even, -1), even)
    return result


def along_surfaces(gaussians: Gaussians, labels: IntArray, k: int, least: int) -> IntArray:
    """Labels (N,) in which those without one, 0, take the one they reach over the evenest surface.

    A surface of at least ``least`` Gaussians that no label reaches evenly is a group of its own: it
    belongs to an object that no mask shows. Normals have no sign here, as no view sees these
    Gaussians: an edge is even that runs along the planes of both ends. Whom no edge joins to a
    label takes the nearest one.
    """
    rows = np.flatnonzero(finite(gaussians))
    if len(rows) < 2 or not (labels[rows] > 0).any():
        return labels
    some = gaussians.take(rows)
    graph = Neighbours.of(some.means.astype(np.float64), k, only_near=False)
    even = _within_planes(graph, splat_normals(some, graph.nearest))
    solid = some.logit_opacities > _SOLID
    even = np.where(solid[graph.first] & solid[graph.second], even, 0)
    found = _with_surfaces_apart(graph, even, labels[rows].astype(np.int64), least)
    spacing = np.median(graph.distance) if len(graph.distance) else 1.0
    order = np.argsort(-even - _NEARNESS * np.exp(-graph.distance / spacing), kind="stable")
    flood(graph.first[order], graph.second[order], np.arange(len(rows)), found)
    known, alone = np.flatnonzero(found > 0), np.flatnonzero(found == 0)
    if len(alone) > 0:
        found[alone] = found[known[cKDTree(some.means[known]).query(some.means[alone])[1]]]
    result = labels.copy()
    result[rows] = found
    return result


def _within_planes(graph: Neighbours, normals: DoubleArray) -> DoubleArray:
    """How far edges (E,) run within the planes of both ends, 0..1; normals of either sign."""
    one, other = normals[graph.first], normals[graph.second]
    cosine = (one * other).sum(axis=1)
    middle = one + np.where(cosine < 0, -1, 1)[:, None] * other
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
    result: DoubleArray = np.abs(cosine) * (1 - np.abs((graph.way * middle).sum(axis=1)))
    return result


def _with_surfaces_apart(
    graph: Neighbours, even: DoubleArray, labels: LongArray, least: int
) -> LongArray:
    """Labels (N,) in which even surfaces without a label have new ones, if they are large."""
    n = len(labels)
    joins = graph.is_near & (even >= _EVEN)
    ends = (graph.first[joins], graph.second[joins])
    _, surface = connected_components(coo_matrix((even[joins], ends), shape=(n, n)), directed=False)
    labelled = np.bincount(surface, labels > 0) > 0
    own = ~labelled & (np.bincount(surface) >= least)
    new = np.where(own, int(labels.max()) + np.cumsum(own), 0)
    return np.where(labels > 0, labels, new[surface])


def finite(gaussians: Gaussians) -> BoolArray:
    """Which Gaussians (N,) have a place in space."""
    result: BoolArray = np.isfinite(gaussians.means.sum(axis=1))
    return result
