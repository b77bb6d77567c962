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

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.robust.contacts import APART, Priors, contacts_of, surface_normals
from gaga_core.grouping.robust.linkage import (
    MOST_POINTS,
    LinkageRules,
    linkage_stage,
    renumbered,
)
from gaga_core.grouping.robust.point_tables import (
    Leaders,
    PointTables,
    Sightings,
    point_tables,
)
from gaga_core.grouping.robust.surface_points import (
    DepthMaps,
    LoadMasks,
    masks_of_points,
    sample_points,
)
from gaga_core.progress import Progress, Stage, part

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
    whole_groups: int = 4  # a mask that shows so many clusters is of many things at once
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
    """``mask_of`` without masks of many things at once: a table with all that stands on it.

    Segment Anything gives such wholes, and where few views see two things next to each other, one
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
        agreement[apart[_shared_points(tables, key[apart]) < config.min_shared]] = 0
    return key, np.round(agreement, _DIGITS)


def _shared_points(tables: PointTables, key: LongArray) -> DoubleArray:
    """How many points (P,) of the lesser of two clusters lie in masks that show both, view by
    view. Of clusters far apart one stray point in one view would else join them."""
    first, second = np.divmod(key, tables.width)
    columns = tables.counts.tocsc()
    shared = columns[:, first].minimum(columns[:, second]).sum(axis=0)
    return np.asarray(shared, np.float64).ravel()


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
