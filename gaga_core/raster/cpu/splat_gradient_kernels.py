"""Kernel of training: from sums over pixels to the parameters of a splat."""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel
from gaga_core.raster.cpu.backward_kernels import SUMS
from gaga_core.raster.cpu.project_kernels import OPACITY, H, R, S

_ZERO = np.float32(0)
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
