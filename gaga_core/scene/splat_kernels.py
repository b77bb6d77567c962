"""What it costs to merge two splats, and which pairs are merged."""

import math

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.geometry_kernels import eigen
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


# --- Moments of runs of splats, and the splat that has them.


_MOST_OPACITY = 1 - 1e-6  # where the logit ends


@kernel
def turn_of(quat: FloatArray, turn: DoubleArray) -> None:
    """The rotation (3, 3) of a quaternion (4,) wxyz of any length; none of one without length."""
    w, x, y, z = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    norm = w * w + x * x + y * y + z * z
    s = 2.0 / norm if norm > 0.0 else 0.0
    turn[0, 0] = 1 - s * (y * y + z * z)
    turn[0, 1] = s * (x * y - w * z)
    turn[0, 2] = s * (x * z + w * y)
    turn[1, 0] = s * (x * y + w * z)
    turn[1, 1] = 1 - s * (x * x + z * z)
    turn[1, 2] = s * (y * z - w * x)
    turn[2, 0] = s * (x * z - w * y)
    turn[2, 1] = s * (y * z + w * x)
    turn[2, 2] = 1 - s * (x * x + y * y)


@kernel
def _quat_of(m: DoubleArray, quat: FloatArray) -> None:
    """The quaternion (4,) wxyz, w >= 0, of the columns of ``m`` (3, 3), which may be a mirror."""
    det = (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )
    if det < 0.0:
        for i in range(3):
            m[i, 2] = -m[i, 2]
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace >= max(m[0, 0], m[1, 1], m[2, 2]):
        w, x, y, z = 1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    elif m[0, 0] >= m[1, 1] and m[0, 0] >= m[2, 2]:
        w, x = m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - trace
        y, z = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]
    elif m[1, 1] >= m[2, 2]:
        w, x = m[0, 2] - m[2, 0], m[0, 1] + m[1, 0]
        y, z = 1 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1]
    else:
        w, x = m[1, 0] - m[0, 1], m[0, 2] + m[2, 0]
        y, z = m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - trace
    s = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0.0:
        s = -s
    quat[0], quat[1], quat[2], quat[3] = s * w, s * x, s * y, s * z


@kernel
def _face(a: float, b: float, c: float) -> float:
    """What an ellipsoid of these half axes covers, of all directions, up to a constant factor."""
    return a * b + b * c + c * a + _TINY


@kernel
def merge_rows(
    means: FloatArray,  # (N, 3)
    quats: FloatArray,  # (N, 4)
    log_scales: FloatArray,  # (N, 3)
    logits: FloatArray,  # (N,)
    sh: FloatArray,  # (N, S, 3)
    columns: FloatArray,  # (N, E) averaged like a color
    order: LongArray,  # (N,) rows, run after run
    starts: LongArray,  # (P + 1,) of the runs in ``order``
    out_means: FloatArray,  # (P, 3)
    out_quats: FloatArray,  # (P, 4)
    out_log_scales: FloatArray,  # (P, 3)
    out_logits: FloatArray,  # (P,)
    out_sh: FloatArray,  # (P, S, 3)
    out_columns: FloatArray,  # (P, E)
    heaviest: LongArray,  # (P,) out: the row that covers most
    first: int,
    last: int,
) -> None:
    """Merge the runs ``first`` to ``last``; a run of one row keeps its bits."""
    n_sh, n_columns = sh.shape[1], columns.shape[1]
    turn, cov, axes = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    mean, size, d = np.empty(3), np.empty(3), np.empty(3)
    color, other = np.empty((n_sh, 3)), np.empty(n_columns)
    longest = 0
    for k in range(first, last):
        longest = max(longest, starts[k + 1] - starts[k])
    weights = np.empty(longest)
    for k in range(first, last):
        lo, n = starts[k], starts[k + 1] - starts[k]
        top = order[lo]
        heaviest[k] = top
        if n == 1:
            out_means[k], out_quats[k] = means[top], quats[top]
            out_log_scales[k], out_logits[k] = log_scales[top], logits[top]
            out_sh[k], out_columns[k] = sh[top], columns[top]
            continue
        # Log of the length in which this run is measured: nothing over- or underflows.
        unit = -np.inf
        for m in range(n):
            i = order[lo + m]
            unit = max(unit, np.float64(max(log_scales[i, 0], log_scales[i, 1], log_scales[i, 2])))
        total, most = 0.0, -1.0
        for m in range(n):
            i = order[lo + m]
            a = math.exp(log_scales[i, 0] - unit)
            b = math.exp(log_scales[i, 1] - unit)
            c = math.exp(log_scales[i, 2] - unit)
            w = _face(a, b, c) / (1.0 + math.exp(-np.float64(logits[i])))
            if w > most:
                most, heaviest[k] = w, i
            weights[m] = w
            total += w
        if not total > 0.0:  # nothing of them is seen: they count alike
            weights[:n] = 1.0
        sum_of_weights = total if total > 0.0 else float(n)
        for a in range(3):
            mean[a] = 0.0
        color[:], other[:] = 0.0, 0.0
        for m in range(n):
            i = order[lo + m]
            w = weights[m] / sum_of_weights
            weights[m] = w
            for a in range(3):
                mean[a] += w * (np.float64(means[i, a]) - np.float64(means[top, a]))
            for s in range(n_sh):
                for a in range(3):
                    color[s, a] += w * sh[i, s, a]
            for s in range(n_columns):
                other[s] += w * columns[i, s]
        cov[:] = 0.0
        shrink = math.exp(-unit)
        for m in range(n):
            i = order[lo + m]
            w = weights[m]
            turn_of(quats[i], turn)
            for a in range(3):
                size[a] = math.exp(2.0 * (log_scales[i, a] - unit))
                d[a] = (np.float64(means[i, a]) - np.float64(means[top, a]) - mean[a]) * shrink
            for a in range(3):
                for b in range(a, 3):
                    spread = d[a] * d[b]
                    for c in range(3):
                        spread += turn[a, c] * size[c] * turn[b, c]
                    cov[a, b] += w * spread
        cov[1, 0], cov[2, 0], cov[2, 1] = cov[0, 1], cov[0, 2], cov[1, 2]
        eigen(cov, axes)
        for a in range(3):
            size[a] = math.sqrt(max(cov[a, a], _TINY))
            out_log_scales[k, a] = unit + math.log(size[a])
            out_means[k, a] = np.float64(means[top, a]) + mean[a]
        _quat_of(axes, out_quats[k])
        opacity = min(total / _face(size[0], size[1], size[2]), _MOST_OPACITY)
        out_logits[k] = math.log(opacity / (1.0 - opacity))
        out_sh[k] = color
        out_columns[k] = other


# --- One pass over all splats for the object list.


@kernel
def tally_groups(
    labels: IntArray,  # (N,)
    state: UInt8Array,  # (N,)
    placement: IntArray,  # (N,)
    matrix: DoubleArray,  # (P, 3, 4)
    means: FloatArray,  # (N, 3)
    counts: LongArray,  # (G, 16) out: splats by group and state bits
    spread: DoubleArray,  # (G, 10) out: lo xyz, hi xyz, sum xyz, sum of squares; live splats
) -> None:
    """Count splats by group and state, and measure where the live ones stand."""
    for i in range(labels.shape[0]):
        g = labels[i]
        bits = state[i] & 15
        counts[g, bits] += 1
        if bits & 8:
            continue
        x = float(means[i, 0])
        y = float(means[i, 1])
        z = float(means[i, 2])
        r = placement[i]
        if r != 0:
            m = matrix[r]
            a = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            b = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            c = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            x, y, z = a, b, c
        if not math.isfinite(x + y + z):
            continue
        s = spread[g]
        s[0] = min(s[0], x)
        s[1] = min(s[1], y)
        s[2] = min(s[2], z)
        s[3] = max(s[3], x)
        s[4] = max(s[4], y)
        s[5] = max(s[5], z)
        s[6] += x
        s[7] += y
        s[8] += z
        s[9] += x * x + y * y + z * z
