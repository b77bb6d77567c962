"""Objects of regions: pieces of surface join to a tree, and the best cut through it is the objects.

No threshold for a whole scene divides a toy plane and a plate. So each node of the tree of joins
gets its objectness, the IoU that it is expected to have with a true object, from what views and
surfaces show of it: how well regions fit it at each level of detail, how it is bounded, its shape,
and how it compares to its parts and to what it is a part of. An ensemble of trees was learned for
that from scenes with truth (`tools.learn_objects`). Objects are the disjoint nodes with the
greatest sum of what they are worth, found by dynamic programming. A price for each object gives the
other levels of detail, which refine one another (cost-complexity pruning: Breiman et al.,
Classification and Regression Trees, 1984). What is no object is background.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.color import lab_from_rgb, rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import principal_axes
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.robust.surface_graph import finite
from gaga_core.grouping.robust.surface_points import DepthMaps, LoadMasks
from gaga_core.grouping.surfaces.boosted_trees import BoostedTrees, learned
from gaga_core.grouping.surfaces.borders import (
    GRID,
    Borders,
    Moments,
    Seen,
    SignedGraph,
    borders_of,
    joined,
    linked,
)
from gaga_core.grouping.surfaces.surfels import (
    N_LEVELS,
    LoadFurther,
    Neighbourhood,
    dense,
    outlines,
    sample_surfels,
    small_pieces,
    support_of,
)
from gaga_core.progress import Progress, Stage, part
from gaga_core.threads import n_threads

# --- The tree of joins.


# Least log odds of joins, round by round: set before anything was learned, and not tuned.
ROUNDS = (4.0, 2.5, 1.0, 0.0, -1.5, -np.inf)
_FINEST = 8.0  # log odds of joins of pieces in the level below the leaves: most inside of a plane
_CRUMB = 1.0  # samples that a view shows of the smallest leaf, mean
_APART = 0.8  # difference of shares that what the rest stands on has in two nodes
_PARTED = 1e6  # log odds against a join with what the rest stands on
_CERTAIN = 8.0  # log odds that stand for a leaf's own, and against a join of roots


@dataclass(frozen=True, eq=False)
class Tree:
    """Nodes 0..L-1 are leaves, each later one joins two earlier ones."""

    pieces: SignedGraph  # what the leaves were joined from
    leaf: LongArray  # (S,) of each sample
    finest: LongArray  # (S,) pieces inside of leaves: the finest level
    parent: LongArray  # (n,) -1 = none
    evidence: DoubleArray  # (n,) at which both parts of a node joined
    length: DoubleArray  # (n,) of the border along which they did
    borders: Borders  # of the leaves
    judged: DoubleArray  # (B,) evidence about them, log odds

    @property
    def n_leaves(self) -> int:
        """L."""
        return int(self.leaf.max()) + 1

    def leaves(self) -> csr_matrix:
        """Which leaves (n, L) each node consists of."""
        node = leaf = np.arange(self.n_leaves)
        rows, columns = list[LongArray](), list[LongArray]()
        while len(node):
            rows.append(node)
            columns.append(leaf)
            up = self.parent[node]
            node, leaf = up[up >= 0], leaf[up >= 0]
        row, column = np.concatenate(rows), np.concatenate(columns)
        return csr_matrix((np.ones(len(row)), (row, column)), (len(self.parent), self.n_leaves))

    def children(self) -> LongArray:
        """Both parts (n, 2) of each node, -1 of leaves."""
        order = np.argsort(self.parent, kind="stable")
        found = np.full((len(self.parent), 2), -1, np.int64)
        found[self.n_leaves :] = order[self.parent[order] >= 0].reshape(-1, 2)
        return found

    def first_common(self, a: LongArray, b: LongArray) -> LongArray:
        """The first node (B,) that both nodes (B,) are parts of, n = none."""
        n = len(self.parent)
        up = np.append(np.where(self.parent < 0, n, self.parent), n)
        while (apart := a != b).any():  # of two nodes the lower one has not been joined later
            a, b = np.where(apart & (a < b), up[a], a), np.where(apart & (b < a), up[b], b)
        return a


def join_crumbs(graph: SignedGraph, least_evidence: float) -> LongArray:
    """Clusters (n,) after all joins of at least this evidence, and of what is left too small."""
    cluster = joined(graph, least_evidence)
    return joined(graph.contracted(cluster), -np.inf, _CRUMB)[cluster]


def grown(
    seen: Seen,
    least: float = ROUNDS[0],  # log odds at which pieces join to leaves
    pieces: BoostedTrees | None = None,
    borders: BoostedTrees | None = None,
    support: BoolArray | None = None,  # (S,) what the rest stands on: it joins that last
) -> Tree:
    """Join pieces round by round, borders judged again before each; by what is `learned`, unless
    other ensembles are given."""
    pieces, borders = pieces or learned().pieces, borders or learned().borders

    def parted(graph: SignedGraph, cluster: LongArray) -> SignedGraph:
        if support is None or not support.any():
            return graph
        share = np.bincount(cluster, support) / np.bincount(cluster)
        across = np.abs(share[graph.first] - share[graph.second]) > _APART
        return replace(graph, evidence=np.where(across, -_PARTED, graph.evidence))

    fine = parted(borders_of(seen, seen.piece).judged(pieces), seen.piece)
    finest = joined(fine, _FINEST)[seen.piece]
    leaf = cluster = join_crumbs(fine, least)[seen.piece]
    node = np.arange(int(leaf.max()) + 1)  # of each cluster
    parent, evidence, length = [-1] * len(node), [_CERTAIN] * len(node), [0.0] * len(node)
    leaves = borders_of(seen, leaf)
    of_leaves = graph = leaves.judged(borders)
    for k, of_round in enumerate(ROUNDS[1:]):
        if k > 0:
            graph = borders_of(seen, cluster).judged(borders)
        graph = parted(graph, cluster)
        into = np.arange(len(node))
        for a, b, value, edges in linked(graph, of_round):
            parent[node[a]] = parent[node[b]] = len(parent)
            node[a], into[b] = len(parent), a
            parent.append(-1)
            evidence.append(value)
            length.append(edges)
        while (into[into] != into).any():
            into = into[into]
        node, cluster = node[np.unique(into)], dense(into)[cluster]
    numbers = np.array(evidence), np.array(length)
    return Tree(
        fine, leaf, finest, np.array(parent, np.int64), *numbers, leaves, of_leaves.evidence
    )


# --- What nodes of the tree look like.


_MARGIN = 0.03  # of the longer side of a view: its border
_AT_BORDER = 0.03  # share of the samples in a view at its border that make a node cut
_SHOWN = 3  # samples of a node that a view must show
_FITS = 0.7  # IoU with a region from which on a view shows a node as one
_PARALLEL = 1e-12  # of the largest eigenvalue: axes of cameras that meet nowhere


def node_features(
    seen: Seen, tree: Tree, views: Sequence[Camera], n_splats: LongArray
) -> DoubleArray:
    """Features (n, F) of the nodes; ``n_splats`` (S,) is how many Gaussians are next to each
    sample."""
    n, leaves = len(tree.parent), tree.leaves()
    moments = Moments.of(seen, tree.leaf).of_sets(leaves)
    count, shown = moments.count, moments.shown
    fit, good, seen_by, cut = _in_views(seen, tree.leaf, leaves, views)
    bounds, outline = _outer_borders(tree)
    has_whole, child = tree.parent >= 0, tree.children()
    whole = np.where(has_whole, tree.parent, 0)

    def of_whole(values: DoubleArray) -> DoubleArray:
        """Values (n,) that depend on what a node is a part of, 0 where it is a part of nothing."""
        return np.where(has_whole, values, 0)

    other = child[whole].sum(axis=1) - np.arange(n)
    other = np.where(has_whole, other, 0)
    parts = np.where(child >= 0, fit[child, 0], 0)
    smaller = np.where(child[:, 0] >= 0, count[child].min(axis=1) / count, 0)
    above, below = np.zeros(n), np.zeros(n)
    for k in range(n):
        if has_whole[k]:
            below[whole[k]] = max(below[whole[k]], below[k], fit[k, 0])
    for k in range(n - 1, -1, -1):
        if has_whole[k]:
            above[k] = max(above[whole[k]], fit[whole[k], 0])
    deviation, basis = moments.axes()
    normal, color = basis[:, :, 0], moments.colors / count[:, None]
    over = ((moments.centre - moments.centre[other]) * normal[other]).sum(axis=1)
    over = np.where((normal[other] * moments.normals[other]).sum(axis=1) < 0, -over, over)
    flat = deviation[:, 0] / np.maximum(deviation[:, 1], 1e-6)
    focus, radius, missed, in_front = _focus(views)
    away = np.linalg.norm(seen.in_scene(moments.centre) - focus, axis=1) / radius
    logs = np.log(deviation + 0.05)
    features = {
        "samples that a view shows": np.log(shown + 0.1),
        "samples": np.log(count),
        "share of the largest": np.log(count / count.max()),
        "fit": fit[:, 0],
        **{f"fit at level {k}": fit[:, 1 + k] for k in range(N_LEVELS)},
        "views that fit": good,
        "views that show it": seen_by,
        "views that cut it": cut,
        **dict(zip(_BOUNDS, bounds.T, strict=True)),
        "evidence inside": tree.evidence,
        "evidence of the join": np.where(has_whole, tree.evidence[whole], -_CERTAIN),
        "outline that joins": of_whole(
            np.minimum(tree.length[whole] / np.maximum(outline, 1), 1.5)
        ),
        "size of the other part": of_whole(np.log((shown[other] + 0.1) / (shown + 0.1))),
        "fit of the whole": of_whole(fit[whole, 0]) - fit[:, 0],
        "fit of the other part": of_whole(fit[other, 0]) - fit[:, 0],
        "fit of the better part": parts.max(axis=1) - fit[:, 0],
        "fit of the worse part": parts.min(axis=1) - fit[:, 0],
        "size of the smaller part": smaller,
        "best fit of what it is in": above - fit[:, 0],
        "best fit of what is in it": below - fit[:, 0],
        "open": np.linalg.norm(moments.normals, axis=1) / count,
        "flat": logs[:, 0] - logs[:, 1],
        "long": logs[:, 1] - logs[:, 2],
        "thick": logs[:, 0],
        "contact": np.minimum(outline / outlines(count), 5),
        "color inside": np.sqrt(np.maximum(moments.squares / count - (color**2).sum(axis=1), 0)),
        "color of the other part": of_whole(np.linalg.norm(color - color[other], axis=1)),
        "height over the other part": of_whole(np.clip(over / np.sqrt(count), -9, 9)),
        "flatness of the other part": of_whole(np.minimum(flat[other], 2)),
        "way to the focus": np.minimum(away, 5),
        "extent": np.minimum(deviation[:, 2] * seen.spacing / radius, 3),
        "cameras that miss the focus": np.full(n, min(missed, 1.0)),
        "focus in front": np.full(n, in_front),
        "splats": np.log((leaves @ np.bincount(tree.leaf, n_splats) + 1) / count),
        "views": np.full(n, np.log(seen.n_views)),
        "roughness of the scene": np.full(n, tree.borders.roughness),
        "leaves": np.log(np.diff(leaves.indptr)),
    }
    return np.round(np.stack(list(features.values()), axis=1) * GRID) / GRID


def _in_views(
    seen: Seen, leaf: LongArray, leaves: csr_matrix, views: Sequence[Camera]
) -> tuple[DoubleArray, DoubleArray, DoubleArray, DoubleArray]:
    """How views show nodes: the mean IoU (n, 1 + 4) with the region that fits best, of all levels
    and of each, where views count by the samples that they show; the share (n,) of views that fit;
    the share (n,) that show it, and of those the share (n,) that cut it."""
    n, n_leaves = leaves.shape
    fit, weight = np.zeros((n, 1 + N_LEVELS)), np.zeros(n)
    good, shows, cuts = np.zeros(n), np.zeros(n), np.zeros(n)
    for v, camera in enumerate(views):
        best, now = np.zeros((n, 1 + N_LEVELS)), np.zeros(n)
        for level, region in seen.surfels.maps_of(v):
            rows = np.flatnonzero(region)
            area = np.bincount(region)
            table = coo_matrix(
                (np.ones(len(rows)), (leaf[rows], region[rows])), (n_leaves, len(area))
            )
            common = (leaves @ table.tocsr()).tocsr()
            count = np.asarray(common.sum(axis=1)).ravel()
            node = np.repeat(np.arange(n), np.diff(common.indptr))
            iou = common.data / (count[node] + area[common.indices] - common.data)
            found = np.zeros(n)
            np.maximum.at(found, node, iou)
            best[:, 0] = np.maximum(best[:, 0], found)
            best[:, slice(1, None) if level is None else 1 + level] = (
                found[:, None] if level is None else found
            )
            now = np.maximum(now, count)
        fit += best * now[:, None]
        good += (best[:, 0] > _FITS) * now
        weight += now
        rows = np.flatnonzero(seen.surfels.regions[:, v])
        pixels = camera.project(seen.surfels.points[rows])[0]
        size = np.array([camera.width, camera.height])
        margin = _MARGIN * float(size.max())
        outer = rows[((pixels < margin) | (pixels > size - margin)).any(axis=1)]
        held = leaves @ np.bincount(leaf[rows], minlength=n_leaves)
        at_border = leaves @ np.bincount(leaf[outer], minlength=n_leaves)
        shows += held >= _SHOWN
        cuts += (held >= _SHOWN) & (at_border >= np.maximum(1, _AT_BORDER * held))
    weight = np.maximum(weight, 1)
    return fit / weight[:, None], good / weight, shows / seen.n_views, cuts / np.maximum(shows, 1)


_BOUNDS = ("crease", "bulge", "step", "sharp", "evidence", "color across", "views across")


def _outer_borders(tree: Tree) -> tuple[DoubleArray, DoubleArray]:
    """Means (n, 7) of `_BOUNDS` over the outer borders of nodes, 0 where there are none; and their
    lengths (n,)."""
    n, borders = len(tree.parent), tree.borders
    one, views = np.ones(len(borders.length)), [f"views, level {k}" for k in range(N_LEVELS)]
    across = borders.column("color across"), sum(map(borders.column, views)) / N_LEVELS
    values = [one, *map(borders.column, _BOUNDS[:4]), tree.judged, *across]
    sums = np.stack(values, axis=1) * borders.length[:, None]
    total = np.zeros((n + 1, sums.shape[1]))
    np.add.at(total, borders.first, sums)
    np.add.at(total, borders.second, sums)
    # Counted from both sides, what is inside a node counts as nothing.
    np.add.at(total, tree.first_common(borders.first, borders.second), -2 * sums)
    for k, up in enumerate(tree.parent):
        if up >= 0:
            total[up] += total[k]
    outline = np.maximum(total[:n, 0], 0)
    some = outline > 0.5
    return np.where(some[:, None], total[:n, 1:] / np.maximum(outline, 0.5)[:, None], 0), outline


def _focus(views: Sequence[Camera]) -> tuple[DoubleArray, float, float, float]:
    """The point (3,) that the views look at from around, their median distance from it, and the
    medians of the sine by which their axes miss it and of the cosine by which it is in front."""
    positions = np.array([camera.position for camera in views])
    axes = np.array([camera.forward for camera in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    values, basis = (found[0] for found in principal_axes(across.sum(axis=0)[None]))
    parts = (basis * np.einsum("vij,vj->i", across, positions)[:, None]).sum(axis=0)
    known = values > _PARALLEL * values[2]
    focus = (basis[:, known] * (parts[known] / values[known])).sum(axis=1)
    way = focus - positions
    distance = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    radius = float(np.median(distance))
    missed = float(np.median(np.linalg.norm(np.cross(axes, way), axis=1) / distance))
    return focus, radius, missed, float(np.median((way * axes).sum(axis=1))) / radius


# --- The best cut.


_POWER = 3.0  # of the objectness in what a node is worth: on validation scenes 2 and 4 lose a point
OBJECT = 0.22  # objectness of the least object: chosen there; 0.15 costs 7 points of precision
# Price of an object, coarse to fine: even steps of detail by eye; the last one parts all leaves.
PRICES = (0.45, 0.25, 0.12, 0.0, -0.06, -0.15, -0.4, -2.0)
CHOSEN = 3  # of them: no price


def best_cut(tree: Tree, worth: DoubleArray) -> LongArray:
    """The nodes (K,), ascending, that together hold all leaves with the greatest sum of ``worth``
    (n,)."""
    n, n_leaves = len(tree.parent), tree.n_leaves
    parent, worths = tree.parent.tolist(), worth.tolist()
    below, is_best = [0.0] * n, [False] * n
    for k, (up, own) in enumerate(zip(parent, worths, strict=True)):
        is_best[k] = k < n_leaves or own >= below[k]
        if up >= 0:
            below[up] += own if is_best[k] else below[k]
    is_open = [True] * n
    for k in range(n - 1, -1, -1):
        up = parent[k]
        is_open[k] = up < 0 or (is_open[up] and not is_best[up])
    return np.flatnonzero(np.array(is_open) & is_best)


def cuts(
    tree: Tree, objectness: DoubleArray, is_rest: BoolArray, least: float = OBJECT
) -> tuple[LongArray, BoolArray, DoubleArray]:
    """Clusters (L, S) of the samples at all levels, coarse to fine, and of level `CHOSEN` which
    samples (S,) are background and the objectness (S,) of what they are in.

    Background is what is worth less than ``least``, and nodes (n,) that are rest however they look.
    Finer levels have more and more of it as objects; the last one has pieces of leaves.
    """
    objectness = np.maximum(objectness, 0)
    n, leaves, worth = len(tree.parent), tree.leaves(), objectness**_POWER
    levels = np.empty((len(PRICES), tree.n_leaves), np.int64)
    for node_of, price in zip(levels, PRICES, strict=True):
        for k in best_cut(tree, worth - price):
            node_of[leaves.indices[leaves.indptr[k] : leaves.indptr[k + 1]]] = k
    sure = objectness[levels[CHOSEN]]
    behind = (sure < least) | is_rest[levels[CHOSEN]]
    for i, node_of in enumerate(levels):
        finer = (i - CHOSEN) / (len(PRICES) - 1 - CHOSEN)
        still = (objectness[node_of] < (1 - finer) * least) | is_rest[node_of]
        node_of[behind & (still | (i <= CHOSEN))] = n
    clusters = np.concatenate([levels[:, tree.leaf], tree.finest[None]])
    return clusters, behind[tree.leaf], sure[tree.leaf]


# --- Colors of samples, and the sample that stands for each Gaussian.


_AROUND = 4  # splats whose median is the color of a sample
_OPAQUE = 0.3  # opacity of such splats
_LIGHTNESS = 0.4  # weight of lightness against hue: faces of one object are lit differently
_NEAREST = 3  # samples that a Gaussian takes its groups from
_BOTH_NEAR = 2.0  # times the distance of the nearest one at which the two others may outvote it


def colors_of_samples(gaussians: Gaussians, rows: LongArray, points: DoubleArray) -> DoubleArray:
    """Color (S, 3) of points (S, 3) by the splats around them, of ``rows`` (K,), K > 0: CIE Lab,
    lightness weighted down."""
    opaque = rows[gaussians.opacities[rows] > _OPAQUE]
    opaque = opaque if len(opaque) >= _AROUND else rows
    lab = lab_from_rgb(rgb_from_dc(gaussians.sh[opaque, 0]))
    lab[:, 0] *= _LIGHTNESS
    lab = np.round(lab * GRID) / GRID
    tree = cKDTree(gaussians.means[opaque].astype(np.float64))
    ranks = list(range(1, min(_AROUND, len(opaque)) + 1))
    nearest = np.asarray(tree.query(points, k=ranks, workers=n_threads())[1])
    return np.median(lab[nearest], axis=1)


# --- All of it.


STAGE = "Find objects"
_STEPS = 4
LEAST_SURFELS = 32  # fewer show no surface
_LEAST_SPLATS = 10  # Gaussians of the smallest object: fewer are rest, however large


@dataclass(frozen=True)
class HierarchyConfig:
    """Settings of how regions that no model made become objects."""

    surfels: int = 60_000  # most samples of the surfaces; time grows with them
    background: bool = True  # gather what is no object in one group
    detail: float | None = None  # level to choose, 0 coarse .. 1 fine; None = objects
    silhouettes: bool = False  # regions at the coarsest level are outlines of whole objects

    def __post_init__(self) -> None:
        if self.surfels < LEAST_SURFELS:
            raise ValueError(f"surfels: {self.surfels} is under {LEAST_SURFELS}")
        if self.detail is not None and not 0 <= self.detail <= 1:
            raise ValueError(f"detail: {self.detail} is not between 0 and 1")


@dataclass(frozen=True, eq=False)
class FoundObjects:
    """Levels of groups, and the samples of the surfaces that carry them."""

    levels: Levels
    confidence: FloatArray  # (N,) objectness of the group, times the nearest samples' share in it
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
    near, support = Neighbourhood.of(surfels.points), None
    if config.silhouettes:
        support = support_of(surfels.points, surfels.normals)
        surfels = surfels.parted(support, near, _SILHOUETTES)
    yield Progress(STAGE, 1, _STEPS, "small pieces")
    rows = np.flatnonzero(finite(gaussians))
    around = cKDTree(surfels.points).query(
        gaussians.means[rows].astype(np.float64), k=_NEAREST, workers=n_threads()
    )
    distance, samples = np.asarray(around[0]), np.asarray(around[1], np.int64)
    n_splats = np.bincount(samples[:, 0], minlength=len(surfels.points))
    piece = small_pieces(surfels, near)
    color = colors_of_samples(gaussians, rows, surfels.points)
    seen = Seen.of(surfels, near, color, piece, len(views))
    yield Progress(STAGE, 2, _STEPS, "borders")
    tree = grown(seen, support=support)
    yield Progress(STAGE, 3, _STEPS, "objects")
    features = node_features(seen, tree, views, n_splats)
    objectness = learned().objects(features)
    if config.silhouettes:
        fit = features[:, _FIT_AT_LEVEL + _SILHOUETTES]
        objectness = _by_silhouettes(tree, objectness, fit)
    is_rest = tree.leaves() @ np.bincount(tree.leaf, n_splats, tree.n_leaves) < _LEAST_SPLATS
    least = OBJECT if config.background else -np.inf
    clusters, behind, sure = cuts(tree, objectness, is_rest, least)
    groups = clusters[CHOSEN][samples]
    nearest = np.where(_is_outvoted(groups, distance), samples[:, 1], samples[:, 0])
    confidence = np.zeros(len(gaussians), np.float32)
    share = (groups == clusters[CHOSEN][nearest][:, None]).mean(axis=1)
    confidence[rows] = share * np.clip(sure[nearest], 0, 1)
    carriers = np.append(nearest, np.arange(len(surfels.points)))
    found = Levels.of(clusters[:, carriers], CHOSEN, behind[carriers].astype(np.int64))
    if config.detail is not None:
        found = found.choose(config.detail)
    labels = np.zeros((len(clusters), len(gaussians)), np.int32)
    labels[:, rows] = found.labels[:, : len(rows)]
    of_samples = found.labels[found.chosen, len(rows) :]
    return FoundObjects(replace(found, labels=labels), confidence, surfels.regions, of_samples)


OF_CUTS = 10  # feature of a node: the share of views that cut it
_FIT_AT_LEVEL = 4  # first feature of how a node fits the regions of a level of detail
_SILHOUETTES = 1  # the level at which regions may be outlines of whole objects: the coarsest


def _by_silhouettes(tree: Tree, objectness: DoubleArray, fit: DoubleArray) -> DoubleArray:
    """The objectness (n,) where regions may be outlines of whole objects, which nodes fit (n,).

    How well one fits a node, or what that is a part of, is the chance that it is one. Then how well
    the node itself fits is its IoU with an object, however much a part looks like one.
    """
    chance = fit.copy()
    for k in range(len(fit) - 1, -1, -1):
        if tree.parent[k] >= 0:
            chance[k] = max(chance[k], chance[tree.parent[k]])
    return (1 - chance) * objectness + chance * fit


def _is_outvoted(groups: LongArray, distance: DoubleArray) -> BoolArray:
    """Where (K,) the second and the third sample agree on another group (K, 3) than the nearest
    one's, and are about as near."""
    agree = (groups[:, 1] == groups[:, 2]) & (groups[:, 1] != groups[:, 0])
    result: BoolArray = agree & (distance[:, 2] < _BOTH_NEAR * distance[:, 0])
    return result
