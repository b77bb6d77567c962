"""Beyond the paper: what the consensus of the views makes of masks and Gaussians ("robust").

Every mask takes the group of most of the points that it shows. A mask that holds two groups does
not vote at first; then its pixels vote, each for that one of its groups that the first labels show
there. Gaussians that no picture shows take the gate's votes, then their neighbours'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import ViewMasks, gaussians_of_masks
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.grouping.robust.surface_points import Leaders, PointTables
from gaga_core.grouping.views import load_labels
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage
from gaga_core.raster.vote_slots import VoteSlots

_NEIGHBOURS = 8
_TABLE_BYTES = 1 << 28  # of counts of all groups; above, a few groups of each Gaussian are kept


def decide_masks(
    bank: MemoryBank,  # its log has one decision for each mask of these views
    views: Sequence[str],
    tables: PointTables,  # of the views: points of each group in each mask
    ids: Sequence[IntArray],  # by view: (M + 1,) the id of each mask in the label map
) -> MemoryBank:
    """The bank with each mask decided by its points: overlap = share of the points it shows.

    Decisions keep their order and #G(m); a group is new where it comes first. No group
    owns Gaussians yet. A mask without a point of any group has none.
    """
    known, log = {0}, []
    for view, decisions in groupby(bank.log, lambda d: d.view):
        v = views.index(view)
        said = Leaders.of(tables[v]).by_mask(ids[v])
        for old in decisions:
            group, share, second, rival = said[old.mask]
            is_new = group not in known
            log.append(
                Decision(view, old.mask, group, is_new, share, second, rival, old.n_gaussians)
            )
            known.add(group)
    group_of = np.full_like(bank.group, -1)
    return replace(bank, group=group_of, n_groups=tables.width - 1, log=tuple(log))


def voting_labels(
    masks: ViewMasks,
    table: csr_matrix,  # (M + 1, G + 1) points
    merged: LongArray,  # dense ids of masks that hold several groups
    shown: IntArray | None = None,  # (H, W) groups rendered from the first labels
) -> IntArray:
    """The groups (H, W) that the pixels of a view vote for, 0 = does not vote.

    Pixels of a merged mask vote for the group shown there if the mask has points of it.
    """
    group = Leaders.of(table).first
    group[merged] = 0
    labels: IntArray = group[masks.labels]
    if shown is None or len(merged) == 0:
        return labels
    return labels + divided_labels(masks, table, merged, shown)


def divided_labels(
    masks: ViewMasks,
    table: csr_matrix,  # (M + 1, G + 1) points
    merged: LongArray,  # dense ids of masks that hold several groups
    shown: IntArray,  # (H, W) groups rendered from the first labels
) -> IntArray:
    """The groups (H, W) that the pixels of merged masks vote for, 0 = does not vote, as all other
    pixels."""
    is_merged = np.isin(np.arange(len(masks) + 1), merged)[masks.labels]
    rows, groups = masks.labels[is_merged], shown[is_merged]
    labels = np.zeros_like(masks.labels)
    labels[is_merged] = np.where(np.asarray(table[rows, groups]).ravel() > 0, groups, 0)
    return labels


def fill_unseen(
    gaussians: Gaussians,
    views: Sequence[Camera],
    masks: MaskSet,
    bounds: Mapping[str, DoubleArray],  # accepted depths of each view's masks
    groups: Mapping[str, IntArray],  # by view: group of each mask id, 0 = none
    n_groups: int,
    labels: IntArray,  # (N,) 0 = not labelled yet
) -> Stage[IntArray]:
    """Labels (N,) in which the unlabelled Gaussians take the gate's votes, then neighbours'.

    The gate's vote counts in how many views the centre lies behind a mask of each group.
    """
    unseen = np.flatnonzero(labels == 0)
    result = labels.copy()
    if len(unseen) == 0 or not (labels > 0).any():
        return result
    means = np.ascontiguousarray(gaussians.means[unseen])
    is_table = 2 * len(unseen) * (n_groups + 1) <= _TABLE_BYTES
    counts = np.zeros((len(unseen), n_groups + 1) if is_table else (0, 1), np.uint16)
    slots = VoteSlots.empty(0 if is_table else len(unseen))
    rows = np.arange(len(unseen), dtype=np.int32)
    for i, camera in enumerate(views):
        yield Progress("Label hidden Gaussians", i, len(views), camera.name)
        view_masks = ViewMasks.of(load_labels(masks, camera)[0])
        mask_of = gaussians_of_masks(means, camera, view_masks, bounds[camera.name])
        found = groups[camera.name][view_masks.ids[mask_of]]
        if is_table:
            counts[rows, found] += 1
        else:
            slots.add_one(rows[found > 0], found[found > 0])
    counts[:, 0] = 0
    result[unseen] = counts.argmax(axis=1) if is_table else np.maximum(slots.winners()[0], 0)
    return _from_neighbours(gaussians.means, result)


def _from_neighbours(means: FloatArray, labels: IntArray) -> IntArray:
    """Unlabelled Gaussians take the label most frequent among their nearest labelled ones."""
    finite = np.isfinite(means.sum(axis=1))
    known = np.flatnonzero((labels > 0) & finite)
    unknown = np.flatnonzero((labels == 0) & finite)
    if len(unknown) == 0 or len(known) == 0:
        return labels
    k = min(_NEIGHBOURS, len(known))
    _, nearest = cKDTree(means[known]).query(means[unknown], k=k)
    near = labels[known[nearest.reshape(len(unknown), k)]]
    # The most frequent of k labels, the nearer one on a tie: count each one's equals in its row.
    frequency = (near[:, :, None] == near[:, None, :]).sum(axis=2)
    result = labels.copy()
    result[unknown] = near[np.arange(len(unknown)), frequency.argmax(axis=1)]
    return result
