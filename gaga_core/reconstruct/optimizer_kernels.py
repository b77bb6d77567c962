"""Kernels of the optimiser, and of what density control sums up along with it."""

import math

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.kernels import kernel
from gaga_core.simd_kernels import prefetch

_F = np.float32
_BETA1, _BETA2, _EPSILON = _F(0.9), _F(0.999), _F(1e-15)
_REST1, _REST2 = _F(1.0 - 0.9), _F(1.0 - 0.999)
_AHEAD = 12  # rows whose memory is asked for before they are needed
_LINE = 16  # numbers of a cache line


@kernel
def adam_rows(
    rows: IntArray,  # (n,) rows to change
    gradient: FloatArray,  # (n, C)
    values: FloatArray,  # (N, C) changed
    first: FloatArray,  # (N, C) changed: running mean of the gradient
    second: FloatArray,  # (N, C) changed: running mean of its square
    rates: FloatArray,  # (C,) learning rate over the first bias correction
    correction: float,  # 1 / the second bias correction
    start: int,
    stop: int,
) -> None:
    """One step of Adam (Kingma 2015) for rows[start:stop]; all other rows rest."""
    n_columns = values.shape[1]
    unbias = _F(correction)
    for k in range(start, stop):
        ahead = n_columns * rows[min(k + _AHEAD, stop - 1)]
        for c in range(ahead, ahead + n_columns, _LINE):
            prefetch(values, c)
            prefetch(first, c)
            prefetch(second, c)
        i = rows[k]
        for c in range(n_columns):
            g = gradient[k, c]
            m = _BETA1 * first[i, c] + _REST1 * g
            v = _BETA2 * second[i, c] + _REST2 * (g * g)
            first[i, c] = m
            second[i, c] = v
            values[i, c] -= rates[c] * np.divide(m, _F(math.sqrt(v * unbias)) + _EPSILON)


@kernel
def add_view(
    rows: IntArray,  # (n,) splats that a view draws, each once
    screen: FloatArray,  # (n,)
    gradient: FloatArray,  # (N,) changed: ``screen`` is added
    n_views: IntArray,  # (N,) changed: 1 is added
) -> None:
    """Count a view of the splats ``rows``."""
    for k in range(len(rows)):
        gradient[rows[k]] += screen[k]
        n_views[rows[k]] += 1
