"""Spherical harmonics against their definition, and the colors of groups."""

from math import factorial, pi, sqrt

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.color import group_palette, lab_from_rgb, sh_basis


def legendre_basis(directions: DoubleArray) -> DoubleArray:
    """Real spherical harmonics (N, 25) of degree 0-4 at unit directions (N, 3).

    Computed from associated Legendre functions (order l, then m from -l to l); signs are those of
    3D Gaussian Splatting, in which odd m carry the Condon-Shortley phase.
    """
    x, y, z = directions.T
    azimuth = np.arctan2(y, x)
    sine = np.sqrt(np.maximum(0, 1 - z * z))
    # P[l][m] without the phase, by the usual recurrences.
    P: dict[tuple[int, int], DoubleArray] = {(0, 0): np.ones_like(z)}
    for m in range(1, 5):
        P[m, m] = (2 * m - 1) * sine * P[m - 1, m - 1]
    for m in range(4):
        P[m + 1, m] = (2 * m + 1) * z * P[m, m]
        for degree in range(m + 2, 5):
            P[degree, m] = (
                (2 * degree - 1) * z * P[degree - 1, m] - (degree + m - 1) * P[degree - 2, m]
            ) / (degree - m)
    columns = []
    for degree in range(5):
        for m in range(-degree, degree + 1):
            k = abs(m)
            norm = sqrt((2 * degree + 1) / (4 * pi) * factorial(degree - k) / factorial(degree + k))
            if m == 0:
                columns.append(norm * P[degree, 0])
                continue
            wave = np.cos(k * azimuth) if m > 0 else np.sin(k * azimuth)
            columns.append((-1) ** k * sqrt(2) * norm * wave * P[degree, k])
    return np.stack(columns, axis=1)


def _product_rule() -> tuple[DoubleArray, DoubleArray]:
    """Directions (J, 3) and weights (J,) that integrate degree 8 over the sphere exactly."""
    z, z_weights = np.polynomial.legendre.leggauss(12)
    azimuth = np.arange(24) * 2 * np.pi / 24
    zz, aa = (a.ravel() for a in np.meshgrid(z, azimuth, indexing="ij"))
    sine = np.sqrt(1 - zz**2)
    directions = np.stack([sine * np.cos(aa), sine * np.sin(aa), zz], axis=1)
    return directions, np.repeat(z_weights, 24) * 2 * np.pi / 24


def test_sh_basis_is_orthonormal() -> None:
    """Integrated over the sphere: the identity matrix."""
    directions, weights = _product_rule()
    basis = sh_basis(directions, 4)
    np.testing.assert_allclose(basis.T @ (basis * weights[:, None]), np.eye(25), atol=1e-12)


def test_sh_basis_is_the_real_spherical_harmonics() -> None:
    directions, _ = _product_rule()
    for degree in range(5):
        want = legendre_basis(directions)[:, : (degree + 1) ** 2]
        np.testing.assert_allclose(sh_basis(directions, degree), want, atol=1e-12)


def _as_seen_without_green(rgb: DoubleArray) -> DoubleArray:
    """Colors (N, 3) as a deuteranope sees them (Vienot, Brettel, Mollon 1999)."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    lms_from_rgb = np.array(
        [[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]]
    )
    seen = np.array([[1, 0, 0], [0.494207, 0, 1.24827], [0, 0, 1]])
    flat = np.clip(linear @ (np.linalg.inv(lms_from_rgb) @ seen @ lms_from_rgb).T, 0, 1)
    return np.where(flat <= 0.0031308, 12.92 * flat, 1.055 * flat ** (1 / 2.4) - 0.055)


def test_group_colors_are_calm_and_tell_neighbours_apart_for_every_eye() -> None:
    colors = group_palette(200)[1:].astype(np.float64)
    lab = lab_from_rgb(colors)
    assert np.hypot(lab[:, 1], lab[:, 2]).max() < 50
    assert lab[:, 0].min() > 40
    assert lab[:, 0].max() < 76
    for shown, least in ((colors, 30.0), (_as_seen_without_green(colors), 6.0)):
        values = lab_from_rgb(shown)
        for apart in (1, 2, 3):
            assert np.linalg.norm(values[apart:] - values[:-apart], axis=1).min() > least
    assert np.array_equal(group_palette(500)[:201], group_palette(200))
