"""Axes of symmetric 3 x 3 matrices, the same bits on every processor."""

import math

from gaga_core.arrays import DoubleArray
from gaga_core.kernels import exact_kernel

_SWEEPS = 12  # of Jacobi rotations; 5 to 7 are enough for 3 x 3
_SAME = 1e-6  # of the largest: eigenvalues, and components of an axis, that count as equal


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


@exact_kernel
def principal(
    moments: DoubleArray,  # (N, 3, 3) symmetric, overwritten
    values: DoubleArray,  # (N, 3) written, ascending
    axes: DoubleArray,  # (N, 3, 3) written, columns
) -> None:
    """Eigenvalues and eigenvectors; `geometry.principal_axes` says what decides equal ones."""
    for n in range(len(moments)):
        c, v, a = moments[n], values[n], axes[n]
        eigen(c, a)
        for i in range(3):
            v[i] = c[i, i]
        for i, j in ((0, 1), (1, 2), (0, 1)):
            if v[j] < v[i]:
                v[i], v[j] = v[j], v[i]
                for r in range(3):
                    a[r, i], a[r, j] = a[r, j], a[r, i]
        low, high = v[1] - v[0] <= _SAME * v[2], v[2] - v[1] <= _SAME * v[2]
        if low and high:
            a[:] = 0.0
            for i in range(3):
                a[i, i] = 1.0
        elif low:
            _across(a, 2, 0, 1)
        elif high:
            _across(a, 0, 1, 2)
        for i in range(3):
            r = _largest(a[:, i])
            if a[r, i] < 0.0:
                a[:, i] = -a[:, i]


@exact_kernel
def _largest(axis: DoubleArray) -> int:
    """The first of the largest components (3,)."""
    best = 0
    for r in range(1, 3):
        if abs(axis[r]) > abs(axis[best]) + _SAME:
            best = r
    return best


@exact_kernel
def _across(axes: DoubleArray, known: int, first: int, second: int) -> None:
    """Write two columns across a known one: the first towards the coordinate axis that lies most
    across it."""
    x, y, z = axes[0, known], axes[1, known], axes[2, known]
    least = 0
    for r in range(1, 3):
        if abs(axes[r, known]) < abs(axes[least, known]) - _SAME:
            least = r
    along = axes[least, known]
    length = math.sqrt(1.0 - along * along)
    for r in range(3):
        axes[r, first] = ((1.0 if r == least else 0.0) - along * axes[r, known]) / length
    u, v, w = axes[0, first], axes[1, first], axes[2, first]
    axes[0, second], axes[1, second], axes[2, second] = y * w - z * v, z * u - x * w, x * v - y * u
