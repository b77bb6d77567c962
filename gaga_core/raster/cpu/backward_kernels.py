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

import math
from typing import Any

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.blend_kernels import _ALPHA_MAX, _ALPHA_MIN, _LOWEST, _T_MIN
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V
from gaga_core.raster.cpu.simd_kernels import (
    fill,
    lane_numbers,
    larger,
    load,
    log2_above,
    minus_abs,
    reciprocal,
    run_at_least,
    smaller,
    store,
    store_totals,
    total,
    where_at_least,
)

# --- From the splats of a tile to rows of 16 pixels: what both ways of training walk over.
# `list_rows` goes ahead of the pixels with a few splats: it reads their columns, scattered in
# memory, and lists the rows of the tile that each of them reaches. What follows has no branch but
# the ends of short loops whose lengths are known long before, and waits for no memory.
#
# Lengths are divided by the root of 8, so that exponents come as an eighth: `exp8` wants them so.


AT_ONCE = 32  # splats of a tile that are listed at once
ROWS = AT_ONCE * TILE + TILE  # room for their rows
# Columns of a listed splat. SMALL_S is S over the root of 8; U and V count from the middle of the
# tile's first pixel.
SMALL_S, ALPHA, RED, GREEN, BLUE, AT_U, AT_V, PLAIN_S, PLAIN_R, N_COLUMNS = range(10)
# Rows of the list of rows: number in the tile, shift and rest such that at column x the exponent is
# 8 (rest - (SMALL_S x + shift)^2).
ROW, SHIFT, REST, N_LISTS = range(4)
_F = np.float32
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
_EIGHTH, _ROOT = _F(1 / 8), _F(math.sqrt(1 / 8))
# Of log2 of 255 alpha the eighth of the logarithm; what float32 may be wrong by lies in the 0.09
# of `log2_above`, of which at least 0.003 is left.
_LN2_8, _LOG255 = _F(math.log(2) / 8), _F(math.log2(255))
_LAST = _F(TILE - 1)


@kernel
def exp8(y: Any) -> Any:
    """exp(8 y) of a vector in [-0.7125, 0], as `blend_kernels._exp` computes exp."""
    p = y * _F(0.0058484054) + _F(0.039789192)
    p = y * p + _F(0.16599582)
    p = y * p + _F(0.4998927)
    p = y * p + _F(0.9999943)
    p = y * p + _ONE
    p = p * p
    p = p * p
    return p * p


@kernel
def open_rows(planes: FloatArray, n_rows: int, n_columns: int) -> None:
    """Clear ``planes`` (TILE, C, TILE) of a tile, and set the transmittances, its first plane."""
    planes[:] = _ZERO
    for y in range(TILE):
        for x in range(TILE):
            planes[y, 0, x] = _ONE if y < n_rows and x < n_columns else -_ONE


@kernel
def is_done(planes: FloatArray) -> bool:
    """Whether no pixel of the tile lets anything through."""
    most = load(planes, 0)
    for y in range(1, TILE):
        most = larger(most, load(planes, y * planes.shape[1] * TILE))
    end: int = run_at_least(most, fill(_ZERO))[1]
    return end == 0


@kernel
def list_rows(
    splats: FloatArray,
    colors: FloatArray,  # (n, 3)
    ids: IntArray,
    start: int,
    stop: int,  # entries of ``ids`` that are listed, AT_ONCE at most
    left: int,
    top: int,  # first pixel of the tile
    listed: FloatArray,  # (AT_ONCE, N_COLUMNS)
    rows: FloatArray,  # (N_LISTS, ROWS)
    spans: LongArray,  # (AT_ONCE, 2) first of its rows, and the one behind the last
) -> None:
    """List splats, and the rows of the tile in which their ellipse {alpha >= 1/255} has a pixel.

    A few rows more, at most, and none that has a gap between them: an ellipse is convex.
    """
    x = lane_numbers()
    n = 0
    for q in range(stop - start):
        k = ids[start + q]
        u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
        s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
        small = s * _ROOT
        listed[q, SMALL_S] = small
        listed[q, ALPHA] = opacity
        for c in range(3):
            listed[q, RED + c] = colors[k, c]
        listed[q, AT_U] = u
        listed[q, AT_V] = v
        listed[q, PLAIN_S] = s
        listed[q, PLAIN_R] = r
        y0 = max(_ZERO, splats[k, Y0] - _F(top))
        y1 = min(_F(TILE), splats[k, Y1] - _F(top))
        dy = x + (y0 - v)
        shift = dy * (-small * r) + (-small * u)
        rest = dy * dy * (-h * _EIGHTH)
        store(rows, ROW * ROWS + n, x + y0)
        store(rows, SHIFT * ROWS + n, shift)
        store(rows, REST * ROWS + n, rest)
        # The least distance along the row: 0 if the ellipse's axis crosses it.
        apart = larger(fill(_ZERO), larger(shift, (shift + small * _LAST) * -_ONE))
        least = -(log2_above(opacity) + _LOG255) * _LN2_8
        first, end = run_at_least(rest - apart * apart, fill(least))
        end = min(end, int(y1 - y0))
        spans[q, 0] = n + first
        spans[q, 1] = n + end
        n += max(0, end)


SUMS = 9
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


# --- Kernel of training: from sums over pixels to the parameters of a splat.


_AT_ONCE = 32  # splats whose rows are read before the first of them is worked on
# Columns of what is read of a splat, behind its sums: projected columns but for the rows of pixels,
# color, mean, quaternion, log scales.
_DRAWN, _COLOR, _MEAN, _QUAT, _SIZE = SUMS, SUMS + 6, SUMS + 9, SUMS + 12, SUMS + 16


@kernel
def backward_splats(
    means: FloatArray,
    quats: FloatArray,
    log_scales: FloatArray,
    pose: DoubleArray,  # (3, 4) cam_from_world
    lens: DoubleArray,  # fx, fy, cx, cy, width, height, near, blur, 1 = antialiased
    order: IntArray,
    rows: IntArray,
    splats: FloatArray,
    colors: FloatArray,
    sums: FloatArray,  # (n, SUMS) of `backward_tiles`, of all tiles together
    d_means: FloatArray,  # (n, 3)
    d_quats: FloatArray,  # (n, 4)
    d_log_scales: FloatArray,  # (n, 3)
    d_logits: FloatArray,  # (n,)
    by_color: FloatArray,  # (n, 3) gradient by the color that `sh_kernels.sh_colors` gives
    screen: FloatArray,  # (n,)
    radii: FloatArray,  # (n,)
) -> None:
    """From sums over pixels to gradients of the parameters of splats ``rows``.

    All but those by color: `sh_kernels.backward_colors` goes on, and adds to ``d_means``. In
    float64 like `project_kernels.project`, whose steps it repeats and then walks back. What a few
    splats need is read first: a processor waits for many rows at once, but not across the hundreds
    of instructions that a splat takes.

    In the antialiased mode a splat is drawn with its opacity times f, where f^2 = det C0 / det C of
    the 2D covariances before and after the blur, so that dL/dC0 = dL/dC + m (C0^-1 - C^-1) / 2 with
    m = dL/dlog f, which is the sum of d.
    """
    near = np.empty((_AT_ONCE, _SIZE + 3), np.float64)
    for start in range(0, len(rows), _AT_ONCE):
        stop = min(start + _AT_ONCE, len(rows))
        for m in range(start, stop):
            k, q = rows[m], m - start
            i = order[k]
            for c in range(SUMS):
                near[q, c] = sums[k, c]
            for c in range(_COLOR - _DRAWN):
                near[q, _DRAWN + c] = splats[k, c]
            for c in range(3):
                near[q, _COLOR + c] = colors[k, c]
                near[q, _MEAN + c] = means[i, c]
                near[q, _SIZE + c] = log_scales[i, c]
            for c in range(4):
                near[q, _QUAT + c] = quats[i, c]
        _walk_back(
            near,
            pose,
            lens,
            d_means,
            d_quats,
            d_log_scales,
            d_logits,
            by_color,
            screen,
            radii,
            start,
            stop,
        )


@kernel
def _walk_back(
    near: DoubleArray,  # (_AT_ONCE, 28) what is read of splats ``start`` to ``stop``
    pose: DoubleArray,
    lens: DoubleArray,
    d_means: FloatArray,
    d_quats: FloatArray,
    d_log_scales: FloatArray,
    d_logits: FloatArray,
    by_color: FloatArray,
    screen: FloatArray,
    radii: FloatArray,
    start: int,
    stop: int,
) -> None:
    """`backward_splats` for a few splats."""
    fx, fy, width, height, blur = lens[0], lens[1], lens[4], lens[5], lens[7]
    limit_x = 1.3 * 0.5 * width / fx
    limit_y = 1.3 * 0.5 * height / fy
    for m in range(start, stop):
        q = m - start
        d0 = near[q, 0]
        d1 = near[q, 1]
        d2 = near[q, 2]
        d3 = near[q, 3]
        d4 = near[q, 4]
        d5 = near[q, 5]
        c0 = near[q, 6]
        c1 = near[q, 7]
        c2 = near[q, 8]
        x, y, z = near[q, _MEAN], near[q, _MEAN + 1], near[q, _MEAN + 2]
        tx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        ty = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        tz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        s, r, h = near[q, _DRAWN + S], near[q, _DRAWN + R], near[q, _DRAWN + H]
        # The 2D covariance from its Cholesky form; 3 standard deviations of its long axis.
        cyy = 0.5 / h
        cxy = r * cyy
        cxx = 0.5 / (s * s) + r * cxy
        half = 0.5 * (cxx - cyy)
        radii[m] = 3.0 * math.sqrt(0.5 * (cxx + cyy) + math.sqrt(half * half + cxy * cxy))
        moves = abs(d0) + abs(d1) + abs(d2) + abs(d3) + abs(d4) + abs(d5)
        if moves + abs(c0) + abs(c1) + abs(c2) == 0.0:
            # Hidden behind others, or its colors are at rest: nothing to walk back.
            for c in range(3):
                d_means[m, c] = _ZERO
                d_log_scales[m, c] = _ZERO
                by_color[m, c] = _ZERO
            for c in range(4):
                d_quats[m, c] = _ZERO
            d_logits[m] = _ZERO
            screen[m] = _ZERO
            continue
        opacity = near[q, _DRAWN + OPACITY]
        # dp/du = 2 s e, dp/dv = -2 s r e + 2 h dy; dp/dcovariance is half their outer product.
        du = 2.0 * s * d1
        dv = -2.0 * s * r * d1 + 2.0 * h * d2
        dxx = 2.0 * s * s * d3
        dxy = -2.0 * s * s * r * d3 + 2.0 * s * h * d4
        dyy = 2.0 * s * s * r * r * d3 - 4.0 * s * r * h * d4 + 2.0 * h * h * d5
        screen[m] = 0.5 * math.sqrt((width * du) ** 2 + (height * dv) ** 2)
        iz = 1.0 / tz
        a, b = near[q, _QUAT + 1], near[q, _QUAT + 2]
        c_, w = near[q, _QUAT + 3], near[q, _QUAT]
        shrink = 1.0 / math.sqrt(w * w + a * a + b * b + c_ * c_)
        w *= shrink
        a *= shrink
        b *= shrink
        c_ *= shrink
        slope_x = min(limit_x, max(-limit_x, tx * iz))
        slope_y = min(limit_y, max(-limit_y, ty * iz))
        j00, j11 = fx * iz, fy * iz
        j02, j12 = -fx * slope_x * iz, -fy * slope_y * iz
        p0 = j00 * pose[0, 0] + j02 * pose[2, 0]
        p1 = j00 * pose[0, 1] + j02 * pose[2, 1]
        p2 = j00 * pose[0, 2] + j02 * pose[2, 2]
        q0 = j11 * pose[1, 0] + j12 * pose[2, 0]
        q1 = j11 * pose[1, 1] + j12 * pose[2, 1]
        q2 = j11 * pose[1, 2] + j12 * pose[2, 2]
        s0 = math.exp(near[q, _SIZE])
        s1 = math.exp(near[q, _SIZE + 1])
        s2 = math.exp(near[q, _SIZE + 2])
        r00, r10, r20 = 1 - 2 * (b * b + c_ * c_), 2 * (a * b + w * c_), 2 * (a * c_ - w * b)
        r01, r11, r21 = 2 * (a * b - w * c_), 1 - 2 * (a * a + c_ * c_), 2 * (b * c_ + w * a)
        r02, r12, r22 = 2 * (a * c_ + w * b), 2 * (b * c_ - w * a), 1 - 2 * (a * a + b * b)
        # Columns of the 2D root (J W)(R S) = (A; B), their gradients, and those of rows P, Q = J W.
        a0, b0 = (p0 * r00 + p1 * r10 + p2 * r20) * s0, (q0 * r00 + q1 * r10 + q2 * r20) * s0
        a1, b1 = (p0 * r01 + p1 * r11 + p2 * r21) * s1, (q0 * r01 + q1 * r11 + q2 * r21) * s1
        a2, b2 = (p0 * r02 + p1 * r12 + p2 * r22) * s2, (q0 * r02 + q1 * r12 + q2 * r22) * s2
        if lens[8] > 0.0:
            xx, yy = a0 * a0 + a1 * a1 + a2 * a2, b0 * b0 + b1 * b1 + b2 * b2
            xy = a0 * b0 + a1 * b1 + a2 * b2
            plain = (a0 * b1 - a1 * b0) ** 2 + (a0 * b2 - a2 * b0) ** 2 + (a1 * b2 - a2 * b1) ** 2
            det = plain + blur * (xx + yy) + blur * blur
            opacity *= math.sqrt(det / plain)
            dxx += 0.5 * d0 * (yy / plain - (yy + blur) / det)
            dyy += 0.5 * d0 * (xx / plain - (xx + blur) / det)
            dxy += 0.5 * d0 * (xy / det - xy / plain)
        d_logits[m] = d0 * (1.0 - opacity)
        da0, db0 = 2 * (dxx * a0 + dxy * b0), 2 * (dxy * a0 + dyy * b0)
        da1, db1 = 2 * (dxx * a1 + dxy * b1), 2 * (dxy * a1 + dyy * b1)
        da2, db2 = 2 * (dxx * a2 + dxy * b2), 2 * (dxy * a2 + dyy * b2)
        d_log_scales[m, 0] = da0 * a0 + db0 * b0
        d_log_scales[m, 1] = da1 * a1 + db1 * b1
        d_log_scales[m, 2] = da2 * a2 + db2 * b2
        da0, da1, da2 = da0 * s0, da1 * s1, da2 * s2
        db0, db1, db2 = db0 * s0, db1 * s1, db2 * s2
        dp0 = da0 * r00 + da1 * r01 + da2 * r02
        dp1 = da0 * r10 + da1 * r11 + da2 * r12
        dp2 = da0 * r20 + da1 * r21 + da2 * r22
        dq0 = db0 * r00 + db1 * r01 + db2 * r02
        dq1 = db0 * r10 + db1 * r11 + db2 * r12
        dq2 = db0 * r20 + db1 * r21 + db2 * r22
        # Rotation matrix, then the quaternion, then its length: only turning counts.
        r00, r01, r02 = da0 * p0 + db0 * q0, da1 * p0 + db1 * q0, da2 * p0 + db2 * q0
        r10, r11, r12 = da0 * p1 + db0 * q1, da1 * p1 + db1 * q1, da2 * p1 + db2 * q1
        r20, r21, r22 = da0 * p2 + db0 * q2, da1 * p2 + db1 * q2, da2 * p2 + db2 * q2
        gw = 2 * (a * (r21 - r12) + b * (r02 - r20) + c_ * (r10 - r01))
        ga = 2 * (b * (r01 + r10) + c_ * (r02 + r20) + w * (r21 - r12) - 2 * a * (r11 + r22))
        gb = 2 * (a * (r01 + r10) + c_ * (r12 + r21) + w * (r02 - r20) - 2 * b * (r00 + r22))
        gc = 2 * (a * (r02 + r20) + b * (r12 + r21) + w * (r10 - r01) - 2 * c_ * (r00 + r11))
        radial = gw * w + ga * a + gb * b + gc * c_
        d_quats[m, 0] = (gw - radial * w) * shrink
        d_quats[m, 1] = (ga - radial * a) * shrink
        d_quats[m, 2] = (gb - radial * b) * shrink
        d_quats[m, 3] = (gc - radial * c_) * shrink
        # J and the centre by the position in camera axes. A clamped slope does not move.
        d00 = dp0 * pose[0, 0] + dp1 * pose[0, 1] + dp2 * pose[0, 2]
        d02 = dp0 * pose[2, 0] + dp1 * pose[2, 1] + dp2 * pose[2, 2]
        d11 = dq0 * pose[1, 0] + dq1 * pose[1, 1] + dq2 * pose[1, 2]
        d12 = dq0 * pose[2, 0] + dq1 * pose[2, 1] + dq2 * pose[2, 2]
        by_x = -d02 * fx * iz if abs(tx * iz) <= limit_x else 0.0
        by_y = -d12 * fy * iz if abs(ty * iz) <= limit_y else 0.0
        by_x += du * fx
        by_y += dv * fy
        dtx, dty = by_x * iz, by_y * iz
        dtz = -(d00 * j00 + d02 * j02 + d11 * j11 + d12 * j12) * iz
        dtz -= (by_x * tx + by_y * ty) * iz * iz
        mx = pose[0, 0] * dtx + pose[1, 0] * dty + pose[2, 0] * dtz
        my = pose[0, 1] * dtx + pose[1, 1] * dty + pose[2, 1] * dtz
        mz = pose[0, 2] * dtx + pose[1, 2] * dty + pose[2, 2] * dtz
        # max(0, .) lets nothing through where it is at rest.
        by_color[m, 0] = c0 if near[q, _COLOR] > _ZERO else 0.0
        by_color[m, 1] = c1 if near[q, _COLOR + 1] > _ZERO else 0.0
        by_color[m, 2] = c2 if near[q, _COLOR + 2] > _ZERO else 0.0
        d_means[m, 0] = mx
        d_means[m, 1] = my
        d_means[m, 2] = mz
