"""Rotation of spherical-harmonic color, degrees 0 to 4, in the basis of 3D Gaussian Splatting."""

from functools import cache

import numpy as np

from gaga_core.arrays import DoubleArray, check_shape
from gaga_core.color import SH_C0

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
