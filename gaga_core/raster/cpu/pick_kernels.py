"""Every splat that one pixel shows, found without baking or binning the scene.

Nearly all splats are far from the pixel: one comparison that needs no quaternion and no square
root drops them, with a bound on their size that is never too small. The rest are evaluated like
`project_kernels.project` does.
"""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.kernels import kernel

_REACH = 2.0 * math.log(255.0) + 0.01  # -2 log(alpha_min): the largest q of an opaque splat


@kernel
def pick_pixel(
    means: FloatArray,
    quats: FloatArray,
    log_scales: FloatArray,
    logits: FloatArray,
    state: UInt8Array,
    unseen: int,  # bits of `state` that hide a splat
    placement: IntArray,
    poses: DoubleArray,  # (P, 3, 4) cam_from_file of each placement
    growth: DoubleArray,  # (P,) greatest stretch of each, squared
    opacities: DoubleArray,  # (P,) factor
    lens: DoubleArray,  # as in `project_kernels.project`
    pixel: DoubleArray,  # (2,) u, v
    index: IntArray,
    alphas: DoubleArray,
    depths: DoubleArray,
    counts: LongArray,
    chunk: int,
    start: int,
    stop: int,
) -> None:
    """Pack index, alpha and depth of the hits among rows start..stop from ``start`` on."""
    fx, fy = lens[0], lens[1]
    near, blur = lens[6], lens[7]
    limit_x = 1.3 * 0.5 * lens[4] / fx
    limit_y = 1.3 * 0.5 * lens[5] / fy
    # Greatest eigenvalue of J J^T at depth 1: J J^T = diag(f) (I + t t^T) diag(f), t clamped.
    stretch = max(fx * fx, fy * fy) * (1.0 + limit_x * limit_x + limit_y * limit_y)
    pu, pv = pixel[0] - lens[2], pixel[1] - lens[3]
    # e^(2 log scale), rounded up: a table costs a third of what the exponential does.
    steps = np.empty(81, np.float64)
    for k in range(81):
        steps[k] = math.exp(k - 40.0)
    n = start
    for i in range(start, stop):
        if state[i] & unseen:
            continue
        p = placement[i]
        pose = poses[p]
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        tz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if not (tz >= near and tz < 1e30):
            continue
        tx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        ty = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        dx, dy = pu * tz - fx * tx, pv * tz - fy * ty
        l0, l1, l2 = log_scales[i, 0], log_scales[i, 1], log_scales[i, 2]
        # Both sides are times depth squared. Not a number is no step of the table: it stays in.
        longest = max(l0, l1, l2)
        step = 2.0 * longest + 41.0
        if step < 81.0:
            s_max = steps[int(max(0.0, step))] * growth[p]
            if not dx * dx + dy * dy < _REACH * (stretch * s_max + blur * tz * tz):
                continue
        opacity = opacities[p] / (1.0 + math.exp(-np.float64(logits[i])))
        a, b = np.float64(quats[i, 1]), np.float64(quats[i, 2])
        c, w = np.float64(quats[i, 3]), np.float64(quats[i, 0])
        norm = w * w + a * a + b * b + c * c
        if not (opacity >= 1.0 / 255.0 and norm > 0.0 and norm < 1e300):
            continue
        scale = 1.0 / math.sqrt(norm)
        w *= scale
        a *= scale
        b *= scale
        c *= scale
        iz = 1.0 / tz
        j00, j11 = fx * iz, fy * iz
        j02 = -fx * min(limit_x, max(-limit_x, tx * iz)) * iz
        j12 = -fy * min(limit_y, max(-limit_y, ty * iz)) * iz
        cxx, cyy, cxy = blur, blur, 0.0
        for axis in range(3):
            if axis == 0:
                r0, r1, r2 = 1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b)
                s = math.exp(np.float64(l0))
            elif axis == 1:
                r0, r1, r2 = 2 * (a * b - w * c), 1 - 2 * (a * a + c * c), 2 * (b * c + w * a)
                s = math.exp(np.float64(l1))
            else:
                r0, r1, r2 = 2 * (a * c + w * b), 2 * (b * c - w * a), 1 - 2 * (a * a + b * b)
                s = math.exp(np.float64(l2))
            m0 = pose[0, 0] * r0 + pose[0, 1] * r1 + pose[0, 2] * r2
            m1 = pose[1, 0] * r0 + pose[1, 1] * r1 + pose[1, 2] * r2
            m2 = pose[2, 0] * r0 + pose[2, 1] * r1 + pose[2, 2] * r2
            e, f = (j00 * m0 + j02 * m2) * s, (j11 * m1 + j12 * m2) * s
            cxx += e * e
            cyy += f * f
            cxy += e * f
        det = cxx * cyy - cxy * cxy
        if not (det > 0.0 and cxx + cyy < 1e30):
            continue
        if lens[8] > 0.0:
            opacity = min(1.0, opacity)
            plain = det - blur * (cxx + cyy) + blur * blur
            opacity *= math.sqrt(max(0.0, plain) / det)
        du, dv = dx * iz, dy * iz
        q = (cyy * du * du - 2.0 * cxy * du * dv + cxx * dv * dv) / det
        alpha = min(0.99, min(1.0, opacity) * math.exp(-0.5 * q))
        if alpha >= 1.0 / 255.0:
            index[n] = i
            alphas[n] = alpha
            depths[n] = tz
            n += 1
    counts[start // chunk] = n - start
