"""Objects of regions: pieces of surface join, best evidence first, to levels of objects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.hierarchy.borders import Agreement, fine_graph, noise_of
from gaga_core.grouping.hierarchy.divided import divided
from gaga_core.grouping.hierarchy.enclosed import is_outside, keep_enclosed
from gaga_core.grouping.hierarchy.held import held_together
from gaga_core.grouping.hierarchy.judging import Judge
from gaga_core.grouping.hierarchy.linkage import joined
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, small_pieces
from gaga_core.grouping.hierarchy.sheets import planes_of
from gaga_core.grouping.hierarchy.smaller import (
    carriers_by_color,
    colors_of_samples,
    smaller_levels,
)
from gaga_core.grouping.hierarchy.spanned import spanned
from gaga_core.grouping.hierarchy.surfels import LoadFurther, Surfels, sample_surfels
from gaga_core.grouping.levels import Levels, agreement_of
from gaga_core.grouping.robust.surface_points import DepthMaps, LoadMasks
from gaga_core.grouping.robust.surfaces import finite
from gaga_core.kernels import n_threads
from gaga_core.progress import Progress, Stage, part

STAGE = "Find objects"
_STEPS = 5
LEAST_SURFELS = 32  # fewer show no surface
_NEAREST = 3  # samples that a Gaussian takes its groups from ...
_NEAREST_SMALL = 6  # ... and its pieces smaller than parts
_BOTH_NEAR = 2.0  # times the distance of the nearest sample at which two others may outvote it


@dataclass(frozen=True)
class HierarchyConfig:
    """Settings. Evidence is in log odds that two neighbouring pieces are one thing."""

    surfels: int = 60_000  # most samples of the surfaces; time grows with them
    pieces: float = 2.3  # evidence at which small pieces join to those that are judged in full
    smaller: tuple[float, ...] = (1.5, 3.0)  # levels in parts, by color as well, ascending
    finer: tuple[float, ...] = (3.0, 2.0, 1.2)  # levels of parts, descending
    objects: float = 0.6  # the level of whole objects
    coarser: tuple[float, ...] = (0.0, -1.0, -2.0)  # levels of things together, descending
    least_piece: float = 1.0  # samples that a view shows of the smallest piece in a part, mean ...
    least_part: float = 1.5  # ... of the smallest part ...
    least_object: float = 6.0  # ... and of the smallest object
    least_splats: int = 10  # Gaussians of the smallest object: fewer are rest, however large
    background: bool = True  # gather what surrounds the scene in one group
    detail: float | None = None  # level to choose, 0 coarse .. 1 fine; None = objects

    def __post_init__(self) -> None:
        steps = (self.pieces, *self.finer, self.objects, *self.coarser)
        if not self.finer or list(steps[1:]) != sorted(steps[1:], reverse=True):
            raise ValueError("finer, objects, coarser: evidence must descend")
        if list(self.smaller) != sorted(self.smaller):
            raise ValueError("smaller: evidence must ascend")
        sizes = (self.least_piece, self.least_part, self.least_object)
        if self.surfels < LEAST_SURFELS or min(sizes) < 0:
            raise ValueError("surfels, least_piece, least_part and least_object: too small")
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
    around = _Around.of(gaussians, surfels.points)
    near = Neighbourhood.of(surfels.points)
    n_splats = np.bincount(around.samples[:, 0], minlength=len(surfels.points))
    chosen, rows = len(config.coarser), around.rows
    rgb = rgb_from_dc(gaussians.sh[rows, 0])
    colors = rgb, colors_of_samples(gaussians, rows, rgb, surfels.points)
    clusters, behind = yield from part(
        _nested_clusters(surfels, near, views, n_splats, colors[1], config), 1, _STEPS, STAGE
    )
    background = behind > 0
    groups = clusters[chosen][around.samples[:, :_NEAREST]].astype(np.int32)
    nearest = around.carriers(groups)
    confidence = np.zeros(len(gaussians), np.float32)
    confidence[rows] = agreement_of(groups, clusters[chosen][nearest].astype(np.int32))
    yield Progress(STAGE, _STEPS - 2, _STEPS, "small things")
    parts = np.where(background, -1, clusters[-1])
    shown = surfels.n_views / len(views)
    smaller = smaller_levels(
        surfels, near, parts, colors[1], shown, config.smaller, config.least_piece
    )
    alike = carriers_by_color(around.distance, around.samples, nearest, parts, colors, near.spacing)
    yield Progress(STAGE, _STEPS - 1, _STEPS, "label Gaussians")
    every = np.arange(len(surfels.points))
    nearest, alike = np.append(nearest, every), np.append(alike, every)
    nested = np.empty((len(clusters) + len(smaller), len(nearest)), np.int64)
    for level, of_samples in enumerate(clusters):
        nested[level] = of_samples[nearest]
    for level, of_samples in enumerate(smaller, start=len(clusters)):
        inside = np.where(background, of_samples.max() + behind, of_samples)
        nested[level] = inside[alike]
    found = Levels.of(nested, chosen, background[nearest].astype(np.int64))
    if config.detail is not None:
        found = found.choose(config.detail)
    labels = np.zeros((len(nested), len(gaussians)), np.int32)
    labels[:, rows] = found.labels[:, : len(rows)]
    return FoundObjects(
        levels=replace(found, labels=labels),
        confidence=confidence,
        regions=surfels.regions,
        groups=found.labels[found.chosen, len(rows) :],
    )


@dataclass(frozen=True, eq=False)
class _Around:
    """The samples around each Gaussian."""

    rows: LongArray  # (K,) Gaussians that are finite
    distance: DoubleArray  # (K, 6) ascending, scene units
    samples: IntArray  # (K, 6)

    @staticmethod
    def of(gaussians: Gaussians, points: DoubleArray) -> "_Around":
        rows = np.flatnonzero(finite(gaussians))
        means = gaussians.means[rows].astype(np.float64)
        found = cKDTree(points).query(means, k=_NEAREST_SMALL, workers=n_threads())
        return _Around(rows, np.asarray(found[0]), np.asarray(found[1], np.int32))

    def carriers(self, groups: IntArray) -> LongArray:
        """The sample (K,) that stands for each Gaussian, where those around are in ``groups``
        (K, 3).

        The nearest one does, unless the next two agree on another cluster and are about as near.
        """
        outvoted = (groups[:, 1] == groups[:, 2]) & (groups[:, 1] != groups[:, 0])
        outvoted &= self.distance[:, 2] < _BOTH_NEAR * self.distance[:, 0]
        chosen = np.where(outvoted, self.samples[:, 1], self.samples[:, 0])
        return chosen.astype(np.int64)


def _nested_clusters(
    surfels: Surfels,
    near: Neighbourhood,
    views: Sequence[Camera],
    n_splats: LongArray,
    color: DoubleArray,
    config: HierarchyConfig,
) -> Stage[tuple[LongArray, LongArray]]:
    """Clusters (L, S) of samples, coarse to fine, and what is background (S,): 0 = not, 1 = rest,
    each thing in it another number.

    ``n_splats`` (S,) is how many Gaussians are next to each sample, ``color`` (S, 3) as of
    `colors_of_samples`.
    """
    yield Progress(STAGE, 0, 4, "small pieces")
    piece = small_pieces(surfels, near)
    agreement = Agreement.of(surfels, near, piece)
    yield Progress(STAGE, 1, 4, "planes")
    plane = planes_of(surfels, near)
    yield Progress(STAGE, 2, 4, "parts")
    fine = joined(fine_graph(surfels, near, piece, agreement), config.pieces)[piece]
    noise = noise_of(surfels, near, plane, fine)
    judge = Judge(surfels, near, plane, piece, surfels.n_views / len(views), noise)
    parts = judge.parts(fine, config.finer, config.least_part, config.least_object)
    yield Progress(STAGE, 3, 4, "objects")
    now = keep_enclosed(surfels, near, judge.again(parts[-1]), config.least_object)
    now = now.joined(config.objects).joined(-np.inf, config.least_object)
    fine_to_coarse = [level.cluster for level in parts]
    two = divided(surfels, near, now.cluster, fine_to_coarse, judge.shown, config.least_object)
    if two.max() > now.cluster.max():
        now = keep_enclosed(surfels, near, judge.judged(two), config.least_object)
        fine_to_coarse = [_overlaid(level, two) for level in fine_to_coarse]
    now = now.merged(held_together(near, plane, now.cluster, judge.shown))
    now = now.merged(spanned(surfels, near, plane, color, now.cluster))
    splats = np.bincount(now.cluster, n_splats)
    crumbs = (now.graph.size < config.least_object) | (splats < config.least_splats)
    outside = crumbs
    if config.background:
        outside = crumbs | is_outside(surfels, near, views, now, config.least_object)
    background = outside[now.cluster]
    behind = np.where(outside, 1 + np.cumsum(outside & ~crumbs) * ~crumbs, 0)[now.cluster]
    now = now.set_apart(outside)
    fine_to_coarse.append(now.cluster)
    for evidence in config.coarser:
        now = now.joined(evidence)
        fine_to_coarse.append(now.cluster)
    levels = np.stack(fine_to_coarse[::-1])
    return np.where(background, levels.max() + 1, levels), behind


def _overlaid(one: LongArray, other: LongArray) -> LongArray:
    """Dense ids (S,) of the samples that two clusterings (S,) have in common."""
    key = one * (int(other.max()) + 1) + other
    result: LongArray = np.unique(key, return_inverse=True)[1].astype(np.int64)
    return result
