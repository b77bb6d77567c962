"""Kernels that blend tiles: color and depth, more channels, weights of sampled pixels.

Each works on tiles ``start`` to ``stop`` of 16 x 16 pixels; splat outside, pixels inside, whole
rows of 16 pixels so that a row is one or two vector registers (see `project_kernels` for a splat's
columns). T is the transmittance of a pixel; a finished pixel, or one beyond the picture, holds it
negated: every later splat then fails the same comparison without a branch. The row of six lines
that turns a splat into weights is repeated in each kernel on purpose: as a function it is not
vectorised together with what follows.

Thresholds decide here (drawn or not, ended or not, median depth), and objects follow from them, so
that arithmetic is exact: no fast math, `fma` where a product is added, sums in one order.
"""

import math

import numpy as np

from gaga_core.arrays import (
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt8Array,
    UInt64Array,
)
from gaga_core.kernels import exact_kernel, kernel
from gaga_core.raster.cpu.project_kernels import OPACITY, TILE, Y0, Y1, H, R, S, U, V
from gaga_core.raster.cpu.simd_kernels import (
    fill,
    fma,
    lane_numbers,
    larger,
    load,
    minus_abs,
    smaller,
    store,
    where_at_least,
)

WIDE = 16  # channels of one pass of `blend_wide`
_F = np.float32
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
# The image model of raster/base.py.
_ALPHA_MIN, _ALPHA_MAX, _T_MIN = _F(1 / 255), _F(0.99), _F(1e-4)
# exp(-5.7) < 1/255: under this exponent nothing is drawn, and `_exp` need not be right.
_LOWEST = _F(-5.7)
_DONE = -2  # of a label's plane: its outline is known, or not wanted
_MINUS, _AREA = _F(-0.0), TILE * TILE  # -0.0 - x is -x
_CHECK = 15  # look for an end every 16 splats
# Planes of a tile's working memory in `blend`. One array for all: the compiler then knows that they
# do not overlap and vectorises without asking (half the time of an array each).
_T, _C0, _C1, _C2, _DEPTH, _MEDIAN = range(6)


@exact_kernel
def _exp(x: np.float32) -> np.float32:
    """exp on [-5.7, 0] as p(x / 8)^8, relative error 3e-6: unlike libm's, it vectorises.

    p is the polynomial of degree 5 with p(0) = 1 of the smallest relative error.
    """
    y = x * _F(0.125)
    p = fma(y, _F(0.0058484054), _F(0.039789192))
    p = fma(y, fma(y, p, _F(0.16599582)), _F(0.4998927))
    p = fma(y, fma(y, p, _F(0.9999943)), _ONE)
    p = p * p
    p = p * p
    return p * p


@exact_kernel
def _open_tile(T: FloatArray, n_rows: int, n_columns: int) -> None:
    for y in range(TILE):
        for x in range(TILE):
            T[y, x] = _ONE if y < n_rows and x < n_columns else -_ONE


@exact_kernel
def _is_done(T: FloatArray) -> np.bool_:
    most = -_ONE
    for y in range(TILE):
        for x in range(TILE):
            most = max(most, T[y, x])
    return most <= _ZERO


@exact_kernel
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
                    e = fma(s, _F(x), shift)
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, fma(-e, e, rest))))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = planes[_T, y, x]
                    after = fma(-before, a, before)
                    goes_on = after >= _T_MIN
                    w = a * before if goes_on else _ZERO
                    planes[_T, y, x] = after if goes_on else -abs(before)
                    planes[_C0, y, x] = fma(w, f0, planes[_C0, y, x])
                    planes[_C1, y, x] = fma(w, f1, planes[_C1, y, x])
                    planes[_C2, y, x] = fma(w, f2, planes[_C2, y, x])
                    planes[_DEPTH, y, x] = fma(w, z, planes[_DEPTH, y, x])
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


@exact_kernel
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
                    e = fma(s, _F(x), shift)
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, fma(-e, e, rest))))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = fma(-before, a, before)
                    goes_on = after >= _T_MIN
                    weights[x] = a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
                for c in range(WIDE):
                    f = features[k, c]
                    for x in range(TILE):
                        total[y, c, x] = fma(weights[x], f, total[y, c, x])
            if (j & _CHECK) == _CHECK and _is_done(T):
                break
        for y in range(n_rows):
            for x in range(n_columns):
                t = abs(T[y, x])
                for c in range(min(WIDE, n_channels - first)):
                    image[top + y, left + x, first + c] = total[y, c, x] + t * background[first + c]


@exact_kernel
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
                a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, fma(-e, e, -h * dy * dy))))
                a = a if a >= _ALPHA_MIN else _ZERO
                before = T[m]
                after = fma(-before, a, before)
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


# --- Every splat that one pixel shows, found without baking or binning the scene.
# Nearly all splats are far from the pixel: one comparison that needs no quaternion and no square
# root drops them, with a bound on their size that is never too small. The rest are evaluated like
# `project_kernels.project` does.


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


# --- Kernels of votes that keep a few labels for each Gaussian.


@kernel
def add_to_slot(
    labels: IntArray,  # (N, K) label of each slot, -1 = free
    weights: FloatArray,  # (N, K)
    lost: FloatArray,  # (N,) weight of what has no slot
    i: int,
    label: int,
    weight: float,
) -> None:
    """Add to the slot of a label, or open one; a new label takes the place of the smallest one when
    it weighs more, else it is lost."""
    smallest = 0
    for s in range(labels.shape[1]):
        if labels[i, s] == label:
            weights[i, s] += weight
            return
        if labels[i, s] < 0:
            labels[i, s], weights[i, s] = label, weight
            return
        if weights[i, s] < weights[i, smallest]:
            smallest = s
    if weight > weights[i, smallest]:
        lost[i] += weights[i, smallest]
        labels[i, smallest], weights[i, smallest] = label, weight
    else:
        lost[i] += weight


@kernel
def add_rows(
    rows: IntArray,  # (n,)
    columns: IntArray,  # (k,) labels
    added: FloatArray,  # (n, k)
    labels: IntArray,
    weights: FloatArray,
    lost: FloatArray,
) -> None:
    """Add a dense table of some Gaussians and some labels."""
    for r in range(len(rows)):
        for c in range(len(columns)):
            if added[r, c] > 0:
                add_to_slot(labels, weights, lost, rows[r], columns[c], added[r, c])


@kernel
def add_ones(
    rows: IntArray,  # (n,)
    values: IntArray,  # (n,) labels
    labels: IntArray,
    weights: FloatArray,
    lost: FloatArray,
) -> None:
    """One vote of one label for each of some Gaussians."""
    for r in range(len(rows)):
        add_to_slot(labels, weights, lost, rows[r], values[r], 1.0)


# --- Kernels for labels: the map of labels that a view shows, and votes of labeled pixels.
# Tiles are walked as in `blend_kernels`, whose image model they share.


@exact_kernel
def label_tiles(
    splats: FloatArray,
    splat_labels: IntArray,  # (n,) 0 <= label < n_labels
    offsets: LongArray,
    ids: IntArray,
    n_labels: int,
    labels: IntArray,  # (H, W)
    confidence: FloatArray,
    start: int,
    stop: int,
) -> None:
    """At each pixel the label of greatest summed weight, the smaller one when two are equal.

    A tile keeps one plane of sums per label that occurs in it, so the cost does not depend on the
    number of labels of the scene.
    """
    height, width = labels.shape
    n_tiles_x = (width + TILE - 1) // TILE
    T = np.empty((TILE, TILE), np.float32)
    plane_of = np.full(n_labels, -1, np.int32)
    label_of = np.empty(16, np.int32)
    planes = np.empty((16, TILE, TILE), np.float32)
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        n_planes = 0
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            plane = plane_of[splat_labels[k]]
            if plane < 0:
                if n_planes == len(label_of):
                    label_of = np.concatenate((label_of, np.empty_like(label_of)))
                    planes = np.concatenate((planes, np.empty_like(planes)))
                plane = n_planes
                plane_of[splat_labels[k]] = plane
                label_of[plane] = splat_labels[k]
                planes[plane] = _ZERO
                n_planes += 1
            total = planes[plane]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = fma(s, _F(x), shift)
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, fma(-e, e, rest))))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = fma(-before, a, before)
                    goes_on = after >= _T_MIN
                    total[y, x] += a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
            if (j & _CHECK) == _CHECK and _is_done(T):
                break
        for y in range(n_rows):
            for x in range(n_columns):
                best, most = 0, _ZERO
                for p in range(n_planes):
                    w = planes[p, y, x]
                    if w > most or (w == most and w > _ZERO and label_of[p] < best):
                        best, most = label_of[p], w
                labels[top + y, left + x] = best
                confidence[top + y, left + x] = most
        for p in range(n_planes):
            plane_of[label_of[p]] = -1


@exact_kernel
def _take_over(T: FloatArray, total: FloatArray, alone: FloatArray) -> None:
    """Set weight and transmittance of the only label of a tile from those of the picture."""
    for y in range(TILE):
        for x in range(TILE):
            total[y, x], alone[y, x] = _ONE - abs(T[y, x]), T[y, x]


@exact_kernel
def _is_found(alone: FloatArray) -> np.bool_:
    """Whether each pixel of a tile lets half of the light through at most."""
    most = -_ONE
    for y in range(TILE):
        for x in range(TILE):
            most = max(most, alone[y, x])
    return most <= _HALF


@exact_kernel
def _cover(alone: FloatArray, splat: FloatArray, left: int, top: int) -> None:
    """Let one splat take its part of the light that is left in a tile."""
    u, v = splat[U] - _F(left) - _HALF, splat[V] - _F(top) - _HALF
    s, r, h, opacity = splat[S], splat[R], splat[H], splat[OPACITY]
    for y in range(max(0, int(splat[Y0]) - top), min(TILE, int(splat[Y1]) - top)):
        dy = _F(y) - v
        shift = -s * (u + r * dy)
        rest = -h * dy * dy
        for x in range(TILE):
            e = fma(s, _F(x), shift)
            a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, fma(-e, e, rest))))
            a = a if a >= _ALPHA_MIN else _ZERO
            alone[y, x] = fma(-alone[y, x], a, alone[y, x])


@exact_kernel
def blend_labels(
    splats: FloatArray,
    depths: FloatArray,
    colors: FloatArray,  # (n, 3)
    splat_labels: IntArray,  # (n,) 0 <= label < n_labels
    object_of: IntArray,  # (n_labels,) bit of the label, -1 = its outline is not wanted
    offsets: LongArray,
    ids: IntArray,
    void: float,
    background: FloatArray,  # (3,)
    image: FloatArray,  # (H, W, 3)
    alpha: FloatArray,
    median: FloatArray,
    labels: IntArray,  # (H, W)
    found: UInt64Array,  # (W, H, words) zeros: bit b % 64 of word b // 64 is set
    start: int,
    stop: int,
) -> None:
    """What `blend` gives but the expected depth, what `label_tiles` gives, and where each object
    would be seen if nothing stood before it: where it is seen, or has alpha >= 1/2 alone.

    A label that weighs less than ``void`` is 0. A splat's alphas are worked out once for all of it,
    and labels have sums of their own from the second one of a tile on; when a tile's picture is
    done, only objects that are not whole there are followed.
    """
    height, width, _ = image.shape
    n_tiles_x = (width + TILE - 1) // TILE
    plane_of = np.full(len(object_of), -1, np.int32)
    label_of = np.empty(16, np.int32)
    planes = np.empty((6, TILE, TILE), np.float32)
    summed = np.empty((16, TILE, TILE), np.float32)  # weights of a label
    alone = np.empty((16, TILE, TILE), np.float32)  # its transmittance without the others
    T = planes[_T]
    columns, nothing, half = lane_numbers(), fill(_ZERO), fill(_HALF)
    lowest, t_min = fill(_LOWEST), fill(_T_MIN)
    most_opaque, least_opaque = fill(_ALPHA_MAX), fill(_ALPHA_MIN)
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        planes[1:] = _ZERO
        n_planes, behind = 0, offsets[tile + 1]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            plane = plane_of[splat_labels[k]]
            if plane < 0:
                if n_planes == len(label_of):
                    label_of = np.concatenate((label_of, np.empty_like(label_of)))
                    summed = np.concatenate((summed, np.empty_like(summed)))
                    alone = np.concatenate((alone, np.empty_like(alone)))
                if n_planes == 1:  # all so far was of one label
                    _take_over(T, summed[0], alone[0])
                plane = n_planes
                plane_of[splat_labels[k]], label_of[plane] = plane, splat_labels[k]
                summed[plane] = _ZERO
                _open_tile(alone[plane], n_rows, n_columns)
                n_planes += 1
            is_object = object_of[splat_labels[k]] >= 0
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            f0, f1, f2, z = colors[k, 0], colors[k, 1], colors[k, 2], fill(depths[k])
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                at = y * TILE
                dy = _F(y) - v
                e = fma(columns, s, fill(-s * (u + r * dy)))
                e = larger(lowest, fma(_MINUS - e, e, fill(-h * dy * dy)))
                a = smaller(most_opaque, opacity * _exp(e))
                a = where_at_least(a, least_opaque, a, nothing)
                before = load(planes, at)
                after = fma(_MINUS - before, a, before)
                w = where_at_least(after, t_min, a * before, nothing)
                store(planes, at, where_at_least(after, t_min, after, minus_abs(before)))
                store(planes, _C0 * _AREA + at, fma(w, f0, load(planes, _C0 * _AREA + at)))
                store(planes, _C1 * _AREA + at, fma(w, f1, load(planes, _C1 * _AREA + at)))
                store(planes, _C2 * _AREA + at, fma(w, f2, load(planes, _C2 * _AREA + at)))
                median_z = load(planes, _MEDIAN * _AREA + at)
                crosses = where_at_least(half, after, z, median_z)
                store(planes, _MEDIAN * _AREA + at, where_at_least(half, before, median_z, crosses))
                if n_planes > 1:
                    at += plane * _AREA
                    store(summed, at, load(summed, at) + w)
                    if is_object:
                        own = load(alone, at)
                        store(alone, at, fma(_MINUS - own, a, own))
            if (j & _CHECK) == _CHECK and _is_done(T):
                behind = j + 1
                break
        if n_planes == 1:
            _take_over(T, summed[0], alone[0])
        for y in range(n_rows):
            for x in range(n_columns):
                best, most, first = 0, _ZERO, 0
                for p in range(n_planes):
                    w = summed[p, y, x]
                    if w > most or (w == most and w > _ZERO and label_of[p] < best):
                        best, most, first = label_of[p], w, p
                is_seen = most > _ZERO and most >= _F(void)
                labels[top + y, left + x] = best if is_seen else 0
                if is_seen:
                    alone[first, y, x] = -_ONE
                t = abs(planes[_T, y, x])
                alpha[top + y, left + x] = _ONE - t
                median[top + y, left + x] = planes[_MEDIAN, y, x]
                image[top + y, left + x, 0] = planes[_C0, y, x] + t * background[0]
                image[top + y, left + x, 1] = planes[_C1, y, x] + t * background[1]
                image[top + y, left + x, 2] = planes[_C2, y, x] + t * background[2]
        for p in range(n_planes):
            if object_of[label_of[p]] < 0 or _is_found(alone[p]):
                plane_of[label_of[p]] = _DONE
        for j in range(behind, offsets[tile + 1]):  # what the picture does not need
            k = ids[j]
            plane = plane_of[splat_labels[k]]
            if plane == _DONE:
                continue
            if plane < 0:
                if n_planes == len(label_of):
                    label_of = np.concatenate((label_of, np.empty_like(label_of)))
                    summed = np.concatenate((summed, np.empty_like(summed)))
                    alone = np.concatenate((alone, np.empty_like(alone)))
                plane = n_planes if object_of[splat_labels[k]] >= 0 else _DONE
                plane_of[splat_labels[k]], label_of[n_planes] = plane, splat_labels[k]
                n_planes += 1
                if plane == _DONE:
                    continue
                _open_tile(alone[plane], n_rows, n_columns)
            _cover(alone[plane], splats[k], left, top)
            if (j & _CHECK) == _CHECK and _is_found(alone[plane]):
                plane_of[splat_labels[k]] = _DONE
        for p in range(n_planes):
            row = object_of[label_of[p]]
            plane_of[label_of[p]] = -1
            if row < 0:
                continue
            word, bit = row // 64, np.uint64(1) << np.uint64(row % 64)
            for y in range(n_rows):
                for x in range(n_columns):
                    if alone[p, y, x] <= _HALF:
                        found[left + x, top + y, word] |= bit


@kernel
def tile_labels(
    labels: IntArray,  # (H, W)
    local: IntArray,  # (n_tiles, TILE, TILE) position in `found`; -1 = ignore
    found: IntArray,  # (n_tiles, TILE * TILE) the labels of each tile
    n_found: LongArray,
    start: int,
    stop: int,
) -> None:
    """Number the labels that occur in each tile, in the order met."""
    height, width = labels.shape
    n_tiles_x = (width + TILE - 1) // TILE
    for tile in range(start, stop):
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        local[tile] = -1
        n = 0
        last = 0
        for y in range(min(TILE, height - top)):
            for x in range(min(TILE, width - left)):
                label = labels[top + y, left + x]
                if label < 0:
                    continue
                if not (n > 0 and found[tile, last] == label):
                    last = 0
                    while last < n and found[tile, last] != label:
                        last += 1
                    if last == n:
                        found[tile, n] = label
                        n += 1
                local[tile, y, x] = last
        n_found[tile] = n


@exact_kernel
def vote_tiles(
    splats: FloatArray,
    offsets: LongArray,
    ids: IntArray,
    local: IntArray,
    n_found: LongArray,
    sum_offsets: LongArray,  # (stop of batch - first + 1,) where a tile's sums begin
    first: int,
    size: LongArray,  # (2,) width, height
    sums: FloatArray,
    start: int,
    stop: int,
) -> None:
    """Sums of weights of each (splat, label) of tiles first + start .. first + stop.

    ``sums`` of a tile is (splats of the tile, labels of the tile), row-major; it comes zeroed.
    """
    width, height = size[0], size[1]
    n_tiles_x = (width + TILE - 1) // TILE
    T = np.empty((TILE, TILE), np.float32)
    weights = np.empty(TILE, np.float32)
    row_label = np.empty(TILE, np.int32)
    for tile in range(first + start, first + stop):
        n_labels = n_found[tile]
        if n_labels == 0:
            continue
        left, top = (tile % n_tiles_x) * TILE, (tile // n_tiles_x) * TILE
        n_rows, n_columns = min(TILE, height - top), min(TILE, width - left)
        _open_tile(T, n_rows, n_columns)
        # A row of one label is summed at once; -2 = mixed. Pixels beyond the picture have w = 0.
        for y in range(TILE):
            row_label[y] = local[tile, y, 0]
            for x in range(1, n_columns):
                if local[tile, y, x] != row_label[y]:
                    row_label[y] = -2
        at = sum_offsets[tile - first]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            u, v = splats[k, U] - _F(left) - _HALF, splats[k, V] - _F(top) - _HALF
            s, r, h, opacity = splats[k, S], splats[k, R], splats[k, H], splats[k, OPACITY]
            for y in range(max(0, int(splats[k, Y0]) - top), min(TILE, int(splats[k, Y1]) - top)):
                dy = _F(y) - v
                shift = -s * (u + r * dy)
                rest = -h * dy * dy
                for x in range(TILE):
                    e = fma(s, _F(x), shift)
                    a = min(_ALPHA_MAX, opacity * _exp(max(_LOWEST, fma(-e, e, rest))))
                    a = a if a >= _ALPHA_MIN else _ZERO
                    before = T[y, x]
                    after = fma(-before, a, before)
                    goes_on = after >= _T_MIN
                    weights[x] = a * before if goes_on else _ZERO
                    T[y, x] = after if goes_on else -abs(before)
                if row_label[y] >= 0:
                    total = _ZERO
                    for x in range(TILE):
                        total += weights[x]
                    sums[at + row_label[y]] += total
                elif row_label[y] == -2:
                    for x in range(n_columns):
                        if local[tile, y, x] >= 0:
                            sums[at + local[tile, y, x]] += weights[x]
            at += n_labels
            if (j & _CHECK) == _CHECK and _is_done(T):
                break


@kernel
def add_sums(
    order: IntArray,
    offsets: LongArray,
    ids: IntArray,
    found: IntArray,
    n_found: LongArray,
    sum_offsets: LongArray,
    first: int,
    sums: FloatArray,
    histogram: FloatArray,  # (N, K)
    start: int,
    stop: int,
) -> None:
    """Add a batch's sums to the rows of splats ``start`` to ``stop`` (depth order), tile by tile.

    A row has one writer and a fixed order, so the result does not depend on threads.
    """
    for b in range(len(sum_offsets) - 1):
        tile = first + b
        n_labels = n_found[tile]
        at = sum_offsets[b]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            if k >= start and k < stop:
                for m in range(n_labels):
                    w = sums[at + m]
                    if w > _ZERO:
                        histogram[order[k], found[tile, m]] += w
            at += n_labels


@kernel
def add_sums_to_slots(
    order: IntArray,
    offsets: LongArray,
    ids: IntArray,
    found: IntArray,
    n_found: LongArray,
    sum_offsets: LongArray,
    first: int,
    sums: FloatArray,
    slot_labels: IntArray,  # (N, K), like the next two changed in place
    slot_weights: FloatArray,  # (N, K)
    lost: FloatArray,  # (N,)
    start: int,
    stop: int,
) -> None:
    """`add_sums` where each Gaussian keeps a few labels (`VoteSlots`)."""
    for b in range(len(sum_offsets) - 1):
        tile = first + b
        n_labels = n_found[tile]
        at = sum_offsets[b]
        for j in range(offsets[tile], offsets[tile + 1]):
            k = ids[j]
            if k >= start and k < stop:
                for m in range(n_labels):
                    w = sums[at + m]
                    if w > _ZERO:
                        add_to_slot(slot_labels, slot_weights, lost, order[k], found[tile, m], w)
            at += n_labels
