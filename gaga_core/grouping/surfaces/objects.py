"""Objects of regions: pieces of surface join, best evidence first, to levels of objects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, vstack
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import lab_from_rgb, rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import along, axes_of_points
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.robust.surface_graph import finite
from gaga_core.grouping.robust.surface_points import DepthMaps, LoadMasks
from gaga_core.grouping.surfaces.borders import (
    Agreement,
    Clusters,
    Judge,
    coarser_of,
    fine_graph,
    is_outside,
    joined,
    keep_enclosed,
    noise_of,
    shown_whole,
)
from gaga_core.grouping.surfaces.surfels import (
    LoadFurther,
    Neighbourhood,
    Surfels,
    dense,
    outlines,
    planes_of,
    sample_surfels,
    small_pieces,
)
from gaga_core.progress import Progress, Stage, part
from gaga_core.threads import n_threads

# --- Clusters that are two objects: an orange and the half of a drill that it touches.
# Evidence is a mean over a border, and the small pieces of two objects that touch may straddle it,
# so that each later join looks right. The object that comes out does not: views show a part of it
# and the rest as one region each, and both together as none, and the two meet in a narrow neck. A
# neck is asked for because regions part stripes of paint as well, which meet along their whole
# length.


_WHOLE_IOU = 0.62  # mean IoU of both sides with the best region of each view ...
_BETTER_IOU = 0.05  # ... by which they are better than together
_NECK = 2.0  # outlines of the smaller side along which both touch, at most


def divided(
    surfels: Surfels,
    near: Neighbourhood,
    cluster: LongArray,
    parts: list[LongArray],
    shown: DoubleArray,
    least_size: float,
) -> LongArray:
    """Dense ids (S,) of the clusters (S,) after those that are two objects have been divided, each
    once.

    ``parts`` are levels (S,) that refine the clusters, fine to coarse, ``shown`` (S,) is how much
    each sample counts for the size of an object, which is ``least_size`` at least.
    """
    leaf, levels, n = parts[0], [cluster, *parts], int(cluster.max()) + 1
    members = vstack([_members(level, leaf) for level in levels], format="csr")
    inside = np.concatenate([coarser_of(level, cluster) for level in levels])
    whole = shown_whole(surfels, leaf, members)  # of the clusters, then of all parts
    count, size = members @ np.bincount(leaf), members @ np.bincount(leaf, shown)
    outline = outlines(np.minimum(count, count[inside] - count))
    neck = np.concatenate([_necks(near, cluster, level) for level in levels])
    asked = (whole > _WHOLE_IOU) & (whole > whole[inside] + _BETTER_IOU) & (neck < _NECK * outline)
    found = np.flatnonzero(asked & (np.minimum(size, size[inside] - size) >= least_size))
    if len(found) == 0:
        return cluster
    rests = members[inside[found]] - members[found]
    rests.eliminate_zeros()
    least = np.minimum(whole[found], shown_whole(surfels, leaf, rests))
    better = least - whole[inside[found]]
    side = cluster.copy()
    for k in np.argsort(better, kind="stable"):  # the best of each cluster last
        if least[k] > _WHOLE_IOU and better[k] > _BETTER_IOU:
            own = inside[found[k]]
            side[cluster == own] = own
            side[np.isin(leaf, members[found[k]].indices)] = n + own
    return dense(side)


def _members(level: LongArray, leaf: LongArray) -> csr_matrix:
    """Which leaves (n, m) each cluster of a level (S,) consists of."""
    of_leaf = coarser_of(leaf, level)
    return csr_matrix((np.ones(len(of_leaf)), (of_leaf, np.arange(len(of_leaf)))))


def _necks(near: Neighbourhood, cluster: LongArray, part: LongArray) -> LongArray:
    """Edges (n,) from each part (S,) to others in its cluster (S,)."""
    a, b = near.first, near.second
    across = (part[a] != part[b]) & (cluster[a] == cluster[b])
    ends = np.concatenate([part[a[across]], part[b[across]]])
    return np.bincount(ends, minlength=int(part.max()) + 1).astype(np.int64)


# --- Objects whose parts only hold each other: leaves, blossoms, the back of a chair.
# What lies or stands on a plane touches it all around its foot. A part that does not, and that
# only touches others of the kind, cannot be an object alone where all of them together are held
# by a border that is short for their size. Fruit in a bowl or a box on a box have longer borders.
# A part that hardly a view shows may well stand on something: it holds together with others of
# that kind only, as the pot of a plant does, but not with the leaves over it.


_SUPPORT_AREA = 0.01  # share of the area of all samples of a plane to stand on
_IN_PLANE = 0.3  # share of its samples that makes a cluster a part of such a plane
_FOOT = 0.25  # share of its outline that an object has in common at least with what it stands on
_HELD = 1.5  # ... that parts have in common with what holds them, below which they are one object
_SEEN = 0.12  # share of the views that show a sample, mean: less says nothing of the foot
_HANGING_SHARE_MAX = (
    0.05  # share of all samples: larger ones are the ground or the subject, not a hanging part
)


def held_together(
    near: Neighbourhood, plane: IntArray, cluster: LongArray, shown: DoubleArray
) -> LongArray:
    """Dense ids (n,) of the clusters (S,) after parts that hold each other up have joined.

    ``plane`` (S,) is the plane that each sample lies on, 0 = none; ``shown`` (S,) the share of the
    views that see it.
    """
    n = int(cluster.max()) + 1
    apart = cluster[near.first] != cluster[near.second]
    a, b = near.first[apart], near.second[apart]
    one, other = cluster[a], cluster[b]
    stands = _standing(near, plane, cluster, a, b)
    rare = np.bincount(cluster, shown) < _SEEN * np.bincount(cluster)
    links = ~stands[one] & ~stands[other] & (rare[one] == rare[other])
    ones = np.ones(int(links.sum()), np.int8)
    graph = coo_matrix((ones, (one[links], other[links])), shape=(n, n))
    part = connected_components(graph, directed=False)[1].astype(np.int64)
    outer = part[one] != part[other]
    size = np.bincount(part[cluster], minlength=n)
    held = np.bincount(part[np.concatenate([one[outer], other[outer]])], minlength=n)
    joins = (held > 0) & (held < _HELD * outlines(size))
    joins &= size < _HANGING_SHARE_MAX * len(cluster)
    ids = np.where(joins[part], part, n + np.arange(n))
    return dense(ids)


def _standing(
    near: Neighbourhood, plane: IntArray, cluster: LongArray, a: LongArray, b: LongArray
) -> BoolArray:
    """Which clusters (n,) are a part of a large plane, or touch one at edges (B,) along a foot."""
    n = int(cluster.max()) + 1
    area = np.bincount(plane, near.spacing**2)
    large = area > _SUPPORT_AREA * area.sum()
    large[0] = False
    foot = np.zeros(n)
    for thing, below in ((a, b), (b, a)):
        on = large[plane[below]] & (plane[thing] != plane[below])
        foot += np.bincount(cluster[thing[on]], minlength=n)
    size = np.bincount(cluster, minlength=n)
    flat = np.bincount(cluster, large[plane], n) > _IN_PLANE * size
    return flat | (foot >= _FOOT * outlines(size))


# --- Levels below the smallest parts: objects of few samples, distinguished by color, too.
# A book in a row or a toy block shows some twenty samples. Its small pieces straddle its outline,
# and what borders of parts ask (a crease, a region in most views) is lost in so few. Here pieces
# end where the color changes, and color is a witness of their borders as well. At the levels of
# objects it is none, because print and shadows have colors of their own; these levels only offer
# pieces to choose from, inside of parts that are found without color.


_AROUND = 4  # splats whose median is the color of a sample
_OPAQUE = 0.3  # opacity of such splats
_OF_LAB = 1024  # steps of a unit of CIE Lab: last bits of powers differ between processors
_LIGHTNESS = 0.4  # weight of lightness against hue: faces of one object are lit differently
_AGAINST = 0.05  # log odds against one object for a unit of CIE Lab between two pieces
_LAB_PER_SPACING = 10.0  # difference in CIE Lab that counts as much as the spacing of the samples
_CHUNK = 1 << 16


def hue_of(rgb: FloatArray) -> DoubleArray:
    """Colors (K, 3) of sRGB (K, 3) to compare: CIE Lab, lightness weighted down."""
    lab = lab_from_rgb(rgb)
    lab[:, 0] *= _LIGHTNESS
    return np.round(lab * _OF_LAB) / _OF_LAB


def colors_of_samples(
    gaussians: Gaussians, rows: LongArray, rgb: FloatArray, points: DoubleArray
) -> DoubleArray:
    """Color (S, 3), as of `hue_of`, of points (S, 3) by the splats around them, of ``rows`` (K,)
    with sRGB (K, 3); K > 0."""
    opaque = np.flatnonzero(gaussians.opacities[rows] > _OPAQUE)
    opaque = opaque if len(opaque) >= _AROUND else np.arange(len(rows))
    ranks = list(range(1, min(_AROUND, len(opaque)) + 1))
    tree = cKDTree(gaussians.means[rows[opaque]].astype(np.float64))
    nearest = opaque[np.asarray(tree.query(points, k=ranks, workers=n_threads())[1])]
    around = np.stack([hue_of(rgb[rank]) for rank in nearest.T])
    return np.median(around, axis=0)


def smaller_levels(
    surfels: Surfels,
    near: Neighbourhood,
    part: LongArray,
    color: DoubleArray,
    shown: DoubleArray,
    least_evidence: tuple[float, ...],
    least_size: float,
) -> LongArray:
    """Clusters (L, S) of samples that refine the parts (S,), coarse to fine, one a number of
    ``least_evidence``, which ascends; a part of id -1 stays whole.

    ``color`` (S, 3) is that of each sample, ``shown`` (S,) how much it counts for the size of a
    cluster, which is ``least_size`` at least where the part has as much.
    """
    if not least_evidence:
        return np.zeros((0, len(part)), np.int64)
    piece = small_pieces(surfels, near, color)
    piece = np.where(part < 0, 0, 1 + piece * (int(part.max()) + 1) + part)
    piece = dense(piece)
    graph = fine_graph(surfels, near, piece, Agreement.of(surfels, near, piece))
    part_of = coarser_of(piece, part)
    count = np.bincount(piece)
    mean = np.stack([np.bincount(piece, column) / count for column in color.T], axis=1)
    unlike = np.linalg.norm(mean[graph.first] - mean[graph.second], axis=1)
    size = np.bincount(piece, shown).astype(np.float64)
    graph = replace(graph, size=size, evidence=graph.evidence - _AGAINST * unlike)
    now = Clusters(piece, graph.only(part_of[graph.first] == part_of[graph.second]))
    levels = now.levels(least_evidence[::-1], least_size)
    return np.stack([level.cluster for level in levels[::-1]])


def carriers_by_color(
    distance: DoubleArray,
    samples: IntArray,
    carriers: LongArray,
    part: LongArray,
    colors: tuple[FloatArray, DoubleArray],
    spacing: DoubleArray,
) -> LongArray:
    """The sample (K,) that stands for each splat at the smaller levels, of the nearest ``samples``
    (K, k) at ``distance`` (K, k), which hold its ``carriers`` (K,) at the other levels.

    It is near and alike in color, and in the ``part`` (S,) of that carrier. ``colors`` are sRGB
    (K, 3) of the splats and `colors_of_samples` (S, 3), ``spacing`` (S,) is that of the samples.
    """
    rgb, of_sample = colors
    chosen = np.empty_like(carriers)
    for start in range(0, len(carriers), _CHUNK):
        rows = slice(start, start + _CHUNK)
        near = samples[rows]
        unlike = np.linalg.norm(of_sample[near] - hue_of(rgb[rows])[:, None], axis=2)
        cost = distance[rows] / spacing[near] + unlike / _LAB_PER_SPACING
        cost[part[near] != part[carriers[rows]][:, None]] = np.inf
        chosen[rows] = near[np.arange(len(near)), cost.argmin(axis=1)]
    return chosen


# --- Surfaces that an object lies across: a table top under its runner, a floor under a carpet.
# Both sides of the runner never touch, so no border says that they are one. They join where they
# lie on one plane and have one color, and where what fills the whole gap between them is one object
# that lies on that plane and is smaller than they are together. Open air joins nothing, and
# neither do two plates on a table: the table is lower than they are, and larger.


_SIDE_SHARE_MIN = 0.002  # share of all samples that either side has on the plane
_ONE_SURFACE_LAB = 5.0  # difference in CIE Lab (`hue_of`) from which on they are two surfaces
_WIDTH = 1.2  # times the least gap: how far apart opposite samples are at most
_ALONG = (0.25, 0.5, 0.75)  # of the way between them that are looked at
_COVERED = 0.8  # share of the ways that the object covers
_HEIGHT = 0.1  # spacings that it lies above the plane, mean: less is the plane itself


def spanned(
    surfels: Surfels, near: Neighbourhood, plane: IntArray, color: DoubleArray, cluster: LongArray
) -> LongArray:
    """Dense ids (n,) of the clusters (S,) after surfaces that an object lies across have joined.

    ``plane`` (S,) is the plane that each sample lies on, 0 = none; ``color`` (S, 3) CIE Lab as of
    `hue_of`.
    """
    n, pairs = int(cluster.max()) + 1, []
    for p in range(1, int(plane.max(initial=0)) + 1):
        rows = np.flatnonzero(plane == p)
        own = cluster[rows]
        large = np.flatnonzero(np.bincount(own) >= _SIDE_SHARE_MIN * len(cluster))
        for one, other in combinations([rows[own == k] for k in large], 2):
            unlike = np.median(color[one], axis=0) - np.median(color[other], axis=0)
            if np.linalg.norm(unlike) > _ONE_SURFACE_LAB:
                continue
            if _is_spanned(surfels, near, plane, cluster, one, other):
                pairs.append((cluster[one[0]], cluster[other[0]]))
    first, second = np.array(pairs, np.int64).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(pairs)), (first, second)), (n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _is_spanned(
    surfels: Surfels,
    near: Neighbourhood,
    plane: IntArray,
    cluster: LongArray,
    one: LongArray,
    other: LongArray,
) -> bool:
    """Whether one smaller cluster fills the gap between samples (A,) and (B,) of one plane (S,),
    and lies on it."""
    points, both = surfels.points, np.concatenate([one, other])
    spacing = float(np.median(near.spacing[both]))
    found = cKDTree(points[other]).query(points[one])
    apart, opposite = np.asarray(found[0]), np.asarray(found[1], np.int64)
    facing = np.flatnonzero(apart <= _WIDTH * apart.min())
    start, way = points[one[facing]], points[other[opposite[facing]]] - points[one[facing]]
    places = np.concatenate([start + share * way for share in _ALONG])
    between = np.asarray(cKDTree(points).query(places)[1], np.int64)
    thing = int(np.bincount(cluster[between]).argmax())
    covers = (cluster[between] == thing) & (plane[between] == plane[one[0]])
    middle = points[both].mean(axis=0)
    normal = axes_of_points(points[both])[:, 0]
    seen = (normal * surfels.normals[both].sum(axis=0)).sum() > 0
    height = along(points[between[covers]] - middle, normal if seen else -normal)
    if covers.mean() < _COVERED or height.mean() < _HEIGHT * spacing:
        return False
    return int(((cluster == thing) & (plane == plane[one[0]])).sum()) < len(both)


# --- All levels, from the finest pieces to what surrounds the scene.


STAGE = "Find objects"
_STEPS = 5
LEAST_SURFELS = 32  # fewer show no surface
_NEAREST = 3  # samples that a Gaussian takes its groups from ...
_NEAREST_SMALL = 6  # ... and its pieces smaller than parts
_BOTH_NEAR = 2.0  # times the distance of the nearest sample at which two others may outvote it


@dataclass(frozen=True)
class HierarchyConfig:
    """Settings. Evidence is in log odds that two neighbouring pieces are one object."""

    surfels: int = 60_000  # most samples of the surfaces; time grows with them
    pieces: float = 2.3  # evidence at which small pieces join to those that are judged in full
    smaller: tuple[float, ...] = (1.5, 3.0)  # levels in parts, by color as well, ascending
    finer: tuple[float, ...] = (3.0, 2.0, 1.2)  # levels of parts, descending
    objects: float = 0.6  # the level of whole objects
    coarser: tuple[float, ...] = (0.0, -1.0, -2.0)  # levels of objects together, descending
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
        raise GagaError("The views show almost none of the splats. Check poses and model.")
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
    confidence[rows] = (groups == clusters[chosen][nearest][:, None]).mean(axis=1)
    yield Progress(STAGE, _STEPS - 2, _STEPS, "small objects")
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
    each object in it another number.

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
        fine_to_coarse = [dense(level * (int(two.max()) + 1) + two) for level in fine_to_coarse]
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
    fine_to_coarse += [level.cluster for level in (now, *now.levels(config.coarser))]
    levels = np.stack(fine_to_coarse[::-1])
    return np.where(background, levels.max() + 1, levels), behind
