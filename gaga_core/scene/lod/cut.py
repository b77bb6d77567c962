"""The cut of a tree: for every part of the scene the one node that is drawn.

A node is divided while what it cannot show is larger than some pixels in the picture; how many
pixels follows from the budget of splats (view-dependent refinement: Hoppe 1997, Rusinkiewicz 2000).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import NEAR, Camera
from gaga_core.scene.lod.cut_kernels import behind, cover_cells, divide, end_depths, node_errors
from gaga_core.scene.lod.tree import FAN, LodTree

LEAST_ERROR = 0.7  # pixels: finer than this nothing is divided
MARGIN = 0.12  # share of the picture's size around it that counts as seen, as in the depth sort
_OUTSIDE = 0.2  # share of the error that counts of what is not in the picture
_HIDDEN = 0.1  # the same of what lies behind others
_KEPT = 1.3  # factor of the error of nodes that are divided already: no flicker between two cuts
_DIVIDED = 1e6  # pixels: the error of what is divided whatever its size
_COVERED = 0.25  # of its squared error is what a splat covers
_STEPS = 24  # of the search for the error that fits the budget
_ROOM = 1.5  # splats of a cut, also out of the picture, times the budget


@dataclass(frozen=True, eq=False)
class Cut:
    """The nodes of a tree to draw."""

    divided: BoolArray  # (M,) nodes whose children are drawn, or these divided again
    seen: BoolArray  # (M,) nodes that can be in the picture
    errors: FloatArray  # (M,) pixels, see `node_errors`
    least_error: float  # pixels that the greatest error of what is drawn comes to
    n_seen: int  # splats of the cut that can be in the picture
    n_all: int


def choose_cut(
    tree: LodTree,
    boxes: FloatArray,
    camera: Camera,
    budget: int,
    *,
    before: BoolArray | None = None,
    exact: BoolArray | None = None,
    hidden: BoolArray | None = None,
) -> Cut:
    """The finest cut with at most ``budget`` splats in the picture.

    ``boxes`` (M, 6) are those of the nodes as the scene is now,
    ``before`` (M,) the divided nodes of the last cut, which stay so for a little longer. Nodes of
    ``exact`` (M,) that are seen are divided whatever their size, as far as the budget allows. Those
    of ``hidden`` (M,) lie behind others: they are drawn coarser.
    """
    n = tree.n_nodes
    errors, seen = np.empty(n, np.float32), np.empty(n, np.bool_)
    K, width, height = camera.K, camera.width, camera.height
    lens = np.array(
        [K[0, 0], K[1, 1], K[0, 2], K[1, 2], width, height, NEAR, MARGIN * max(width, height)]
    )
    pose = np.ascontiguousarray(camera.cam_from_world[:3], np.float64)
    node_errors(boxes, tree.details, pose, lens, _OUTSIDE, errors, seen)
    if hidden is not None:
        errors[hidden & seen] *= np.float32(_HIDDEN)
    if before is not None:
        errors[before] *= np.float32(_KEPT)
    if exact is not None:
        errors[exact & seen] += np.float32(_DIVIDED)
    divided = np.empty(n, np.bool_)

    def count(values: FloatArray, least: float) -> tuple[int, int]:
        n_seen, n_all = divide(values, seen, tree.counts, tree.first_nodes, FAN, least, divided)
        return int(n_seen), int(n_all)

    def fits(least: float) -> bool:
        return count(errors, least)[0] <= budget

    def leaves_room(share: float) -> bool:
        values = np.where(seen, errors, errors * np.float32(share))
        return count(values, least)[1] <= _ROOM * budget

    # First what is in the picture, then what there is room for besides.
    least = LEAST_ERROR
    if not fits(least):
        least = _least_that(fits, LEAST_ERROR, 4 * _DIVIDED)
    if not leaves_room(1.0):
        coarser = _least_that(lambda factor: leaves_room(1 / factor), 1.0, _DIVIDED)
        errors = np.where(seen, errors, errors / np.float32(coarser))
    found = count(errors, least)
    return Cut(divided, seen, errors, least, *found)


def _least_that(holds: Callable[[float], bool], low: float, high: float) -> float:
    """The least value above ``low``, for which it does not hold, up to ``high``."""
    lower, upper = np.log(low), np.log(high)
    for _ in range(_STEPS):
        middle = (lower + upper) / 2
        if holds(float(np.exp(middle))):
            upper = middle
        else:
            lower = middle
    return float(np.exp(upper))


def picture_shares(counts: IntArray, errors: FloatArray, camera: Camera) -> DoubleArray:
    """About what share (K,), 0..1, of the picture the splats of nodes cover.

    ``counts`` (K,) of splats, ``errors`` (K,) of `choose_cut`: about two standard deviations of the
    largest ones in pixels.
    """
    # Those that are divided whatever their size have their own error on top.
    pixels = np.where(errors >= _DIVIDED, errors - _DIVIDED, errors).astype(np.float64)
    covered = _COVERED * counts * pixels**2
    return np.minimum(covered / (camera.width * camera.height), 1.0)


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


# --- Which nodes lie behind what is opaque: the splats of the last cut, counted in coarse cells.
# The idea of occlusion maps (Zhang 1997), without a picture: what splats cover adds up in the cell
# of their centre, by depth. Where it adds up to several layers, also in all cells around, the view
# ends. A node that lies wholly behind is not left out but drawn coarser, so an error leaves no
# hole.


_CELLS = 72  # along the longer side of the picture
_DEPTHS = 96
_FARTHEST = 1e5  # times the nearest depth: what lies behind hides nothing
_OPAQUE = 2.0  # layers; seen from the front they are twice as many: e^-4 of what is behind shows
_THIN = 0.4  # share of them that each cell has alone, or there may be a gap


def covers_of(log_scales: FloatArray, logit_opacities: FloatArray) -> FloatArray:
    """What splats cover (K,), world units squared: the mean over all directions, by opacity."""
    with np.errstate(over="ignore", invalid="ignore"):
        a, b, c = np.exp(log_scales.T)
        faces = np.float32(np.pi) * (a * b + b * c + c * a)
        covers: FloatArray = faces / (1 + np.exp(-logit_opacities))
    return covers


def hidden_nodes(
    boxes: FloatArray, means: FloatArray, covers: FloatArray, camera: Camera
) -> BoolArray:
    """Nodes (M,) of these boxes (M, 6) of which the picture shows next to nothing.

    ``means`` (K, 3) and ``covers`` (K,) are samples of the splats that are drawn, opaque as they
    are: of n splats each counts for n / K of them. What lies out of the picture is never hidden.
    """
    share = _CELLS / max(camera.width, camera.height)
    width = max(round(camera.width * share), 1)
    height = max(round(camera.height * share), 1)
    K, x, y = camera.K, width / camera.width, height / camera.height
    lens = np.array([K[0, 0] * x, K[1, 1] * y, K[0, 2] * x, K[1, 2] * y])
    pose: DoubleArray = np.ascontiguousarray(camera.cam_from_world[:3], np.float64)
    bins = _DEPTHS / np.log(_FARTHEST)
    grid = np.zeros((height, width, _DEPTHS), np.float32)
    cover_cells(means, covers, pose, lens, NEAR, bins, grid)
    depths = np.empty((height, width), np.float32)
    end_depths(grid, NEAR, bins, _OPAQUE, _THIN, depths)
    hidden = np.empty(len(boxes), np.bool_)
    behind(boxes, pose, lens, NEAR, depths, hidden)
    return hidden
