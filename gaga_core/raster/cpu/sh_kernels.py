"""Kernels of view-dependent color: spherical harmonics, and their gradient.

Real spherical harmonics to degree 4 in the order and signs of 3D Gaussian Splatting (Kerbl 2023),
summed in float64. Splats are walked in the order of the file: their coefficients are most of a
file, and in the order of depth nearly every access would miss the processor's caches.
"""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel
from gaga_core.simd_kernels import prefetch

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
            c4, c5, c7 = (
                1.0925484305920792 * w[_SHADE + 4, q],
                -1.0925484305920792 * w[_SHADE + 5, q],
                1.0925484305920792 * w[_SHADE + 7, q],
            )
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
            c9, c15 = (
                -1.7701307697799304 * w[_SHADE + 9, q],
                -1.7701307697799304 * w[_SHADE + 15, q],
            )
            c10, c14 = 2.890611442640554 * w[_SHADE + 10, q], 1.445305721320277 * w[_SHADE + 14, q]
            c11, c13 = (
                -0.4570457994644658 * w[_SHADE + 11, q],
                -0.4570457994644658 * w[_SHADE + 13, q],
            )
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
            c16, c17 = (
                2.5033429417967046 * w[_SHADE + 16, q],
                -1.7701307697799304 * w[_SHADE + 17, q],
            )
            c18, c19 = (
                0.9461746957575601 * w[_SHADE + 18, q],
                -0.6690465435572892 * w[_SHADE + 19, q],
            )
            c20, c21 = (
                0.10578554691520431 * w[_SHADE + 20, q],
                -0.6690465435572892 * w[_SHADE + 21, q],
            )
            c22, c23 = (
                0.47308734787878004 * w[_SHADE + 22, q],
                -1.7701307697799304 * w[_SHADE + 23, q],
            )
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
