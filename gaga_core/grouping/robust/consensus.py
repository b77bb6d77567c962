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

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.robust.consensus_kernels import count_pairs, find_partners, merge_clusters
from gaga_core.grouping.robust.contacts import contacts_of, surface_normals
from gaga_core.grouping.robust.surface_points import (
    DepthMaps,
    LoadMasks,
    masks_of_points,
    sample_points,
)
from gaga_core.kernels import run_chunks
from gaga_core.progress import Progress, Stage, part

STAGE = "Compare views"
_ROWS = 64  # rows of pairs in one piece of work
_SLICE = 1024  # rows between two chances to cancel
_MERGES = 256  # merges between two chances to cancel
_HALF_WEIGHT = 0.3  # points of a cluster with which a view's vote about it weighs 1/2
_DIGITS = 9  # of agreements that are compared, so that the order of sums does not matter


@dataclass(frozen=True)
class ConsensusConfig:
    """Settings of the view consensus."""

    per_mask: int = 8  # points sampled in each mask that shows fewer
    max_points: int = 8192  # memory and time grow with the square
    point_agreement: float = 0.55  # share of views that joins clusters of points, pair by pair
    view_agreement: float = 0.45  # ... that joins clusters, one vote for each view
    doubt: float = 2.0  # prior, in views: orders pairs that few views see
    min_views: float = 0.1  # least views per pair of points; few, because parts chain
    min_voice: float = 0.2  # least summed weight of the views that see two clusters
    min_points: int = 3  # smaller clusters are noise
    min_support: float = 0.25  # share of the views that see a group in which it leads a mask
    rare: float = 0.05  # groups that lead masks in a lesser share of all views are noise, ...
    rare_views: int = 3  # ... but not those of so many views
    whole_groups: int = 4  # a mask that shows so many clusters is of many things at once
    whole_share: float = 0.04  # ... each with this share of its points
    merged_share: float = 0.15  # a mask whose second group has this share of points holds both

    def __post_init__(self) -> None:
        shares = (self.point_agreement, self.view_agreement, self.min_support, self.merged_share)
        if not all(0 < share < 1 for share in shares):
            raise ValueError("agreements, min_support and merged_share must be between 0 and 1")
        if self.per_mask < 1 or self.max_points < 2 or self.min_points < 1:
            raise ValueError("per_mask, max_points and min_points: too small")
        if self.whole_groups < 3 or not 0 < self.whole_share < 1 / self.whole_groups:
            raise ValueError("whole_groups: at least 3, each with less than 1 of so many parts")
        if self.doubt < 0 or self.min_views <= 0 or self.min_voice <= 0:
            raise ValueError("doubt must not be negative, min_views and min_voice positive")


def consensus_stage(
    views: Sequence[Camera], load_masks: LoadMasks, depths: DepthMaps, config: ConsensusConfig
) -> Stage[list[LongArray]]:
    """For each view the table (M + 1, G + 1) of points: how many of group g show in mask m.

    Row 0 and column 0 are empty. All tables have the same groups 1..G, in the order of their
    first points.
    """
    sample = sample_points(views, load_masks, depths, config.per_mask, config.max_points)
    points = yield from part(sample, 0, 5, STAGE)
    mask_of = yield from part(masks_of_points(points, views, load_masks, depths), 1, 5, STAGE)
    normal = surface_normals(points, mask_of, views, load_masks, depths)
    contacts = contacts_of(points, (yield from part(normal, 2, 5, STAGE)))
    sizes = [load_masks(camera).ids.size for camera in views]
    cluster = yield from part(_linked(mask_of, config), 3, 5, STAGE)
    evidence = without_wholes(mask_of, cluster, sizes, config)
    if not np.array_equal(evidence, mask_of):
        cluster = yield from part(_linked(evidence, config), 4, 5, STAGE)
    while True:
        yield Progress(STAGE, 1, 1, f"{cluster.max(initial=0)} clusters")
        tables = point_tables(evidence, cluster, sizes)
        joined = _join_best(tables, contacts.prior(cluster), config)
        if joined is None:
            break
        cluster = _renumbered(joined[cluster])
    tables = point_tables(mask_of, cluster, sizes)
    kept = _supported(tables, np.bincount(cluster, minlength=1), config)
    return point_tables(mask_of, kept[cluster], sizes)


def point_tables(
    mask_of: IntArray,  # (S, V)
    cluster: IntArray,  # (S,) 1.., 0 = none
    sizes: Sequence[int],  # rows of each view's table: masks + 1
) -> list[LongArray]:
    """For each view how many points of each cluster show in each mask, (M + 1, C + 1)."""
    width = int(cluster.max(initial=0)) + 1
    tables = []
    for v, rows in enumerate(sizes):
        cells = mask_of[:, v].astype(np.int64) * width + cluster
        table = np.bincount(cells, minlength=rows * width).reshape(rows, width)
        table[0], table[:, 0] = 0, 0
        tables.append(table)
    return tables


def without_wholes(
    mask_of: IntArray,  # (S, V)
    cluster: IntArray,  # (S,) 1..
    sizes: Sequence[int],  # rows of each view's table: masks + 1
    config: ConsensusConfig,
) -> IntArray:
    """``mask_of`` without masks of many things at once: a table with all that stands on it.

    Segment Anything gives such wholes, and where few views see two things next to each other, one
    or two of them would outvote the rest. (Dropping under-segmented masks before clustering is from
    MaskClustering, Yan et al., CVPR 2024.)
    """
    evidence = mask_of.copy()
    for v, table in enumerate(point_tables(mask_of, cluster, sizes)):
        least = np.maximum(config.min_points, config.whole_share * table.sum(axis=1))
        wholes = np.flatnonzero((table >= least[:, None]).sum(axis=1) >= config.whole_groups)
        evidence[np.isin(evidence[:, v], wholes), v] = 0
    return evidence


def merged_masks(table: LongArray, config: ConsensusConfig) -> LongArray:
    """Dense ids of the masks of a view that hold more than one group."""
    if table.shape[1] < 2:
        return np.zeros(0, np.int64)
    second = np.partition(table, -2, axis=1)[:, -2]
    share = config.merged_share * np.maximum(table.sum(axis=1), 1)
    return np.flatnonzero((second >= share) & (second >= 2))


def _linked(mask_of: IntArray, config: ConsensusConfig) -> Stage[IntArray]:
    """Clusters (S,) 1.. of points by average linkage over pairs of points."""
    n = len(mask_of)
    together, both = np.zeros((n, n), np.float32), np.zeros((n, n), np.float32)
    size, score = np.ones(n), np.full(n, -1.0)
    partner, parent = np.full(n, -1, np.int32), np.arange(n, dtype=np.int32)
    rules = np.array([config.point_agreement, config.min_views, config.doubt])

    def count(start: int, stop: int) -> None:
        count_pairs(mask_of, first + start, first + stop, together, both)

    def find(start: int, stop: int) -> None:
        find_partners(together, both, size, rules, start, stop, partner, score)

    for first in range(0, n, _SLICE):
        yield Progress(STAGE, first, 2 * n, f"{n} points")
        run_chunks(count, min(_SLICE, n - first), _ROWS)
    run_chunks(find, n, _ROWS)
    n_merges = _MERGES
    while n_merges == _MERGES:
        left = int((size > 0).sum())
        yield Progress(STAGE, 2 * n - left, 2 * n, f"{left} clusters")
        n_merges = merge_clusters(together, both, size, rules, partner, score, parent, _MERGES)
    return _renumbered(_roots(parent))


def _roots(parent: IntArray) -> IntArray:
    """The surviving cluster (S,) of each point; parents come before their children."""
    root = parent
    while (root[root] != root).any():
        root = root[root]
    return root


def _join_best(
    tables: Sequence[LongArray], prior: DoubleArray, config: ConsensusConfig
) -> IntArray | None:
    """The cluster (C + 1,) that each one becomes when those join that agree most with each other;
    None when no two agree enough.

    Every view has one vote: the chance that a point of a and one of b show in one mask. Its
    weight grows with the points that it sees of both, towards 1. ``prior`` (C + 1, C + 1), what the
    surface says of two clusters, weighs as much as ``doubt`` views.
    """
    agreement = _view_agreement(tables, prior, config)
    best, value = agreement.argmax(axis=1), agreement.max(axis=1)
    a = np.arange(len(best))
    mutual = (best[best] == a) & (a < best) & (value > config.view_agreement)
    if not mutual.any():
        return None
    joined = a.copy()
    joined[best[mutual]] = a[mutual]
    return joined.astype(np.int32)


def _view_agreement(
    tables: Sequence[LongArray], prior: DoubleArray, config: ConsensusConfig
) -> DoubleArray:
    """Agreement (C + 1, C + 1) of clusters, 0 where too little is seen of two at once."""
    width = tables[0].shape[1]
    same, voice = np.zeros((width, width)), np.zeros((width, width))
    for table in tables:
        seen = table.sum(axis=0)
        weight = seen / (seen + _HALF_WEIGHT)
        share = table / np.maximum(seen, 1) * weight
        same += share.T @ share
        voice += weight[:, None] * weight[None, :]
    agreement = (same + prior * config.doubt) / (voice + config.doubt)
    agreement[voice < config.min_voice] = 0
    np.fill_diagonal(agreement, 0)
    agreement[0], agreement[:, 0] = 0, 0
    result: DoubleArray = np.round(agreement, _DIGITS)
    return result


def _supported(
    tables: Sequence[LongArray], n_points: LongArray, config: ConsensusConfig
) -> IntArray:
    """New id (C + 1,) of each cluster: 0 for those too small or that lead too few masks."""
    width = tables[0].shape[1]
    leads, seen = np.zeros(width, np.int64), np.zeros(width)
    for table in tables:
        first = table.argmax(axis=1)[table.max(axis=1) > 0]
        leads[np.unique(first)] += 1
        count = table.sum(axis=0)
        seen += count / (count + 1)
    least = max(1.0, min(config.rare * len(tables), config.rare_views))
    keeps = (leads >= np.maximum(least, config.min_support * seen)) & (
        n_points >= config.min_points
    )
    keeps[0] = False
    return np.where(keeps, np.cumsum(keeps), 0).astype(np.int32)


def _renumbered(cluster: IntArray) -> IntArray:
    """The same clusters as 1, 2, ... in the order of their first points."""
    _, first, inverse = np.unique(cluster, return_index=True, return_inverse=True)
    order = np.empty(len(first), np.int32)
    order[np.argsort(first)] = np.arange(1, len(first) + 1)
    result: IntArray = order[inverse]
    return result
