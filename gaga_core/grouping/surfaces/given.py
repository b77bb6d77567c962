"""Levels around groups that are known: what they consist of, and what they are parts of.

Masks of a model give groups by the consensus of the views (`grouping.robust`), and they stay as
they are. Where the model says what contains what (Segment Anything's whole, part and subpart), its
masks at other levels of detail are the views' witness of the same borders that make objects of
regions: finer levels cut only inside of a group, coarser ones only join groups.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import IntArray, LongArray
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import MemoryBank, at_level
from gaga_core.grouping.robust.surface_graph import finite
from gaga_core.grouping.robust.surface_points import DepthMaps
from gaga_core.grouping.surfaces.boosted_trees import learned
from gaga_core.grouping.surfaces.borders import Seen, borders_of, joined
from gaga_core.grouping.surfaces.objects import (
    CHOSEN,
    LEAST_SURFELS,
    HierarchyConfig,
    colors_of_samples,
    cuts,
    grown,
    node_features,
)
from gaga_core.grouping.surfaces.surfels import Neighbourhood, dense, sample_surfels, small_pieces
from gaga_core.grouping.views import GatedViews, load_further
from gaga_core.progress import Progress, Stage, part
from gaga_core.threads import n_threads

STAGE = "Find levels"
_NEAREST = 8  # samples among which a Gaussian seeks one of its own group
_LEAVES = 7.0  # log odds at which pieces join to leaves: more than regions ask, as models part less
_TOGETHER = (-2.0, -1.0, 0.0)  # least log odds at which groups join, coarse to fine


def levels_around_stage(
    gated: GatedViews, bank: MemoryBank, depths: DepthMaps, config: HierarchyConfig
) -> Stage[MemoryBank]:
    """The bank with levels around its groups, at the level that ``config`` wants; without levels
    where the views show next to nothing.

    Masks of ``gated`` come with others that contain them or lie in them.
    """
    gaussians, further = gated.gaussians, partial(load_further, gated.masks)
    sample = sample_surfels(gated.views, gated.masks_of, further, depths, config.surfels)
    surfels = yield from part(sample, 0, 3, STAGE)
    labels = np.maximum(bank.group, 0)
    rows = np.flatnonzero(finite(gaussians) & (labels > 0))
    if len(surfels.points) < LEAST_SURFELS or len(rows) == 0:
        return bank
    means = gaussians.means[rows].astype(np.float64)
    nearest = cKDTree(means).query(surfels.points, workers=n_threads())[1]
    given = labels[rows[np.asarray(nearest)]].astype(np.int64)
    yield Progress(STAGE, 1, 3, "parts of groups")
    around = np.asarray(cKDTree(surfels.points).query(means, k=_NEAREST, workers=n_threads())[1])
    near = Neighbourhood.of(surfels.points)
    piece = dense(small_pieces(surfels, near) * (int(given.max()) + 1) + given)
    color = colors_of_samples(gaussians, rows, surfels.points)
    seen = Seen.of(surfels, near, color, piece, len(gated.views))
    n_splats = np.bincount(around[:, 0], minlength=len(surfels.points))
    clusters = _nested_clusters(seen, gated, given, n_splats)
    yield Progress(STAGE, 2, 3, "label Gaussians")
    every = np.full((len(clusters), len(gaussians)), -1, np.int64)
    every[:, rows] = _spread(clusters, given, around.astype(np.int64), labels[rows])
    levels = Levels.around(every, labels, len(_TOGETHER))
    bank = replace(bank, levels=levels)
    return bank if config.detail is None else at_level(bank, levels.at(config.detail))


def _nested_clusters(
    seen: Seen, gated: GatedViews, given: LongArray, n_splats: LongArray
) -> LongArray:
    """Clusters (L, S) of samples, coarse to fine, ids from 0; level ``len(_TOGETHER)`` is ``given``
    (S,)."""
    whole = dense(given)
    graph = borders_of(seen, whole).judged(learned().borders)
    coarser = [joined(graph, least)[whole] for least in _TOGETHER]
    near = seen.near
    one_group = given[near.first] == given[near.second]
    columns = {name: getattr(near, name)[one_group] for name in ("first", "second", "length")}
    inside = replace(seen, near=replace(near, **columns))
    tree = grown(inside, _LEAVES)
    objectness = learned().objects(node_features(inside, tree, gated.views, n_splats))
    nothing = np.zeros(len(tree.parent), np.bool_)
    finer = cuts(tree, objectness, nothing, -np.inf)[0][CHOSEN + 1 :]
    return np.stack([*coarser, whole, *finer])


def _spread(
    clusters: LongArray, given: LongArray, around: LongArray, labels: IntArray
) -> LongArray:
    """Clusters (L, K) of Gaussians with ``labels`` (K,), from the samples ``around`` them (K, 8).

    Each takes those of the nearest sample of its own group; without one those of the group's
    largest part, and of a group without samples it is an object by itself.
    """
    n_groups = int(max(labels.max(), given.max())) + 1
    alone = clusters.max() + 1 + np.arange(n_groups)
    of_group = np.tile(alone, (len(clusters), 1))
    finest = clusters[-1]
    size = np.bincount(finest)[finest]
    order = np.argsort(size, kind="stable")  # the largest part writes last
    of_group[:, given[order]] = clusters[:, order]
    own = given[around] == labels[:, None]
    sample = around[np.arange(len(labels)), own.argmax(axis=1)]
    return np.where(own.any(axis=1), clusters[:, sample], of_group[:, labels])
