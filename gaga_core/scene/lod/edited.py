"""A tree under a scene that was edited: where its nodes stand, and which stand for too much.

Merged splats know nothing of edits: a node's splats take state, placement and group of the splat
that counts most in each. That is right as long as all splats below it were treated alike; a node of
others is mixed, and is drawn from its children, or is merged again.
"""

import threading
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import NEAR, Camera
from gaga_core.gaussians import Gaussians
from gaga_core.scene.bake import bake
from gaga_core.scene.lod.build import merged_level
from gaga_core.scene.lod.cut_kernels import leaf_facts, node_errors
from gaga_core.scene.lod.tree import FAN, NODE, LodTree, union_of_children
from gaga_core.scene.scene import Placements, Scene, State
from gaga_core.threads import run_chunks

_BITS = int(State.SELECTED | State.HIDDEN | State.DELETED)
_UNSEEN = int(State.HIDDEN | State.DELETED)
_MOST_PLACEMENTS = 8  # of a node that are distinguished
_LEAVES = 256  # nodes that one thread looks at at once
_EMPTY = np.array([np.inf] * 3 + [-np.inf] * 3, np.float32)  # box


@dataclass(frozen=True, eq=False)
class NodeFacts:
    """Effect of the edits of a scene on the nodes of its tree."""

    mixed: BoolArray  # (M,) splats below were not all treated alike
    # (M,) ... some of them are hidden or stand elsewhere, so they merge differently
    torn: BoolArray
    gone: BoolArray  # (M,) all splats below are hidden or deleted
    leaf_placements: IntArray | None  # (K, C) of the nodes of level 0; -1 = no more; None = all 0
    has_many: BoolArray  # (K,) more placements than have room there


def node_facts(tree: LodTree, scene: Scene) -> NodeFacts:
    """Look at every splat of the tree once; ``scene``: the opened one, with its edits."""
    n, n_leaves = len(tree), int(tree.first_nodes[1])
    state, placement = scene.state[:n], scene.placement[:n]
    if not (state & np.uint8(_BITS)).any() and not placement.any():
        none, few = np.zeros(tree.n_nodes, np.bool_), np.zeros(n_leaves, np.bool_)
        return NodeFacts(none, none, none, None, few)
    leaf_mixed, leaf_torn = np.empty(n_leaves, np.bool_), np.empty(n_leaves, np.bool_)
    states = np.empty(n_leaves, np.uint8)
    found = np.full((n_leaves, _MOST_PLACEMENTS), -1, np.int32)
    n_found = np.empty(n_leaves, np.int32)

    given = tree.order, state, placement, _BITS, _UNSEEN, NODE
    work = partial(leaf_facts, *given, leaf_mixed, leaf_torn, states, found, n_found)
    run_chunks(work, n_leaves, _LEAVES)
    keys = np.where(leaf_mixed, -1, states.astype(np.int64) << 32 | found[:, 0])
    mixed, gone = _upwards(tree, keys)
    seen = states.astype(np.int64) & _UNSEEN
    torn, _ = _upwards(tree, np.where(leaf_torn, -1, seen << 32 | found[:, 0]))
    return NodeFacts(mixed, torn, gone, found, n_found > _MOST_PLACEMENTS)


def _upwards(tree: LodTree, leaf_keys: LongArray) -> tuple[BoolArray, BoolArray]:
    """Mixed and gone nodes (M,) by the key of each leaf: state and placement, -1 = mixed."""
    firsts = tree.first_nodes
    keys = np.empty(tree.n_nodes, np.int64)
    unseen = np.empty(tree.n_nodes, np.bool_)
    keys[: firsts[1]] = leaf_keys
    unseen[: firsts[1]] = (leaf_keys >= 0) & (leaf_keys >> 32 & _UNSEEN != 0)
    for level in range(1, len(tree.sizes)):
        below = keys[firsts[level - 1] : firsts[level]]
        starts = np.arange(0, len(below), FAN)
        low, high = np.minimum.reduceat(below, starts), np.maximum.reduceat(below, starts)
        here = slice(firsts[level], firsts[level + 1])
        keys[here] = np.where(low == high, low, -1)
        gone_below = unseen[firsts[level - 1] : firsts[level]]
        unseen[here] = np.logical_and.reduceat(gone_below, starts)
    return keys < 0, unseen


def merged_again(tree: LodTree, node: int, scene: Scene) -> tuple[Gaussians, IntArray]:
    """Splats (K,) of a node above level 0, merged from those below that are visible, where they
    stand now; and of each the row that counts most in it. Never more than as opened: where few are
    visible, they are merged less often, or not at all."""
    first, end = tree.opened_span(node)
    rows = tree.order[first:end]
    rows = rows[scene.state[rows] & np.uint8(_UNSEEN) == 0]
    ordered = np.sort(rows)
    baked = bake(replace(scene, gaussians=replace(scene.gaussians, extra={})), indices=ordered)
    splats = baked.take(np.searchsorted(ordered, rows))
    place, last = tree.span(node)
    while len(rows) > last - place:
        splats, rows = merged_level(splats, rows)
    return splats, rows


def placed_boxes(tree: LodTree, facts: NodeFacts, placements: Placements) -> FloatArray:
    """Boxes (M, 6) of the nodes where their splats stand."""
    if facts.leaf_placements is None:
        return tree.boxes
    boxes = tree.boxes.copy()
    n_leaves = int(tree.first_nodes[1])
    opened = tree.boxes[:n_leaves]
    placed = np.tile(_EMPTY, (n_leaves, 1))
    for column in facts.leaf_placements.T:
        has = np.flatnonzero(column >= 0)
        if len(has):
            _unite(placed, has, _moved(opened[has], placements.matrix[column[has]]))
    many = np.flatnonzero(facts.has_many)
    if len(many):
        for matrix in placements.matrix:
            moved = _moved(opened[many], np.broadcast_to(matrix, (len(many), 3, 4)))
            _unite(placed, many, moved)
    boxes[:n_leaves], boxes[n_leaves:] = placed, _EMPTY
    union_of_children(boxes, tree.first_nodes)
    return boxes


def _unite(boxes: FloatArray, at: AnyArray, others: FloatArray) -> None:
    boxes[at, :3] = np.minimum(boxes[at, :3], others[:, :3])
    boxes[at, 3:] = np.maximum(boxes[at, 3:], others[:, 3:])


def _moved(boxes: FloatArray, matrices: DoubleArray) -> FloatArray:
    """Boxes (K, 6) around boxes (K, 6) moved by matrices (K, 3, 4)."""
    middle, half = (boxes[:, :3] + boxes[:, 3:]) / 2, (boxes[:, 3:] - boxes[:, :3]) / 2
    centre = np.einsum("kij,kj->ki", matrices[:, :, :3], middle) + matrices[:, :, 3]
    reach = np.einsum("kij,kj->ki", np.abs(matrices[:, :, :3]), half)
    return np.concatenate([centre - reach, centre + reach], axis=1).astype(np.float32)


# --- Which splats a pixel may show: what a click in a large scene looks at.


_MARGIN = 4.0  # pixels: the blur of small splats, and more


class PickBoxes:
    """A tree, and the boxes of its nodes where the splats of a scene stand.

    They are looked up when the first one asks: after an edit that is the thread of what lies under
    the mouse, not the one that draws.
    """

    def __init__(self, tree: LodTree, scene: Scene) -> None:
        self.tree = tree
        # Edits replace columns, never change them in place: this is the scene as it is now.
        self._scene = replace(scene)
        self._boxes: FloatArray | None = None
        self._looking = threading.Lock()

    @property
    def boxes(self) -> FloatArray:
        """Boxes (M, 6) of the nodes under the edits of the scene."""
        with self._looking:
            if self._boxes is None:
                tree, scene = self.tree, self._scene
                is_moved = scene.placement[: len(tree)].any()
                self._boxes = tree.boxes
                if is_moved:
                    self._boxes = placed_boxes(tree, node_facts(tree, scene), scene.placements)
            return self._boxes

    def rows_at(self, camera: Camera, u: float, v: float, n: int) -> IntArray:
        """Rows (K,) ascending, of ``n`` splats, whose nodes the ray of a pixel may meet.

        Splats that were added behind those of the tree are all among them.
        """
        tree, K = self.tree, camera.K
        n_leaves = int(tree.first_nodes[1])
        errors, seen = np.empty(n_leaves, np.float32), np.empty(n_leaves, np.bool_)
        # A picture of the one pixel.
        lens = np.array([K[0, 0], K[1, 1], K[0, 2] - u, K[1, 2] - v, 0, 0, NEAR, _MARGIN])
        pose = np.ascontiguousarray(camera.cam_from_world[:3], np.float64)
        leaves = self.boxes[:n_leaves]
        node_errors(leaves, tree.details[:n_leaves], pose, lens, 0.0, errors, seen)
        spans = [
            tree.order[leaf * NODE : min((leaf + 1) * NODE, len(tree))]
            for leaf in np.flatnonzero(seen)
        ]
        added = np.arange(len(tree), n, dtype=np.int32)
        return np.sort(np.concatenate([*spans, added]))
