"""Kernels of the depth sort: one pass that culls, one counting sort on 18-bit keys.

Keys are the bits of the float32 depth, stretched over the range that is seen: they grow like its
logarithm (linear inside each power of two), so far outliers do not cost precision near by. 16 bits
would save 5 % of the time and give up to three times the greatest error of a picture, where splats
of a surface share a key.
"""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array, UInt32Array
from gaga_core.kernels import kernel

N_KEYS = 1 << 18
SKIPPED = 2 | 8  # bits of State: hidden, deleted


def reaches(log_scales: FloatArray) -> FloatArray:
    """Distance (N,) within which each splat can be seen: 3.34 times its longest standard
    deviation."""
    a, b, c = log_scales.T
    with np.errstate(over="ignore"):
        return np.float32(3.34) * np.exp(np.maximum(np.maximum(a, b), c))


def importance(log_scales: FloatArray, logit_opacities: FloatArray) -> FloatArray:
    """Rank (N,) of each splat, -inf of a damaged one.

    Of those above any threshold t, each was taken with probability p = min(1, e^-t w), where w is
    the root of opacity times the area of the largest cross-section: what is large is there with
    certainty, and of a small thing made of many splats some remain, where the largest alone would
    leave nothing of it (priority sampling, Duffield 2007). Enlarged by 1 / p in area they cover
    what all of them did. Chance is a row of multiples of the golden ratio: neighbours in the file
    are thinned out evenly.
    """
    a, b, c = log_scales.T
    with np.errstate(invalid="ignore", over="ignore"):
        area = a + b + c - np.minimum(np.minimum(a, b), c)
        weight = 0.5 * (area - np.logaddexp(0, -logit_opacities))
    chance = np.arange(1, len(a) + 1) * 0.6180339887498949 % 1.0
    rank = weight - np.log(np.maximum(chance, 1e-9)).astype(np.float32)
    return np.nan_to_num(rank.astype(np.float32), copy=False, nan=-np.inf)


@kernel
def visible_depths(
    means: FloatArray,  # (N, 3)
    reach: FloatArray,  # (N,)
    state: UInt8Array,  # (N,)
    placement: IntArray,  # (N,)
    rows: IntArray,  # (R,) splats to look at; R = 0: all
    poses: DoubleArray,  # (P, 3, 4) cam_from_file of each placement
    stretch: DoubleArray,  # (P,) bound on how much the placement enlarges
    lens: DoubleArray,  # fx, fy, cx, cy, width, height, near, margin in pixels
    depths: FloatArray,  # (N or R,) out, first M filled
    ids: IntArray,  # (N or R,) out
) -> int:
    """Camera depths and ids of the M splats that can touch the picture, in row order; M.

    A splat is kept when its centre lies in the picture grown by ``margin`` plus a bound of its own
    radius in pixels (the one of the rasterizer: the Jacobian is clamped, so it is finite).
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    width, height, near, margin = lens[4], lens[5], lens[6], lens[7]
    limit_x = 0.65 * width / fx
    limit_y = 0.65 * height / fy
    grow = max(fx * math.sqrt(1 + limit_x * limit_x), fy * math.sqrt(1 + limit_y * limit_y))
    rim = 1.9 + margin
    n = reach.shape[0] if rows.shape[0] == 0 else rows.shape[0]
    m = 0
    # u and v times depth, and depth, as maps of a mean: neighbours mostly share their placement.
    last = -1
    ux = uy = uz = u0 = vx = vy = vz = v0 = zx = zy = zz = z0 = enlarged = 0.0
    for j in range(n):
        # Unsigned: no code for indices that count from the end.
        i = np.uint64(j) if rows.shape[0] == 0 else np.uint64(rows[j])
        p = placement[i]
        if state[i] & SKIPPED != 0 or p < 0 or p >= poses.shape[0]:
            continue
        if p != last:
            a, b, c = poses[p, 0], poses[p, 1], poses[p, 2]
            zx, zy, zz, z0 = c[0], c[1], c[2], c[3]
            ux, uy, uz = fx * a[0] + cx * zx, fx * a[1] + cx * zy, fx * a[2] + cx * zz
            vx, vy, vz = fy * b[0] + cy * zx, fy * b[1] + cy * zy, fy * b[2] + cy * zz
            u0, v0 = fx * a[3] + cx * z0, fy * b[3] + cy * z0
            enlarged = stretch[p] * grow
            last = p
        x, y, z = means[i, 0], means[i, 1], means[i, 2]
        tz = zx * x + zy * y + zz * z + z0
        # Pixels times depth: no division, and no jump that depends on the splat below.
        u = ux * x + uy * y + uz * z + u0
        v = vx * x + vy * y + vz * z + v0
        # sqrt(s^2 + BLUR) <= s + sqrt(BLUR); 3.34 sqrt(0.3) < 1.9.
        bound = reach[i] * enlarged + rim * tz
        # Not "outside" but "inside": a NaN anywhere is left out.
        seen = (tz >= near) & (tz < 1e30)
        seen &= (u + bound > 0) & (u - bound < width * tz)
        seen &= (v + bound > 0) & (v - bound < height * tz)
        depths[m] = tz
        ids[m] = i
        m += seen
    return m


@kernel
def far_to_near(
    bits: UInt32Array,  # (M,) depths as bits
    ids: IntArray,  # (M,)
    counts: IntArray,  # (N_KEYS + 1,) scratch; 32 bits each, so that the cache holds them
    order: IntArray,  # (M,) out
    quantiles: UInt32Array,  # (2,) out: bits of the depths at 0.5 % and 99.5 %
) -> None:
    """Counting sort, far to near; of equal keys the first id comes last, as in front to back."""
    m = bits.shape[0]
    if m == 0:
        return
    low, high = bits[0], bits[0]
    for i in range(m):
        low = min(low, bits[i])
        high = max(high, bits[i])
    scale = (N_KEYS - 1) / max(1.0, float(high) - float(low))
    counts[:] = 0
    for i in range(m):
        counts[int((float(bits[i]) - float(low)) * scale) + 1] += 1
    found = 0
    for k in range(N_KEYS):
        counts[k + 1] += counts[k]
        while found < 2 and counts[k + 1] >= (0.005 if found == 0 else 0.995) * m:
            quantiles[found] = np.uint32(float(low) + (k + 0.5) / scale)
            found += 1
    for i in range(m):
        k = int((float(bits[i]) - float(low)) * scale)
        order[m - 1 - counts[k]] = ids[i]
        counts[k] += 1
