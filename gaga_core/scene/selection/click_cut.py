"""Clicks on a thing and off it, answered one after the other.

The first click takes the object of the graph that it meets; a click on another one adds it, if it
is not larger, or takes it away. Every other click is a minimum cut (Boykov and Jolly, ICCV 2001)
that changes the last answer where the click is: clicked nodes are given, other nodes keep their
side at a cost that grows with their size and with the distance from the click, and parting two
neighbours costs the more the likelier they are one thing.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.raster.base import NEAR
from gaga_core.scene.selection.click_graph import ClickGraph

_STAY = 10.0  # cost of a sample that changes its side far from the click
_NEAREST = 7  # samples around a click that tell how far they are apart
_NARROW = 1.5  # times the spacing of samples: half the width of an error that is an edge
_REACH = 0.5  # of the way to the nearest click of the other side: how far a click reaches
_LARGER = 1.5  # times what is chosen: the largest object that joins as a whole
_AROUND = 3.0  # times the size of what is chosen: what a click may change
_UNIT = 1000  # of the integers that costs are rounded to
_MOST = 1 << 29
_INSIDE = 0.8  # share of the seen samples of an object that a box must hold
_MISS = 0.02  # share of its depth by which a sample may miss the surface that a view shows


@dataclass(frozen=True)
class Click:
    """A click on the surface at ``point``, world: on the thing, or off it."""

    point: tuple[float, float, float]
    is_on: bool = True


@dataclass(frozen=True, eq=False)
class Answer:
    """What some clicks mean."""

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
        on[nodes], off[nodes] = np.where(given, _MOST, 0), np.where(given, 0, _MOST)
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
    spacing = float(np.median(graph.tree.query(last, k=_NEAREST)[0]))
    narrow = min(1.0, _NARROW * spacing / max(wide, 1e-9))
    away = np.linalg.norm(graph.centre - last, axis=1)
    far_off = 1 - np.exp(-((away / max(_REACH * far, spacing)) ** 2))
    here = graph.part == graph.part[graph.node[_sample_at(graph, click)]]
    size = np.bincount(graph.node)
    cost: DoubleArray = _STAY * narrow**2 * size * far_off * np.where(here, narrow, 1.0)
    return cost


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
    whole: IntArray = np.minimum(np.rint(capacity * _UNIT), _MOST).astype(np.int32)
    network = csr_array((whole, (tail, head)), shape=(sink + 1, sink + 1))
    left = csr_array(network - maximum_flow(network, source, sink).flow)
    left.data = np.maximum(left.data, 0)
    left.eliminate_zeros()
    result = np.zeros(sink + 1, np.bool_)
    result[breadth_first_order(left, source, return_predecessors=False)] = True
    return result[: len(rows)]
