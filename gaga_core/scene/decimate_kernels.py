"""What it costs to merge two splats, and which pairs are merged."""

import math

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, LongArray
from gaga_core.kernels import kernel

_TINY = 1e-300


@kernel
def _overlap(
    d0: float, d1: float, d2: float, a: float, b: float, c: float, d: float, e: float, f: float
) -> float:
    """Integral of the product of two Gaussians of mass 1, up to a constant: their centres are
    (d0, d1, d2) apart, and a..f (xx, xy, xz, yy, yz, zz) is the sum of their covariances."""
    i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
    i11, i12, i22 = a * f - c * c, b * c - a * e, a * d - b * b
    det = max(a * i00 + b * i01 + c * i02, _TINY)
    q = d0 * d0 * i00 + d1 * d1 * i11 + d2 * d2 * i22
    q += 2 * (d0 * d1 * i01 + d0 * d2 * i02 + d1 * d2 * i12)
    return math.exp(-0.5 * max(q, 0.0) / det) / math.sqrt(det)


@kernel
def pair_costs(
    means: FloatArray,  # (N, 3)
    covariances: DoubleArray,  # (N, 6) xx, xy, xz, yy, yz, zz
    weights: DoubleArray,  # (N,) opacity times surface
    colors: FloatArray,  # (N, 3) 0..1
    first: LongArray,  # (P,)
    second: LongArray,  # (P,)
    color_weight: float,
    out: DoubleArray,  # (P,) out
    start: int,
    stop: int,
) -> None:
    """Cost of merging the pairs ``start`` to ``stop``: how far the merged splat is from the two, as
    1 - cosine in L2, plus how far their colors are apart, squared."""
    s = np.empty(6)
    for p in range(start, stop):
        i, j = first[p], second[p]
        total = weights[i] + weights[j]
        if not total > 0.0:
            out[p] = 0.0
            continue
        a = weights[i] / total
        b = 1.0 - a
        x = np.float64(means[i, 0]) - np.float64(means[j, 0])
        y = np.float64(means[i, 1]) - np.float64(means[j, 1])
        z = np.float64(means[i, 2]) - np.float64(means[j, 2])
        ci, cj = covariances[i], covariances[j]
        # In units of the pair's own extent: sizes of 1e-20 and 1e20 do not leave the range.
        unit = ci[0] + ci[3] + ci[5] + cj[0] + cj[3] + cj[5] + x * x + y * y + z * z
        unit = 1.0 / max(unit, _TINY)
        step = math.sqrt(unit)
        x, y, z = x * step, y * step, z * step
        spread = (x * x, x * y, x * z, y * y, y * z, z * z)
        thin = 1e-9  # a disk of no thickness has no volume to compare
        for k in range(6):
            s[k] = unit * (a * ci[k] + b * cj[k]) + a * b * spread[k]
        u, v = unit, thin
        ii = _overlap(
            0.0, 0.0, 0.0, 2 * u * ci[0] + v, 2 * u * ci[1], 2 * u * ci[2],
            2 * u * ci[3] + v, 2 * u * ci[4], 2 * u * ci[5] + v,
        )  # fmt: skip
        jj = _overlap(
            0.0, 0.0, 0.0, 2 * u * cj[0] + v, 2 * u * cj[1], 2 * u * cj[2],
            2 * u * cj[3] + v, 2 * u * cj[4], 2 * u * cj[5] + v,
        )  # fmt: skip
        ij = _overlap(
            x, y, z, u * (ci[0] + cj[0]) + v, u * (ci[1] + cj[1]), u * (ci[2] + cj[2]),
            u * (ci[3] + cj[3]) + v, u * (ci[4] + cj[4]), u * (ci[5] + cj[5]) + v,
        )  # fmt: skip
        mm = _overlap(
            0.0, 0.0, 0.0, 2 * s[0] + v, 2 * s[1], 2 * s[2], 2 * s[3] + v, 2 * s[4], 2 * s[5] + v
        )
        im = _overlap(
            b * x, b * y, b * z, u * ci[0] + s[0] + v, u * ci[1] + s[1], u * ci[2] + s[2],
            u * ci[3] + s[3] + v, u * ci[4] + s[4], u * ci[5] + s[5] + v,
        )  # fmt: skip
        jm = _overlap(
            a * x, a * y, a * z, u * cj[0] + s[0] + v, u * cj[1] + s[1], u * cj[2] + s[2],
            u * cj[3] + s[3] + v, u * cj[4] + s[4], u * cj[5] + s[5] + v,
        )  # fmt: skip
        norm = math.sqrt(max((a * a * ii + b * b * jj + 2 * a * b * ij) * mm, _TINY))
        apart = 0.0
        for k in range(3):
            gap = np.float64(colors[i, k]) - np.float64(colors[j, k])
            apart += gap * gap
        out[p] = 1.0 - (a * im + b * jm) / norm + color_weight * a * b * apart


@kernel
def match_pairs(
    order: LongArray,  # (P,) pairs, the cheapest first
    first: LongArray,  # (P,)
    second: LongArray,  # (P,)
    parents: LongArray,  # (N,) out: the row into which each is merged; itself at the call
    used: BoolArray,  # (N,) False at the call
    most: int,
) -> int:
    """Pair each row with at most one other, the cheapest pairs first; the number of pairs."""
    n = 0
    for k in range(order.shape[0]):
        if n == most:
            break
        i, j = first[order[k]], second[order[k]]
        if used[i] or used[j]:
            continue
        used[i] = used[j] = True
        parents[j] = i
        n += 1
    return n
