"""Two witnesses of a border between pieces: what the views say, and the shape of the surface.

Views: the share of them that show both sides in one region. Regions of several levels of detail
count as so many views, because a single level is an accident of its threshold. Shape: concave
creases and steps speak for two objects, even and bulging borders for one (local convexity: Stein et
al., CVPR 2014). Where the surface is even, views say nothing against one object: print, shadows and
texture part regions as well. Two pieces that both stand on a plane and meet in a crease are two
objects, too.

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

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, identity

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.geometry import principal_axes
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels, dense, outlines

# --- Average linkage over a graph with signed evidence: which clusters join, and in what order.
# The evidence between two clusters is the mean over their common border, not over all pairs of
# members, so that large surfaces hold together (as in GASP, Bailoni et al., CVPR 2022).


@dataclass(frozen=True, eq=False)
class SignedGraph:
    """Nodes with sizes, and the borders between them, each once."""

    size: DoubleArray  # (n,)
    first: LongArray  # (B,) node
    second: LongArray  # (B,) node
    length: DoubleArray  # (B,) of the border, > 0
    evidence: DoubleArray  # (B,) log odds that both are one object: the mean over the border

    def contracted(self, cluster: LongArray) -> "SignedGraph":
        """The graph of clusters (n,), dense ids from 0."""
        a, b = cluster[self.first], cluster[self.second]
        first, second, cell = _pairs(a, b)
        length = np.bincount(cell, self.length[a != b], len(first)).astype(np.float64)
        total = np.bincount(cell, (self.length * self.evidence)[a != b], len(first))
        size = np.bincount(cluster, self.size).astype(np.float64)
        return SignedGraph(size, first, second, length, total / length)

    def only(self, chosen: BoolArray) -> "SignedGraph":
        """The same nodes with some of the borders (B,)."""
        return replace(
            self,
            first=self.first[chosen],
            second=self.second[chosen],
            length=self.length[chosen],
            evidence=self.evidence[chosen],
        )


@dataclass(frozen=True, eq=False)
class Clusters:
    """Clusters of samples, and what is known of their borders."""

    cluster: LongArray  # (S,) dense ids from 0
    graph: SignedGraph

    def joined(self, least_evidence: float, least_size: float = 0.0) -> "Clusters":
        """After all joins of at least this evidence, as the function `joined` makes them."""
        joins = joined(self.graph, least_evidence, least_size)
        return Clusters(joins[self.cluster], self.graph.contracted(joins))

    def levels(
        self,
        least_evidence: Sequence[float],
        least_size: float = 0.0,
        again: Callable[["Clusters"], "Clusters"] = lambda now: now,
    ) -> list["Clusters"]:
        """Levels of clusters that grow: one a number of ``least_evidence``, which descends.

        The smallest cluster has ``least_size`` where it has neighbours; ``again`` judges borders
        before each level but the first.
        """
        levels: list[Clusters] = []
        for evidence in least_evidence:
            now = (again(levels[-1]) if levels else self).joined(evidence)
            grows = least_size > 0 and not levels
            levels.append(now.joined(-np.inf, least_size) if grows else now)
        return levels

    def merged(self, into: LongArray) -> "Clusters":
        """After joining clusters (n,) to those of dense ids ``into`` (n,)."""
        return Clusters(into[self.cluster], self.graph.contracted(into))

    def set_apart(self, outside: BoolArray) -> "Clusters":
        """The same with no borders between some clusters (n,) and the others."""
        inside = ~(outside[self.graph.first] | outside[self.graph.second])
        return Clusters(self.cluster, self.graph.only(inside))


def joined(graph: SignedGraph, least_evidence: float, least_size: float = 0.0) -> LongArray:
    """Clusters (n,), dense ids from 0, after all joins of at least this evidence, best first.

    With ``least_size`` only clusters that are smaller join, each the neighbour of best evidence.
    """
    n = len(graph.size)
    size = graph.size.tolist()
    borders: list[dict[int, tuple[float, float]]] = [{} for _ in range(n)]
    heap = []
    rows = zip(graph.first.tolist(), graph.second.tolist(), strict=True)
    totals = (graph.length * graph.evidence).tolist()
    for (a, b), total, length in zip(rows, totals, graph.length.tolist(), strict=True):
        borders[a][b] = borders[b][a] = (total, length)
        heap.append((-total / length, a, b, length))
    heapq.heapify(heap)
    parent, is_alive = np.arange(n), [True] * n
    while heap:
        value, a, b, length = heapq.heappop(heap)
        if not (is_alive[a] and is_alive[b]) or borders[a].get(b, (0.0, 0.0))[1] != length:
            continue  # one of them has joined another since
        if -value < least_evidence:
            break
        if least_size > 0 and min(size[a], size[b]) >= least_size:
            continue
        if len(borders[a]) < len(borders[b]):
            a, b = b, a
        parent[b], is_alive[b] = a, False
        size[a] += size[b]
        del borders[a][b]
        for other, (total, length) in borders[b].items():
            if other == a:
                continue
            del borders[other][b]
            known = borders[a].get(other, (0.0, 0.0))
            both = (total + known[0], length + known[1])
            borders[a][other] = borders[other][a] = both
            heapq.heappush(heap, (-both[0] / both[1], min(a, other), max(a, other), both[1]))
        borders[b] = {}
    while (parent[parent] != parent).any():
        parent = parent[parent]
    return dense(parent)


KNOWN_NOISE = np.array([0.1, 0.16])  # crease and step by noise in the scenes of the fit

_STEPS = 2  # from piece to piece, within which pieces of a cluster are asked together
_CALM = 1.25  # times that crease up to which creases are those of objects
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
_FOOT = 0.1  # least crease between an object and its support
# Of small pieces: bias, crease, bulge, step, share of views in one region (-1..1).
_FINE = np.array([1.56, -5.0, -0.5, -3.0, 3.7])
# Of larger ones: bias, crease, bulge, step, views for one region, views for two where the surface
# parts as well, both on one plane, deep crease, views for one region at a crease or step, both
# standing on a plane at a crease.
_COARSE = np.array([1.73, -2.25, 1.91, -1.4, 2.53, 4.22, 0.91, -2.61, 1.38, -1.08])


@dataclass(frozen=True, eq=False)
class Agreement:
    """Evidence of the views on pairs of neighbouring small pieces."""

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
    return SignedGraph(size, a, b, views.length, _weighted(features, _FINE))


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
    same, voice = _at_borders(views, coarser_of(piece, cluster))
    view = 2 * (same + _PRIOR) / (voice + 2 * _PRIOR) - 1
    crease, step = np.clip(crease, 0, 1), np.clip(step, 0, 1)
    parts = np.clip(np.maximum(crease, step) / _SHARP, 0, 1)
    one, two = np.maximum(view, 0), np.minimum(view, 0) * np.clip(parts / _EVEN, 0, 1)
    features = [np.ones_like(bend), crease, np.clip(bend, 0, 1), step, one, two]
    features += [coplanar, np.clip(crease - _DEEP, 0, 1), one * parts]
    features += [stand * np.clip(crease / _STANDS, 0, 1)]
    return SignedGraph(size, first, second, length, _weighted(features, _COARSE))


def _weighted(features: list[DoubleArray], weights: DoubleArray) -> DoubleArray:
    """The weighted sum (B,) of features (B,), added in their order on every processor."""
    total: DoubleArray = (np.stack(features) * weights[:, None]).sum(axis=0)
    return total


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
    which some samples still lie on it, while objects that stand on it hardly have any there."""
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


def coarser_of(level: LongArray, coarser: LongArray) -> LongArray:
    """The cluster (n,) at a ``coarser`` level (S,) of each one at a ``level`` (S,)."""
    result = np.zeros(int(level.max()) + 1, np.int64)
    result[level] = coarser
    return result


def _near_in_cluster(
    first: LongArray, second: LongArray, piece: LongArray, cluster: LongArray
) -> csr_matrix:
    """Which pieces (n, n) are within `_STEPS` borders (B,) of each other inside one cluster."""
    cluster_of = coarser_of(piece, cluster)
    n = len(cluster_of)
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
    return np.where(supports[first] | supports[second], 0, least)


def _at_borders(views: Agreement, cluster_of: LongArray) -> tuple[DoubleArray, DoubleArray]:
    """Agreement (B,) and voice (B,) at borders of clusters, of the pieces (n,) that these hold:
    means over the length."""
    a, b = cluster_of[views.first], cluster_of[views.second]
    first, _, cell = _pairs(a, b)
    length = views.length[a != b]
    total = np.maximum(np.bincount(cell, length, len(first)), 1e-9)
    same = np.bincount(cell, views.same[a != b] * length, len(first)) / total
    return same, np.bincount(cell, views.voice[a != b] * length, len(first)) / total


# --- The surroundings of the scene: walls, floors, shrubs, the sky.
# Photos of objects look at them from around: objects of interest are seen whole in most views. What
# lies outside of the ring of cameras and is cut by the borders of the pictures, or is seen in few
# views, is background. Where views look outwards or along a way, nothing is.


_AROUND = 0.15  # most sine between the views' axes and the way to their focus; half are less
_PARALLEL = 1e-12  # of the largest eigenvalue: axes that meet nowhere
_IN_FRONT = 0.3  # least way to the focus, of the distance of the cameras
_OUTSIDE, _AT_EDGE = 1.0, 0.7  # distances from the focus, of that of the cameras
_CUT, _ALWAYS_CUT = 0.5, 0.75  # shares of the views of a cluster that cut it
_RARE = 0.3  # share of all views
_MARGIN = 0.03  # of the longer side of a view: its border
_AT_BORDER = 0.03  # share of the samples in a view that must lie at its border
_SHOWN = 3  # samples of a cluster that a view must show


def is_background(surfels: Surfels, views: Sequence[Camera], cluster: LongArray) -> BoolArray:
    """Which clusters (n,) of samples (S,) are background."""
    n = int(cluster.max()) + 1
    focus, radius = _focus(views)
    if radius == 0:
        return np.zeros(n, np.bool_)
    distance = np.linalg.norm(surfels.points - focus, axis=1) / radius
    order = np.lexsort((distance, cluster))
    count = np.bincount(cluster, minlength=n)
    start = np.cumsum(count) - count
    away = distance[order[start + count // 2]]
    cut, seen = _cut_views(surfels, views, cluster, n)
    rare = seen < _RARE * len(views)
    far = (away > _OUTSIDE) & ((cut > _CUT) | rare)
    result: BoolArray = far | ((away > _AT_EDGE) & (rare | (cut > _ALWAYS_CUT)))
    return result


def _focus(views: Sequence[Camera]) -> tuple[DoubleArray, float]:
    """The point (3,) that the views look at from around and their median distance from it, 0 when
    there is none."""
    positions = np.array([camera.position for camera in views])
    axes = np.array([camera.forward for camera in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    values, basis = (found[0] for found in principal_axes(across.sum(axis=0)[None]))
    parts = (basis * np.einsum("vij,vj->i", across, positions)[:, None]).sum(axis=0)
    known = values > _PARALLEL * values[2]
    focus = (basis[:, known] * (parts[known] / values[known])).sum(axis=1)
    way = focus - positions
    distance = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    radius = float(np.median(distance))
    missed = np.median(np.linalg.norm(np.cross(axes, way), axis=1) / distance)
    in_front = np.median((way * axes).sum(axis=1))
    looks_around = missed <= _AROUND and in_front >= _IN_FRONT * radius
    return focus, radius if looks_around else 0.0


def _cut_views(
    surfels: Surfels, views: Sequence[Camera], cluster: LongArray, n: int
) -> tuple[DoubleArray, DoubleArray]:
    """Share (n,) of the views that cut each cluster among those that show it, and their number."""
    cut, seen = np.zeros(n), np.zeros(n)
    for v, camera in enumerate(views):
        rows = np.flatnonzero(surfels.regions[:, v])
        pixels = camera.project(surfels.points[rows])[0]
        size = np.array([camera.width, camera.height])
        margin = _MARGIN * size.max()
        outer = ((pixels < margin) | (pixels > size - margin)).any(axis=1)
        count = np.bincount(cluster[rows], minlength=n)
        at_border = np.bincount(cluster[rows[outer]], minlength=n)
        shown = count >= _SHOWN
        seen += shown
        cut += shown & (at_border >= np.maximum(1, _AT_BORDER * count))
    return cut / np.maximum(seen, 1), seen


# --- Thin objects on a surface: a clock on a wall, a saucer on a tray.
# The crease around them is hardly more than noise, so the mean over their border joins them to
# what they lie on, or they lie so far out that they count as background. A part that one other
# cluster encloses stays apart where the views show it whole as one region, with nothing else in
# it. A print has mostly joined before parts are asked, as pieces of an even surface do; where
# nearly all views show it whole it is such a part, as nothing tells it from a flat object.


_ENCLOSED = 0.75  # share of its outline along which one other cluster encloses an object ...
_LARGER = 4.0  # ... that is at least so many times larger
_SEEN = 0.1  # share of the views that show a sample of it, mean
_WHOLE_IOU = 0.7  # mean IoU with the best region of each view


def is_enclosed_thing(
    surfels: Surfels, near: Neighbourhood, now: Clusters, least_size: float
) -> BoolArray:
    """Which clusters (n,) of ``least_size`` at least are enclosed objects."""
    seen = _SEEN * np.bincount(now.cluster)
    found: BoolArray = now.graph.size >= np.maximum(seen, least_size)
    found &= _is_enclosed(near, now.cluster)
    if found.any():
        one_each = identity(len(found), format="csr")[found]
        found[found] = shown_whole(surfels, now.cluster, one_each) > _WHOLE_IOU
    return found


def keep_enclosed(
    surfels: Surfels, near: Neighbourhood, now: Clusters, least_size: float
) -> Clusters:
    """The same clusters, with nothing that speaks for joining an enclosed object to another."""
    found = is_enclosed_thing(surfels, near, now, least_size)
    graph = now.graph
    evidence = np.where(found[graph.first] | found[graph.second], -np.inf, graph.evidence)
    return replace(now, graph=replace(graph, evidence=evidence))


def is_outside(
    surfels: Surfels,
    near: Neighbourhood,
    views: Sequence[Camera],
    now: Clusters,
    least_size: float,
) -> BoolArray:
    """Which clusters (n,) are background, enclosed objects left out: a clock is no part of a wall,
    however far away it hangs."""
    outside = is_background(surfels, views, now.cluster)
    if outside.any():
        outside &= ~is_enclosed_thing(surfels, near, now, least_size)
    return outside


def _is_enclosed(near: Neighbourhood, cluster: LongArray) -> BoolArray:
    """Which clusters (n,) of samples (S,) have most of their outline with one that is larger."""
    size = np.bincount(cluster)
    n = len(size)
    a, b = cluster[near.first], cluster[near.second]
    one, other = np.concatenate([a, b]), np.concatenate([b, a])
    apart = one != other
    key, length = np.unique(one[apart] * n + other[apart], return_counts=True)
    outline = np.bincount(key // n, length, n)
    most = (size[key % n] >= _LARGER * size[key // n]) & (length >= _ENCLOSED * outline[key // n])
    return np.bincount(key[most] // n, minlength=n) > 0


def shown_whole(surfels: Surfels, cluster: LongArray, sets: csr_matrix) -> DoubleArray:
    """Mean IoU (K,) of the samples of sets (K, n) of clusters (S,) with the region of each view
    that fits best, at any level of detail; views count by the samples that they show."""
    n_sets, n = sets.shape
    own = np.bincount(sets.indices, minlength=n)[cluster] > 0
    total, weight = np.zeros(n_sets), np.zeros(n_sets)
    for v in range(surfels.regions.shape[1]):
        best, seen = np.zeros(n_sets), np.zeros(n_sets)
        for region in surfels.maps_of(v).T:
            rows = np.flatnonzero(own & (region > 0))
            area = np.bincount(region)
            table = coo_matrix((np.ones(len(rows)), (cluster[rows], region[rows])), (n, len(area)))
            common = (sets @ table.tocsr()).tocoo()
            seen = np.asarray(common.sum(axis=1), np.float64).ravel()
            iou = common.data / (seen[common.row] + area[common.col] - common.data)
            np.maximum.at(best, common.row, iou)
        total += best * seen
        weight += seen
    return total / np.maximum(weight, 1)


# --- How clusters grow to parts: their borders are judged, they join, and borders are judged
# again.
# A mean over borders of small pieces joins a bowl and the box next to it, so borders are judged
# again with the surroundings of what has grown. Noise of the splats speaks in that as well, and
# two rules depend on how much of it there is (`is_calm`). Where splats are calm, borders are
# judged again at each level of parts. Where they are rough, most borders that are left after each
# join are noise, so that is done once, before whole objects join, and within one plane the better
# of both judgements counts, because noise tears patches out of tables.


@dataclass(frozen=True, eq=False)
class Judge:
    """What is known of the samples, and the judgement of borders by it."""

    surfels: Surfels
    near: Neighbourhood
    plane: IntArray  # (S,) that each sample lies on, 0 = none
    piece: LongArray  # (S,) small pieces
    shown: DoubleArray  # (S,) share of the views that see each sample
    noise: DoubleArray  # (2,) as `noise_of` finds it

    def judged(self, cluster: LongArray) -> Clusters:
        """Clusters (S,) of small pieces with the evidence about their borders; their size is how
        many samples a view shows of them, on average."""
        views_say = Agreement.of(self.surfels, self.near, self.piece, cluster)
        graph = coarse_graph(
            self.surfels, self.near, self.plane, self.piece, views_say, cluster, self.noise
        )
        size = np.bincount(cluster, self.shown).astype(np.float64)
        return Clusters(cluster, replace(graph, size=size))

    def again(self, before: Clusters) -> Clusters:
        """The same clusters with their borders judged again."""
        now = self.judged(before.cluster)
        if is_calm(self.noise):
            return now
        kept = in_one_plane(self.plane, now) & (before.graph.evidence > now.graph.evidence)
        evidence = np.where(kept, before.graph.evidence, now.graph.evidence)
        return Clusters(now.cluster, replace(now.graph, evidence=evidence))

    def parts(
        self,
        cluster: LongArray,
        least_evidence: tuple[float, ...],
        least_size: float,
        least_thing: float,
    ) -> list[Clusters]:
        """Levels of parts that grow from clusters (S,): one a number of ``least_evidence``, which
        descends.

        The smallest part has ``least_size`` where it has neighbours; enclosed objects of at least
        ``least_thing`` stay apart (`keep_enclosed`).
        """

        def again(now: Clusters) -> Clusters:
            now = self.again(now) if is_calm(self.noise) else now
            return keep_enclosed(self.surfels, self.near, now, least_thing)

        return self.judged(cluster).levels(least_evidence, least_size, again)
