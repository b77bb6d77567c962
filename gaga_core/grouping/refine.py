"""Beyond the paper: groups refined by votes (the preset "robust").

The paper names "a dynamic reassignment mechanism" as future work. Here: every Gaussian takes the
label that the masks vote for; every mask takes the group that most of its rendered pixels show;
repeat. That does not depend on the order of the views, and dissolves groups that one bad mask
opened. Gaussians that no picture shows take the gate's votes, then their neighbours'.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import ViewMasks, gaussians_of_masks
from gaga_core.grouping.memory_bank import (
    Decision,
    MemoryBank,
    groups_of_masks,
    two_best,
    views_per_group,
)
from gaga_core.grouping.views import load_labels
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer

_NEIGHBOURS = 8
_MIN_PIXELS = 30  # a group that shows on fewer pixels of a view has no say there
_MIN_TOGETHER = 2  # views
_MAJORITY = 2  # views for, per view against


def reassign_masks(
    gaussians: Gaussians,
    views: Sequence[Camera],
    masks: MaskSet,
    bank: MemoryBank,  # its log has one decision for each mask of these views
    labels: IntArray,  # (N,) 0 = none
    rasterizer: Rasterizer,
    threshold: float,
) -> Stage[tuple[Decision, ...]]:
    """Give each mask the group that most of its pixels show when ``labels`` are rendered.

    Pixels that show no group do not vote; a mask of which less than the share ``threshold`` shows
    one group gets none. The new decisions carry these shares as their overlaps. Groups that most
    views hold to be one thing (`same_thing`) become one.
    """
    before = {(d.view, d.mask): d for d in bank.log}
    log = []
    together = np.zeros((bank.n_groups + 1, bank.n_groups + 1), np.int32)
    apart = np.zeros_like(together)
    for i, camera in enumerate(views):
        yield Progress("Reassign masks", i, len(views), camera.name)
        view_masks = ViewMasks.of(load_labels(masks, camera)[0])
        shown = rasterizer.label_splat(gaussians, camera, labels).labels
        width = bank.n_groups + 1
        cells = view_masks.labels.astype(np.int64) * width + shown
        counts = np.bincount(cells.ravel(), minlength=(len(view_masks) + 1) * width)
        table = counts.reshape(-1, width)
        sizes = np.maximum(table.sum(axis=1), 1)
        best, second = two_best(table)
        _compare_groups(table, together, apart)
        for m in range(1, len(view_masks) + 1):
            old = before[camera.name, int(view_masks.ids[m])]
            share = float(table[m, best[m]] / sizes[m]) if best[m] else 0.0
            group = int(best[m]) if share >= threshold else 0
            log.append(
                replace(
                    old,
                    group=group,
                    is_new=old.is_new and group == old.group,
                    overlap=share,
                    runner_up=int(second[m]),
                    runner_up_overlap=float(table[m, second[m]] / sizes[m]) if second[m] else 0.0,
                )
            )
    merged = same_thing(together, apart)
    return tuple(_renumbered(decision, merged) for decision in log)


def same_thing(together: IntArray, apart: IntArray) -> IntArray:
    """The group (G + 1,) that each group becomes when those that are one thing are merged.

    ``together[a, b]`` counts the views in which a and b show mainly inside one mask, ``apart``
    those in which they show inside two. Two groups are one thing when at least `_MIN_TOGETHER`
    views say so, and more than `_MAJORITY` times as many as say the opposite: a segmenter cuts one
    thing in two, or takes two for one, in a minority of views. A merged group keeps its lowest id.
    """
    one = (together >= _MIN_TOGETHER) & (together > _MAJORITY * apart)
    n, component = connected_components(csr_matrix(one.astype(np.int8)), directed=False)
    lowest = np.full(n, len(one), np.int64)
    np.minimum.at(lowest, component, np.arange(len(one)))
    return lowest[component].astype(np.int32)


def _compare_groups(
    table: LongArray,  # (M + 1, G + 1) pixels of mask m that show group g
    together: IntArray,  # (G + 1, G + 1) views, added to in place; both are symmetric
    apart: IntArray,
) -> None:
    """Add one view's opinion on every pair of groups that it shows under masks."""
    main_mask = table.argmax(axis=0)
    shown = np.flatnonzero((table.sum(axis=0) >= _MIN_PIXELS) & (main_mask > 0))
    shown = shown[shown > 0]
    same = main_mask[shown][:, None] == main_mask[shown][None, :]
    together[np.ix_(shown, shown)] += same
    apart[np.ix_(shown, shown)] += ~same


def prune_groups(bank: MemoryBank, min_views: int) -> MemoryBank:
    """Drop the groups that masks of fewer than ``min_views`` views joined; renumber the rest.

    Masks and Gaussians of a dropped group have none. The order of the ids is kept.
    """
    keeps = views_per_group(bank) >= max(min_views, 1)
    keeps[0] = False
    new_id = np.where(keeps, np.cumsum(keeps), 0).astype(np.int32)
    log = tuple(_renumbered(decision, new_id) for decision in bank.log)
    group = np.where(bank.group > 0, new_id[np.maximum(bank.group, 0)], -1)
    return MemoryBank(np.where(group > 0, group, -1).astype(np.int32), int(keeps.sum()), log)


def fill_unseen(
    gaussians: Gaussians,
    views: Sequence[Camera],
    masks: MaskSet,
    bounds: Mapping[str, DoubleArray],  # accepted depths of each view's masks
    bank: MemoryBank,  # for its log
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
    groups = groups_of_masks(bank, [camera.name for camera in views])
    counts = np.zeros((len(unseen), bank.n_groups + 1), np.uint16)
    rows = np.arange(len(unseen))
    for i, camera in enumerate(views):
        yield Progress("Label hidden Gaussians", i, len(views), camera.name)
        view_masks = ViewMasks.of(load_labels(masks, camera)[0])
        mask_of = gaussians_of_masks(means, camera, view_masks, bounds[camera.name])
        counts[rows, groups[camera.name][view_masks.ids[mask_of]]] += 1
    counts[:, 0] = 0
    result[unseen] = counts.argmax(axis=1)
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


def _renumbered(decision: Decision, new_id: IntArray) -> Decision:
    group, runner_up = int(new_id[decision.group]), int(new_id[decision.runner_up])
    return replace(
        decision,
        group=group,
        is_new=decision.is_new and group > 0,
        runner_up=runner_up,
        runner_up_overlap=decision.runner_up_overlap if runner_up else 0.0,
    )
