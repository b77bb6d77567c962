"""How likely the two sides of a border are one object, and in which order pieces join.

Small pieces of surface grow to objects in rounds. In each round the features of every border are
measured with what has grown so far: the shape of the surface (creases, steps, whether both sides
lie on one plane), the share of the views that show both sides in one region, at each level of
detail of the regions, color, and sizes. An ensemble of trees that was learned from scenes with
truth (`tools.learn_objects`) says the log odds that both sides are one object. Clusters join, best
first, by the mean over their common border, not over all pairs of members, so that large surfaces
hold together (as in GASP, Bailoni et al., CVPR 2022).
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, hstack

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.geometry import principal_axes
from gaga_core.grouping.surfaces.surfels import (
    N_LEVELS,
    Neighbourhood,
    Surfels,
    dense,
    outlines,
)
from gaga_core.grouping.surfaces.surfels_kernels import add_agreement, smooth_once

_STEPS = 2  # from piece to piece, within which pieces of a cluster are asked together
_PRIOR = 0.5  # views' worth of doubt about a share of views, on either side
_HALF_VOICE = 1.0  # samples with which a view has half a voice about a piece
_SMOOTHED = 2  # rounds of averaging over neighbours within a cluster
GRID = 1 << 12  # steps of a unit of a feature: last bits differ between processors


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
        first, second, cell = pairs(a, b)
        length = np.bincount(cell, self.length[a != b], len(first)).astype(np.float64)
        total = np.bincount(cell, (self.length * self.evidence)[a != b], len(first))
        size = np.bincount(cluster, self.size).astype(np.float64)
        return SignedGraph(size, first, second, length, total / length)


def pairs(a: LongArray, b: LongArray) -> tuple[LongArray, LongArray, LongArray]:
    """The distinct pairs of different ids, lower first, and the pair of each entry that has one."""
    apart = a != b
    n = int(max(a.max(initial=0), b.max(initial=0))) + 1
    key = np.minimum(a, b)[apart] * n + np.maximum(a, b)[apart]
    keys, cell = np.unique(key, return_inverse=True)
    return keys // n, keys % n, cell.astype(np.int64)


def linked(
    graph: SignedGraph, least_evidence: float, least_size: float = 0.0
) -> list[tuple[int, int, float, float]]:
    """All joins of at least this evidence, best first: two nodes, the evidence and the length of
    their border. What has joined is called by the first of both.

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
    is_alive, joins = [True] * n, []
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
        is_alive[b] = False
        joins.append((a, b, -value, length))
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
    return joins


def joined(graph: SignedGraph, least_evidence: float, least_size: float = 0.0) -> LongArray:
    """Clusters (n,), dense ids from 0, after the joins of `linked`."""
    parent = np.arange(len(graph.size))
    for a, b, _, _ in linked(graph, least_evidence, least_size):
        parent[b] = a
    while (parent[parent] != parent).any():
        parent = parent[parent]
    return dense(parent)


# --- What the views say: how often they show both sides in one region.


@dataclass(frozen=True, eq=False)
class Shown:
    """Which regions of all maps show pieces."""

    counts: csr_matrix  # (n, R) samples of each piece in each region, map by map
    map_of: IntArray  # (R,) of each region
    level_of: IntArray  # of each map, -1 = every level

    @staticmethod
    def of(surfels: Surfels, piece: LongArray) -> "Shown":
        """Of pieces (S,), dense ids from 0."""
        n, tables, levels = int(piece.max(initial=-1)) + 1, list[csr_matrix](), list[int]()
        for level, region in surfels.maps():
            rows = np.flatnonzero(region)
            shape = (n, int(region.max(initial=0)) + 1)
            cells = (piece[rows], region[rows])
            tables.append(coo_matrix((np.ones(len(rows)), cells), shape).tocsr())
            levels.append(-1 if level is None else level)
        widths = [table.shape[1] for table in tables]
        counts = hstack(tables, "csr") if tables else csr_matrix((n, 0))
        map_of = np.repeat(np.arange(len(tables), dtype=np.int32), widths)
        return Shown(counts, map_of, np.array(levels, np.int32))


@dataclass(frozen=True, eq=False)
class Agreement:
    """Evidence of the views on pairs of neighbouring pieces, by levels of detail of regions."""

    first: LongArray  # (B,) < second
    second: LongArray  # (B,)
    length: DoubleArray  # (B,) edges between them
    same: DoubleArray  # (B, 4) summed chance that a sample of each shows in one region
    voice: DoubleArray  # (B, 4) summed voice of the views that see both

    @staticmethod
    def of(shown: Shown, near: Neighbourhood, piece: LongArray, cluster: LongArray) -> "Agreement":
        """Agreement about borders of pieces (S,) that are in two clusters (S,), each with what is
        near it in its cluster: a piece of seven samples is no larger than what regions miss an
        outline by."""
        first, second, cell = pairs(piece[near.first], piece[near.second])
        length = np.bincount(cell, minlength=len(first)).astype(np.float64)
        cluster_of = coarser_of(piece, cluster)
        apart = cluster_of[first] != cluster_of[second]
        together = _near_in_cluster(first, second, cluster_of)
        first, second, length = first[apart], second[apart], length[apart]
        asked = np.unique(np.concatenate([first, second]))
        a, b = np.searchsorted(asked, first), np.searchsorted(asked, second)
        table = (together[asked] @ shown.counts).tocsr()
        table.sort_indices()
        same, voice = np.zeros((len(first), N_LEVELS)), np.zeros((len(first), N_LEVELS))
        rows, maps = (table.indptr, table.indices, table.data), (shown.map_of, shown.level_of)
        add_agreement(*rows, *maps, a, b, _HALF_VOICE, same, voice)
        return Agreement(first, second, length, same, voice)


def coarser_of(level: LongArray, coarser: LongArray) -> LongArray:
    """The cluster (n,) at a ``coarser`` level (S,) of each one at a ``level`` (S,)."""
    result = np.zeros(int(level.max()) + 1, np.int64)
    result[level] = coarser
    return result


def _near_in_cluster(first: LongArray, second: LongArray, cluster_of: LongArray) -> csr_matrix:
    """Which pieces (n, n) are within `_STEPS` borders (B,) of each other inside one cluster."""
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


# --- The shape of clusters and of the surface at their borders.


@dataclass(frozen=True, eq=False)
class Moments:
    """Sums over the samples of clusters; those of a union are the sums of its parts."""

    count: DoubleArray  # (n,)
    shown: DoubleArray  # (n,) share of the views that see each sample: samples that a view shows
    sums: DoubleArray  # (n, 3) places
    products: DoubleArray  # (n, 6) of places: xx, xy, xz, yy, yz, zz
    normals: DoubleArray  # (n, 3)
    colors: DoubleArray  # (n, 3) CIE Lab
    squares: DoubleArray  # (n,) of colors
    spacing: DoubleArray  # (n,)

    @staticmethod
    def of(seen: "Seen", cluster: LongArray) -> "Moments":
        """Of each cluster (S,)."""

        def total(values: DoubleArray) -> DoubleArray:
            if values.ndim == 1:
                return np.bincount(cluster, values).astype(np.float64)
            return np.stack([np.bincount(cluster, column) for column in values.T], axis=1)

        x, y, z = seen.points.T
        products = np.stack([x * x, x * y, x * z, y * y, y * z, z * z], axis=1)
        return Moments(
            np.bincount(cluster).astype(np.float64),
            total(seen.shown),
            total(seen.points),
            total(products),
            total(seen.surfels.normals),
            total(seen.color),
            total((seen.color**2).sum(axis=1)),
            total(seen.near.spacing),
        )

    def of_sets(self, sets: csr_matrix) -> "Moments":
        """Of sets (K, n) of clusters."""
        return Moments(*(np.asarray(sets @ getattr(self, name)) for name in _MOMENTS))

    def taken(self, rows: LongArray) -> "Moments":
        """Of some clusters (K,)."""
        return Moments(*(getattr(self, name)[rows] for name in _MOMENTS))

    def plus(self, other: "Moments") -> "Moments":
        """Of the unions with others, one by one."""
        return Moments(*(getattr(self, name) + getattr(other, name) for name in _MOMENTS))

    @property
    def centre(self) -> DoubleArray:
        """Means (n, 3) of the places."""
        return self.sums / self.count[:, None]

    def covariance(self) -> DoubleArray:
        """(n, 3, 3) of the places."""
        x, y, z = self.centre.T
        mean = np.stack([x * x, x * y, x * z, y * y, y * z, z * z], axis=1)
        flat = self.products / self.count[:, None] - mean
        result: DoubleArray = flat[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        return result

    def axes(self) -> tuple[DoubleArray, DoubleArray]:
        """Standard deviations (n, 3), ascending, and their directions (n, 3, 3), columns."""
        values, basis = principal_axes(self.covariance())
        return np.sqrt(np.maximum(values, 0)), basis


_MOMENTS = ("count", "shown", "sums", "products", "normals", "colors", "squares", "spacing")


@dataclass(frozen=True, eq=False)
class Seen:
    """All that is known of the samples of a scene."""

    surfels: Surfels
    near: Neighbourhood
    color: DoubleArray  # (S, 3) CIE Lab
    piece: LongArray  # (S,) small pieces
    in_regions: Shown  # of the pieces
    n_views: int
    middle: DoubleArray  # (3,) of the samples, world
    spacing: float  # median, scene units
    points: DoubleArray  # (S, 3) of the samples, from their middle, in spacings

    @staticmethod
    def of(
        surfels: Surfels, near: Neighbourhood, color: DoubleArray, piece: LongArray, n_views: int
    ) -> "Seen":
        """With what follows from them."""
        spacing, middle = float(np.median(near.spacing)), np.median(surfels.points, axis=0)
        points = np.round((surfels.points - middle) / spacing * GRID) / GRID
        shown = Shown.of(surfels, piece)
        return Seen(surfels, near, color, piece, shown, n_views, middle, spacing, points)

    @property
    def shown(self) -> DoubleArray:
        """Share (S,) of the views that see each sample."""
        result: DoubleArray = self.surfels.n_views / self.n_views
        return result

    def in_scene(self, points: DoubleArray) -> DoubleArray:
        """Points (K, 3) in world coordinates."""
        return points * self.spacing + self.middle


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


def _smoothed(seen: Seen, cluster: LongArray) -> tuple[DoubleArray, DoubleArray]:
    """Normals and points (S, 3) averaged over neighbours of the same cluster, so that a crease
    stays sharp and noise does not make one."""
    normals, points = seen.surfels.normals, seen.surfels.points
    count = np.empty(len(points))
    for _ in range(_SMOOTHED):
        sums = np.empty_like(points)
        smooth_once(normals, seen.near.around, cluster, sums, count)
        normals = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
        sums = np.empty_like(points)
        smooth_once(points, seen.near.around, cluster, sums, count)
        points = sums / count[:, None]
    return normals, points


@dataclass(frozen=True, eq=False)
class Borders:
    """The borders of clusters, and their features."""

    size: DoubleArray  # (n,) samples of each cluster that a view shows, mean
    first: LongArray  # (B,) < second
    second: LongArray  # (B,)
    length: DoubleArray  # (B,) edges
    features: DoubleArray  # (B, F)

    def judged(self, evidence: Callable[[DoubleArray], DoubleArray]) -> SignedGraph:
        """The graph with what ``evidence`` says of the features."""
        said = evidence(self.features)
        return SignedGraph(self.size, self.first, self.second, self.length, said)

    def column(self, name: str) -> DoubleArray:
        """One of the `FEATURES` (B,)."""
        return self.features[:, FEATURES.index(name)]

    @property
    def roughness(self) -> float:
        """Of the scene, a feature of each border; 0 without borders."""
        return float(self.column("roughness of the scene").max(initial=0))


FEATURES = (  # of one side "smaller" and one "larger", by samples
    *("crease", "bulge", "step", "sharp", "rough", "roughness of the scene"),
    *(f"views, level {k}" for k in range(N_LEVELS)),
    *("voice", "color across", "color of both", "color inside"),
    *("size of the smaller", "size of the larger"),
    *("length", "share of the smaller", "share of the larger"),
    *("height over the larger", "thickness over the larger"),
    *("flatness of the larger", "flatness of the smaller", "flatness of both"),
    *("planes", "facing", "views of the smaller", "views of the larger"),
)


def borders_of(seen: Seen, cluster: LongArray) -> Borders:
    """All borders of clusters (S,) of pieces."""
    near = seen.near
    agreement = Agreement.of(seen.in_regions, near, seen.piece, cluster)
    a, b = near.first, near.second
    apart = cluster[a] != cluster[b]
    normals, points = _smoothed(seen, cluster)
    bend, step = _shape(points, normals, a, b)
    unlike = np.linalg.norm(seen.color[a] - seen.color[b], axis=1)
    first, second, cell = pairs(cluster[a], cluster[b])
    length = np.bincount(cell, minlength=len(first)).astype(np.float64)

    def mean(values: DoubleArray) -> DoubleArray:
        """Means (B,) over borders of values (E,) of edges."""
        result: DoubleArray = np.bincount(cell, values[apart], len(first)) / length
        return result

    n = int(cluster.max()) + 1
    crease, rough = np.maximum(-bend, 0), np.maximum(np.abs(bend), step)

    def inside(values: DoubleArray) -> DoubleArray:
        """Means (n,) over edges inside clusters of values (E,), the mean of all where few are."""
        own = cluster[a[~apart]]
        every = float(values[~apart].mean()) if len(own) else 0.0
        total = np.bincount(own, values[~apart], n) + 5 * every
        result: DoubleArray = total / (np.bincount(own, minlength=n) + 5)
        return result

    rough_in, unlike_in = inside(rough), inside(unlike)
    moments = Moments.of(seen, cluster)
    # The smaller side first.
    swap = moments.count[first] > moments.count[second]
    one, other = np.where(swap, second, first), np.where(swap, first, second)
    small, large = moments.taken(one), moments.taken(other)
    outline = np.bincount(first, length, n) + np.bincount(second, length, n)
    deviation, basis = moments.axes()
    normal = basis[:, :, 0]
    both, _ = small.plus(large).axes()
    across = normal[other]
    height = ((small.centre - large.centre) * across).sum(axis=1)
    seen_from = np.where((across * large.normals).sum(axis=1) < 0, -1.0, 1.0)
    thick = np.sqrt(
        np.maximum((across[:, :, None] * across[:, None] * small.covariance()).sum((1, 2)), 0)
    )
    facing = (small.normals * large.normals).sum(axis=1) / (small.count * large.count)
    mean_color = small.colors / small.count[:, None] - large.colors / large.count[:, None]
    same, voice = _at_borders(agreement, coarser_of(seen.piece, cluster))
    view = 2 * (same + _PRIOR) / (voice + 2 * _PRIOR) - 1
    columns = [
        mean(crease), mean(np.maximum(bend, 0)), mean(step),
        mean(np.clip(np.maximum(crease, step) / 0.4, 0, 1)),
        np.maximum(rough_in[one], rough_in[other]), np.full(len(first), rough_in.mean()),
        *view.T, np.log1p(voice.sum(axis=1)),
        mean(unlike), np.linalg.norm(mean_color, axis=1),
        np.maximum(unlike_in[one], unlike_in[other]),
        np.log(small.shown + 0.1), np.log(large.shown + 0.1),
        length / outlines(small.count), length / outline[one], length / outline[other],
        seen_from * height / np.sqrt(small.count), thick / np.sqrt(small.count),
        np.log(deviation[other, 0] + 0.05), np.log(deviation[one, 0] + 0.05),
        np.log(both[:, 0] + 0.05) - np.log(deviation[other, 0] + 0.05),
        np.abs((normal[one] * across).sum(axis=1)), facing,
        small.shown / small.count, large.shown / large.count,
    ]  # fmt: skip
    features = np.round(np.stack(columns, axis=1) * GRID) / GRID
    return Borders(moments.shown, first, second, length, features)


def _at_borders(views: Agreement, cluster_of: LongArray) -> tuple[DoubleArray, DoubleArray]:
    """Agreement and voice (B, 4) at borders of clusters, of the pieces (n,) that these hold: means
    over the length."""
    a, b = cluster_of[views.first], cluster_of[views.second]
    first, _, cell = pairs(a, b)
    apart = a != b
    length = views.length[apart]
    total = np.maximum(np.bincount(cell, length, len(first)), 1e-9)

    def mean(values: DoubleArray) -> DoubleArray:
        columns = [np.bincount(cell, column * length, len(first)) for column in values[apart].T]
        result: DoubleArray = np.stack(columns, axis=1) / total[:, None]
        return result

    return mean(views.same), mean(views.voice)
