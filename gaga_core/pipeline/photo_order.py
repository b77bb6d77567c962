"""In which order photos are segmented: those that tell most first, so that a run may stop early.

A photo tells what it shows and no photo before it has shown. Gaussians that it shows count in full
the first time, half the second, a quarter the third: a greedy cover of the scene, several times
over, since an object is found by the views that agree on it.
"""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage

_MOST = 20_000  # Gaussians that are looked at
_CELLS = 64  # of the coarse depth picture along its width
_BEHIND = 1.08  # times the nearest depth of a cell: as far as that a Gaussian is seen
_LEAST_LOGIT = -0.85  # opacity 0.3: fainter ones hide nothing and are not counted
_FADE = 0.5  # what a Gaussian counts the next time


def coverage_order(gaussians: Gaussians, cameras: Sequence[Camera]) -> Stage[IntArray]:
    """Indices (V,) of ``cameras``, the photo that tells most first; of equals the first by index.

    Uses some of the Gaussians, evenly taken, and a coarse depth picture for what hides them: a
    guess that is good enough for an order. Frames: world for the Gaussians, as the cameras say.
    """
    opaque = np.flatnonzero(gaussians.logit_opacities > _LEAST_LOGIT)
    chosen = opaque[:: max(1, -(-len(opaque) // _MOST))]
    points = gaussians.means[chosen].astype(np.float64)
    sees = np.zeros((len(cameras), len(points)), np.bool_)
    for i, camera in enumerate(cameras):
        yield Progress("Order the photos", i, len(cameras), camera.name)
        sees[i] = visible(points, camera)
    return greedy_cover(sees)


def visible(points: DoubleArray, camera: Camera) -> BoolArray:
    """Which points (N, 3) world the photo shows (N,), by a coarse depth picture."""
    pixels, depth = camera.project(points)
    scale = _CELLS / camera.width
    rows = max(1, round(camera.height * scale))
    inside = (depth > 0) & (pixels >= 0).all(axis=1)
    inside &= (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
    index = np.flatnonzero(inside)
    column = np.minimum((pixels[index, 0] * scale).astype(np.int64), _CELLS - 1)
    row = np.minimum((pixels[index, 1] * scale).astype(np.int64), rows - 1)
    cell = row * _CELLS + column
    nearest = np.full(rows * _CELLS, np.inf)
    np.minimum.at(nearest, cell, depth[index])
    shown = np.zeros(len(points), np.bool_)
    shown[index] = depth[index] <= _BEHIND * nearest[cell]
    return shown


def greedy_cover(sees: BoolArray) -> IntArray:
    """Order (V,) of the rows of ``sees`` (V, N): each adds most to those before it."""
    left = list(range(len(sees)))
    weight = np.ones(sees.shape[1], np.float32)
    order: list[int] = []
    while left:
        gains = sees[left] @ weight
        best = left.pop(int(np.argmax(gains)))
        order.append(best)
        weight[sees[best]] *= _FADE
    return np.array(order, np.int32)
