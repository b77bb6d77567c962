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
from gaga_core.kernels import exact_kernel, kernel
from gaga_core.raster.cpu.simd_kernels import prefetch

TILE = 16
U, V, S, R, H, OPACITY, Y0, Y1 = range(8)
# Added to log(255 opacity): tile lists must hold a little more than float32 blending can draw.
_MARGIN = 2e-3
_CUT = math.log(255.0)


@exact_kernel
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


# --- Kernels of view-dependent color: spherical harmonics, and their gradient.
# Real spherical harmonics to degree 4 in the order and signs of 3D Gaussian Splatting (Kerbl
# 2023), summed in float64. Splats are walked in the order of the file: their coefficients are most
# of a file, and in the order of depth nearly every access would miss the processor's caches.


_Y0 = 0.28209479177387814  # degree 0
_ZERO = np.float32(0)
_LINE = 16  # numbers of a cache line
_LANES = 16  # splats at once: polynomials of several are computed in one vector
# Rows of a working array (56, _LANES): direction, then these.
_BASIS, _SHADE, _SLOPE = 3, 28, 53


@kernel
def sh_colors(
    sh: FloatArray,  # (N, S, 3)
    means: FloatArray,
    order: IntArray,  # (n,) Gaussian of each splat in view
    rows: IntArray,  # (n,) rows of `order` by ascending Gaussian
    eye: DoubleArray,  # (3,)
    colors: FloatArray,  # (n, 3)
    start: int,
    stop: int,
) -> None:
    """Color max(0, 0.5 + SH(direction)) of the splats ``rows[start:stop]`` seen from ``eye``.

    A color that is not finite is drawn black.
    """
    n_sh = sh.shape[1]
    w = np.zeros((56, _LANES), np.float64)
    for first in range(start, stop, _LANES):
        n = min(_LANES, stop - first)
        for q in range(n):
            i = order[rows[first + q]]
            for c in range(3):
                w[c, q] = means[i, c] - eye[c]
        for ahead in range(first + _LANES, min(first + 2 * _LANES, stop)):
            _ask_for(sh, means, order[rows[ahead]])
        _turn(w)
        _basis(w, n_sh)
        for q in range(n):
            k = rows[first + q]
            i = order[k]
            red, green, blue = 0.5, 0.5, 0.5
            for j in range(n_sh):
                red += w[_BASIS + j, q] * sh[i, j, 0]
                green += w[_BASIS + j, q] * sh[i, j, 1]
                blue += w[_BASIS + j, q] * sh[i, j, 2]
            colors[k, 0] = red if red > 0.0 and red < 1e30 else 0.0
            colors[k, 1] = green if green > 0.0 and green < 1e30 else 0.0
            colors[k, 2] = blue if blue > 0.0 and blue < 1e30 else 0.0


@kernel
def backward_colors(
    sh: FloatArray,  # (N, S, 3)
    means: FloatArray,
    indices: IntArray,  # (n,) Gaussian, ascending
    eye: DoubleArray,  # (3,)
    by_color: FloatArray,  # (n, 3) gradient by the color, 0 where max(0, .) is at rest
    d_sh: FloatArray,  # (n, S, 3)
    d_means: FloatArray,  # (n, 3) the part of the direction is added
) -> None:
    """From gradients by colors to those by coefficients and, through the direction, by means."""
    n_sh = sh.shape[1]
    w, near = np.zeros((56, _LANES), np.float64), np.zeros(_LANES, np.float64)
    for first in range(0, len(indices), _LANES):
        n = min(_LANES, len(indices) - first)
        for q in range(n):
            for c in range(3):
                w[c, q] = means[indices[first + q], c] - eye[c]
        for ahead in range(first + _LANES, min(first + 2 * _LANES, len(indices))):
            _ask_for(sh, means, indices[ahead])
        for q in range(_LANES):
            near[q] = np.divide(1.0, math.sqrt(w[0, q] ** 2 + w[1, q] ** 2 + w[2, q] ** 2))
        _turn(w)
        _basis(w, n_sh)
        for q in range(n):
            m = first + q
            i = indices[m]
            g0, g1, g2 = by_color[m, 0], by_color[m, 1], by_color[m, 2]
            for j in range(n_sh):
                part = np.float32(w[_BASIS + j, q])
                d_sh[m, j, 0] = part * g0
                d_sh[m, j, 1] = part * g1
                d_sh[m, j, 2] = part * g2
            f0, f1, f2 = g0 != _ZERO, g1 != _ZERO, g2 != _ZERO
            if f0 and f1 and f2:
                for j in range(n_sh):
                    w[_SHADE + j, q] = sh[i, j, 0] * g0 + sh[i, j, 1] * g1 + sh[i, j, 2] * g2
            else:  # a channel at rest may hold what is no number
                for j in range(n_sh):
                    shade = sh[i, j, 0] * g0 if f0 else _ZERO
                    shade += sh[i, j, 1] * g1 if f1 else _ZERO
                    shade += sh[i, j, 2] * g2 if f2 else _ZERO
                    w[_SHADE + j, q] = shade
        if n_sh > 1:
            _slope(w, n_sh)
            for q in range(n):
                x, y, z = w[0, q], w[1, q], w[2, q]
                sx, sy, sz = w[_SLOPE, q], w[_SLOPE + 1, q], w[_SLOPE + 2, q]
                radial = sx * x + sy * y + sz * z
                d_means[first + q, 0] += (sx - radial * x) * near[q]
                d_means[first + q, 1] += (sy - radial * y) * near[q]
                d_means[first + q, 2] += (sz - radial * z) * near[q]


@kernel
def _ask_for(sh: FloatArray, means: FloatArray, i: int) -> None:
    """Have what is known of Gaussian ``i`` brought, for the next lanes."""
    prefetch(means, 3 * i)
    width = 3 * sh.shape[1]
    for c in range(width * i, width * i + width, _LINE):
        prefetch(sh, c)


@kernel
def _turn(w: DoubleArray) -> None:
    """From differences of positions to directions."""
    for q in range(_LANES):
        x, y, z = w[0, q], w[1, q], w[2, q]
        # np.divide: the operator would check for zero, and a branch ends vectors.
        near = np.divide(1.0, math.sqrt(x * x + y * y + z * z))
        w[0, q] = x * near
        w[1, q] = y * near
        w[2, q] = z * near


@kernel
def _basis(w: DoubleArray, n_sh: int) -> None:
    """The polynomials of all lanes."""
    for q in range(_LANES):
        w[_BASIS, q] = _Y0
    if n_sh <= 1:
        return
    for q in range(_LANES):
        x, y, z = w[0, q], w[1, q], w[2, q]
        w[_BASIS + 1, q] = -0.4886025119029199 * y
        w[_BASIS + 2, q] = 0.4886025119029199 * z
        w[_BASIS + 3, q] = -0.4886025119029199 * x
    if n_sh <= 4:
        return
    for q in range(_LANES):
        x, y, z = w[0, q], w[1, q], w[2, q]
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        w[_BASIS + 4, q] = 1.0925484305920792 * xy
        w[_BASIS + 5, q] = -1.0925484305920792 * yz
        w[_BASIS + 6, q] = 0.31539156525252005 * (2.0 * zz - xx - yy)
        w[_BASIS + 7, q] = -1.0925484305920792 * xz
        w[_BASIS + 8, q] = 0.5462742152960396 * (xx - yy)
    if n_sh <= 9:
        return
    for q in range(_LANES):
        x, y, z = w[0, q], w[1, q], w[2, q]
        xx, yy, zz, xy = x * x, y * y, z * z, x * y
        w[_BASIS + 9, q] = -0.5900435899266435 * y * (3.0 * xx - yy)
        w[_BASIS + 10, q] = 2.890611442640554 * xy * z
        w[_BASIS + 11, q] = -0.4570457994644658 * y * (4.0 * zz - xx - yy)
        w[_BASIS + 12, q] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)
        w[_BASIS + 13, q] = -0.4570457994644658 * x * (4.0 * zz - xx - yy)
        w[_BASIS + 14, q] = 1.445305721320277 * z * (xx - yy)
        w[_BASIS + 15, q] = -0.5900435899266435 * x * (xx - 3.0 * yy)
    if n_sh <= 16:
        return
    for q in range(_LANES):
        x, y, z = w[0, q], w[1, q], w[2, q]
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        w[_BASIS + 16, q] = 2.5033429417967046 * xy * (xx - yy)
        w[_BASIS + 17, q] = -1.7701307697799304 * yz * (3.0 * xx - yy)
        w[_BASIS + 18, q] = 0.9461746957575601 * xy * (7.0 * zz - 1.0)
        w[_BASIS + 19, q] = -0.6690465435572892 * yz * (7.0 * zz - 3.0)
        w[_BASIS + 20, q] = 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0)
        w[_BASIS + 21, q] = -0.6690465435572892 * xz * (7.0 * zz - 3.0)
        w[_BASIS + 22, q] = 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0)
        w[_BASIS + 23, q] = -1.7701307697799304 * xz * (xx - 3.0 * yy)
        w[_BASIS + 24, q] = 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy))


@kernel
def _slope(w: DoubleArray, n_sh: int) -> None:
    """Gradient by (x, y, z) of sum shade[j] Y_j, of all lanes."""
    for q in range(_LANES):
        w[_SLOPE, q] = -0.4886025119029199 * w[_SHADE + 3, q]
        w[_SLOPE + 1, q] = -0.4886025119029199 * w[_SHADE + 1, q]
        w[_SLOPE + 2, q] = 0.4886025119029199 * w[_SHADE + 2, q]
    if n_sh > 4:
        for q in range(_LANES):
            x, y, z = w[0, q], w[1, q], w[2, q]
            sx, sy, sz = w[_SLOPE, q], w[_SLOPE + 1, q], w[_SLOPE + 2, q]
            c4 = 1.0925484305920792 * w[_SHADE + 4, q]
            c5 = -1.0925484305920792 * w[_SHADE + 5, q]
            c7 = 1.0925484305920792 * w[_SHADE + 7, q]
            c6, c8 = 0.6307831305050401 * w[_SHADE + 6, q], 1.0925484305920792 * w[_SHADE + 8, q]
            sx += c4 * y - c6 * x - c7 * z + c8 * x
            sy += c4 * x + c5 * z - c6 * y - c8 * y
            sz += c5 * y + 2.0 * c6 * z - c7 * x
            w[_SLOPE, q] = sx
            w[_SLOPE + 1, q] = sy
            w[_SLOPE + 2, q] = sz
    if n_sh > 9:
        for q in range(_LANES):
            x, y, z = w[0, q], w[1, q], w[2, q]
            xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
            sx, sy, sz = w[_SLOPE, q], w[_SLOPE + 1, q], w[_SLOPE + 2, q]
            c9 = -1.7701307697799304 * w[_SHADE + 9, q]
            c15 = -1.7701307697799304 * w[_SHADE + 15, q]
            c10, c14 = 2.890611442640554 * w[_SHADE + 10, q], 1.445305721320277 * w[_SHADE + 14, q]
            c11 = -0.4570457994644658 * w[_SHADE + 11, q]
            c13 = -0.4570457994644658 * w[_SHADE + 13, q]
            c12 = 1.1195289977703462 * w[_SHADE + 12, q]
            sx += 2.0 * c9 * xy + c10 * yz - 2.0 * c11 * xy - 2.0 * c12 * xz
            sx += c13 * (4.0 * zz - 3.0 * xx - yy) + 2.0 * c14 * xz + c15 * (xx - yy)
            sy += c9 * (xx - yy) + c10 * xz + c11 * (4.0 * zz - xx - 3.0 * yy) - 2.0 * c12 * yz
            sy -= 2.0 * c13 * xy + 2.0 * c14 * yz + 2.0 * c15 * xy
            sz += c10 * xy + 8.0 * (c11 * yz + c13 * xz) + c12 * (2.0 * zz - xx - yy)
            sz += c14 * (xx - yy)
            w[_SLOPE, q] = sx
            w[_SLOPE + 1, q] = sy
            w[_SLOPE + 2, q] = sz
    if n_sh > 16:
        for q in range(_LANES):
            x, y, z = w[0, q], w[1, q], w[2, q]
            xx, yy, zz, xy = x * x, y * y, z * z, x * y
            sx, sy, sz = w[_SLOPE, q], w[_SLOPE + 1, q], w[_SLOPE + 2, q]
            c16 = 2.5033429417967046 * w[_SHADE + 16, q]
            c17 = -1.7701307697799304 * w[_SHADE + 17, q]
            c18 = 0.9461746957575601 * w[_SHADE + 18, q]
            c19 = -0.6690465435572892 * w[_SHADE + 19, q]
            c20 = 0.10578554691520431 * w[_SHADE + 20, q]
            c21 = -0.6690465435572892 * w[_SHADE + 21, q]
            c22 = 0.47308734787878004 * w[_SHADE + 22, q]
            c23 = -1.7701307697799304 * w[_SHADE + 23, q]
            c24 = 2.5033429417967046 * w[_SHADE + 24, q]
            f1, f3 = 7.0 * zz - 1.0, 7.0 * zz - 3.0
            sx += c16 * y * (3.0 * xx - yy) + 6.0 * c17 * xy * z + c18 * y * f1 + c21 * z * f3
            sx += 2.0 * c22 * x * f1 + 3.0 * c23 * z * (xx - yy) + c24 * x * (xx - 3.0 * yy)
            sy += (
                c16 * x * (xx - 3.0 * yy) + 3.0 * c17 * z * (xx - yy) + c18 * x * f1 + c19 * z * f3
            )
            sy += -2.0 * c22 * y * f1 - 6.0 * c23 * xy * z + c24 * y * (yy - 3.0 * xx)
            sz += c17 * y * (3.0 * xx - yy) + 14.0 * c18 * xy * z
            sz += (c19 * y + c21 * x) * (21.0 * zz - 3.0) + c20 * z * (140.0 * zz - 60.0)
            sz += 14.0 * c22 * z * (xx - yy) + c23 * x * (xx - 3.0 * yy)
            w[_SLOPE, q] = sx
            w[_SLOPE + 1, q] = sy
            w[_SLOPE + 2, q] = sz
