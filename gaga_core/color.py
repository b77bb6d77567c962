"""Spherical harmonics of color, and the colors of groups and of depth."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, check_shape

SH_C0 = 0.28209479177387814  # Y_0^0; color = 0.5 + C0 * dc (3D Gaussian Splatting, Kerbl 2023)
LUMA = np.array([0.2126, 0.7152, 0.0722])  # red, green, blue of a luminance (Rec. 709)
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005)
_C3 = (-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154)
_C4 = (
    2.5033429417967046,
    -1.7701307697799304,
    0.9461746957575601,
    -0.6690465435572892,
    0.10578554691520431,
    0.47308734787878004,
    0.6258357354491761,
)
# Near is light yellow, far is dark violet; lightness falls evenly, so that it reads in gray too.
# Fitted to equal steps of OKLab lightness with a turning hue: RGB of t^5, t^4, ... 1.
DEPTH_POLYNOMIAL = (
    (-2.3091, -3.6267, 19.4515),
    (10.6356, 5.1724, -48.4768),
    (-14.1871, 0.5230, 37.7581),
    (6.0236, -2.1676, -7.8111),
    (-1.0434, -0.7561, -1.2072),
    (1.0103, 0.9187, 0.5842),
)
_GOLDEN = 0.618033988749895  # turns of hue from one group to the next
_LIGHTNESS, _CHROMA = (72.0, 54.0, 63.0, 45.0), (42.0, 30.0)  # of groups, CIE Lab
WHITE = np.array([0.95047, 1.0, 1.08883])  # D65
XYZ_FROM_RGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
_RGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def rgb_from_dc(dc: FloatArray) -> FloatArray:
    """Color (..., 3) of the degree-0 SH coefficient, not clipped."""
    return (0.5 + SH_C0 * dc).astype(np.float32)


def dc_from_rgb(rgb: FloatArray) -> FloatArray:
    """Degree-0 SH coefficient (..., 3) of a color."""
    return ((np.asarray(rgb) - 0.5) / SH_C0).astype(np.float32)


def sh_basis(directions: DoubleArray, degree: int) -> DoubleArray:
    """Basis (N, S) at unit ``directions`` (N, 3), S = (degree + 1)^2, in 3DGS order and signs.

    The color seen along d (from camera to splat) is ``0.5 + sh_basis(d) @ sh``
    (Kerbl 2023, after Fridovich-Keil 2022, Plenoxels).
    """
    check_shape("directions", directions, ("N", 3))
    x, y, z = np.asarray(directions, np.float64).T
    xx, yy, zz = x * x, y * y, z * z
    columns = [np.full_like(x, SH_C0), -_C1 * y, _C1 * z, -_C1 * x]
    columns += [
        _C2[0] * x * y,
        _C2[1] * y * z,
        _C2[2] * (2 * zz - xx - yy),
        _C2[1] * x * z,
        _C2[0] / 2 * (xx - yy),
    ]
    columns += [
        _C3[0] * y * (3 * xx - yy),
        _C3[1] * x * y * z,
        _C3[2] * y * (4 * zz - xx - yy),
        _C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
        _C3[2] * x * (4 * zz - xx - yy),
        _C3[1] / 2 * z * (xx - yy),
        _C3[0] * x * (xx - 3 * yy),
    ]
    columns += [
        _C4[0] * x * y * (xx - yy),
        _C4[1] * y * z * (3 * xx - yy),
        _C4[2] * x * y * (7 * zz - 1),
        _C4[3] * y * z * (7 * zz - 3),
        _C4[4] * (zz * (35 * zz - 30) + 3),
        _C4[3] * x * z * (7 * zz - 3),
        _C4[5] * (xx - yy) * (7 * zz - 1),
        _C4[1] * x * z * (xx - 3 * yy),
        _C4[6] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
    ]
    return np.stack(columns[: (degree + 1) ** 2], axis=1)


def group_palette(n_groups: int) -> FloatArray:
    """Colors (n_groups + 1, 3) of labels 0..n_groups: 0 is dark grey, the rest distinct.

    Stable by id: a group keeps its color when others come or go. Hue walks by the golden ratio at a
    low chroma, so that a picture full of them stays calm; lightness cycles in CIE Lab, so that
    neighbours in id also differ for eyes that do not tell hues apart.
    """
    ids = np.arange(1, n_groups + 1)
    chroma = np.array(_CHROMA)[ids % len(_CHROMA)]
    colors = np.full((n_groups + 1, 3), 0.22, np.float32)
    colors[1:] = _group_colors(ids, ids, chroma)
    return colors


def shades(hue: IntArray, shade: IntArray) -> FloatArray:
    """Colors (K, 3) of hues (K,), numbered from 0 as in `group_palette`.

    ``shade`` (K,) is any number >= 0: it tells objects of one hue apart by lightness alone.
    """
    return _group_colors(hue, shade, np.full(len(hue), _CHROMA[0])).astype(np.float32)


def _group_colors(hue: AnyArray, shade: AnyArray, chroma: DoubleArray) -> DoubleArray:
    angle = 2 * np.pi * ((0.57 + hue * _GOLDEN) % 1.0)
    lightness = np.array(_LIGHTNESS)[shade % len(_LIGHTNESS)]
    return _rgb_from_lab(np.stack([lightness, chroma * np.cos(angle), chroma * np.sin(angle)], 1))


def linear_of_srgb(rgb: AnyArray) -> AnyArray:
    """Linear light of sRGB colors, both 0..1, of any shape (IEC 61966-2-1)."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab_from_rgb(rgb: AnyArray) -> DoubleArray:
    """CIE Lab (..., 3), D65, of sRGB colors (..., 3) in 0..1 (clipped)."""
    unit = np.clip(np.asarray(rgb, np.float64), 0, 1)
    linear = linear_of_srgb(unit)
    xyz = linear @ XYZ_FROM_RGB.T / WHITE
    root = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def _rgb_from_lab(lab: DoubleArray) -> DoubleArray:
    """Colors (N, 3), sRGB in 0..1, clipped, of CIE Lab (N, 3) under D65."""
    root = (
        (lab[:, :1] + 16) / 116 + lab[:, 1:2] * [[1 / 500, 0, 0]] - lab[:, 2:] * [[0, 0, 1 / 200]]
    )
    xyz = np.where(root > 6 / 29, root**3, 3 * (6 / 29) ** 2 * (root - 4 / 29))
    linear = np.clip(xyz * WHITE @ _RGB_FROM_XYZ.T, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def colorize_labels(labels: IntArray) -> FloatArray:
    """RGB picture (H, W, 3) of a label map (H, W)."""
    palette = group_palette(int(labels.max(initial=0)))
    return palette[np.maximum(labels, 0)]


def depth_colors(depth: FloatArray, span: tuple[float, float]) -> FloatArray:
    """Colors (H, W, 3) of depths (H, W) > 0: `DEPTH_POLYNOMIAL` of log depth, from the logs
    ``span`` of the nearest to the farthest depth."""
    near, far = span
    t = np.clip((np.log(np.maximum(depth, 1e-20)) - near) / (far - near), 0, 1)[..., None]
    color = np.zeros((*depth.shape, 3), np.float32)
    for coefficients in DEPTH_POLYNOMIAL:
        color = color * t + np.array(coefficients, np.float32)
    return np.clip(color, 0, 1).astype(np.float32)


# --- Rotation of spherical-harmonic color, degrees 0 to 4, in the basis of 3D Gaussian Splatting.


def sh_rotation(rotation: DoubleArray, degree: int) -> DoubleArray:
    """Matrix (S, S) that turns SH coefficients with the splat: ``sh_basis(Q d) @ (D c) ==
    sh_basis(d) @ c`` for every direction d.

    ``rotation`` Q (3, 3) is orthogonal; a mirror (determinant -1) works too. Each band maps onto
    itself, so D follows exactly from the values at a few directions (a projection in the sense of
    Ivanic and Ruedenberg 1996, without their recurrences).
    """
    check_shape("rotation", rotation, (3, 3))
    directions, inverse = _samples(degree)
    dense = inverse @ sh_basis(directions @ rotation, degree)
    bands = np.zeros_like(dense)
    for band in range(degree + 1):
        part = slice(band**2, (band + 1) ** 2)
        bands[part, part] = dense[part, part]
    return bands


@cache
def _samples(degree: int) -> tuple[DoubleArray, DoubleArray]:
    """Directions (J, 3) spread over the sphere (Fibonacci), and the pseudo-inverse (S, J) there."""
    n = 64
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return directions, np.linalg.pinv(sh_basis(directions, degree)).astype(np.float64)


def luminance(rgb: AnyArray | Sequence[float]) -> float:
    """Relative luminance of sRGB (3,), 0..1 (WCAG 2.2)."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb]
    return float(LUMA @ linear)
