"""Objects of regions: pieces of surface join, best evidence first, to levels of objects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.hierarchy.background import is_background
from gaga_core.grouping.hierarchy.borders import (
    Agreement,
    coarse_graph,
    fine_graph,
    in_one_plane,
    is_calm,
    noise_of,
)
from gaga_core.grouping.hierarchy.held import held_together
from gaga_core.grouping.hierarchy.linkage import Clusters, joined
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, small_pieces
from gaga_core.grouping.hierarchy.sheets import planes_of
from gaga_core.grouping.hierarchy.surfels import LoadFurther, Surfels, sample_surfels
from gaga_core.grouping.levels import Levels, agreement_of
from gaga_core.grouping.robust.surface_points import DepthMaps, LoadMasks
from gaga_core.grouping.robust.surfaces import finite
from gaga_core.kernels import n_threads
from gaga_core.progress import Progress, Stage, part

STAGE = "Find objects"
_STEPS = 5
LEAST_SURFELS = 32  # fewer show no surface
_NEAREST = 3  # samples that a Gaussian takes its groups from
_BOTH_NEAR = 2.0  # times the distance of the nearest sample at which two others may outvote it


@dataclass(frozen=True)
class HierarchyConfig:
    """Settings. Evidence is in log odds that two neighbouring pieces are one thing."""

    surfels: int = 60_000  # most samples of the surfaces; time grows with them
    pieces: float = 2.3  # evidence at which small pieces join to those that are judged in full
    finer: tuple[float, ...] = (3.0, 2.0, 1.2)  # levels of parts, descending
    objects: float = 0.6  # the level of whole objects
    coarser: tuple[float, ...] = (0.0, -1.0, -2.0)  # levels of things together, descending
    least_part: float = 1.5  # samples that a view shows of the smallest part, on average ...
    least_object: float = 6.0  # ... and of the smallest object
    least_splats: int = 10  # Gaussians of the smallest object: fewer are rest, however large
    background: bool = True  # gather what surrounds the scene in one group
    detail: float | None = None  # level to choose, 0 coarse .. 1 fine; None = objects

    def __post_init__(self) -> None:
        steps = (self.pieces, *self.finer, self.objects, *self.coarser)
        if list(steps[1:]) != sorted(steps[1:], reverse=True):
            raise ValueError("finer, objects, coarser: evidence must descend")
        if self.surfels < LEAST_SURFELS or min(self.least_part, self.least_object) < 0:
            raise ValueError("surfels, least_part and least_object: too small")
        if self.detail is not None and not 0 <= self.detail <= 1:
            raise ValueError(f"detail: {self.detail} is not between 0 and 1")


@dataclass(frozen=True, eq=False)
class FoundObjects:
    """Levels of groups, and the samples of the surfaces that carry them."""

    levels: Levels
    confidence: FloatArray  # (N,) share of the nearest samples that are in the Gaussian's group
    regions: IntArray  # (S, V) dense mask id that each view shows at each sample, 0 = none
    groups: IntArray  # (S,) group of each sample at the chosen level, 1..


def objects_stage(
    gaussians: Gaussians,
    views: Sequence[Camera],
    load_masks: LoadMasks,
    load_further: LoadFurther,
    depths: DepthMaps,
    config: HierarchyConfig,
) -> Stage[FoundObjects]:
    """Find objects from regions of ``views``; ``depths`` has the median depth of each.

    ``load_further`` gives regions of a view at other levels of detail, none where there are none:
    with them the result depends less on how fine the regions happen to be.

    Raises ``GagaError`` when the views show next to nothing.
    """
    sample = sample_surfels(views, load_masks, load_further, depths, config.surfels)
    surfels = yield from part(sample, 0, _STEPS, STAGE)
    if len(surfels.points) < LEAST_SURFELS:
        raise GagaError("The views show next to none of the splats. Check poses and model.")
    rows = np.flatnonzero(finite(gaussians))
    tree = cKDTree(surfels.points)
    means = gaussians.means[rows].astype(np.float64)
    distance, samples = map(np.asarray, tree.query(means, k=_NEAREST, workers=n_threads()))
    n_splats = np.bincount(samples[:, 0], minlength=len(surfels.points))
    clusters, background = yield from part(
        _nested_clusters(surfels, views, n_splats, config), 1, _STEPS, STAGE
    )
    yield Progress(STAGE, _STEPS - 1, _STEPS, "label Gaussians")
    chosen = len(config.coarser)
    groups = clusters[chosen][samples].astype(np.int32)
    nearest = _carriers(distance, samples, groups)
    carriers = np.concatenate([nearest, np.arange(len(surfels.points))])
    found = Levels.of(clusters[:, carriers], chosen, background[carriers].astype(np.int64))
    if config.detail is not None:
        found = found.choose(config.detail)
    labels = np.zeros((len(clusters), len(gaussians)), np.int32)
    labels[:, rows] = found.labels[:, : len(rows)]
    confidence = np.zeros(len(gaussians), np.float32)
    confidence[rows] = agreement_of(groups, clusters[chosen][nearest].astype(np.int32))
    return FoundObjects(
        levels=replace(found, labels=labels),
        confidence=confidence,
        regions=surfels.regions,
        groups=found.labels[found.chosen, len(rows) :],
    )


def _nested_clusters(
    surfels: Surfels, views: Sequence[Camera], n_splats: LongArray, config: HierarchyConfig
) -> Stage[tuple[LongArray, BoolArray]]:
    """Clusters (L, S) of samples, coarse to fine, and which samples (S,) are background.

    ``n_splats`` (S,) is how many Gaussians are next to each sample.
    """
    yield Progress(STAGE, 0, 4, "small pieces")
    near = Neighbourhood.of(surfels.points)
    piece = small_pieces(surfels, near)
    agreement = Agreement.of(surfels, near, piece)
    yield Progress(STAGE, 1, 4, "planes")
    plane = planes_of(surfels, near)
    yield Progress(STAGE, 2, 4, "parts")
    shown = surfels.n_views / len(views)

    fine = joined(fine_graph(surfels, near, piece, agreement), config.pieces)[piece]
    noise = noise_of(surfels, near, plane, fine)

    def judged(cluster: LongArray) -> Clusters:
        views_say = Agreement.of(surfels, near, piece, cluster)
        graph = coarse_graph(surfels, near, plane, piece, views_say, cluster, noise)
        size = np.bincount(cluster, shown).astype(np.float64)
        return Clusters(cluster, replace(graph, size=size))

    def judged_again(before: Clusters) -> Clusters:
        now = judged(before.cluster)
        if is_calm(noise):
            return now
        kept = in_one_plane(plane, now) & (before.graph.evidence > now.graph.evidence)
        evidence = np.where(kept, before.graph.evidence, now.graph.evidence)
        return Clusters(now.cluster, replace(now.graph, evidence=evidence))

    now = judged(fine)
    fine_to_coarse = []
    for i, evidence in enumerate(config.finer):
        now = (judged_again(now) if i > 0 and is_calm(noise) else now).joined(evidence)
        now = now if i > 0 else now.joined(-np.inf, config.least_part)
        fine_to_coarse.append(now.cluster)
    yield Progress(STAGE, 3, 4, "objects")
    now = judged_again(now).joined(config.objects).joined(-np.inf, config.least_object)
    now = now.merged(held_together(near, plane, now.cluster))
    splats = np.bincount(now.cluster, n_splats)
    crumbs = (now.graph.size < config.least_object) | (splats < config.least_splats)
    outside = crumbs
    if config.background:
        outside = crumbs | is_background(surfels, views, now.cluster)
    background = outside[now.cluster]
    now = now.set_apart(outside)
    fine_to_coarse.append(now.cluster)
    for evidence in config.coarser:
        now = now.joined(evidence)
        fine_to_coarse.append(now.cluster)
    levels = np.stack(fine_to_coarse[::-1])
    return np.where(background, levels.max() + 1, levels), background


def _carriers(distance: DoubleArray, samples: LongArray, groups: IntArray) -> LongArray:
    """The sample (K,) that stands for each Gaussian, of the nearest ``samples`` (K, 3) at
    ``distance`` (K, 3), which are in ``groups`` (K, 3).

    The nearest one does, unless the next two agree on another cluster and are about as near.
    """
    outvoted = (groups[:, 1] == groups[:, 2]) & (groups[:, 1] != groups[:, 0])
    outvoted &= distance[:, 2] < _BOTH_NEAR * distance[:, 0]
    chosen: LongArray = np.where(outvoted, samples[:, 1], samples[:, 0]).astype(np.int64)
    return chosen
