"""Kernels of view-dependent color: spherical harmonics, and their gradient.

Real spherical harmonics to degree 4 in the order and signs of 3D Gaussian Splatting (Kerbl 2023),
summed in float64. Splats are walked in the order of the file: their coefficients are most of a
file, and in the order of depth nearly every access would miss the processor's caches.
"""

import math

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import kernel

_Y0 = 0.28209479177387814  # degree 0
_ZERO = np.float32(0)


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
    basis = np.empty(25, np.float64)
    for m in range(start, stop):
        k = rows[m]
        i = order[k]
        x = np.float64(means[i, 0]) - eye[0]
        y = np.float64(means[i, 1]) - eye[1]
        z = np.float64(means[i, 2]) - eye[2]
        near = 1.0 / math.sqrt(x * x + y * y + z * z) if n_sh > 1 else 0.0
        _sh_basis(x * near, y * near, z * near, n_sh, basis)
        red, green, blue = 0.5, 0.5, 0.5
        for j in range(n_sh):
            red += basis[j] * sh[i, j, 0]
            green += basis[j] * sh[i, j, 1]
            blue += basis[j] * sh[i, j, 2]
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
    basis, shade = np.empty(25, np.float64), np.empty(25, np.float64)
    slope = np.empty(3, np.float64)
    for m in range(len(indices)):
        g0, g1, g2 = by_color[m, 0], by_color[m, 1], by_color[m, 2]
        f0, f1, f2 = g0 != _ZERO, g1 != _ZERO, g2 != _ZERO
        if not (f0 or f1 or f2):
            for j in range(n_sh):
                for c in range(3):
                    d_sh[m, j, c] = _ZERO
            continue
        i = indices[m]
        x = np.float64(means[i, 0]) - eye[0]
        y = np.float64(means[i, 1]) - eye[1]
        z = np.float64(means[i, 2]) - eye[2]
        near = 1.0 / math.sqrt(x * x + y * y + z * z) if n_sh > 1 else 0.0
        x, y, z = x * near, y * near, z * near
        _sh_basis(x, y, z, n_sh, basis)
        for j in range(n_sh):
            part = np.float32(basis[j])
            d_sh[m, j, 0] = part * g0
            d_sh[m, j, 1] = part * g1
            d_sh[m, j, 2] = part * g2
        if n_sh > 1:
            if f0 and f1 and f2:
                for j in range(n_sh):
                    shade[j] = sh[i, j, 0] * g0 + sh[i, j, 1] * g1 + sh[i, j, 2] * g2
            else:  # a channel at rest may hold what is no number
                for j in range(n_sh):
                    shade[j] = sh[i, j, 0] * g0 if f0 else 0.0
                    shade[j] += sh[i, j, 1] * g1 if f1 else 0.0
                    shade[j] += sh[i, j, 2] * g2 if f2 else 0.0
            _sh_slope(x, y, z, n_sh, shade, slope)
            radial = slope[0] * x + slope[1] * y + slope[2] * z
            d_means[m, 0] += (slope[0] - radial * x) * near
            d_means[m, 1] += (slope[1] - radial * y) * near
            d_means[m, 2] += (slope[2] - radial * z) * near


@kernel
def _sh_basis(x: float, y: float, z: float, n_sh: int, out: DoubleArray) -> None:
    out[0] = _Y0
    if n_sh <= 1:
        return
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    out[1] = -0.4886025119029199 * y
    out[2] = 0.4886025119029199 * z
    out[3] = -0.4886025119029199 * x
    if n_sh <= 4:
        return
    out[4] = 1.0925484305920792 * xy
    out[5] = -1.0925484305920792 * yz
    out[6] = 0.31539156525252005 * (2.0 * zz - xx - yy)
    out[7] = -1.0925484305920792 * xz
    out[8] = 0.5462742152960396 * (xx - yy)
    if n_sh <= 9:
        return
    out[9] = -0.5900435899266435 * y * (3.0 * xx - yy)
    out[10] = 2.890611442640554 * xy * z
    out[11] = -0.4570457994644658 * y * (4.0 * zz - xx - yy)
    out[12] = 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy)
    out[13] = -0.4570457994644658 * x * (4.0 * zz - xx - yy)
    out[14] = 1.445305721320277 * z * (xx - yy)
    out[15] = -0.5900435899266435 * x * (xx - 3.0 * yy)
    if n_sh <= 16:
        return
    out[16] = 2.5033429417967046 * xy * (xx - yy)
    out[17] = -1.7701307697799304 * yz * (3.0 * xx - yy)
    out[18] = 0.9461746957575601 * xy * (7.0 * zz - 1.0)
    out[19] = -0.6690465435572892 * yz * (7.0 * zz - 3.0)
    out[20] = 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0)
    out[21] = -0.6690465435572892 * xz * (7.0 * zz - 3.0)
    out[22] = 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0)
    out[23] = -1.7701307697799304 * xz * (xx - 3.0 * yy)
    out[24] = 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy))


@kernel
def _sh_slope(x: float, y: float, z: float, n_sh: int, t: DoubleArray, slope: DoubleArray) -> None:
    """slope (3,) = gradient by (x, y, z) of sum t[j] Y_j, the polynomials of `_sh_basis`."""
    sx = -0.4886025119029199 * t[3]
    sy = -0.4886025119029199 * t[1]
    sz = 0.4886025119029199 * t[2]
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    if n_sh > 4:
        c4, c5, c7 = (
            1.0925484305920792 * t[4],
            -1.0925484305920792 * t[5],
            1.0925484305920792 * t[7],
        )
        c6, c8 = 0.6307831305050401 * t[6], 1.0925484305920792 * t[8]
        sx += c4 * y - c6 * x - c7 * z + c8 * x
        sy += c4 * x + c5 * z - c6 * y - c8 * y
        sz += c5 * y + 2.0 * c6 * z - c7 * x
    if n_sh > 9:
        c9, c15 = -1.7701307697799304 * t[9], -1.7701307697799304 * t[15]
        c10, c14 = 2.890611442640554 * t[10], 1.445305721320277 * t[14]
        c11, c13 = -0.4570457994644658 * t[11], -0.4570457994644658 * t[13]
        c12 = 1.1195289977703462 * t[12]
        sx += 2.0 * c9 * xy + c10 * yz - 2.0 * c11 * xy - 2.0 * c12 * xz
        sx += c13 * (4.0 * zz - 3.0 * xx - yy) + 2.0 * c14 * xz + c15 * (xx - yy)
        sy += c9 * (xx - yy) + c10 * xz + c11 * (4.0 * zz - xx - 3.0 * yy) - 2.0 * c12 * yz
        sy -= 2.0 * c13 * xy + 2.0 * c14 * yz + 2.0 * c15 * xy
        sz += c10 * xy + 8.0 * (c11 * yz + c13 * xz) + c12 * (2.0 * zz - xx - yy)
        sz += c14 * (xx - yy)
    if n_sh > 16:
        c16, c17 = 2.5033429417967046 * t[16], -1.7701307697799304 * t[17]
        c18, c19 = 0.9461746957575601 * t[18], -0.6690465435572892 * t[19]
        c20, c21 = 0.10578554691520431 * t[20], -0.6690465435572892 * t[21]
        c22, c23 = 0.47308734787878004 * t[22], -1.7701307697799304 * t[23]
        c24 = 2.5033429417967046 * t[24]
        f1, f3 = 7.0 * zz - 1.0, 7.0 * zz - 3.0
        sx += c16 * y * (3.0 * xx - yy) + 6.0 * c17 * xy * z + c18 * y * f1 + c21 * z * f3
        sx += 2.0 * c22 * x * f1 + 3.0 * c23 * z * (xx - yy) + c24 * x * (xx - 3.0 * yy)
        sy += c16 * x * (xx - 3.0 * yy) + 3.0 * c17 * z * (xx - yy) + c18 * x * f1 + c19 * z * f3
        sy += -2.0 * c22 * y * f1 - 6.0 * c23 * xy * z + c24 * y * (yy - 3.0 * xx)
        sz += c17 * y * (3.0 * xx - yy) + 14.0 * c18 * xy * z
        sz += (c19 * y + c21 * x) * (21.0 * zz - 3.0) + c20 * z * (140.0 * zz - 60.0)
        sz += 14.0 * c22 * z * (xx - yy) + c23 * x * (xx - 3.0 * yy)
    slope[0] = sx
    slope[1] = sy
    slope[2] = sz
