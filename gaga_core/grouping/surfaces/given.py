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
from gaga_core.grouping.surfaces.borders import (
    KNOWN_NOISE,
    Agreement,
    Clusters,
    Judge,
    SignedGraph,
    coarser_of,
    fine_graph,
    joined,
    keep_enclosed,
)
from gaga_core.grouping.surfaces.objects import LEAST_SURFELS, HierarchyConfig
from gaga_core.grouping.surfaces.surfels import (
    Neighbourhood,
    Surfels,
    dense,
    planes_of,
    sample_surfels,
    small_pieces,
)
from gaga_core.grouping.views import GatedViews, load_further
from gaga_core.progress import Progress, Stage, part
from gaga_core.threads import n_threads

STAGE = "Find levels"
_NEAREST = 8  # samples among which a Gaussian seeks one of its own group


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
    clusters = _nested_clusters(surfels, len(gated.views), given, config)
    yield Progress(STAGE, 2, 3, "label Gaussians")
    around = cKDTree(surfels.points).query(means, k=_NEAREST, workers=n_threads())[1]
    every = np.full((len(clusters), len(gaussians)), -1, np.int64)
    every[:, rows] = _spread(clusters, given, np.asarray(around, np.int64), labels[rows])
    levels = Levels.around(every, labels, len(config.coarser))
    bank = replace(bank, levels=levels)
    return bank if config.detail is None else at_level(bank, levels.at(config.detail))


def _nested_clusters(
    surfels: Surfels, n_views: int, given: LongArray, config: HierarchyConfig
) -> LongArray:
    """Clusters (L, S) of samples, coarse to fine, ids from 0; level ``len(coarser)`` is ``given``
    (S,)."""
    near = Neighbourhood.of(surfels.points)
    piece = small_pieces(surfels, near)
    piece = dense(piece * (int(given.max()) + 1) + given)
    plane = planes_of(surfels, near)
    judge = Judge(surfels, near, plane, piece, surfels.n_views / n_views, KNOWN_NOISE)
    fine = fine_graph(surfels, near, piece, Agreement.of(surfels, near, piece))

    def within(graph: SignedGraph, cluster: LongArray) -> SignedGraph:
        """Without the borders of clusters (S,) of two groups."""
        group = coarser_of(cluster, given)
        return graph.only(group[graph.first] == group[graph.second])

    now = judge.judged(joined(within(fine, piece), config.pieces)[piece])
    now = Clusters(now.cluster, within(now.graph, now.cluster))
    parts = now.levels(
        config.finer,
        config.least_part,
        lambda part: keep_enclosed(surfels, near, part, config.least_object),
    )
    whole = judge.judged(dense(given))
    levels = [*parts, whole, *whole.levels(config.coarser)]
    return np.stack([level.cluster for level in levels[::-1]])


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
