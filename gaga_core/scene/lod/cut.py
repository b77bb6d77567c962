"""The cut of a tree: for every part of the scene the one node that is drawn.

A node is divided while what it cannot show is larger than some pixels in the picture; how many
pixels follows from the budget of splats (view-dependent refinement: Hoppe 1997, Rusinkiewicz 2000).
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.raster.base import NEAR
from gaga_core.scene.lod.tree import FAN, LodTree

LEAST_ERROR = 0.7  # pixels: finer than this nothing is divided
MARGIN = 0.12  # share of the picture's size around it that counts as seen, as in the depth sort
_OUTSIDE = 0.08  # share of the error that counts of what is not in the picture
_KEPT = 1.3  # factor of the error of nodes that are divided already: no flicker between two cuts
_MOST = 1e6  # pixels
_STEPS = 24  # of the search for the error that fits the budget
_ROOM = 1.5  # splats of a cut, also out of the picture, times the budget


@dataclass(frozen=True, eq=False)
class Cut:
    """What to draw of a tree."""

    divided: BoolArray  # (M,) nodes whose children are drawn, or these divided again
    seen: BoolArray  # (M,) nodes that can be in the picture
    errors: FloatArray  # (M,) pixels, see `node_errors`
    least_error: float  # pixels that the greatest error of what is drawn comes to
    n_seen: int  # splats of the cut that can be in the picture
    n_all: int


def node_counts(tree: LodTree) -> IntArray:
    """Splats (M,) of each node."""
    counts = [np.diff([tree.span(int(node)) for node in range(tree.n_nodes)], axis=1)[:, 0]]
    return np.concatenate(counts).astype(np.int32)


def choose_cut(
    tree: LodTree,
    counts: IntArray,
    boxes: FloatArray,
    camera: Camera,
    budget: int,
    *,
    before: BoolArray | None = None,
    exact: BoolArray | None = None,
) -> Cut:
    """The finest cut with at most ``budget`` splats in the picture.

    ``counts`` (M,) are of `node_counts`, ``boxes`` (M, 6) those of the nodes as the scene is now,
    ``before`` (M,) the divided nodes of the last cut, which stay so for a little longer. Nodes of
    ``exact`` (M,) that are seen are divided whatever their size, as far as the budget allows.
    """
    # Imported when first needed: importing numba takes a large part of the launch time.
    from gaga_core.scene.lod.cut_kernels import divide, node_errors

    n = tree.n_nodes
    errors, seen = np.empty(n, np.float32), np.empty(n, np.bool_)
    K, width, height = camera.K, camera.width, camera.height
    lens = np.array(
        [K[0, 0], K[1, 1], K[0, 2], K[1, 2], width, height, NEAR, MARGIN * max(width, height)]
    )
    pose = np.ascontiguousarray(camera.cam_from_world[:3], np.float64)
    node_errors(boxes, tree.details, pose, lens, _OUTSIDE, errors, seen)
    if before is not None:
        errors[before] *= np.float32(_KEPT)
    if exact is not None:
        errors[exact & seen] += np.float32(_MOST)
    divided = np.empty(n, np.bool_)

    def count(least: float) -> tuple[int, int]:
        n_seen, n_all = divide(errors, seen, counts, tree.first_nodes, FAN, least, divided)
        return int(n_seen), int(n_all)

    def fits(found: tuple[int, int]) -> bool:
        return found[0] <= budget and found[1] <= _ROOM * budget

    least, found = LEAST_ERROR, count(LEAST_ERROR)
    if not fits(found):
        low, high = np.log(LEAST_ERROR), np.log(4 * _MOST)
        for _ in range(_STEPS):
            middle = (low + high) / 2
            if fits(count(float(np.exp(middle)))):
                high = middle
            else:
                low = middle
        least = float(np.exp(high))
        found = count(least)
    return Cut(divided, seen, errors, least, *found)


def drawn_nodes(tree: LodTree, divided: BoolArray) -> IntArray:
    """Nodes of the cut whose divided nodes are these, ascending."""
    parents = parent_of(tree)
    top = parents < 0
    reached = top | divided[np.where(top, 0, parents)]
    return np.flatnonzero(reached & ~divided).astype(np.int32)


def parent_of(tree: LodTree) -> IntArray:
    """Parent (M,) of each node; -1 of the node at the top."""
    parents = np.full(tree.n_nodes, -1, np.int32)
    firsts = tree.first_nodes
    for level in range(len(tree.sizes) - 1):
        nodes = np.arange(firsts[level], firsts[level + 1])
        parents[nodes] = firsts[level + 1] + (nodes - firsts[level]) // FAN
    return parents
