"""Continue values smoothly into cells where they are not known."""

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray

_WEAK = 1e-6  # pull to the mean: decides where nothing known is next to the cells


def continued(values: DoubleArray, known: BoolArray, wanted: BoolArray) -> DoubleArray:
    """``values`` (H, W, C) with the ``wanted`` cells (H, W) between ``known`` ones.

    The harmonic (membrane) interpolation: each wanted cell is the mean of its neighbours that are
    known or wanted; others do not count, so no value comes from outside.
    """
    result = values.copy()
    n = int(wanted.sum())
    if n == 0 or not known.any():
        return result
    index = np.full(wanted.shape, -1)
    index[wanted] = np.arange(n)
    diagonal = np.full(n, _WEAK)
    right = np.tile(_WEAK * values[known].mean(axis=0), (n, 1))
    pairs = []
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        to, inside = _shifted(index, axis, step), _shifted(np.ones_like(wanted), axis, step)
        fixed = wanted & inside.astype(bool) & _shifted(known & ~wanted, axis, step).astype(bool)
        linked = wanted & inside.astype(bool) & (to >= 0)
        diagonal[index[fixed]] += 1
        neighbour = np.stack(
            [_shifted(values[:, :, c], axis, step) for c in range(values.shape[2])], 2
        )
        right[index[fixed]] += neighbour[fixed]
        diagonal[index[linked]] += 1
        pairs.append((index[linked], to[linked]))
    i = np.concatenate([a for a, _ in pairs])
    j = np.concatenate([b for _, b in pairs])
    both = np.arange(n)
    matrix = coo_matrix(
        (np.append(-np.ones(len(i)), diagonal), (np.append(i, both), np.append(j, both))),
        shape=(n, n),
    ).tocsc()
    result[wanted] = splu(matrix).solve(right)
    return result


def _shifted(values: AnyArray, axis: int, step: int) -> AnyArray:
    """The values of each cell's neighbour; at the border False or -1 (what a zero or index is)."""
    moved = np.roll(values, -step, axis)
    edge = [slice(None)] * values.ndim
    edge[axis] = slice(-1, None) if step > 0 else slice(0, 1)
    moved[tuple(edge)] = -1 if values.dtype.kind == "i" else 0
    return moved


def blurred(values: DoubleArray, weights: DoubleArray, sigma: float) -> DoubleArray:
    """Mean of ``values`` (H, W, C) around each cell, weighted by ``weights`` (H, W)."""
    below = ndimage.gaussian_filter(weights, sigma)
    return np.stack(
        [
            ndimage.gaussian_filter(values[:, :, c] * weights, sigma) / np.maximum(below, 1e-9)
            for c in range(values.shape[2])
        ],
        axis=2,
    )


def smooth_base(color: DoubleArray, known: BoolArray, hole: BoolArray, sigma: float) -> DoubleArray:
    """What the color (H, W, C) is without its texture, in known cells and in the hole.

    A linear trend fitted around the hole (light falls off over a surface), and the membrane of
    what is left of it.
    """
    rows, columns = np.indices(known.shape)
    distance = ndimage.distance_transform_edt(~hole) if hole.any() else np.ones(known.shape)
    reach = 2 + np.sqrt(hole.sum())
    weight = known * np.exp(-((distance / reach) ** 2))
    terms = np.stack(
        [
            np.ones(known.shape),
            (rows - rows.mean()) / rows.max(),
            (columns - columns.mean()) / columns.max(),
        ],
        axis=2,
    )
    root = np.sqrt(weight[known])[:, None]
    trend_weights = np.linalg.lstsq(root * terms[known], root * color[known], rcond=None)[0]
    trend = terms @ trend_weights
    left = np.where(known[:, :, None], color - trend, 0)
    low = blurred(left, known.astype(float), sigma)
    result: DoubleArray = trend + continued(low, known, hole)
    return result
