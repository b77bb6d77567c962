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

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import principal_axes, quats_to_matrices
from gaga_core.grouping.robust.linkage_kernels import flood, pieces_of
from gaga_core.grouping.views import load_labels
from gaga_core.grouping.votes import VoteSums
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer
from gaga_core.threads import n_threads

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
        a, b, length = edges_once(nearest, distance)
        near = length <= _FAR * np.minimum(spacing[a], spacing[b])
        kept = (length > 0) & (a != b) & (near | (not only_near))
        a, b, length, near = a[kept], b[kept], length[kept], near[kept]
        way = (points[b] - points[a]) / length[:, None]
        return Neighbours(nearest, a, b, way, length, near)


def edges_once(
    nearest: LongArray, distance: DoubleArray
) -> tuple[LongArray, LongArray, DoubleArray]:
    """Edges (E,) from each point to its ``nearest`` (N, k) at ``distance`` (N, k), each once: the
    lower end, the higher end and the length."""
    n, k = nearest.shape
    a, b = np.repeat(np.arange(n), k), nearest.ravel()
    keys, once = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_index=True)
    return keys // n, keys % n, distance.ravel()[once]


def splat_normals(gaussians: Gaussians, nearest: LongArray) -> DoubleArray:
    """Unit normals (N, 3) of either sign, from neighbours ``nearest`` (N, k)."""
    order = np.argsort(gaussians.log_scales, axis=1, kind="stable")
    axes = quats_to_matrices(gaussians.quats)
    normals = axes[np.arange(len(order)), :, order[:, 0]]
    scales = np.take_along_axis(gaussians.log_scales, order, axis=1)
    unclear = np.flatnonzero(~(scales[:, 0] - scales[:, 1] <= np.log(_FLAT)))
    around = gaussians.means[nearest[unclear]].astype(np.float64)
    offsets = around - around.mean(axis=1, keepdims=True)
    if len(unclear) > 0:
        normals[unclear] = principal_axes(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]
    return np.nan_to_num(normals)


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


# --- Beyond the paper: with few views, the shape of the surfaces decides together with the masks.
# With a few views no other view corrects an error of one mask: an object that is merged with its
# neighbour in all of them has no group, and a mask that is too large leaves a rim. So each group
# is cut into pieces at creases and mask borders; a piece that continues smoothly into another
# group joins that group, a large one becomes a group of its own. Gaussians that no view sees well
# take the label that they reach along the surface, not the nearest one.


STAGE = "Follow surfaces"
_HALF_WEIGHT = 0.1  # blending weight with which a view's vote about a Gaussian weighs 1/2
_WEIGHT_STEPS = 256  # of a weight 1: an error of 1e-7 changes one weight in 40,000
_ROUNDS = 2
_STEPS = 4 + _ROUNDS  # of progress: views, neighbours, normals, rounds, hidden Gaussians
_HIDDEN = 4  # times the least size of a piece: of a surface that no mask shows to be a group


@dataclass(frozen=True)
class SurfaceConfig:
    """Settings of the pieces; used up to ``max_views`` views, more outvote the shape."""

    max_views: int = 12
    neighbours: int = 10
    least_weight: float = 0.6  # summed blending weight of a Gaussian that a view sees well
    same_mask: float = 1.0  # a view's vote for an edge inside a mask; a smooth edge counts 1, too
    other_mask: float = 0.5  # ... against an edge between two masks
    runs_on: float = 0.25  # mean likeness of the edges over which a piece joins another group ...
    runs_on_share: float = 0.3  # ... and their least share of all edges that leave the piece
    crease: float = 2.0  # least summed unlikeness to the rest of its group of a piece that parts,
    # for each square root of its size: about how wide it is
    least_share: float = 0.0004  # of the Gaussians seen well: smaller pieces are no groups ...
    least_size: int = 10  # ... nor those of fewer Gaussians

    def __post_init__(self) -> None:
        if self.max_views < 0 or self.neighbours < 1 or self.least_size < 1:
            raise ValueError("max_views, neighbours and least_size: too small")
        if min(self.least_weight, self.same_mask, self.other_mask) < 0:
            raise ValueError("least_weight, same_mask and other_mask must not be negative")
        if self.crease < 0:
            raise ValueError("crease must not be negative")
        if not (0 <= self.runs_on_share <= 1 and 0 <= self.least_share <= 1):
            raise ValueError("runs_on_share and least_share must be between 0 and 1")

    def least(self, n_seen: int) -> int:
        """Gaussians of the smallest piece that may be a group, of so many seen well."""
        return max(self.least_size, round(self.least_share * n_seen))


def follow_surfaces(
    gaussians: Gaussians,
    views: Sequence[Camera],
    masks: MaskSet,
    labels: IntArray,  # (N,) by vote, 0 = none
    rasterizer: Rasterizer,
    config: SurfaceConfig,
) -> Stage[IntArray]:
    """Labels (N,) that follow the surfaces; new groups have the ids after the largest one."""
    looking = _observe(gaussians, views, masks, rasterizer)
    seen = yield from part(looking, 0, _STEPS, STAGE)
    shown = finite(gaussians) & (seen.weights.max(axis=1) > config.least_weight)
    rows = np.flatnonzero(shown)
    if len(rows) < 2:
        return labels
    found = yield from _pieced(gaussians.take(rows), views, seen.take(rows), labels[rows], config)
    result = np.zeros_like(labels)
    result[rows] = found
    yield Progress(STAGE, _STEPS - 1, _STEPS, "hidden Gaussians")
    if not (found > 0).any():
        return labels
    least = _HIDDEN * config.least(len(rows))
    return along_surfaces(gaussians, result, config.neighbours, least)


@dataclass(frozen=True, eq=False)
class _ViewObservations:
    """The mask of each Gaussian in each view, with its weight."""

    masks: IntArray  # (N, V) mask of most of its pixels, 0 = none
    weights: FloatArray  # (N, V) summed blending weight

    def take(self, rows: LongArray) -> "_ViewObservations":
        return _ViewObservations(self.masks[rows], self.weights[rows])


def _observe(
    gaussians: Gaussians, views: Sequence[Camera], masks: MaskSet, rasterizer: Rasterizer
) -> Stage[_ViewObservations]:
    of = np.zeros((len(gaussians), len(views)), np.int32)
    weights = np.zeros((len(gaussians), len(views)), np.float32)
    for v, camera in enumerate(views):
        labels = load_labels(masks, camera)[0] + np.int32(1)  # pixels of no mask count as well
        count = int(labels.max(initial=1))
        sums = VoteSums.empty(len(gaussians), count)
        add = sums.add_stage(gaussians, [camera], {camera: labels}.__getitem__, rasterizer)
        yield from part(add, v, len(views), STAGE)
        votes = sums.votes()
        of[:, v] = np.maximum(votes.labels - 1, 0)
        # Their last bits differ between processors, and would order the edges.
        weights[:, v] = np.round(votes.weight * _WEIGHT_STEPS) / _WEIGHT_STEPS
    return _ViewObservations(of, weights)


def _pieced(
    gaussians: Gaussians,
    views: Sequence[Camera],
    seen: _ViewObservations,
    labels: IntArray,
    config: SurfaceConfig,
) -> Stage[IntArray]:
    """Labels (N,) of Gaussians that are seen well."""
    yield Progress(STAGE, 1, _STEPS, "find neighbours")
    points = gaussians.means.astype(np.float64)
    graph = Neighbours.of(points, config.neighbours)
    yield Progress(STAGE, 2, _STEPS, "find normals")
    normals = splat_normals(gaussians, graph.nearest)
    weights = seen.weights.astype(np.float64)
    normals = towards_cameras(normals, points, views, weights, graph.nearest)
    likeness = evenness(graph, normals) + _votes_of_masks(graph, seen, config)
    least = config.least(len(points))
    for turn in range(_ROUNDS):
        yield Progress(STAGE, 3 + turn, _STEPS, "cut into pieces")
        pieces = _Pieces.of(graph, likeness, labels)
        labels = pieces.joined(config)
    return pieces.parted(labels, config.crease, least)


def _votes_of_masks(
    graph: Neighbours, seen: _ViewObservations, config: SurfaceConfig
) -> DoubleArray:
    """What all views say of each edge (E,): > 0 its ends show in one mask, < 0 in two."""
    result = np.zeros(len(graph.first))
    for of, weight in zip(seen.masks.T, seen.weights.T.astype(np.float64), strict=True):
        a, b = of[graph.first], of[graph.second]
        least = np.minimum(weight[graph.first], weight[graph.second])
        weights = np.where((a > 0) & (b > 0), least / (least + _HALF_WEIGHT), 0)
        result += weights * np.where(a == b, config.same_mask, -config.other_mask)
    return result


@dataclass(frozen=True, eq=False)
class _Pieces:
    """What groups fall into, and the borders between two pieces, each in both directions."""

    piece: LongArray  # (N,) 0..P - 1
    group: LongArray  # (P,) 0 = none
    size: LongArray  # (P,)
    is_main: BoolArray  # (P,) the largest of its group
    first: LongArray  # (B,) piece
    second: LongArray  # (B,) piece
    likeness: DoubleArray  # (B,) summed over the edges
    edges: LongArray  # (B,)

    @staticmethod
    def of(graph: Neighbours, likeness: DoubleArray, labels: IntArray) -> "_Pieces":
        """Pieces of the groups of ``labels`` (N,)."""
        parent = np.arange(len(labels))
        inside = (labels[graph.first] == labels[graph.second]) & (labels[graph.first] > 0)
        ends = np.stack([graph.first[inside], graph.second[inside]], axis=1).ravel()
        pieces_of(ends, likeness[inside].copy(), parent)
        while (parent[parent] != parent).any():
            parent = parent[parent]
        _, piece = np.unique(parent, return_inverse=True)
        n = int(piece.max()) + 1
        group = np.zeros(n, np.int64)
        group[piece] = labels
        size = np.bincount(piece)
        order = np.lexsort((-size, group))
        is_main = np.zeros(n, np.bool_)
        is_main[order[np.unique(group[order], return_index=True)[1]]] = True
        a, b = piece[graph.first], piece[graph.second]
        a, b, value = a[a != b], b[a != b], likeness[a != b]
        keys, cell = np.unique(np.r_[a * n + b, b * n + a], return_inverse=True)
        total = np.bincount(cell, np.r_[value, value], minlength=len(keys)).astype(np.float64)
        edges = np.bincount(cell, minlength=len(keys))
        return _Pieces(piece, group, size, is_main, keys // n, keys % n, total, edges)

    def joined(self, config: SurfaceConfig) -> IntArray:
        """Labels (N,) after lesser pieces joined the larger one that they run on into."""
        a, b = self.first, self.second
        leaving = np.bincount(a, self.edges, minlength=len(self.group))
        joins = (self.group[a] > 0) & (self.group[b] > 0) & (self.group[a] != self.group[b])
        joins &= ~self.is_main[a] & (self.size[b] > self.size[a])
        joins &= self.likeness > config.runs_on * self.edges
        joins &= self.edges >= config.runs_on_share * leaving[a]
        rows = np.flatnonzero(joins)
        rows = rows[np.lexsort((-self.likeness[rows], a[rows]))]
        pieces, best = np.unique(a[rows], return_index=True)
        group = self.group.copy()
        group[pieces] = self.group[b[rows[best]]]
        return group[self.piece].astype(np.int32)

    def parted(self, labels: IntArray, crease: float, least: int) -> IntArray:
        """Labels (N,) in which the pieces that joined no other group and that creases part from
        the rest of their own are new groups."""
        after = np.zeros(len(self.group), np.int64)
        after[self.piece] = labels
        inside = self.group[self.first] == self.group[self.second]
        unlike = -np.bincount(self.first[inside], self.likeness[inside], len(self.group))
        own = (after == self.group) & ~self.is_main & (self.group > 0) & (self.size >= least)
        own &= (unlike > 0) & (unlike >= crease * np.sqrt(self.size))
        after[own] = int(labels.max()) + 1 + np.arange(int(own.sum()))
        return after[self.piece].astype(np.int32)
