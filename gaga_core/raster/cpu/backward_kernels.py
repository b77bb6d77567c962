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
from gaga_core.raster.cpu.blend_kernels import _ALPHA_MAX, _ALPHA_MIN, _LOWEST, _T_MIN
from gaga_core.raster.cpu.project_kernels import TILE
from gaga_core.raster.cpu.row_kernels import (
    ALPHA,
    AT_ONCE,
    AT_U,
    AT_V,
    BLUE,
    GREEN,
    N_COLUMNS,
    N_LISTS,
    PLAIN_R,
    PLAIN_S,
    RED,
    REST,
    ROW,
    ROWS,
    SHIFT,
    SMALL_S,
    exp8,
    is_done,
    list_rows,
    open_rows,
)
from gaga_core.simd_kernels import (
    fill,
    lane_numbers,
    larger,
    load,
    minus_abs,
    reciprocal,
    smaller,
    store,
    store_totals,
    total,
    where_at_least,
)

SUMS = 9
_F = np.float32
_ZERO, _ONE = _F(0), _F(1)
_MIDDLE = _F(7.5)  # of a tile, in its pixel columns and rows
_LOW = _F(_LOWEST / 8)
# Planes of a tile's working memory, those of a row one behind the other: T and the picture on the
# way forward; T, R, and the gradient of the picture on the way back.
_PICTURE, _N_DRAWN = 1, 4
_LEFT, _G0, _G1, _G2, _N_BACK = 1, 2, 3, 4, 5


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
    planes = np.empty((TILE, _N_DRAWN, TILE), np.float32)
    listed = np.empty((AT_ONCE, N_COLUMNS), np.float32)
    rows, spans = np.empty((N_LISTS, ROWS), np.float32), np.empty((AT_ONCE, 2), np.int64)
    x, zero, t_min = lane_numbers(), fill(_ZERO), fill(_T_MIN)
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        open_rows(planes, n_rows, n_columns)
        ends[tile] = offsets[tile + 1]
        for first in range(offsets[tile], offsets[tile + 1], AT_ONCE):
            last = min(first + AT_ONCE, offsets[tile + 1])
            list_rows(splats, colors, ids, first, last, left, top, listed, rows, spans)
            for q in range(last - first):
                along, opacity = x * listed[q, SMALL_S], fill(listed[q, ALPHA])
                f0, f1, f2 = fill(listed[q, RED]), fill(listed[q, GREEN]), fill(listed[q, BLUE])
                for m in range(spans[q, 0], spans[q, 1]):
                    at = int(rows[ROW, m]) * (_N_DRAWN * TILE)
                    e = along + rows[SHIFT, m]
                    raw = exp8(larger(rows[REST, m] - e * e, fill(_LOW))) * opacity
                    a = smaller(raw, fill(_ALPHA_MAX))
                    before = load(planes, at)
                    w = where_at_least(a, fill(_ALPHA_MIN), a * before, zero)
                    after = before - w
                    w = where_at_least(after, t_min, w, zero)
                    store(planes, at, where_at_least(after, t_min, after, minus_abs(before)))
                    store(planes, at + TILE, load(planes, at + TILE) + w * f0)
                    store(planes, at + 2 * TILE, load(planes, at + 2 * TILE) + w * f1)
                    store(planes, at + 3 * TILE, load(planes, at + 3 * TILE) + w * f2)
            if is_done(planes):
                ends[tile] = last
                break
        for y in range(n_rows):
            for column in range(n_columns):
                t = abs(planes[y, 0, column])
                transmittance[top + y, left + column] = t
                for c in range(3):
                    color = planes[y, _PICTURE + c, column] + t * background[c]
                    image[top + y, left + column, c] = color


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
    planes = np.empty((TILE, _N_BACK, TILE), np.float32)
    listed = np.empty((AT_ONCE, N_COLUMNS), np.float32)
    rows, spans = np.empty((N_LISTS, ROWS), np.float32), np.empty((AT_ONCE, 2), np.int64)
    sums = np.empty(8, np.float32)
    x, zero, one = lane_numbers(), fill(_ZERO), fill(_ONE)
    alpha_max, t_min = fill(_ALPHA_MAX), fill(_T_MIN)
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        open_rows(planes, n_rows, n_columns)
        for y in range(n_rows):
            for column in range(n_columns):
                # What is behind everything: background color, and alpha = 1 - T.
                behind_all = alpha_gradient[top + y, left + column]
                behind_all *= -transmittance[top + y, left + column]
                for c in range(3):
                    g = image_gradient[top + y, left + column, c]
                    planes[y, _G0 + c, column] = g
                    behind_all += g * image[top + y, left + column, c]
                planes[y, _LEFT, column] = behind_all
        for first in range(offsets[tile], ends[tile], AT_ONCE):
            last = min(first + AT_ONCE, ends[tile])
            list_rows(splats, colors, ids, first, last, left, top, listed, rows, spans)
            for q in range(last - first):
                along, opacity = x * listed[q, SMALL_S], fill(listed[q, ALPHA])
                f0, f1, f2 = fill(listed[q, RED]), fill(listed[q, GREEN]), fill(listed[q, BLUE])
                # Sums in each column of d, d y, d y^2, w g (3).
                in_0, in_y, in_yy, in_c0, in_c1, in_c2 = zero, zero, zero, zero, zero, zero
                for m in range(spans[q, 0], spans[q, 1]):
                    at = int(rows[ROW, m]) * (_N_BACK * TILE)
                    e = along + rows[SHIFT, m]
                    raw = exp8(larger(rows[REST, m] - e * e, fill(_LOW))) * opacity
                    a = smaller(raw, alpha_max)
                    a = where_at_least(a, fill(_ALPHA_MIN), a, zero)
                    before = load(planes, at)
                    w = a * before
                    after = before - w
                    w = where_at_least(after, t_min, w, zero)
                    store(planes, at, where_at_least(after, t_min, after, minus_abs(before)))
                    g0, g1 = load(planes, at + _G0 * TILE), load(planes, at + _G1 * TILE)
                    g2 = load(planes, at + _G2 * TILE)
                    shade = g0 * f0 + g1 * f1 + g2 * f2
                    behind = load(planes, at + _LEFT * TILE) - w * shade
                    store(planes, at + _LEFT * TILE, behind)
                    d = a * (before * shade - behind * reciprocal(one - a))
                    d = where_at_least(alpha_max, raw, d, zero)
                    d = where_at_least(after, t_min, d, zero)
                    yl = rows[ROW, m] - _MIDDLE
                    dy = d * yl
                    in_0, in_y, in_yy = in_0 + d, in_y + dy, in_yy + dy * yl
                    in_c0, in_c1, in_c2 = in_c0 + w * g0, in_c1 + w * g1, in_c2 + w * g2
                xl = x - fill(_MIDDLE)
                in_x = xl * in_0
                moments = (in_0, in_x, xl * in_x, in_y, xl * in_y, in_yy, in_c0, in_c1)
                store_totals(sums, 0, moments)
                m0, mx, mxx, my, mxy, myy = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
                # From moments about the tile's middle to moments of e and dy:
                # e = s xl - t yl + e0, dy = yl + y0.
                s, r = listed[q, PLAIN_S], listed[q, PLAIN_R]
                t, y0 = s * r, _MIDDLE - listed[q, AT_V]
                e0 = s * (_MIDDLE - listed[q, AT_U] - r * y0)
                turned = s * mx - t * my
                me = turned + e0 * m0
                j = first + q
                partials[j, 0] = m0
                partials[j, 1] = me
                partials[j, 2] = my + y0 * m0
                both = (s * t + s * t) * mxy
                partials[j, 3] = s * s * mxx - both + t * t * myy + e0 * (turned + me)
                partials[j, 4] = s * mxy - t * myy + e0 * my + y0 * me
                partials[j, 5] = myy + y0 * (my + my + y0 * m0)
                partials[j, 6] = sums[6]
                partials[j, 7] = sums[7]
                partials[j, 8] = total(in_c2)


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
