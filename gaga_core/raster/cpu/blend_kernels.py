"""Kernels that blend tiles: color and depth, more channels, weights of sampled pixels.

Each works on tiles ``start`` to ``stop`` of 16 x 16 pixels; splat outside, pixels inside, whole
rows of 16 pixels so that a row is one or two vector registers (see `project_kernels` for a splat's
columns). T is the transmittance of a pixel; a finished pixel, or one beyond the picture, holds it
negated: every later splat then fails the same comparison without a branch. The row of six lines
that turns a splat into weights is repeated in each kernel on purpose: as a function it is not
vectorised together with what follows.
"""

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V

WIDE = 16  # channels of one pass of `blend_wide`
_F = np.float32
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
# The image model of raster/base.py.
_ALPHA_MIN, _ALPHA_MAX, _T_MIN = _F(1 / 255), _F(0.99), _F(1e-4)
# exp(-5.7) < 1/255: under this exponent nothing is drawn, and `_exp` need not be right.
_LOWEST = _F(-5.7)
_CHECK = 15  # look for an end every 16 splats
# Planes of a tile's working memory in `blend`. One array for all: the compiler then knows that they
# do not overlap and vectorises without asking (half the time of an array each).
_T, _C0, _C1, _C2, _DEPTH, _MEDIAN = range(6)


@kernel
def _exp(x: np.float32) -> np.float32:
    """exp on [-5.7, 0] as p(x / 8)^8, relative error 3e-6: unlike libm's, it vectorises.

    p is the polynomial of degree 5 with p(0) = 1 of the smallest relative error.
    """
    y = x * _F(0.125)
    p = _F(0.039789192) + y * _F(0.0058484054)
    p = _F(0.4998927) + y * (_F(0.16599582) + y * p)
    p = _ONE + y * (_F(0.9999943) + y * p)
    p = p * p
    p = p * p
    return p * p


@kernel
def _open_tile(T: FloatArray, n_rows: int, n_columns: int) -> None:
    for y in range(TILE):
        for x in range(TILE):
            T[y, x] = _ONE if y < n_rows and x < n_columns else -_ONE


@kernel
def _is_done(T: FloatArray) -> np.bool_:
    most = -_ONE
    for y in range(TILE):
        for x in range(TILE):
            most = max(most, T[y, x])
    return most <= _ZERO


@kernel
def blend(
    splats: FloatArray,
    depths: FloatArray,
    colors: FloatArray,  # (n, 3)
    offsets: LongArray,
    ids: IntArray,
    background: FloatArray,  # (3,)
    image: FloatArray,  # (H, W, C): the first min(C, 3) channels are written
    alpha: FloatArray,
    expected: FloatArray,
    median: FloatArray,
    start: int,
    stop: int,
) -> None:
    """Three channels, alpha, expected and median depth."""
    height, width, n_channels = image.shape
    n_tiles_x = (width + TILE - 1) // TILE
    planes = np.empty((6, TILE, TILE), np.float32)
    T = planes[_T]
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        planes[1:] = _ZERO
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            f0, f1, f2, z = colors[k, 0], colors[k, 1], colors[k, 2], depths[k]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = s * _F(x) + shift
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, rest - e * e)))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = planes[_T, y, x]
                    after = before - before * a
                    goes_on = after >= _T_MIN
                    w = a * before if goes_on else _ZERO
                    planes[_T, y, x] = after if goes_on else -abs(before)
                    planes[_C0, y, x] += w * f0
                    planes[_C1, y, x] += w * f1
                    planes[_C2, y, x] += w * f2
                    planes[_DEPTH, y, x] += w * z
                    crosses = (before > _HALF) & (after <= _HALF)
                    planes[_MEDIAN, y, x] = z if crosses else planes[_MEDIAN, y, x]
            if (j & _CHECK) == _CHECK and _is_done(T):
                break
        for y in range(n_rows):
            for x in range(n_columns):
                t = abs(planes[_T, y, x])
                covered = _ONE - t
                alpha[top + y, left + x] = covered
                expected[top + y, left + x] = (
                    planes[_DEPTH, y, x] / covered if covered > _ZERO else _ZERO
                )
                median[top + y, left + x] = planes[_MEDIAN, y, x]
                image[top + y, left + x, 0] = planes[_C0, y, x] + t * background[0]
                if n_channels > 1:
                    image[top + y, left + x, 1] = planes[_C1, y, x] + t * background[1]
                if n_channels > 2:
                    image[top + y, left + x, 2] = planes[_C2, y, x] + t * background[2]


@kernel
def blend_wide(
    splats: FloatArray,
    features: FloatArray,  # (n, WIDE)
    offsets: LongArray,
    ids: IntArray,
    background: FloatArray,  # (C,)
    image: FloatArray,  # (H, W, C)
    first: int,
    start: int,
    stop: int,
) -> None:
    """Channels ``first`` to ``first + WIDE`` of ``image`` (as many as it has)."""
    height, width, n_channels = image.shape
    n_tiles_x = (width + TILE - 1) // TILE
    T = np.empty((TILE, TILE), np.float32)
    weights = np.empty(TILE, np.float32)
    total = np.empty((TILE, WIDE, TILE), np.float32)
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        total[:] = _ZERO
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = s * _F(x) + shift
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, rest - e * e)))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = before - before * a
                    goes_on = after >= _T_MIN
                    weights[x] = a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
                for c in range(WIDE):
                    f = features[k, c]
                    for x in range(TILE):
                        total[y, c, x] += weights[x] * f
            if (j & _CHECK) == _CHECK and _is_done(T):
                break
        for y in range(n_rows):
            for x in range(n_columns):
                t = abs(T[y, x])
                for c in range(min(WIDE, n_channels - first)):
                    image[top + y, left + x, first + c] = total[y, c, x] + t * background[first + c]


@kernel
def sample_weights(
    splats: FloatArray,
    order: IntArray,
    offsets: LongArray,
    ids: IntArray,
    samples: LongArray,  # (P,) flat pixels, grouped by tile, ascending inside a tile
    sample_offsets: LongArray,  # (n_tiles + 1,)
    n_tiles_x: int,
    width: int,
    w_min: float,
    row_ends: LongArray,  # (P,) entries of each sample: counted, or where its next entry goes
    indices: IntArray,
    values: FloatArray,
    writes: bool,
    start: int,
    stop: int,
) -> None:
    """Count (``writes`` false) or write the blending weights of sampled pixels."""
    longest = 0
    for tile in range(start, stop):
        longest = max(longest, sample_offsets[tile + 1] - sample_offsets[tile])
    T = np.empty(longest, np.float32)
    xs, ys, weights = np.empty_like(T), np.empty_like(T), np.empty_like(T)
    row_start = np.empty(TILE + 1, np.int64)
    least = _F(w_min)
    for tile in range(start, stop):
        begin = sample_offsets[tile]
        n = sample_offsets[tile + 1] - begin
        if n == 0:
            continue
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        row_start[:] = 0
        for m in range(n):
            x, y = samples[begin + m] % width - left, samples[begin + m] // width - top
            xs[m], ys[m], T[m] = _F(x), _F(y), _ONE
            row_start[y + 1] += 1
        for y in range(TILE):
            row_start[y + 1] += row_start[y]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            m0 = row_start[max(0, int(splats[k, Y0]) - top)]
            m1 = row_start[min(TILE, int(splats[k, Y1]) - top)]
            for m in range(m0, m1):
                dy = ys[m] - v
                e = s * (xs[m] - u - r * dy)
                a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, -h * dy * dy - e * e)))
                a = a if a >= _ALPHA_MIN else _ZERO
                before = T[m]
                after = before - before * a
                goes_on = after >= _T_MIN
                weights[m] = a * before if goes_on else _ZERO
                T[m] = after if goes_on else -abs(before)
            if writes:
                for m in range(m0, m1):
                    if weights[m] > least:
                        indices[row_ends[begin + m]] = order[k]
                        values[row_ends[begin + m]] = weights[m]
                        row_ends[begin + m] += 1
            else:
                for m in range(m0, m1):
                    row_ends[begin + m] += 1 if weights[m] > least else 0
            if (j & _CHECK) == _CHECK:
                most = -_ONE
                for m in range(n):
                    most = max(most, T[m])
                if most <= _ZERO:
                    break
