"""Rotation of spherical-harmonic color, degrees 0 to 4, in the basis of 3D Gaussian Splatting."""

from functools import cache

import numpy as np

from gaga_core.arrays import DoubleArray, check_shape
from gaga_core.color import sh_basis


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
