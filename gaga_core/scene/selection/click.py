"""Clicks on an object and off it, answered one after the other.

The first click takes the object of the graph that it meets; a click on another one adds it, if it
is not larger, or takes it away. Every other click is a minimum cut (Boykov and Jolly, ICCV 2001)
that changes the last answer where the click is: clicked nodes are given, other nodes keep their
side at a cost that grows with their size and with the distance from the click, and parting two
neighbours costs the more the likelier they are one object.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.camera import NEAR, Camera
from gaga_core.color import rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.robust.surface_graph import finite
from gaga_core.grouping.robust.surface_points import DepthMaps
from gaga_core.grouping.surfaces.boosted_trees import learned
from gaga_core.grouping.surfaces.borders import Seen, SignedGraph, coarser_of, joined
from gaga_core.grouping.surfaces.objects import (
    CHOSEN,
    OF_CUTS,
    Tree,
    colors_of_samples,
    cuts,
    grown,
    node_features,
)
from gaga_core.grouping.surfaces.surfels import (
    Neighbourhood,
    Surfels,
    dense,
    sample_surfels,
    small_pieces,
)
from gaga_core.progress import Progress, Stage, portion
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.orientation import estimate_up, views_around
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.bounds import robust_box
from gaga_core.scene.selection.selection_kernels import vote_of_samples
from gaga_core.segmentation.regions import FURTHER_STEPS, regions_at
from gaga_core.threads import n_threads, run_chunks

# --- Candidates of clicks: small pieces of the surfaces, and how likely neighbours are one
# object.
# No model is needed. Views are rendered and divided into regions; samples of the surfaces, joined
# to pieces, get evidence about their borders, and objects and parts are cuts through the tree of
# their joins (`gaga_core.grouping.surfaces`). This takes seconds to a minute, once; then clicks are
# answered from the graph alone.


STAGE = "Prepare clicks"
# Where views, samples, splats around them and borders end, share of all: four files of 30,000 to
# 90,000 splats spent 0.70 to 0.76, 0.04 to 0.05, 0.04 to 0.06 and 0.15 to 0.19 of their time.
_LOOKED, _SAMPLED, _GATHERED = 0.74, 0.78, 0.84
_SAMPLES = 60_000  # most samples of the surfaces
_LEAST_SAMPLES = 32  # fewer show no surface
_OPAQUE = 0.5  # alpha of a pixel that shows a surface
_HIDDEN = 3.0  # spacings of the samples within which a splat is near one
_NODES = 6.0  # log odds at which small pieces join to nodes: fewer than half a percent are wrong
_PARTS = CHOSEN + 2  # the level of detail of parts
_SAME_GROUP = 1.0  # evidence that two pieces of one group of the scene add
_N_NEAREST = 6  # samples that decide about a splat
_COLOR = 3.0  # spacings that a splat is away for a unit of color difference
_ONE_OBJECT = 0.9  # objectness of a whole file: others have 0.87 at most, of 28 validation scenes
_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class ClickGraph:
    """Nodes are small pieces of surface; samples carry them; splats follow the samples around."""

    points: DoubleArray  # (S, 3) samples, world
    node: LongArray  # (S,) of each sample, dense ids from 0
    graph: SignedGraph  # of nodes; evidence in log odds that two are one object
    centre: DoubleArray  # (n, 3) of the nodes, world
    part: LongArray  # (n,) the part that each node belongs to
    object: LongArray  # (n,) the object that each node belongs to, as far as can be told
    rows: IntArray  # (K,) splats that can be clicked, ascending
    nearest: IntArray  # (K, k) samples around each
    weights: FloatArray  # (K, k) of them, sum 1
    tree: cKDTree  # of the points

    def splats(self, samples: BoolArray) -> IntArray:
        """Splats (M,), ascending, that chosen samples (S,) bool make chosen."""
        result = np.empty(len(self.rows), np.bool_)
        work = partial(vote_of_samples, self.nearest, self.weights, samples, result)
        run_chunks(work, len(self.rows), _CHUNK)
        return self.rows[result]


def click_graph_stage(
    scene: Scene, views: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[ClickGraph]:
    """Look at what is visible of ``scene`` from ``views`` and build the graph.

    Groups that the scene has are evidence, too. Raises ``GagaError`` when the views show next to
    nothing.
    """
    rows = np.flatnonzero(scene.visible).astype(np.int32)
    labels = scene.labels[rows]
    gaussians = yield from bake_stage(scene, indices=rows)
    looked = yield from portion(_looked(gaussians, views, rasterizer), 0, _LOOKED, STAGE)
    masks, depths = looked.masks, looked.depths
    further = looked.further
    sample = sample_surfels(
        views, lambda c: masks[c.name], lambda c: further[c.name], depths, _SAMPLES
    )
    surfels = yield from portion(sample, _LOOKED, _SAMPLED, STAGE)
    known = finite(gaussians)
    surfels = _with_unseen(surfels, gaussians.means[known & (gaussians.opacities > _OPAQUE)])
    if len(surfels.points) < _LEAST_SAMPLES:
        raise GagaError("The views show almost none of the splats, so nothing can be clicked.")
    yield Progress(STAGE, _SAMPLED, 1, "splats around the surfaces")
    tree = cKDTree(surfels.points)
    spacing = _spacing(tree)
    nearest, weights = _votes(tree, spacing, gaussians, _colors(looked, views, surfels))
    yield Progress(STAGE, _GATHERED, 1, "borders")
    groups = _majority(labels, nearest[:, 0], len(spacing))
    n_splats = np.bincount(nearest[:, 0], minlength=len(spacing))
    color = colors_of_samples(gaussians, np.flatnonzero(known), surfels.points)
    node, graph, parts, objects = _nodes(surfels, color, groups, views, n_splats)
    sums = [np.bincount(node, column) for column in surfels.points.T]
    centre = np.stack(sums, axis=1) / np.bincount(node)[:, None]
    return ClickGraph(
        surfels.points, node, graph, centre, parts, objects, rows, nearest, weights, tree
    )


@dataclass(frozen=True, eq=False)
class _Looked:
    """Renderings by name of the view."""

    depths: DepthMaps
    masks: dict[str, ViewMasks]
    further: dict[str, list[IntArray]]  # regions (H, W) at other levels of detail
    images: dict[str, UInt8Array]  # (H, W, 3)


def _looked(
    gaussians: Gaussians, views: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[_Looked]:
    looked = _Looked(DepthMaps(views), {}, {}, {})
    for i, camera in enumerate(views):
        yield Progress(STAGE, i, len(views), f"look at the scene, {i + 1} of {len(views)}")
        frame = rasterizer.render(gaussians, camera)
        image = np.rint(np.clip(np.nan_to_num(frame.image), 0, 1) * 255).astype(np.uint8)
        looked.depths.add(camera.name, frame.median_depth, frame.alpha, _OPAQUE)
        maps = regions_at((1.0, *FURTHER_STEPS), image, frame.median_depth)
        looked.masks[camera.name], looked.further[camera.name] = ViewMasks.of(maps[0]), maps[1:]
        looked.images[camera.name] = image
    return looked


def _with_unseen(surfels: Surfels, means: FloatArray) -> Surfels:
    """The samples, and some of the splats (K, 3) that no view shows, as samples without more."""
    points, room = surfels.points, _SAMPLES - len(surfels.points)
    if len(points) > 1 and len(means):
        tree = cKDTree(points)
        distance, nearest = tree.query(means.astype(np.float64), workers=n_threads())
        means = means[np.asarray(distance) > _HIDDEN * _spacing(tree)[nearest]]
    if len(means) == 0:
        return surfels
    more = means[:: -(-len(means) // max(room, _LEAST_SAMPLES))].astype(np.float64)
    unknown = np.zeros((len(more), surfels.regions.shape[1]), np.int32)
    return Surfels(
        np.concatenate([points, more]),
        np.concatenate([surfels.normals, np.zeros((len(more), 3))]),
        np.concatenate([surfels.regions, unknown]),
        np.concatenate([surfels.n_views, np.ones(len(more), np.int32)]),
        np.pad(surfels.further, ((0, len(more)), (0, 0))),
    )


def _spacing(tree: cKDTree) -> DoubleArray:
    """Median distance (S,) of each point of a tree to its nearest others, above 0."""
    points = np.asarray(tree.data)
    k = min(_N_NEAREST + 1, len(points))
    distance = np.asarray(tree.query(points, k=k, workers=n_threads())[0])
    return np.maximum(np.median(distance[:, 1:], axis=1), 1e-12)


def _colors(looked: _Looked, views: Sequence[Camera], surfels: Surfels) -> FloatArray:
    """Mean color (S, 3) of each sample in the views that show it, 0..1; NaN where none does."""
    total, count = np.zeros((len(surfels.points), 3)), np.zeros(len(surfels.points))
    for v, camera in enumerate(views):
        seen = np.flatnonzero(surfels.regions[:, v])
        columns, rows = camera.project(surfels.points[seen])[0].astype(np.int64).T
        total[seen] += looked.images[camera.name][rows, columns]
        count[seen] += 255
    with np.errstate(invalid="ignore"):
        return (total / count[:, None]).astype(np.float32)


def _votes(
    tree: cKDTree, spacing: DoubleArray, gaussians: Gaussians, colors: FloatArray
) -> tuple[IntArray, FloatArray]:
    """The nearest samples (N, k) of each splat, and their weights by distance and color."""
    means = np.where(np.isfinite(gaussians.means), gaussians.means, 0).astype(np.float64)
    k = min(_N_NEAREST, len(spacing))
    nearest, weights = np.empty((len(means), k), np.int32), np.empty((len(means), k), np.float32)
    rgb = np.clip(rgb_from_dc(gaussians.sh[:, 0]), 0, 1)
    for start in range(0, len(means), _CHUNK):
        rows = slice(start, start + _CHUNK)
        distance, found = tree.query(means[rows], k=k, workers=n_threads())
        away = np.asarray(distance).reshape(-1, k) / spacing[np.asarray(found).reshape(-1, k)]
        unlike = np.linalg.norm(colors[found].reshape(-1, k, 3) - rgb[rows][:, None], axis=2)
        cost = away + _COLOR * np.nan_to_num(unlike)
        voice = np.exp(cost.min(axis=1, keepdims=True) - cost)
        nearest[rows] = np.asarray(found).reshape(-1, k)
        weights[rows] = voice / voice.sum(axis=1, keepdims=True)
    return nearest, weights


def _majority(labels: IntArray, sample: IntArray, n: int) -> IntArray:
    """The group (n,) that most splats of each sample have, 0 = none."""
    grouped = np.flatnonzero(labels > 0)
    n_labels = int(labels.max(initial=0)) + 1
    keys, count = np.unique(
        sample[grouped].astype(np.int64) * n_labels + labels[grouped], return_counts=True
    )
    keys = keys[np.argsort(count, kind="stable")]
    result = np.zeros(n, np.int32)
    result[keys // n_labels] = keys % n_labels  # of one sample the largest count is written last
    return result


def _nodes(
    surfels: Surfels,
    color: DoubleArray,  # (S, 3) as of `colors_of_samples`
    groups: IntArray,  # (S,) of the scene, 0 = none
    views: Sequence[Camera],
    n_splats: LongArray,  # (S,) next to each sample
) -> tuple[LongArray, SignedGraph, LongArray, LongArray]:
    """Node of each sample (S,), their graph, and part and object of each node (n,)."""
    near = Neighbourhood.of(surfels.points)
    piece = small_pieces(surfels, near)
    seen = Seen.of(surfels, near, color, piece, len(views))
    tree = grown(seen)
    node_of_piece = joined(tree.pieces, _NODES)
    node = node_of_piece[piece]
    objectness = _objectness(tree, node_features(seen, tree, views, n_splats))
    every = cuts(tree, objectness, np.zeros(len(objectness), np.bool_), -np.inf)[0]
    part, thing = (coarser_of(node, dense(every[level])) for level in (_PARTS, CHOSEN))
    graph = _with_judged(
        tree.pieces.contracted(node_of_piece),
        tree.borders.judged(learned().borders),
        coarser_of(node, tree.leaf),
    )
    group = _majority(groups, node.astype(np.int32), len(graph.size))
    a, b = group[graph.first], group[graph.second]
    said = np.where(a == b, _SAME_GROUP, -_SAME_GROUP) * ((a > 0) & (b > 0))
    return node, replace(graph, evidence=graph.evidence + said), part, thing


def _objectness(tree: Tree, features: DoubleArray) -> DoubleArray:
    """Objectness (n,) of the nodes. Where views show all of everything and that looks like one
    object, it is a file without surroundings, as other programs save an object."""
    if not features[:, OF_CUTS].any():
        alone = learned().alone(features)
        whole = np.argmax(tree.leaves().sum(axis=1))
        if alone[whole] >= _ONE_OBJECT:
            return alone
    return learned().objects(features)


def _with_judged(graph: SignedGraph, judged: SignedGraph, judged_of: LongArray) -> SignedGraph:
    """The graph of nodes (n,) with the evidence of the larger pieces (n,) that they belong to."""
    a, b = judged_of[graph.first], judged_of[graph.second]
    n = len(judged.size)
    at = np.searchsorted(judged.first * n + judged.second, np.minimum(a, b) * n + np.maximum(a, b))
    at = np.minimum(at, max(len(judged.first) - 1, 0))
    evidence = np.where(a == b, graph.evidence, judged.evidence[at] if len(judged.first) else 0)
    return replace(graph, evidence=evidence)


# --- The answer to clicks: `clicked`, and `boxed` for a box.


_STAY = 10.0  # cost of a sample that changes its side far from the click
_N_AROUND = 7  # samples around a click that tell how far they are apart
_NARROW = 1.5  # times the spacing of samples: half the width of an error that is an edge
_REACH = 0.5  # of the way to the nearest click of the other side: how far a click reaches
_LARGER = 1.5  # times what is chosen: the largest object that joins as a whole
_AROUND = 3.0  # times the size of what is chosen: what a click may change
_UNIT = 1000  # of the integers that costs are rounded to
_GIVEN = 1 << 29  # cost of changing what is clicked
_INSIDE = 0.8  # share of the seen samples of an object that a box must hold
_MISS = 0.02  # share of its depth by which a sample may miss the surface that a view shows


@dataclass(frozen=True)
class Click:
    """A click on the surface at ``point``, world: on the object, or off it."""

    point: tuple[float, float, float]
    is_on: bool = True


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer to some clicks."""

    clicks: tuple[Click, ...]
    nodes: BoolArray  # (n,) chosen
    samples: BoolArray  # (S,) chosen


def nothing_yet(graph: ClickGraph) -> Answer:
    """The answer to no click."""
    return Answer((), np.zeros(len(graph.centre), np.bool_), np.zeros(len(graph.points), np.bool_))


def clicked(graph: ClickGraph, before: Answer, click: Click) -> Answer:
    """The answer to one more click. One on the very sample of an earlier click replaces that."""
    at = _sample_at(graph, click)
    clicks = (*(c for c in before.clicks if _sample_at(graph, c) != at), click)
    thing = graph.object == graph.object[graph.node[at]]
    if not before.nodes.any():
        nodes = thing if click.is_on else before.nodes
    elif _is_apart(graph, thing, before.nodes, clicks):
        nodes = before.nodes | thing if click.is_on else before.nodes & ~thing
    else:
        nodes = _cut(graph, before.nodes, clicks)
    return Answer(clicks, nodes, _samples(graph, nodes, clicks))


def boxed(
    graph: ClickGraph,
    camera: Camera,
    corners: tuple[float, float, float, float],
    depth: FloatArray,
) -> Answer:
    """The objects that lie in the box (u0, v0, u1, v1), pixels, of a picture with median ``depth``
    (H, W); else parts that do. None: nothing."""
    pixels, z = camera.project(graph.points)
    size = (camera.width, camera.height)
    inside = (z > NEAR) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)
    columns, rows = np.where(inside[:, None], pixels, 0).astype(np.int64).T
    seen = inside & (np.abs(z - depth[rows, columns]) < _MISS * z)
    low = np.minimum(corners[:2], corners[2:])
    high = np.maximum(corners[:2], corners[2:])
    held = seen & (pixels >= low).all(axis=1) & (pixels <= high).all(axis=1)
    for whole in (graph.object, graph.part):
        of_sample = whole[graph.node]
        n_seen = np.bincount(of_sample, seen)
        n_held = np.bincount(of_sample, held)
        chosen = (n_held > 0) & (n_held >= _INSIDE * n_seen)
        if chosen.any():
            nodes = chosen[whole]
            return Answer((), nodes, nodes[graph.node])
    return nothing_yet(graph)


def adopted(graph: ClickGraph, clicks: tuple[Click, ...], splats: IntArray) -> Answer:
    """``splats`` (K,), found in another way, as the answer to ``clicks``: the next click changes
    them. A sample is chosen with most of the splats that follow it, a node with most samples."""
    chosen = np.isin(graph.rows, splats)
    near, n = graph.nearest.ravel(), len(graph.points)
    on = np.bincount(near, (graph.weights * chosen[:, None]).ravel(), n)
    samples = on > 0.5 * np.bincount(near, graph.weights.ravel(), n)
    nodes = np.bincount(graph.node, samples) > 0.5 * np.bincount(graph.node)
    return Answer(clicks, nodes, samples)


def _is_apart(
    graph: ClickGraph, thing: BoolArray, before: BoolArray, clicks: tuple[Click, ...]
) -> bool:
    """Whether an object (n,) of the graph joins or leaves as a whole at the last of the clicks.

    It joins when nothing of it is chosen yet and it is not much larger than what is; it leaves when
    something else stays. Nothing of it must be clicked before.
    """
    if any(thing[graph.node[_sample_at(graph, click)]] for click in clicks[:-1]):
        return False
    if not clicks[-1].is_on:
        return bool((before & ~thing).any())
    count = np.bincount(graph.node)
    return bool(not (thing & before).any() and count[thing].sum() <= _LARGER * count[before].sum())


def _sample_at(graph: ClickGraph, click: Click) -> int:
    return int(graph.tree.query(click.point)[1])


def _samples(graph: ClickGraph, nodes: BoolArray, clicks: tuple[Click, ...]) -> BoolArray:
    """Chosen samples (S,). A node that is clicked on and off is divided by the nearest click."""
    chosen: BoolArray = nodes[graph.node]
    if not clicks:
        return chosen
    at = graph.node[[_sample_at(graph, click) for click in clicks]]
    is_on = np.array([click.is_on for click in clicks])
    for node in np.intersect1d(at[is_on], at[~is_on]):
        inside, of_node = np.flatnonzero(graph.node == node), np.flatnonzero(at == node)
        places = np.array([clicks[i].point for i in of_node])
        away = np.linalg.norm(graph.points[inside][:, None] - places, axis=2)
        chosen[inside] = is_on[of_node][away.argmin(axis=1)]
    return chosen


def _cut(graph: ClickGraph, before: BoolArray, clicks: tuple[Click, ...]) -> BoolArray:
    """Nodes (n,) after the last of the clicks."""
    last = np.array(clicks[-1].point)
    others = [click.point for click in clicks if click.is_on != clicks[-1].is_on]
    chosen = graph.centre[before]
    spread = float(np.linalg.norm(chosen - chosen.mean(axis=0), axis=1).max())
    far = min((float(np.linalg.norm(last - p)) for p in others), default=spread)
    away = np.linalg.norm(graph.centre - last, axis=1)
    rows = np.flatnonzero(before | (away < _AROUND * max(spread, far)))
    stay = _cost_of_changing(graph, before, clicks[-1], far)
    on, off = np.where(before, stay, 0.0), np.where(before, 0.0, stay)
    at = graph.node[[_sample_at(graph, click) for click in clicks]]
    is_on = np.array([click.is_on for click in clicks])
    both = np.intersect1d(at[is_on], at[~is_on])  # stay what they are; `_samples` divides them
    for nodes, given in ((at[is_on], True), (at[~is_on], False), (both, before[both])):
        on[nodes], off[nodes] = np.where(given, _GIVEN, 0), np.where(given, 0, _GIVEN)
    after = before.copy()
    after[rows] = _minimum_cut(graph, rows, on, off, before)
    return after


def _cost_of_changing(
    graph: ClickGraph, before: BoolArray, click: Click, far: float
) -> DoubleArray:
    """What it costs (n,) that a node changes its side for a click ``far`` from any of the other.

    The wider what is wrong around the click, the more may change. Half of its width is the way to
    the other side; an error that is narrow is an edge, and only what is at the click changes.
    """
    last = np.array(click.point)
    wrong_until = graph.points[before[graph.node] == click.is_on]
    wide = float(np.linalg.norm(wrong_until - last, axis=1).min(initial=far))
    spacing = float(np.median(graph.tree.query(last, k=_N_AROUND)[0]))
    narrow = min(1.0, _NARROW * spacing / max(wide, 1e-9))
    away = np.linalg.norm(graph.centre - last, axis=1)
    far_off = 1 - np.exp(-((away / max(_REACH * far, spacing)) ** 2))
    here = graph.part == graph.part[graph.node[_sample_at(graph, click)]]
    size = np.bincount(graph.node)
    return _STAY * narrow**2 * size * far_off * np.where(here, narrow, 1.0)


def _minimum_cut(
    graph: ClickGraph,
    rows: LongArray,  # (K,) nodes that may change, ascending
    on: DoubleArray,  # (n,) cost of not being chosen
    off: DoubleArray,  # (n,) cost of being chosen
    before: BoolArray,  # (n,) that the other nodes stay
) -> BoolArray:
    """Which of ``rows`` (K,) are chosen at the least cost."""
    place = np.full(len(before), -1, np.int64)
    place[rows] = np.arange(len(rows))
    cost = graph.graph.length * np.logaddexp(0, graph.graph.evidence)
    a, b = place[graph.graph.first], place[graph.graph.second]
    for inner, outer, node in ((a, b, graph.graph.second), (b, a, graph.graph.first)):
        edge = np.flatnonzero((inner >= 0) & (outer < 0))
        side = before[node[edge]]
        np.add.at(on, rows[inner[edge[side]]], cost[edge[side]])
        np.add.at(off, rows[inner[edge[~side]]], cost[edge[~side]])
    edge = np.flatnonzero((a >= 0) & (b >= 0))
    a, b, cost = a[edge], b[edge], cost[edge]
    balance = on[rows] - off[rows]
    source, sink = len(rows), len(rows) + 1
    gives, takes = np.flatnonzero(balance > 0), np.flatnonzero(balance < 0)
    tail = np.concatenate([a, b, np.full(len(gives), source), takes])
    head = np.concatenate([b, a, gives, np.full(len(takes), sink)])
    capacity = np.concatenate([cost, cost, balance[gives], -balance[takes]])
    whole: IntArray = np.minimum(np.rint(capacity * _UNIT), _GIVEN).astype(np.int32)
    network = csr_array((whole, (tail, head)), shape=(sink + 1, sink + 1))
    left = csr_array(network - maximum_flow(network, source, sink).flow)
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    result = np.zeros(sink + 1, np.bool_)
    result[breadth_first_order(left, source, return_predecessors=False)] = True
    return result[: len(rows)]


# --- Views from which a scene is looked at before it can be clicked: its photos', or all around.


_N_VIEWS = 24  # at most
_EVERY = 3  # of them
_SIDE = 480  # pixels, longer side of a view
_RINGS = ((-15.0, 5), (20.0, 8), (50.0, 6))  # elevation in degrees, views around
_FIELD = np.radians(50.0)  # field of view
_ROOM = 1.15  # times the distance at which the scene's ball fills a view


def click_views(cameras: Sequence[Camera], means: FloatArray) -> tuple[Camera, ...]:
    """At most 24 views, 480 pixels or less, that show what can be clicked.

    ``cameras`` are those of the photos, taken evenly in their order; without any, views around the
    splats with centres ``means`` (N, 3).
    """
    if not cameras:
        box = robust_box(means, 0.98)
        up = estimate_up(())
        return views_around(box, up, _RINGS, side=_SIDE, field=_FIELD, room=_ROOM, name="around")
    n = min(_N_VIEWS, len(cameras))
    chosen = np.linspace(0, len(cameras) - 1, n).round().astype(int)
    return tuple(cameras[i].at_most(_SIDE) for i in np.unique(chosen))


def loss_views(cameras: Sequence[Camera], means: FloatArray) -> tuple[Camera, ...]:
    """Some of these views: enough to judge what fewer splats (`decimate`) lose."""
    return click_views(cameras, means)[::_EVERY]
