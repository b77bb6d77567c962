"""Kernels before blending: projection, depth sort, tile lists.

Every kernel is one thread's share of the work: rows ``start`` to ``stop``. Geometry is computed in
float64 (these loops are scalar anyway, and long thin splats lose everything in float32) and stored
in float32 for the blending kernels.

A projected splat is a row of 8 float32: ``u, v`` centre in pixels; ``s, r, h`` such that at offset
(dx, dy) the exponent is -(s (dx - r dy))^2 - h dy^2, the Cholesky form of -q/2: as cheap as
expanding q, never positive, and without the cancellation of needle-shaped conics; ``opacity``; and
the half-open range of pixel rows ``y0, y1`` that it can touch.
"""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray, UInt32Array
from gaga_core.kernels import kernel

TILE = 16
U, V, S, R, H, OPACITY, Y0, Y1 = range(8)
# Added to log(255 opacity): tile lists must hold a little more than float32 blending can draw.
_MARGIN = 2e-3
_CUT = math.log(255.0)


@kernel
def project(
    means: FloatArray,
    quats: FloatArray,
    log_scales: FloatArray,
    logits: FloatArray,
    pose: DoubleArray,  # (3, 4) cam_from_world
    lens: DoubleArray,  # fx, fy, cx, cy, width, height, near, blur, 1 = antialiased
    splats: FloatArray,
    depths: FloatArray,
    index: IntArray,
    counts: LongArray,
    chunk: int,
    start: int,
    stop: int,
) -> None:
    """Project rows start..stop; those in the picture are packed from row ``start`` on.

    ``counts[start // chunk]`` is set to how many. Not drawn: centres nearer than ``near``, opacity
    under 1/255, a quaternion of no length, anything not finite.
    """
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    width, height, near, blur = lens[4], lens[5], lens[6], lens[7]
    limit_x = 1.3 * 0.5 * width / fx
    limit_y = 1.3 * 0.5 * height / fy
    # Squared norm of the rows of J at depth 1: bounds a splat's box with one exp, no quaternion.
    stretch = max(fx * fx * (1 + limit_x * limit_x), fy * fy * (1 + limit_y * limit_y))
    n = start
    for i in range(start, stop):
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        tz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if not (tz >= near and tz < 1e30):
            continue
        logit = np.float64(logits[i])
        if not logit > -5.6:
            continue
        tx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        ty = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        iz = 1.0 / tz
        u = fx * tx * iz + cx
        v = fy * ty * iz + cy
        l0, l1, l2 = log_scales[i, 0], log_scales[i, 1], log_scales[i, 2]
        s_max = math.exp(np.float64(max(l0, l1, l2))) * iz
        bound = 3.34 * math.sqrt(stretch * s_max * s_max + blur)
        # Not "outside" but "not inside": a NaN anywhere leaves here.
        if not (u + bound > 0 and u - bound < width and v + bound > 0 and v - bound < height):
            continue
        opacity = 1.0 / (1.0 + math.exp(-logit))
        if not opacity >= 1.0 / 255.0:
            continue
        a, b = np.float64(quats[i, 1]), np.float64(quats[i, 2])
        c, w = np.float64(quats[i, 3]), np.float64(quats[i, 0])
        norm = w * w + a * a + b * b + c * c
        if not (norm > 0.0 and norm < 1e300):
            continue
        scale = 1.0 / math.sqrt(norm)
        w *= scale
        a *= scale
        b *= scale
        c *= scale
        j00, j11 = fx * iz, fy * iz
        j02 = -fx * min(limit_x, max(-limit_x, tx * iz)) * iz
        j12 = -fy * min(limit_y, max(-limit_y, ty * iz)) * iz
        p0 = j00 * pose[0, 0] + j02 * pose[2, 0]
        p1 = j00 * pose[0, 1] + j02 * pose[2, 1]
        p2 = j00 * pose[0, 2] + j02 * pose[2, 2]
        q0 = j11 * pose[1, 0] + j12 * pose[2, 0]
        q1 = j11 * pose[1, 1] + j12 * pose[2, 1]
        q2 = j11 * pose[1, 2] + j12 * pose[2, 2]
        s0, s1, s2 = math.exp(np.float64(l0)), math.exp(np.float64(l1)), math.exp(np.float64(l2))
        # (J W) (R S), column by column.
        r0, r1, r2 = 1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b)
        a0, b0 = (p0 * r0 + p1 * r1 + p2 * r2) * s0, (q0 * r0 + q1 * r1 + q2 * r2) * s0
        r0, r1, r2 = 2 * (a * b - w * c), 1 - 2 * (a * a + c * c), 2 * (b * c + w * a)
        a1, b1 = (p0 * r0 + p1 * r1 + p2 * r2) * s1, (q0 * r0 + q1 * r1 + q2 * r2) * s1
        r0, r1, r2 = 2 * (a * c + w * b), 2 * (b * c - w * a), 1 - 2 * (a * a + b * b)
        a2, b2 = (p0 * r0 + p1 * r1 + p2 * r2) * s2, (q0 * r0 + q1 * r1 + q2 * r2) * s2
        cxx = a0 * a0 + a1 * a1 + a2 * a2 + blur
        cyy = b0 * b0 + b1 * b1 + b2 * b2 + blur
        cxy = a0 * b0 + a1 * b1 + a2 * b2
        det = cxx * cyy - cxy * cxy
        if not (det > 0.0 and cxx + cyy < 1e30):
            continue
        if lens[8] > 0.0:  # as much as the blur adds to the area
            plain = det - blur * (cxx + cyy) + blur * blur
            opacity *= math.sqrt(max(0.0, plain) / det)
            if opacity < 1.0 / 255.0:
                continue
        cut = 2.0 * (math.log(opacity) + _CUT + _MARGIN)
        ex = math.sqrt(cut * cxx)
        ey = math.sqrt(cut * cyy)
        y0 = max(0.0, math.ceil(v - ey - 0.5))
        y1 = min(height, math.floor(v + ey - 0.5) + 1.0)
        if y1 <= y0 or u + ex < 0.5 or u - ex > width - 0.5:
            continue
        splats[n, U] = u
        splats[n, V] = v
        splats[n, S] = math.sqrt(0.5 * cyy / det)
        splats[n, R] = cxy / cyy
        splats[n, H] = 0.5 / cyy
        splats[n, OPACITY] = opacity
        splats[n, Y0] = y0
        splats[n, Y1] = y1
        depths[n] = tz
        index[n] = i
        n += 1
    counts[start // chunk] = n - start


@kernel
def sort_by_depth(keys: UInt32Array, rows: IntArray) -> IntArray:
    """``rows`` by ascending ``keys`` (bits of positive float32), stable; both are overwritten.

    Radix sort, least significant digit first, 3 x 11 bits.
    """
    n = rows.shape[0]
    keys_b, rows_b = np.empty_like(keys), np.empty_like(rows)
    mask = np.uint32(2047)
    ends = np.zeros((3, 2048), np.int64)
    for i in range(n):
        ends[0, keys[i] & mask] += 1
        ends[1, (keys[i] >> np.uint32(11)) & mask] += 1
        ends[2, (keys[i] >> np.uint32(22)) & mask] += 1
    for digit in range(3):
        total = 0
        for j in range(2048):
            count = ends[digit, j]
            ends[digit, j] = total
            total += count
        shift = np.uint32(11 * digit)
        for i in range(n):
            d = (keys[i] >> shift) & mask
            p = ends[digit, d]
            ends[digit, d] = p + 1
            keys_b[p] = keys[i]
            rows_b[p] = rows[i]
        keys, keys_b = keys_b, keys
        rows, rows_b = rows_b, rows
    return rows


@kernel
def arrange(
    rows: IntArray,
    splats: FloatArray,
    depths: FloatArray,
    index: IntArray,
    sorted_splats: FloatArray,
    sorted_depths: FloatArray,
    order: IntArray,
    row_of: IntArray,
    n_spans: LongArray,
    start: int,
    stop: int,
) -> None:
    """Copy splats into depth order and count the tile rows that each touches.

    ``row_of[j]`` is the place that row j of ``splats`` goes to.
    """
    for k in range(start, stop):
        j = rows[k]
        for c in range(8):
            sorted_splats[k, c] = splats[j, c]
        sorted_depths[k] = depths[j]
        order[k] = index[j]
        row_of[j] = k
        n_spans[k] = (int(splats[j, Y1]) - 1) // TILE - int(splats[j, Y0]) // TILE + 1


@kernel
def tile_spans(
    splats: FloatArray,
    first_span: LongArray,
    width: int,
    n_tiles_x: int,
    spans: IntArray,
    histogram: LongArray,
    chunk: int,
    start: int,
    stop: int,
) -> None:
    """Tiles that hold a pixel of each splat's ellipse {alpha >= 1/255}, exactly, row by row.

    In one row of tiles an ellipse covers one run of tiles: ``spans[row] = first, last + 1``. The
    number of splats of each tile is added to ``histogram[start // chunk]``.
    """
    tiles = histogram[start // chunk]
    for k in range(start, stop):
        u, v = np.float64(splats[k, U]), np.float64(splats[k, V])
        s, r, h = np.float64(splats[k, S]), np.float64(splats[k, R]), np.float64(splats[k, H])
        y0, y1 = int(splats[k, Y0]), int(splats[k, Y1])
        cut = math.log(np.float64(splats[k, OPACITY])) + _CUT + _MARGIN
        cxx = 0.5 / (s * s) + r * r * 0.5 / h
        # Where the ellipse is widest: dy of its rightmost point.
        dy_right = r * 0.5 / h * math.sqrt(2.0 * cut / cxx)
        ty0 = y0 // TILE
        for j in range(first_span[k], first_span[k + 1]):
            ty = ty0 + j - first_span[k]
            top = max(ty * TILE, y0) + 0.5 - v
            bottom = min(ty * TILE + TILE, y1) - 0.5 - v
            dy = min(bottom, max(top, dy_right))
            right = u + r * dy + math.sqrt(max(0.0, cut - h * dy * dy)) / s
            dy = min(bottom, max(top, -dy_right))
            left = u + r * dy - math.sqrt(max(0.0, cut - h * dy * dy)) / s
            x0 = int(max(0.0, math.ceil(left - 0.5)))
            x1 = int(min(width - 1.0, math.floor(right - 0.5)))
            first, end = 0, 0
            if x1 >= x0:
                first = ty * n_tiles_x + x0 // TILE
                end = ty * n_tiles_x + x1 // TILE + 1
            spans[j, 0] = first
            spans[j, 1] = end
            for t in range(first, end):
                tiles[t] += 1


@kernel
def fill_tiles(
    first_span: LongArray,
    spans: IntArray,
    cursor: LongArray,
    ids: IntArray,
    chunk: int,
    start: int,
    stop: int,
) -> None:
    """Write splats start..stop, in order, behind ``cursor[start // chunk]`` of their tiles."""
    tiles = cursor[start // chunk]
    for k in range(start, stop):
        for j in range(first_span[k], first_span[k + 1]):
            for t in range(spans[j, 0], spans[j, 1]):
                ids[tiles[t]] = k
                tiles[t] += 1
