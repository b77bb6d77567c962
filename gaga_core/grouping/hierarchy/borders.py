"""Two witnesses of a border between pieces: what the views say, and the shape of the surface.

Views: the share of them that show both sides in one region. Regions of several levels of detail
count as so many views, because a single level is an accident of its threshold. Shape: concave
creases and steps speak for two things, even and bulging borders for one (local convexity: Stein et
al., CVPR 2014). Where the surface is even, views say nothing against one thing: print, shadows and
texture part regions as well. Two pieces that both stand on a plane and meet in a crease are two
things, too.

A piece of seven samples is no larger than what regions miss an outline by, so a border of larger
pieces asks the views about all samples near it on either side. And splats that a training left
rough have creases and steps everywhere: what pieces of one plane show of them is noise, and what of
it goes beyond the scenes that the weights were fitted to is taken off. Of the borders that are left
in rough splats after pieces have joined, noise made more the later, so they are not judged at each
level (`is_calm`).

The weights are a logistic regression with ridge 1, fitted to the true borders of ycb_table, of the
demo scene and of one generated room, from regions of two widths each
(`tests.bench.bench_objects` reports other widths and scenes).
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.grouping.hierarchy.linkage import Clusters, SignedGraph
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, outlines
from gaga_core.grouping.hierarchy.surfels import Surfels

KNOWN_NOISE = np.array([0.1, 0.16])  # crease and step by noise in the scenes of the fit

_STEPS = 2  # from piece to piece, within which pieces of a cluster are asked together
_CALM = 1.25  # times that crease up to which creases are those of things
_PRIOR = 0.5  # views' worth of doubt about a share of views, on either side
_HALF_VOICE = 1.0  # samples with which a view has half a voice about a piece
_SMOOTHED = 2  # rounds of averaging over neighbours within a piece
_SHARP = 0.4  # crease or step that counts in full
_EVEN = 0.3  # share of that from which on views for two regions count in full
_DEEP = 0.4  # crease from which on more is said
_STANDS = 0.3  # crease at which standing side by side counts in full
_ON_PLANE = 0.6  # share of the samples of a piece that make it a part of a plane
_SUPPORT_AREA, _SUPPORT_SIZE = 0.01, 0.002  # shares of the area and of the samples of a support
_PATCH = 0.15  # share of the samples of either side on the same plane that makes it a patch
_FOOT = 0.1  # least crease between a thing and its support
# Of small pieces: bias, crease, bulge, step, share of views in one region (-1..1).
_FINE = np.array([1.56, -5.0, -0.5, -3.0, 3.7])
# Of larger ones: bias, crease, bulge, step, views for one region, views for two where the surface
# parts as well, both on one plane, deep crease, views for one region at a crease or step, both
# standing on a plane at a crease.
_COARSE = np.array([1.73, -2.25, 1.91, -1.4, 2.53, 4.22, 0.91, -2.61, 1.38, -1.08])


@dataclass(frozen=True, eq=False)
class Agreement:
    """What the views say of pairs of neighbouring small pieces."""

    first: LongArray  # (B,) < second
    second: LongArray  # (B,)
    length: DoubleArray  # (B,) edges between them
    same: DoubleArray  # (B,) summed chance that a sample of each shows in one region
    voice: DoubleArray  # (B,) summed voice of the views that see both

    @staticmethod
    def of(
        surfels: Surfels,
        near: Neighbourhood,
        piece: LongArray,
        cluster: LongArray | None = None,
    ) -> "Agreement":
        """Agreement about all borders of pieces (S,).

        Each piece speaks for itself, or with what is near it in its ``cluster`` (S,) of pieces.
        """
        first, second, cell = _pairs(piece[near.first], piece[near.second])
        n = int(piece.max()) + 1
        together = None if cluster is None else _near_in_cluster(first, second, piece, cluster)
        same, voice = np.zeros(len(first)), np.zeros(len(first))
        for region in surfels.all_regions.T:
            rows = np.flatnonzero(region)
            if len(rows) == 0:
                continue
            shape = (n, int(region.max()) + 1)
            table = coo_matrix((np.ones(len(rows)), (piece[rows], region[rows])), shape).tocsr()
            table = table if together is None else (together @ table).tocsr()
            total = np.asarray(table.sum(axis=1)).ravel()
            both = np.flatnonzero((total[first] > 0) & (total[second] > 0))
            a, b = first[both], second[both]
            weight = total / (total + _HALF_VOICE)
            chance = np.asarray(table[a].multiply(table[b]).sum(axis=1)).ravel()
            same[both] += weight[a] * weight[b] * chance / (total[a] * total[b])
            voice[both] += weight[a] * weight[b]
        length = np.bincount(cell, minlength=len(first)).astype(np.float64)
        return Agreement(first, second, length, same, voice)


def fine_graph(
    surfels: Surfels, near: Neighbourhood, piece: LongArray, views: Agreement
) -> SignedGraph:
    """The small pieces (S,) and the evidence about their borders, by their mean normals."""
    size = np.bincount(piece).astype(np.float64)
    centre = _means(surfels.points, piece) / size[:, None]
    normal = _means(surfels.normals, piece)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    a, b = views.first, views.second
    bend, step = _shape(centre, normal, a, b)
    share = (views.same + _PRIOR) / (views.voice + 2 * _PRIOR)
    features = [np.ones_like(bend), np.clip(-bend - 0.05, 0, 1), np.clip(bend, 0, 1)]
    features += [np.clip(step, 0, 1), 2 * share - 1]
    return SignedGraph(size, a, b, views.length, np.stack(features, axis=1) @ _FINE)


def coarse_graph(
    surfels: Surfels,
    near: Neighbourhood,
    plane: IntArray,  # (S,) 0 = none
    piece: LongArray,  # (S,) small pieces
    views: Agreement,
    cluster: LongArray,  # (S,) of small pieces
    noise: DoubleArray | None = None,  # (2,) as `noise_of` finds it; None = as in the fit
) -> SignedGraph:
    """Clusters of pieces (S,) and the evidence about their borders.

    Normals and places are averaged around each sample within its own cluster, so that a crease
    stays sharp and noise does not make one.
    """
    normals, points = _smoothed(surfels, near, cluster)
    a, b = near.first, near.second
    apart = cluster[a] != cluster[b]
    a, b = a[apart], b[apart]
    first, second, cell = _pairs(cluster[a], cluster[b])
    length = np.bincount(cell, minlength=len(first)).astype(np.float64)
    bend, step = _shape(points, normals, a, b)
    count = np.maximum(length, 1)
    excess = np.maximum((KNOWN_NOISE if noise is None else noise) - KNOWN_NOISE, 0)
    crease = np.bincount(cell, np.maximum(-bend, 0), len(first)) / count
    crease = np.maximum(crease - excess[0], 0)
    bend = np.bincount(cell, bend, len(first)) / count
    step = np.maximum(np.bincount(cell, step, len(first)) / count - excess[1], 0)
    size = np.bincount(cluster).astype(np.float64)
    supports, on_plane = _supports(plane, cluster, near.spacing)
    coplanar = (on_plane[first] == on_plane[second]) & (on_plane[first] > 0)
    stand = _standing(first, second, length, crease, size, supports)
    seen = _summed(views, piece, cluster, first, second, len(size))
    view = 2 * (seen[0] + _PRIOR) / (seen[1] + 2 * _PRIOR) - 1
    crease, step = np.clip(crease, 0, 1), np.clip(step, 0, 1)
    parts = np.clip(np.maximum(crease, step) / _SHARP, 0, 1)
    one, two = np.maximum(view, 0), np.minimum(view, 0) * np.clip(parts / _EVEN, 0, 1)
    features = [np.ones_like(bend), crease, np.clip(bend, 0, 1), step, one, two]
    features += [coplanar, np.clip(crease - _DEEP, 0, 1), one * parts]
    features += [stand * np.clip(crease / _STANDS, 0, 1)]
    return SignedGraph(size, first, second, length, np.stack(features, axis=1) @ _COARSE)


def noise_of(
    surfels: Surfels, near: Neighbourhood, plane: IntArray, cluster: LongArray
) -> DoubleArray:
    """Mean crease and step (2,) at borders of clusters (S,) that run across one plane (S,).

    What `coarse_graph` would see there is noise, as a plane has neither. Those of the fit where no
    border runs across a plane.
    """
    a, b = near.first, near.second
    flat = (cluster[a] != cluster[b]) & (plane[a] == plane[b]) & (plane[a] > 0)
    if not flat.any():
        return KNOWN_NOISE
    normals, points = _smoothed(surfels, near, cluster)
    bend, step = _shape(points, normals, a[flat], b[flat])
    return np.array([np.maximum(-bend, 0).mean(), step.mean()])


def is_calm(noise: DoubleArray) -> bool:
    """Whether splats of this ``noise`` (2,) make no more creases than those of the fit."""
    return bool(noise[0] <= _CALM * KNOWN_NOISE[0])


def in_one_plane(plane: IntArray, clusters: Clusters) -> BoolArray:
    """Which borders (B,) run within one plane (S,) for a part: noise tears patches out of it, of
    which some samples still lie on it, while things that stand on it hardly have any there."""
    graph, n_planes = clusters.graph, int(plane.max(initial=0)) + 1
    n = len(graph.size)
    table = np.bincount(clusters.cluster * n_planes + plane, minlength=n * n_planes)
    share = table.reshape(n, n_planes) / np.bincount(clusters.cluster, minlength=n)[:, None]
    share[:, 0] = 0  # no plane
    result: BoolArray = np.minimum(share[graph.first], share[graph.second]).max(axis=1) > _PATCH
    return result


def _pairs(a: LongArray, b: LongArray) -> tuple[LongArray, LongArray, LongArray]:
    """The distinct pairs of different ids, lower first, and the pair of each entry that has one."""
    apart = a != b
    n = int(max(a.max(initial=0), b.max(initial=0))) + 1
    key = np.minimum(a, b)[apart] * n + np.maximum(a, b)[apart]
    keys, cell = np.unique(key, return_inverse=True)
    return keys // n, keys % n, cell.astype(np.int64)


def _near_in_cluster(
    first: LongArray, second: LongArray, piece: LongArray, cluster: LongArray
) -> csr_matrix:
    """Which pieces (n, n) are within `_STEPS` borders (B,) of each other inside one cluster."""
    n = int(piece.max()) + 1
    cluster_of = np.zeros(n, np.int64)
    cluster_of[piece] = cluster
    inside = cluster_of[first] == cluster_of[second]
    a, b, every = first[inside], second[inside], np.arange(n)
    rows, columns = np.concatenate([a, b, every]), np.concatenate([b, a, every])
    step = coo_matrix((np.ones(len(rows)), (rows, columns)), (n, n)).tocsr()
    reach = step
    for _ in range(_STEPS - 1):
        reach = reach @ step
    reach.data[:] = 1
    return reach


def _means(values: DoubleArray, cluster: LongArray) -> DoubleArray:
    """Sums (n, 3) of values (S, 3) over clusters."""
    return np.stack([np.bincount(cluster, column) for column in values.T], axis=1)


def _shape(
    points: DoubleArray, normals: DoubleArray, a: LongArray, b: LongArray
) -> tuple[DoubleArray, DoubleArray]:
    """Bend (P,), > 0 bulges, < 0 a crease, and step (P,) across the mean plane, 0..1."""
    way = points[b] - points[a]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    bend = ((normals[b] - normals[a]) * way).sum(axis=1)
    middle = normals[a] + normals[b]
    length = np.maximum(np.linalg.norm(middle, axis=1), 0.5)
    return bend, np.abs((middle * way).sum(axis=1)) / length


def _smoothed(
    surfels: Surfels, near: Neighbourhood, cluster: LongArray
) -> tuple[DoubleArray, DoubleArray]:
    """Normals and points (S, 3) averaged over neighbours of the same cluster."""
    normals, points = surfels.normals, surfels.points
    same = (cluster[near.around] == cluster[:, None]).astype(np.float64)
    count = 1 + same.sum(axis=1, keepdims=True)
    for _ in range(_SMOOTHED):
        normals = normals + np.einsum("sk,ski->si", same, normals[near.around])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        points = (points + np.einsum("sk,ski->si", same, points[near.around])) / count
    return normals, points


def _supports(
    plane: IntArray, cluster: LongArray, spacing: DoubleArray
) -> tuple[BoolArray, LongArray]:
    """Which clusters (n,) others may stand on, and the plane (n,) of each, 0 = none."""
    n, n_planes = int(cluster.max()) + 1, int(plane.max(initial=0)) + 1
    table = np.bincount(cluster * n_planes + plane, minlength=n * n_planes).reshape(n, n_planes)
    size = table.sum(axis=1)
    table[:, 0] = 0
    best = table.argmax(axis=1)
    flat = table[np.arange(n), best] > _ON_PLANE * size
    area = np.bincount(plane, spacing**2, n_planes)
    large = area > _SUPPORT_AREA * area.sum()
    supports = flat & large[best] & (size > _SUPPORT_SIZE * len(cluster))
    return supports, np.where(flat, best, 0)


def _standing(
    first: LongArray,
    second: LongArray,
    length: DoubleArray,
    crease: DoubleArray,
    size: DoubleArray,
    supports: BoolArray,
) -> DoubleArray:
    """How far both sides of each border stand on supports, 0..1: the lesser share of outlines."""
    foot = np.zeros(len(size))
    for thing, below in ((first, second), (second, first)):
        on = supports[below] & ~supports[thing] & (crease > _FOOT)
        foot += np.bincount(thing[on], length[on], len(size))
    share = foot / outlines(size)
    least = np.clip(np.minimum(share[first], share[second]), 0, 1)
    result: DoubleArray = np.where(supports[first] | supports[second], 0, least)
    return result


def _summed(
    views: Agreement,
    piece: LongArray,
    cluster: LongArray,
    first: LongArray,
    second: LongArray,
    n: int,
) -> tuple[DoubleArray, DoubleArray]:
    """Agreement (B,) and voice (B,) at borders of clusters: means over their length."""
    cluster_of = np.zeros(int(piece.max()) + 1, np.int64)
    cluster_of[piece] = cluster
    a, b = cluster_of[views.first], cluster_of[views.second]
    apart = a != b
    key = np.minimum(a, b)[apart] * n + np.maximum(a, b)[apart]
    cell = np.searchsorted(first * n + second, key)
    length = views.length[apart]
    total = np.maximum(np.bincount(cell, length, len(first)), 1e-9)
    same = np.bincount(cell, views.same[apart] * length, len(first)) / total
    return same, np.bincount(cell, views.voice[apart] * length, len(first)) / total
