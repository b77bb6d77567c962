"""Kernels of training: color blending, and its gradient back to every parameter of a splat.

The backward pass runs front to back like the forward one and keeps no list per pixel. With g the
gradient of the loss by a pixel's color and R the share of g . color that is still to come (at first
all of it), a splat of weight w = alpha T and color c has

    R -= w (g . c),    dL/dalpha = T (g . c) - R / (1 - alpha)

(the usual back-to-front sums of 3D Gaussian Splatting, Kerbl 2023, written for the other end).

Each (tile, splat) pair has sums of its own, in the order of the tile lists; then they are added up
by splat, tile by tile: no atomics, and no dependence of the result on threads.

They are, over the pixels of the tile, with p the exponent, e = s (dx - r dy) and d = dL/dp: sums
of d, d e, d dy, d e^2, d e dy, d dy^2, and of w g (3). Written in e and dy, the Cholesky form
of `project_kernels`, these stay well scaled for long thin splats, and no 2D covariance is inverted.
"""

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.blend_kernels import (
    _ALPHA_MAX,
    _ALPHA_MIN,
    _C0,
    _C1,
    _C2,
    _CHECK,
    _LOWEST,
    _T,
    _T_MIN,
    _exp,
    _is_done,
    _open_tile,
)
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V

SUMS = 9
_F = np.float32
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
_MIDDLE = _F(7.5)  # of a tile, in its pixel columns and rows
# Planes of a tile's working memory behind _T on the way back: R, gradient of the picture.
_LEFT, _G0, _G1, _G2 = 1, 2, 3, 4
_NOTHING = (_ZERO,) * 11  # what `_read` gives, of no splat
_Drawn = tuple[np.float32, ...]


@kernel
def _read(splats: FloatArray, colors: FloatArray, k: int) -> _Drawn:
    """The columns of splat ``k``, then its color: 11 numbers."""
    return (
        splats[k, U],
        splats[k, V],
        splats[k, S],
        splats[k, R],
        splats[k, H],
        splats[k, OPACITY],
        splats[k, Y0],
        splats[k, Y1],
        colors[k, 0],
        colors[k, 1],
        colors[k, 2],
    )


@kernel
def blend_colors(
    splats: FloatArray,
    colors: FloatArray,  # (n, 3)
    offsets: LongArray,
    ids: IntArray,
    background: FloatArray,  # (3,)
    image: FloatArray,  # (H, W, 3)
    transmittance: FloatArray,  # (H, W)
    ends: LongArray,  # (n_tiles,) entries of a tile's list behind this one were not looked at
    start: int,
    stop: int,
) -> None:
    """The picture alone, as `blend_kernels.blend` draws it, and what the way back needs."""
    height, width = transmittance.shape
    n_tiles_x = (width + TILE - 1) // TILE
    planes = np.empty((4, TILE, TILE), np.float32)
    T = planes[_T]
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        planes[1:] = _ZERO
        ends[tile] = offsets[tile + 1]
        first, last = offsets[tile], offsets[tile + 1] - 1
        following = _read(splats, colors, ids[first]) if first <= last else _NOTHING
        for j in range(first, last + 1):
            # The next splat is read before this one is drawn, which takes more instructions than a
            # processor looks ahead.
            center_x, center_y, s, r, h, opacity, begin, end, f0, f1, f2 = following
            following = _read(splats, colors, ids[min(j + 1, last)])
            u, v = center_x - _F(left) - _HALF, center_y - _F(top) - _HALF
            for y in range(max(0, int(begin) - top), min(TILE, int(end) - top)):
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
            if (j & _CHECK) == _CHECK and _is_done(T):
                ends[tile] = j + 1
                break
        for y in range(n_rows):
            for x in range(n_columns):
                t = abs(planes[_T, y, x])
                transmittance[top + y, left + x] = t
                image[top + y, left + x, 0] = planes[_C0, y, x] + t * background[0]
                image[top + y, left + x, 1] = planes[_C1, y, x] + t * background[1]
                image[top + y, left + x, 2] = planes[_C2, y, x] + t * background[2]


@kernel
def backward_tiles(
    splats: FloatArray,
    colors: FloatArray,
    offsets: LongArray,
    ids: IntArray,
    image: FloatArray,  # (H, W, 3) as `blend_colors` left it, background included
    transmittance: FloatArray,
    ends: LongArray,
    image_gradient: FloatArray,  # (H, W, 3)
    alpha_gradient: FloatArray,  # (H, W)
    partials: FloatArray,  # (M, SUMS); those behind ``ends`` are not written
    start: int,
    stop: int,
) -> None:
    """Gradient by each splat's exponent and color, summed over the pixels of each tile."""
    height, width = transmittance.shape
    n_tiles_x = (width + TILE - 1) // TILE
    planes = np.empty((5, TILE, TILE), np.float32)
    sums = np.empty((6, TILE), np.float32)  # of d, d y, d y^2, w g (3) in each column
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        planes[:] = _ZERO
        _open_tile(planes[_T], n_rows, n_columns)
        for y in range(n_rows):
            for x in range(n_columns):
                g0 = image_gradient[top + y, left + x, 0]
                g1 = image_gradient[top + y, left + x, 1]
                g2 = image_gradient[top + y, left + x, 2]
                planes[_G0, y, x] = g0
                planes[_G1, y, x] = g1
                planes[_G2, y, x] = g2
                # What is behind everything: background color, and alpha = 1 - T.
                planes[_LEFT, y, x] = (
                    g0 * image[top + y, left + x, 0]
                    + g1 * image[top + y, left + x, 1]
                    + g2 * image[top + y, left + x, 2]
                    - alpha_gradient[top + y, left + x] * transmittance[top + y, left + x]
                )
        for j in range(offsets[tile], ends[tile]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            f0, f1, f2 = colors[k, 0], colors[k, 1], colors[k, 2]
            for c in range(6):
                for x in range(TILE):
                    sums[c, x] = _ZERO
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                yl = _F(y) - _MIDDLE
                for x in range(TILE):
                    e = s * _F(x) + shift
                    raw = opacity * _exp(max(_LOWEST, rest - e * e))
                    a = min(_ALPHA_MAX, raw)
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = planes[_T, y, x]
                    after = before - before * a
                    goes_on = after >= _T_MIN
                    w = a * before if goes_on else _ZERO
                    planes[_T, y, x] = after if goes_on else -abs(before)
                    g0, g1, g2 = planes[_G0, y, x], planes[_G1, y, x], planes[_G2, y, x]
                    shade = g0 * f0 + g1 * f1 + g2 * f2
                    behind = planes[_LEFT, y, x] - w * shade
                    planes[_LEFT, y, x] = behind
                    # np.divide: the operator would check for zero, and a branch ends vectors.
                    d = a * (before * shade - np.divide(behind, _ONE - a))
                    d = d if goes_on & (raw <= _ALPHA_MAX) else _ZERO
                    sums[0, x] += d
                    sums[1, x] += d * yl
                    sums[2, x] += d * (yl * yl)
                    sums[3, x] += w * g0
                    sums[4, x] += w * g1
                    sums[5, x] += w * g2
            m0, mx, mxx, my, mxy, myy = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
            c0, c1, c2 = _ZERO, _ZERO, _ZERO
            for x in range(TILE):
                xl = _F(x) - _MIDDLE
                d = sums[0, x]
                dyl = sums[1, x]
                m0 += d
                mx += d * xl
                mxx += d * xl * xl
                my += dyl
                mxy += dyl * xl
                myy += sums[2, x]
                c0 += sums[3, x]
                c1 += sums[4, x]
                c2 += sums[5, x]
            # From moments about the tile's middle to moments of e and dy:
            # e = s xl - t yl + e0, dy = yl + y0.
            t = s * r
            y0 = _MIDDLE - v
            e0 = s * (_MIDDLE - u - r * y0)
            along = s * mx - t * my
            me = along + e0 * m0
            partials[j, 0] = m0
            partials[j, 1] = me
            partials[j, 2] = my + y0 * m0
            partials[j, 3] = s * s * mxx - (s * t + s * t) * mxy + t * t * myy + e0 * (along + me)
            partials[j, 4] = s * mxy - t * myy + e0 * my + y0 * me
            partials[j, 5] = myy + y0 * (my + my + y0 * m0)
            partials[j, 6] = c0
            partials[j, 7] = c1
            partials[j, 8] = c2


@kernel
def add_tiles(
    offsets: LongArray,
    ids: IntArray,
    ends: LongArray,
    partials: FloatArray,  # (M, SUMS)
    sums: FloatArray,  # (n, SUMS) comes zeroed
    start: int,
    stop: int,
) -> None:
    """Add up the sums of splats ``start`` to ``stop`` (depth order), tile by tile.

    A splat has one writer and a fixed order, so the result does not depend on threads.
    """
    for tile in range(len(ends)):
        for j in range(offsets[tile], ends[tile]):
            k = ids[j]
            if k >= start and k < stop:
                for c in range(SUMS):
                    sums[k, c] += partials[j, c]
