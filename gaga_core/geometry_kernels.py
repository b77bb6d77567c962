"""Eigenvectors of one symmetric 3 x 3 matrix, for kernels that merge splats.

Of many: `geometry.principal_axes`, which needs no compiler.
"""

import math

from gaga_core.arrays import DoubleArray
from gaga_core.kernels import exact_kernel

_SWEEPS = 12  # of Jacobi rotations; 5 to 7 are enough for 3 x 3


@exact_kernel
def eigen(c: DoubleArray, axes: DoubleArray) -> None:
    """Diagonalise the symmetric ``c`` (3, 3) in place; its eigenvectors become columns of ``axes``
    (Jacobi's method: no differences of squares, so thin splats stay thin)."""
    for i in range(3):
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    for _ in range(_SWEEPS):
        off = abs(c[0, 1]) + abs(c[0, 2]) + abs(c[1, 2])
        if not off > 1e-18 * (abs(c[0, 0]) + abs(c[1, 1]) + abs(c[2, 2])):
            return
        for p in range(2):
            for q in range(p + 1, 3):
                if c[p, q] == 0.0:
                    continue
                theta = (c[q, q] - c[p, p]) / (2.0 * c[p, q])
                if abs(theta) > 1e150:
                    t = 0.5 / theta
                else:
                    t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                    if theta < 0.0:
                        t = -t
                cosine = 1.0 / math.sqrt(t * t + 1.0)
                sine = t * cosine
                h = t * c[p, q]
                c[p, p] -= h
                c[q, q] += h
                c[p, q] = 0.0
                c[q, p] = 0.0
                r = 3 - p - q
                a, b = c[r, p], c[r, q]
                c[r, p] = cosine * a - sine * b
                c[p, r] = c[r, p]
                c[r, q] = sine * a + cosine * b
                c[q, r] = c[r, q]
                for i in range(3):
                    a, b = axes[i, p], axes[i, q]
                    axes[i, p] = cosine * a - sine * b
                    axes[i, q] = sine * a + cosine * b
