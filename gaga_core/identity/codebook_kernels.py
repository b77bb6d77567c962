"""Kernel of the code book's repulsion."""

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.identity.linear_kernels import D, exp_below_zero
from gaga_core.kernels import kernel

_F = np.float32
_ZERO, _ONE = _F(0), _F(1)


@kernel
def repulsion(
    codes: FloatArray,  # (K, D) unit length
    codes_t: FloatArray,  # (D, K) the same
    sharpness: float,
    push: FloatArray,  # (K, D) out: mean of the other codes, the nearest weighted most
) -> np.float32:
    """Direction that each code is pushed away from; returns the greatest cosine of two codes."""
    K = codes.shape[0]
    row = np.empty(K, np.float32)
    sharp, greatest = _F(sharpness), -_ONE
    for i in range(K):
        for k in range(K):
            row[k] = _ZERO
        for c in range(D):
            f = codes[i, c]
            for k in range(K):
                row[k] += f * codes_t[c, k]
        row[i] = _F(-2)  # itself: under any cosine
        nearest = _F(-2)
        for k in range(K):
            nearest = max(nearest, row[k])
        greatest = max(greatest, nearest)
        total = _ZERO
        for k in range(K):
            e = exp_below_zero(max(_F(-87), sharp * (row[k] - nearest)))
            row[k] = e
            total += e
        total -= row[i]
        row[i] = _ZERO
        for c in range(D):
            away = _ZERO
            for k in range(K):
                away += row[k] * codes_t[c, k]
            push[i, c] = away / total
    return greatest
