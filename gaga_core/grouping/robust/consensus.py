"""Beyond the paper: groups by the consensus of all views (the preset "robust").

A segmenter errs view by view: it splits an object in one view and merges two objects in another.
Two points of one object show in one mask in most of the views that see both; two points of
different objects rarely do. So points on the surfaces (`surface_points`) are clustered by the share
of views that show them in one mask, over the views that see both: average linkage, where a
cluster's agreement with another is the mean over all pairs of their points. No view comes first,
and a mask that merges two objects is one vote among many. (The view consensus rate between masks is
from MaskClustering, Yan et al., CVPR 2024; here its members are points, so that merged masks need
not be found and dropped beforehand.)

What was tried on top of this and left out, with its figures: docs/experiments.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from gaga_core.arrays import (
    BoolArray,
    DoubleArray,
    IntArray,
    LongArray,
    UInt16Array,
    UInt32Array,
)
from gaga_core.camera import Camera
from gaga_core.geometry import principal_axes
from gaga_core.grouping.robust import linkage_kernels as kernels
from gaga_core.grouping.robust.surface_points import (
    DepthMaps,
    Leaders,
    LoadMasks,
    PointTables,
    Sightings,
    full_size,
    lifted,
    masks_of_points,
    point_tables,
    sample_points,
)
from gaga_core.progress import Progress, Stage, part
from gaga_core.threads import run_chunks

# --- Beyond the paper: what the shape of the surface says of two clusters of points.
# Where few views see two clusters at once, the views alone do not show whether they are parts of
# one object. Parts of one object touch along a long border, and the surface is smooth or convex
# there; two objects that touch mostly meet in a crease (local convexity: Stein et al., CVPR 2014).
# This is a prior only: views that see both outvote it.


_NEIGHBOURS = 16
_RADIUS = 4  # pixels on each side of a point whose depths make its plane
_DEEP = 0.03  # share of its depth by which pixels of that plane may differ from the point
_PLANE_PIXELS_MIN = 12  # pixels of a plane
_BORDER = 3.0  # neighbours per point of the smaller cluster at which the border says nothing
_TOUCH = 0.25  # with fewer neighbours per point clusters do not touch
APART = 0.34  # prior of clusters that do not touch
_BIAS, _OF_BORDER, _OF_SHAPE = -0.3, 0.5, 1.0  # log odds; of log border and of convexity


@dataclass(frozen=True, eq=False)
class Contacts:
    """Pairs of neighbouring points: each with its 16 nearest."""

    first: LongArray  # (P,)
    second: LongArray  # (P,)
    convexity: DoubleArray  # (P,) > 0 the surface bulges between them, < 0 it has a crease

    def priors(self, cluster: IntArray) -> "Priors":
        """Chance that two clusters are parts of one object, before the views vote.

        ``cluster`` (S,) has ids 1..C, or 0 = none.
        """
        width = int(cluster.max(initial=0)) + 1
        a, b = cluster[self.first].astype(np.int64), cluster[self.second].astype(np.int64)
        between = (a != b) & (a > 0) & (b > 0)
        a, b, convexity = a[between], b[between], self.convexity[between]
        key, pair = np.unique(np.minimum(a, b) * width + np.maximum(a, b), return_inverse=True)
        count, bulge = np.zeros(len(key)), np.zeros(len(key))
        for way in (a < b, a > b):
            count += np.bincount(pair[way], minlength=len(key))
            bulge += np.bincount(pair[way], convexity[way], minlength=len(key))
        n_points = np.bincount(cluster, minlength=width)
        first, second = np.divmod(key, width)
        border = count / np.maximum(np.minimum(n_points[first], n_points[second]), 1)
        odds = _OF_BORDER * np.log((border + 0.01) / _BORDER)
        odds += _BIAS + _OF_SHAPE * bulge / np.maximum(count, 1)
        return Priors(width, key, np.where(border < _TOUCH, APART, 1 / (1 + np.exp(-odds))))


@dataclass(frozen=True, eq=False)
class Priors:
    """Chances of pairs of clusters; `APART` of all that are not listed."""

    width: int  # C + 1
    key: LongArray  # (P,) first * width + second, first < second, ascending
    value: DoubleArray  # (P,) 0..1

    def of(self, key: LongArray) -> DoubleArray:
        """Chances (Q,) of pairs by their keys."""
        result = np.full(len(key), APART)
        if len(self.key) > 0:
            at = np.minimum(np.searchsorted(self.key, key), len(self.key) - 1)
            listed = self.key[at] == key
            result[listed] = self.value[at[listed]]
        return result


def contacts_of(points: DoubleArray, normals: DoubleArray) -> Contacts:
    """Neighbours among points (S, 3) with unit normals (S, 3); a normal of 0 is unknown."""
    k = min(_NEIGHBOURS, len(points) - 1)
    if k < 1:
        return Contacts(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    found = cKDTree(points).query(points, k=k + 1)
    distance = np.asarray(found[0])[:, 1:].ravel()
    second = np.asarray(found[1], np.int64)[:, 1:].ravel()
    first = np.repeat(np.arange(len(points)), k)
    way = (points[second] - points[first]) / np.maximum(distance, 1e-12)[:, None]
    convexity = ((normals[second] - normals[first]) * way).sum(axis=1)
    known = np.abs(normals).sum(axis=1) > 0
    return Contacts(first, second, np.where(known[first] & known[second], convexity, 0))


def surface_normals(
    points: DoubleArray,  # (S, 3) world
    mask_of: IntArray,  # (S, V) mask that each point shows in each view, 0 = unknown
    views: Sequence[Camera],
    load_masks: LoadMasks,
    depths: DepthMaps,
) -> Stage[DoubleArray]:
    """Unit normals (S, 3), towards the camera, from the depths of the first view that sees a point
    in a mask; 0 where there are too few."""
    normals = np.zeros((len(points), 3))
    first = np.where((mask_of > 0).any(axis=1), (mask_of > 0).argmax(axis=1), -1)
    for i, camera in enumerate(views):
        yield Progress("Find contacts", i, len(views), camera.name)
        rows = np.flatnonzero(first == i)
        if len(rows) > 0:
            labels = load_masks(camera).labels
            found = _normals(camera, labels, depths, points[rows], mask_of[rows, i])
            normals[rows] = found @ camera.world_from_cam[:3, :3].T
    return normals


def _normals(
    camera: Camera, labels: IntArray, depths: DepthMaps, points: DoubleArray, mask: IntArray
) -> DoubleArray:
    """Normals (P, 3) in the camera's frame of points that show ``mask`` (P,)."""
    pixels, z = camera.project(points)
    columns, rows = pixels.astype(np.int64).T
    dy, dx = np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _RADIUS + 1]
    rows = np.clip(rows[:, None] + dy.ravel(), 0, camera.height - 1)
    columns = np.clip(columns[:, None] + dx.ravel(), 0, camera.width - 1)
    depth = full_size(camera, depths)[rows, columns].astype(np.float64)
    near = np.abs(depth - z[:, None]) < _DEEP * z[:, None]
    usable = near & (labels[rows, columns] == mask[:, None])
    cloud = lifted(camera, rows, columns, depth)
    weight = usable[:, :, None]
    middle = (cloud * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    offsets = (cloud - middle[:, None]) * weight
    normal = principal_axes(np.einsum("pki,pkj->pij", offsets, offsets))[1][:, :, 0]
    away = (normal * middle).sum(axis=1) > 0
    result: DoubleArray = np.where(away[:, None], -normal, normal)
    result[usable.sum(axis=1) < _PLANE_PIXELS_MIN] = 0
    return result


# --- Clusters of points by average linkage over the views that show them in one mask.
# Time and memory grow with the pairs of points that some view shows in one mask, not with the
# square of the points: points of objects far apart are never looked at together.


_ROWS = 256  # points in one piece of work
_SLICE = 8192  # points between two chances to cancel
_MERGES = 256  # merges between two chances to cancel
MOST_POINTS = (1 << 17) - 1


@dataclass(frozen=True)
class LinkageRules:
    """When two clusters join."""

    agreement: float  # share of views, above 1/2: pairs that are never together stay apart
    min_views: float  # least views that see both, mean over their pairs
    doubt: float  # weight of the prior 1/2, in views

    def array(self) -> DoubleArray:
        """For the kernels (3,)."""
        return np.array([self.agreement, self.min_views, self.doubt])


def linkage_stage(
    mask_of: IntArray,  # (S, V) mask that each point shows in each view, 0 = unknown
    rules: LinkageRules,
    title: str,  # of the progress
) -> Stage[IntArray]:
    """Clusters (S,) 1.. of points, in the order of their first points.

    The two clusters that agree most join, as long as their agreement is above the threshold: the
    mean over all pairs of their points of the views that show both in one mask, over those that
    see both. Raises ``ValueError`` for more than `MOST_POINTS` points.
    """
    n = len(mask_of)
    if n > MOST_POINTS:
        raise ValueError(f"mask_of: at most {MOST_POINTS} points, got {n}")
    start, length, other, together = yield from _pairs(mask_of, title)
    # A merged list is no longer than both that it replaces: packed, all fit into the first part.
    room, end = len(other) + len(other) // 4 + n, np.array([len(other)])
    other = np.append(other, np.zeros(room - len(other), np.int32))
    together = np.append(together, np.zeros(room - len(together)))
    seen, size = _counts(mask_of > 0), np.ones(n)
    partner, score = np.full(n, -1, np.int32), np.full(n, -1.0)
    parent, numbers = np.arange(n, dtype=np.int32), rules.array()
    state = (start, length, other, together)

    def find(first: int, last: int) -> None:
        kernels.find_partners(first, last, *state, parent, seen, size, numbers, partner, score)

    run_chunks(find, n, _ROWS)
    tree = _maxima(score)
    n_merges = _MERGES
    while n_merges == _MERGES:
        left = int((size > 0).sum())
        yield Progress(title, 2 * n - left, 2 * n, f"{left} clusters")
        n_merges = kernels.merge_clusters(
            *state, end, parent, seen, size, numbers, partner, score, tree, _MERGES
        )
    while (parent[parent] != parent).any():
        parent = parent[parent]
    return renumbered(parent)


def renumbered(cluster: IntArray) -> IntArray:
    """The same clusters (S,) as 1, 2, ... in the order of their first points."""
    _, first, inverse = np.unique(cluster, return_index=True, return_inverse=True)
    order = np.empty(len(first), np.int32)
    order[np.argsort(first)] = np.arange(1, len(first) + 1)
    return order[inverse]


def _pairs(
    mask_of: IntArray, title: str
) -> Stage[tuple[LongArray, LongArray, IntArray, DoubleArray]]:
    """Start (S,) and length (S,) of each point's list of pairs, the other points (P,) of these
    lists, and in how many views each pair is together (P,)."""
    n = len(mask_of)
    masks = mask_of.max(axis=0, initial=0).astype(np.int64) + 1
    first_row = np.cumsum(masks) - masks
    point, view = np.nonzero(mask_of)
    row = first_row[view] + mask_of[point, view]
    members = point[np.argsort(row, kind="stable")].astype(np.int32)
    row_start = np.append(0, np.cumsum(np.bincount(row, minlength=int(masks.sum()))))
    degree, pair_start = np.zeros(n, np.int64), np.zeros(n + 1, np.int64)
    other, together = np.zeros(0, np.int32), np.zeros(0)

    def work(begin: int, stop: int) -> None:
        rows = mask_of, first_row, row_start, members, first + begin, first + stop
        kernels.list_pairs(*rows, pair_start, degree, other, together)

    for is_written in (False, True):
        if is_written:
            pair_start[1:] = np.cumsum(degree)
            other, together = np.empty(pair_start[-1], np.int32), np.empty(pair_start[-1])
            if len(other) == 0:
                break
        for first in range(0, n, _SLICE):
            yield Progress(title, (first + is_written * n) // 2, 2 * n, f"{n} points")
            run_chunks(work, min(_SLICE, n - first), _ROWS)
    return pair_start[:-1].copy(), degree, other, together


def _counts(seen: BoolArray) -> UInt16Array | UInt32Array:
    """``seen`` (S, V) as numbers whose sums over points fit."""
    few = int(seen.sum(axis=0).max(initial=0)) < 1 << 16
    return seen.astype(np.uint16) if few else seen.astype(np.uint32)


def _maxima(score: DoubleArray) -> DoubleArray:
    """The tree (2 L,) of maxima whose leaves are the scores (S,); entry 1 is its root."""
    leaves = 1 << max(0, len(score) - 1).bit_length()
    levels = [np.append(score, np.full(leaves - len(score), -1.0))]
    while len(levels[-1]) > 1:
        levels.append(levels[-1].reshape(-1, 2).max(axis=1))
    return np.concatenate([[-1.0], *reversed(levels)])


# --- Clusters that join by the votes of the views.


STAGE = "Compare views"
_PAIRS = 4096  # pairs of clusters whose views are compared at a time
_CELLS = 1 << 27  # points times views: 512 MiB of masks
_FEW = 8192  # points that any number of views may have
_HALF_WEIGHT = 0.3  # points of a cluster with which a view's vote about it weighs 1/2
_DIGITS = 9  # of agreements that are compared, so that the order of sums does not matter


@dataclass(frozen=True)
class ConsensusConfig:
    """Settings of the view consensus."""

    per_mask: int = 8  # points sampled in each mask that shows fewer
    max_points: int = MOST_POINTS  # of many views fewer, see `point_limit`
    point_agreement: float = 0.55  # share of views that joins clusters of points, pair by pair
    view_agreement: float = 0.45  # ... that joins clusters, one vote for each view
    doubt: float = 2.0  # prior, in views: orders pairs that few views see
    min_views: float = 0.1  # least views per pair of points; few, because parts chain
    min_voice: float = 0.2  # least summed weight of the views that see two clusters
    min_points: int = 3  # smaller clusters are noise
    min_shared: int = 2  # points in common masks that join clusters which do not touch
    min_support: float = 0.25  # share of the views that see a group in which it leads a mask
    rare: float = 0.05  # groups that lead masks in a lesser share of all views are noise, ...
    rare_views: int = 3  # ... but not those of so many views, ...
    sure_views: int = 2  # ... nor those that lead a mask in so many views, ...
    sure_support: float = 0.5  # ... if that is so large a share of the views that see them
    whole_groups: int = 4  # a mask that shows so many clusters is of many objects at once
    whole_share: float = 0.5  # ... each with this share of the points that the view shows of it
    merged_share: float = 0.15  # a mask whose second group has this share of points holds both

    def __post_init__(self) -> None:
        shares = (self.point_agreement, self.view_agreement, self.min_support, self.merged_share)
        if not all(0 < share < 1 for share in shares):
            raise ValueError("agreements, min_support and merged_share must be between 0 and 1")
        if self.point_agreement < 0.5 or self.view_agreement < APART:
            raise ValueError("agreements: pairs that no view shows in one mask must stay apart")
        if self.max_points > MOST_POINTS:
            raise ValueError(f"max_points: at most {MOST_POINTS}")
        if self.per_mask < 1 or self.max_points < 2 or self.min_points < 1:
            raise ValueError("per_mask, max_points and min_points: too small")
        if self.whole_groups < 3 or not 0 < self.whole_share <= 1:
            raise ValueError("whole_groups: at least 3, each with a share of it, 1 at most")
        if self.doubt < 0 or self.min_views <= 0 or self.min_voice <= 0:
            raise ValueError("doubt must not be negative, min_views and min_voice positive")

    def point_limit(self, n_views: int) -> int:
        """How many points a scene of so many views may have: memory is points times views."""
        return min(self.max_points, max(_FEW, _CELLS // max(n_views, 1)))


def consensus_stage(
    views: Sequence[Camera], load_masks: LoadMasks, depths: DepthMaps, config: ConsensusConfig
) -> Stage[PointTables]:
    """For each view the sparse table (M + 1, G + 1) of points: how many of group g show in mask m.

    Row 0 and column 0 are empty. All tables have the same groups 1..G, in the order of their
    first points.
    """
    limit = config.point_limit(len(views))
    sample = sample_points(views, load_masks, depths, config.per_mask, limit)
    points = yield from part(sample, 0, 5, STAGE)
    mask_of = yield from part(masks_of_points(points, views, load_masks, depths), 1, 5, STAGE)
    normal = surface_normals(points, mask_of, views, load_masks, depths)
    contacts = contacts_of(points, (yield from part(normal, 2, 5, STAGE)))
    sizes = [load_masks(camera).ids.size for camera in views]
    rules = LinkageRules(config.point_agreement, config.min_views, config.doubt)
    cluster = yield from part(linkage_stage(mask_of, rules, STAGE), 3, 5, STAGE)
    evidence = without_wholes(mask_of, cluster, sizes, config)
    if not np.array_equal(evidence, mask_of):
        cluster = yield from part(linkage_stage(evidence, rules, STAGE), 4, 5, STAGE)
    shown = Sightings.of(evidence, sizes)
    while True:
        yield Progress(STAGE, 1, 1, f"{cluster.max(initial=0)} clusters")
        joined = _join_best(shown.tables(cluster), contacts.priors(cluster), config)
        if joined is None:
            break
        cluster = renumbered(joined[cluster])
    shown = Sightings.of(mask_of, sizes)
    kept = _supported(shown.tables(cluster), np.bincount(cluster, minlength=1), config)
    return shown.tables(kept[cluster])


def without_wholes(
    mask_of: IntArray,  # (S, V)
    cluster: IntArray,  # (S,) 1..
    sizes: Sequence[int],  # rows of each view's table: masks + 1
    config: ConsensusConfig,
) -> IntArray:
    """``mask_of`` without masks of many objects at once: a table with all that stands on it.

    Segment Anything gives such wholes, and where few views see two objects next to each other, one
    or two of them would outvote the rest. (Dropping under-segmented masks before clustering is from
    MaskClustering, Yan et al., CVPR 2024.)
    """
    tables = point_tables(mask_of, cluster, sizes)
    rows, columns, counts = tables.entries()
    seen = tables.seen()[tables.view_of_row()[rows], columns]
    shows = counts >= np.maximum(config.min_points, config.whole_share * seen)
    n_things = np.bincount(rows, shows, int(tables.first_row[-1]))
    is_whole = n_things >= config.whole_groups
    evidence = mask_of.copy()
    for v in np.unique(tables.view_of_row()[is_whole]):
        wholes = is_whole[tables.first_row[v] : tables.first_row[v + 1]]
        evidence[wholes[evidence[:, v]], v] = 0
    return evidence


def merged_masks(table: csr_matrix, config: ConsensusConfig) -> LongArray:
    """Dense ids of the masks of a view (M + 1, G + 1) that hold more than one group: a second one
    with a good share of the mask's points, or with most of those that the view shows of it."""
    found, entries = Leaders.of(table), table.tocoo()
    share = config.merged_share * np.maximum(found.total, 1)
    is_merged = (found.n_second >= share) & (found.n_second >= 2)
    seen = np.asarray(table.sum(axis=0)).ravel()[entries.col]
    holds = entries.data >= np.maximum(config.min_points, config.whole_share * seen)
    is_merged[entries.row[holds & (entries.col != found.first[entries.row])]] = True
    return np.flatnonzero(is_merged)


def _join_best(tables: PointTables, priors: Priors, config: ConsensusConfig) -> IntArray | None:
    """The cluster (C + 1,) that each one becomes when those join that agree most with each other;
    None when no two agree enough.

    Every view has one vote: the chance that a point of a and one of b show in one mask. Its
    weight grows with the points that it sees of both, towards 1. ``priors``, what the surface says
    of two clusters, weigh as much as ``doubt`` views.
    """
    key, agreement = _view_agreement(tables, priors, config)
    a = np.arange(tables.width)
    best, value = a.copy(), np.zeros(tables.width)
    first, second = np.divmod(key, tables.width)
    one, other = np.append(first, second), np.append(second, first)
    both = np.append(agreement, agreement)
    order = np.lexsort((other, -both, one))  # the greatest first, the lower cluster on a tie
    found, at = np.unique(one[order], return_index=True)
    best[found], value[found] = other[order][at], both[order][at]
    mutual = (best[best] == a) & (a < best) & (value > config.view_agreement)
    if not mutual.any():
        return None
    joined = a.copy()
    joined[best[mutual]] = a[mutual]
    return joined.astype(np.int32)


def _view_agreement(
    tables: PointTables, priors: Priors, config: ConsensusConfig
) -> tuple[LongArray, DoubleArray]:
    """Pairs of clusters (P,), as first * (C + 1) + second, and their agreement (P,): of those that
    a view shows in one mask or that touch. All others agree less than any that may join. 0 where
    too little is seen of two at once, and where they do not touch and too few points of them were
    ever in one mask."""
    width = tables.width
    seen = tables.seen()
    weight = seen / (seen + _HALF_WEIGHT)  # (V, C + 1)
    rows, columns, counts = tables.entries()
    view = tables.view_of_row()[rows]
    share = counts / np.maximum(seen[view, columns], 1) * weight[view, columns]
    shares = csr_matrix((share, tables.counts.indices, tables.counts.indptr), tables.counts.shape)
    same = (shares.T @ shares).tocoo()
    upper = same.row < same.col
    same_key = same.row[upper].astype(np.int64) * width + same.col[upper]
    key = np.union1d(same_key, priors.key)
    together = np.zeros(len(key))
    together[np.searchsorted(key, same_key)] = same.data[upper]
    by_cluster = np.ascontiguousarray(weight.T)
    voice = np.empty(len(key))
    for start in range(0, len(key), _PAIRS):
        first, second = np.divmod(key[start : start + _PAIRS], width)
        seen_both = by_cluster[first] * by_cluster[second]
        voice[start : start + _PAIRS] = seen_both.sum(axis=1)
    agreement = (together + priors.of(key) * config.doubt) / (voice + config.doubt)
    agreement[voice < config.min_voice] = 0
    apart = np.flatnonzero((agreement > config.view_agreement) & (priors.of(key) <= APART))
    if len(apart) > 0:
        # Points of the lesser of both in masks that show both, view by view: of clusters far apart
        # one stray point in one view would else join them.
        first, second = np.divmod(key[apart], tables.width)
        points = tables.counts.tocsc()
        shared = points[:, first].minimum(points[:, second]).sum(axis=0)
        agreement[apart[np.asarray(shared).ravel() < config.min_shared]] = 0
    return key, np.round(agreement, _DIGITS)


def _supported(tables: PointTables, n_points: LongArray, config: ConsensusConfig) -> IntArray:
    """New id (C + 1,) of each cluster: 0 for those too small or that lead too few masks."""
    rows, columns, counts = tables.entries()
    order = np.lexsort((columns, -counts, rows))
    _, at = np.unique(rows[order], return_index=True)
    leading = tables.view_of_row()[rows[order][at]] * tables.width + columns[order][at]
    leads = np.bincount(np.unique(leading) % tables.width, minlength=tables.width)
    shown = tables.seen()
    seen = (shown / (shown + 1)).sum(axis=0)
    least = max(1.0, min(config.rare * len(tables), config.rare_views))
    is_common = (leads >= least) & (leads >= config.min_support * seen)
    is_sure = (leads >= config.sure_views) & (leads >= config.sure_support * seen)
    keeps = (is_common | is_sure) & (n_points >= config.min_points)
    keeps[0] = False
    return np.where(keeps, np.cumsum(keeps), 0).astype(np.int32)
