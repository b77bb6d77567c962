"""Which splats of a window become one: those that are most alike are merged first."""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, LongArray
from gaga_core.kernels import exact_kernel, kernel
from gaga_core.scene.splat_kernels import turn_of

_SH_C0 = 0.28209479177387814
# What a squared distance counts, in units of the two splats' own extent, against a squared
# difference of colors. 0.01 to 0.1 are within 0.1 dB of each other.
_APART = 0.03
_THIN = 0.01  # share of two splats' size that is added to their thickness
_WORST = 1e300  # also of what is not finite
_TINY = 1e-30


@kernel
def _describe(
    f: DoubleArray,  # (W, 13) out: weight, mean, color, covariance xx, xy, xz, yy, yz, zz
    means: FloatArray,
    quats: FloatArray,
    log_scales: FloatArray,
    logits: FloatArray,
    sh: FloatArray,
    first: int,
    n: int,
    turn: DoubleArray,  # (3, 3) scratch
) -> None:
    """Moments of the splats ``first`` to ``first + n``, in units of the largest of them."""
    unit = -np.inf
    for i in range(first, first + n):
        for axis in range(3):
            if unit < log_scales[i, axis] < np.inf:
                unit = np.float64(log_scales[i, axis])
    unit = max(unit, -1e30)
    shrink = math.exp(-unit)
    for i in range(n):
        k = first + i
        a = math.exp(log_scales[k, 0] - unit)
        b = math.exp(log_scales[k, 1] - unit)
        c = math.exp(log_scales[k, 2] - unit)
        opacity = 1.0 / (1.0 + math.exp(-np.float64(logits[k])))
        f[i, 0] = (a * b + b * c + c * a) * opacity + _TINY
        for x in range(3):
            f[i, 1 + x] = (np.float64(means[k, x]) - np.float64(means[first, x])) * shrink
            f[i, 4 + x] = _SH_C0 * sh[k, 0, x]
        turn_of(quats[k], turn)
        a, b, c = a * a, b * b, c * c
        at = 7
        for x in range(3):
            for y in range(x, 3):
                f[i, at] = turn[x, 0] * a * turn[y, 0] + turn[x, 1] * b * turn[y, 1]
                f[i, at] += turn[x, 2] * c * turn[y, 2]
                at += 1


@kernel
def _cost(f: DoubleArray, i: int, j: int) -> float:
    """What merging two rows of `_describe` loses (the variance of Ward 1963, of color and place).

    Places are measured by the sum of the two covariances: along a common surface splats may lie
    further apart than across it.
    """
    a, d, e = f[i, 7] + f[j, 7], f[i, 10] + f[j, 10], f[i, 12] + f[j, 12]
    thick = _THIN * (a + d + e)
    a, d, e = a + thick, d + thick, e + thick
    p, q, s = f[i, 8] + f[j, 8], f[i, 9] + f[j, 9], f[i, 11] + f[j, 11]
    x, y, z = f[i, 1] - f[j, 1], f[i, 2] - f[j, 2], f[i, 3] - f[j, 3]
    m0, m1, m2 = d * e - s * s, q * s - p * e, p * s - q * d
    square = x * x * m0 + y * y * (a * e - q * q) + z * z * (a * d - p * p)
    square += 2 * (x * y * m1 + x * z * m2 + y * z * (p * q - a * s))
    far = square / (a * m0 + p * m1 + q * m2)
    red, green, blue = f[i, 4] - f[j, 4], f[i, 5] - f[j, 5], f[i, 6] - f[j, 6]
    weight = f[i, 0] * f[j, 0] / (f[i, 0] + f[j, 0])
    cost = weight * (red * red + green * green + blue * blue + _APART * far)
    return cost if cost < _WORST else _WORST


@kernel
def _absorb(f: DoubleArray, i: int, j: int) -> None:
    """Let row i of `_describe` be both rows together."""
    total = f[i, 0] + f[j, 0]
    u, v = f[i, 0] / total, f[j, 0] / total
    x, y, z = f[i, 1] - f[j, 1], f[i, 2] - f[j, 2], f[i, 3] - f[j, 3]
    for k in range(1, 13):
        f[i, k] = u * f[i, k] + v * f[j, k]
    f[i, 7] += u * v * x * x
    f[i, 8] += u * v * x * y
    f[i, 9] += u * v * x * z
    f[i, 10] += u * v * y * y
    f[i, 11] += u * v * y * z
    f[i, 12] += u * v * z * z
    f[i, 0] = total


@kernel
def _nearest(
    costs: DoubleArray,  # (W, W) above the diagonal
    alive: LongArray,  # (W,) ascending
    at: int,
    left: int,
    near: LongArray,  # (W,) out
    least: DoubleArray,  # (W,) out
) -> None:
    """Of the rows behind ``alive[at]`` the one that it merges with best."""
    k = alive[at]
    least[k], near[k] = np.inf, -1
    for q in range(at + 1, left):
        other = alive[q]
        if costs[k, other] < least[k]:
            least[k], near[k] = costs[k, other], other


@kernel
def cluster_windows(
    means: FloatArray,  # (N, 3)
    quats: FloatArray,  # (N, 4)
    log_scales: FloatArray,  # (N, 3)
    logits: FloatArray,  # (N,)
    sh: FloatArray,  # (N, S, 3)
    window: int,  # rows that are looked at together; a multiple of ``fan``
    fan: int,
    order: LongArray,  # (N,) out: rows, run after run
    starts: LongArray,  # (P,) out: places in ``order`` at which the runs begin
    first: int,
    last: int,
) -> None:
    """Divide the windows ``first`` to ``last`` into a ``fan``-th as many runs of any length.

    The two runs that lose least become one, again and again. Runs, and the rows in them, are in
    the order of their first rows.
    """
    n = means.shape[0]
    f, costs = np.empty((window, 13)), np.empty((window, window))
    near, least = np.empty(window, np.int64), np.empty(window)
    run, alive = np.empty(window, np.int64), np.empty(window, np.int64)
    turn = np.empty((3, 3))
    for w in range(first, last):
        begin = w * window
        left = n_rows = min(window, n - begin)
        _describe(f, means, quats, log_scales, logits, sh, begin, n_rows, turn)
        for i in range(n_rows):
            run[i] = alive[i] = i
        for i in range(n_rows):
            for j in range(i + 1, n_rows):
                costs[i, j] = _cost(f, i, j)
            _nearest(costs, alive, i, n_rows, near, least)
        while left > (n_rows + fan - 1) // fan:
            i = alive[0]
            for q in range(1, left - 1):
                if least[alive[q]] < least[i]:
                    i = alive[q]
            j = near[i]
            _absorb(f, i, j)
            for k in range(n_rows):
                if run[k] == j:
                    run[k] = i
            at = 0
            for q in range(left):
                if alive[q] != j:
                    alive[at] = alive[q]
                    at += 1
            left -= 1
            for q in range(left):
                k = alive[q]
                if k != i:
                    costs[min(k, i), max(k, i)] = _cost(f, min(k, i), max(k, i))
            for q in range(left):
                k = alive[q]
                if k == i or near[k] == i or near[k] == j:
                    _nearest(costs, alive, q, left, near, least)
                elif k < i and costs[k, i] < least[k]:
                    least[k], near[k] = costs[k, i], i
        place = begin
        for q in range(left):
            starts[w * (window // fan) + q] = place
            for k in range(n_rows):
                if run[k] == alive[q]:
                    order[place] = begin + k
                    place += 1


# --- Places of points along a Hilbert curve: neighbours on the curve are neighbours in space.


BITS = 21  # an axis: three of them fit into 63 bits


@exact_kernel
def hilbert_keys(
    means: FloatArray,  # (N, 3)
    centre: FloatArray,  # (3,)
    half: float,  # half the side of the cube that most points lie in
    keys: np.ndarray,  # (N,) uint64 out
    start: int,
    stop: int,
) -> None:
    """Hilbert keys of rows start..stop (Skilling 2004, Programming the Hilbert curve).

    The cube takes half of the curve's range on each axis; what lies outside is drawn in by
    2 - 1 / x, so that far points keep their order (the contraction of Barron 2022, axis by axis).
    """
    top = np.uint32(1 << (BITS - 1))
    most = float((1 << BITS) - 1)
    x = np.empty(3, np.uint32)
    for i in range(start, stop):
        for a in range(3):
            u = (float(means[i, a]) - float(centre[a])) / half
            if u > 1.0:
                u = 2.0 - 1.0 / u
            elif u < -1.0:
                u = -2.0 - 1.0 / u
            x[a] = np.uint32(min(max((u + 2.0) * 0.25, 0.0), 1.0) * most)
        q = top
        while q > 1:
            p = np.uint32(q - 1)
            for a in range(3):
                if x[a] & q:
                    x[0] ^= p
                else:
                    t = (x[0] ^ x[a]) & p
                    x[0] ^= t
                    x[a] ^= t
            q >>= np.uint32(1)
        x[1] ^= x[0]
        x[2] ^= x[1]
        t = np.uint32(0)
        q = top
        while q > 1:
            if x[2] & q:
                t ^= np.uint32(q - 1)
            q >>= np.uint32(1)
        key = np.uint64(0)
        for a in range(3):
            x[a] ^= t
        for b in range(BITS - 1, -1, -1):
            for a in range(3):
                bit = (x[a] >> np.uint32(b)) & np.uint32(1)
                key = (key << np.uint64(1)) | np.uint64(bit)
        keys[i] = key
