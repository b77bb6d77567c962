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

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
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
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            f0, f1, f2 = colors[k, 0], colors[k, 1], colors[k, 2]
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
    float64 like `project_kernels.project`, whose steps it repeats and then walks back.

    In the antialiased mode a splat is drawn with its opacity times f, where f^2 = det C0 / det C of
    the 2D covariances before and after the blur, so that dL/dC0 = dL/dC + m (C0^-1 - C^-1) / 2 with
    m = dL/dlog f, which is the sum of d.
    """
    fx, fy, width, height, blur = lens[0], lens[1], lens[4], lens[5], lens[7]
    limit_x = 1.3 * 0.5 * width / fx
    limit_y = 1.3 * 0.5 * height / fy
    for m in range(len(rows)):
        k = rows[m]
        i = order[k]
        d0 = np.float64(sums[k, 0])
        d1 = np.float64(sums[k, 1])
        d2 = np.float64(sums[k, 2])
        d3 = np.float64(sums[k, 3])
        d4 = np.float64(sums[k, 4])
        d5 = np.float64(sums[k, 5])
        c0 = np.float64(sums[k, 6])
        c1 = np.float64(sums[k, 7])
        c2 = np.float64(sums[k, 8])
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        tx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        ty = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        tz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        s, r, h = np.float64(splats[k, S]), np.float64(splats[k, R]), np.float64(splats[k, H])
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
        opacity = np.float64(splats[k, OPACITY])
        # dp/du = 2 s e, dp/dv = -2 s r e + 2 h dy; dp/dcovariance is half their outer product.
        du = 2.0 * s * d1
        dv = -2.0 * s * r * d1 + 2.0 * h * d2
        dxx = 2.0 * s * s * d3
        dxy = -2.0 * s * s * r * d3 + 2.0 * s * h * d4
        dyy = 2.0 * s * s * r * r * d3 - 4.0 * s * r * h * d4 + 2.0 * h * h * d5
        screen[m] = 0.5 * math.sqrt((width * du) ** 2 + (height * dv) ** 2)
        iz = 1.0 / tz
        a, b = np.float64(quats[i, 1]), np.float64(quats[i, 2])
        c_, w = np.float64(quats[i, 3]), np.float64(quats[i, 0])
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
        s0 = math.exp(np.float64(log_scales[i, 0]))
        s1 = math.exp(np.float64(log_scales[i, 1]))
        s2 = math.exp(np.float64(log_scales[i, 2]))
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
        by_color[m, 0] = c0 if colors[k, 0] > _ZERO else 0.0
        by_color[m, 1] = c1 if colors[k, 1] > _ZERO else 0.0
        by_color[m, 2] = c2 if colors[k, 2] > _ZERO else 0.0
        d_means[m, 0] = mx
        d_means[m, 1] = my
        d_means[m, 2] = mz
