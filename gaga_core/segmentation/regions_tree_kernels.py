"""Kernel of the weights-free regions: where the tree of merges is cut."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel

# Weights of a merge's penalty, in the order of the array that the kernel takes.
START, SMALL, LARGE, FILLED, FILL, RAGGED, INSIDE, TAKEN = range(8)


@kernel
def cut(
    joined: IntArray,  # (M, 2) larger, smaller of each merge; the larger's index goes on
    costs: FloatArray,  # (M,)
    common: FloatArray,  # (M,) pixel pairs along the border that vanished
    area: FloatArray,  # (n,) pixels of the pieces; this and the next three are changed in place
    border: FloatArray,  # (n,) pixel pairs along the borders to other pieces
    edge: FloatArray,  # (n,) pixels along the edge of the picture
    box: IntArray,  # (n, 4) first and last column, first and last row
    weights: DoubleArray,  # (8,) START..TAKEN
    limit: float,  # doubt from which a merge is not made
    parent: IntArray,  # (n,) own indices; written: whom each piece joined
) -> None:
    """Make the merges whose doubt, and that of all merges within them, is under ``limit``.

    The doubt of a merge is the logarithm of its cost less what its shape speaks for it: it grows
    with the merges within, so that a lower limit only ever splits further.
    """
    total = area.sum()
    doubt = np.full(len(area), -np.inf)
    for step in range(len(joined)):
        a, b = joined[step]
        filled = area[b] / ((box[b, 1] - box[b, 0] + 1) * (box[b, 3] - box[b, 2] + 1))
        granted = weights[START]
        granted += weights[SMALL] * np.log(area[b] / total)
        granted += weights[LARGE] * np.log(area[a] / total)
        granted += weights[INSIDE] * common[step] / max(border[b], 1)
        granted += weights[TAKEN] * common[step] / max(border[a], 1)
        area[a] += area[b]
        border[a] += border[b] - 2 * common[step]
        edge[a] += edge[b]
        for k in range(2):
            box[a, 2 * k] = min(box[a, 2 * k], box[b, 2 * k])
            box[a, 2 * k + 1] = max(box[a, 2 * k + 1], box[b, 2 * k + 1])
        fill = area[a] / ((box[a, 1] - box[a, 0] + 1) * (box[a, 3] - box[a, 2] + 1))
        granted += weights[FILL] * fill + weights[FILLED] * (fill - filled)
        granted += weights[RAGGED] * np.log((border[a] + edge[a]) ** 2 / area[a])
        doubt[a] = max(doubt[a], doubt[b], np.log(costs[step] + 1e-6) - granted)
        if doubt[a] < limit:
            parent[b] = a
