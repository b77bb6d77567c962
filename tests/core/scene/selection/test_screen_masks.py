"""Masks of gestures against the definition, pixel by pixel."""

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.scene.selection import by_screen

W, H = 40, 30


def _is_inside(points: list[tuple[float, float]], u: float, v: float) -> bool:
    """Even-odd rule."""
    inside = False
    for (u0, v0), (u1, v1) in zip(points, [*points[1:], points[0]], strict=True):
        if (v0 > v) != (v1 > v) and u < (u1 - u0) * (v - v0) / (v1 - v0) + u0:
            inside = not inside
    return inside


def _edge_distance(points: list[tuple[float, float]], u: float, v: float) -> float:
    p = np.array([u, v])
    far = []
    for a, b in zip(np.array(points), np.roll(points, -1, axis=0), strict=True):
        along = b - a
        share = np.clip((p - a) @ along / max(along @ along, 1e-9), 0, 1)
        far.append(np.linalg.norm(p - a - share * along))
    return float(min(far))


@pytest.mark.parametrize("seed", range(6))
def test_a_polygon_holds_the_pixels_whose_centres_it_surrounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 7))
    r = rng.uniform(4, 22, 7)  # partly outside the picture
    points = [(20 + a, 15 + b) for a, b in zip(r * np.cos(angle), r * np.sin(angle), strict=True)]
    mask = by_screen.polygon(points, W, H)
    n = 0
    for y in range(H):
        for x in range(W):
            if _edge_distance(points, x + 0.5, y + 0.5) > 1e-6:
                assert mask[y, x] == _is_inside(points, x + 0.5, y + 0.5), (x, y)
                n += 1
    assert n > 900
    assert mask.any()


def test_a_square_is_exact() -> None:
    mask = by_screen.polygon([(5, 6), (15, 6), (15, 20), (5, 20)], W, H)
    want = np.zeros((H, W), np.bool_)
    want[6:20, 5:15] = True
    assert np.array_equal(mask, want)
    assert np.array_equal(by_screen.rectangle((15, 20, 5, 6), W, H), want)


@pytest.mark.parametrize("points", [[], [(1, 1)], [(1, 1), (9, 9)], [(-9, -9), (-2, -9), (-2, -2)]])
def test_nothing_is_inside_an_outline_without_area_or_beside_the_picture(
    points: list[tuple[float, float]],
) -> None:
    assert not by_screen.polygon(points, W, H).any()


def _painted(*steps: tuple[tuple[float, float], tuple[float, float]], radius: float) -> BoolArray:
    mask = np.zeros((H, W), np.bool_)
    for start, stop in steps:
        by_screen.stroke(mask, start, stop, radius)
    return mask


@pytest.mark.parametrize("radius", [0.8, 3, 12])
def test_a_stroke_is_what_lies_within_its_radius(radius: float) -> None:
    a, b = np.array([-3.0, 10]), np.array([33.0, 24.5])
    v, u = np.mgrid[:H, :W] + 0.5
    along = b - a
    share = np.clip(((u - a[0]) * along[0] + (v - a[1]) * along[1]) / (along @ along), 0, 1)
    far = np.hypot(u - a[0] - share * along[0], v - a[1] - share * along[1])
    mask = _painted(((-3, 10), (33, 24.5)), radius=radius)
    assert np.array_equal(mask[abs(far - radius) > 1e-6], (far <= radius)[abs(far - radius) > 1e-6])
    half = ((-3 + 33) / 2, (10 + 24.5) / 2)
    assert np.array_equal(mask, _painted(((-3, 10), half), (half, (33, 24.5)), radius=radius))


def test_a_dab_is_a_disc_and_one_outside_paints_nothing() -> None:
    disc = _painted(((20, 15), (20, 15)), radius=5)
    assert abs(int(disc.sum()) - 25 * np.pi) < 8
    assert np.array_equal(disc, disc[:, ::-1])
    assert not _painted(((-9, -9), (-9, -9)), radius=5).any()
