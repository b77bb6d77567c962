"""Books, toys, a globe: what lies about on a table."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.demo.patches import Patch, ellipsoid, pose, revolve, rounded_box, tube
from gaga_core.demo.sampling import Discs
from gaga_core.demo.surface import Material, Paint, Part, moved, parts
from gaga_core.demo.textures import Color, fractal, mix, noise, plain, rgb, step

_PAPER = rgb("efe6d2")
GOLD = rgb("d8b45a")


def book(
    size: tuple[float, float, float], cloth: Color, accent: Color, seed: int = 0
) -> list[Part]:
    """A bound book lying flat: size along x (spine to edge), y (spine length), z (thickness).

    The spine faces -x. Cloth boards, a block of pages set back from them, bands on the spine.
    """
    w, d, h = size
    board = 0.0035
    cover = Material(_cloth(cloth, accent, size, seed), 0.10, 10.0)
    found: list[Part] = []
    slab = rounded_box((w, d, board), 0.0012)
    rims = [slab[k] for k in ("+x", "-y", "+y")]
    for z, outside, inside in ((h - board / 2, "+z", "-z"), (board / 2, "-z", "+z")):
        place = pose((0, 0, z))
        found += moved(parts([slab[outside]], cover, 0.0095), place)
        found += moved(parts([slab[inside]], cover, 0.02), place)
        found += moved(parts(rims, cover, (0.0045, 0.0095)), place)
    found += _spine(size, cloth, accent)
    pages = rounded_box((w - 0.009, d - 0.014, h - 2 * board), 0.0006)
    leaves = Material(_leaves())
    place = pose((0, 0, h / 2))
    found += moved(parts([pages["+x"]], leaves, (0.0095, 0.0038)), place)
    return found + moved(parts([pages["-y"], pages["+y"]], leaves, (0.0038, 0.0095)), place)


def _cloth(cloth: Color, accent: Color, size: tuple[float, float, float], seed: int) -> Paint:
    w, d, h = size

    def paint(p: Discs) -> DoubleArray:
        x, y, z = p.points.T
        fibre = 0.97 + 0.06 * fractal(p.points * 60, 2, seed)
        color = np.asarray(cloth) * fibre[:, None]
        inset = np.minimum(w / 2 - np.abs(x), d / 2 - np.abs(y))
        frame = step(-np.abs(inset - 0.02), -0.006, -0.004)
        block = (np.abs(x - 0.02 * w) < 0.2 * w) & (np.abs(y - 0.18 * d) < 0.1 * d)
        on_top = p.normals[:, 2] > 0.8
        return mix(color, accent, np.where(on_top & (z > -h), np.maximum(frame, block), 0.0))

    return paint


def _spine(size: tuple[float, float, float], cloth: Color, accent: Color) -> list[Part]:
    w, d, h = size

    def paint(p: Discs) -> DoubleArray:
        y = p.points[:, 1]
        band = np.zeros(len(p))
        for at, half in ((-0.40, 0.012), (-0.34, 0.006), (0.30, 0.05), (0.40, 0.010)):
            band = np.maximum(band, step(-np.abs(y - at * d), -half * d - 0.001, -half * d))
        fibre = 0.97 + 0.06 * fractal(p.points * 60, 2, 3)
        return mix(np.asarray(cloth) * fibre[:, None], accent, band)

    half = h / 2
    bulge = min(0.006, 0.3 * h)

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        s = 2 * u - 1
        x = -w / 2 - bulge * (1 - s * s) + 0.0015
        return np.stack([x, (v - 0.5) * d, half + s * half], axis=1)

    return parts([Patch(position)], Material(paint, 0.12, 10.0), (0.0065, 0.0075))


def _leaves() -> Paint:
    def paint(p: Discs) -> DoubleArray:
        line = noise(np.stack([0 * p.points[:, 0], 0 * p.points[:, 1], p.points[:, 2] / 0.0022], 1))
        return np.asarray(_PAPER) * (0.92 + 0.08 * line)[:, None]

    return paint


def die(color: Color, pip: Color, edge: float = 0.036) -> list[Part]:
    """A large wooden die; opposite faces sum to seven."""
    layout = {"+z": 1, "-z": 6, "+x": 2, "-x": 5, "+y": 3, "-y": 4}
    box = rounded_box((edge, edge, edge), 0.2 * edge)
    found: list[Part] = []
    for face, patch in box.items():
        finish = Material(_pips(layout[face], color, pip), 0.5, 30.0)
        found += parts([patch], finish, 0.0030)
    return moved(found, pose((0, 0, edge / 2)))


def _pips(count: int, color: Color, pip: Color) -> Paint:
    spots = {
        1: [(0, 0)],
        2: [(-1, -1), (1, 1)],
        3: [(-1, -1), (0, 0), (1, 1)],
        4: [(-1, -1), (-1, 1), (1, -1), (1, 1)],
        5: [(-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)],
        6: [(-1, -1), (-1, 0), (-1, 1), (1, -1), (1, 0), (1, 1)],
    }[count]

    def paint(p: Discs) -> DoubleArray:
        at = 2 * p.uv - 1
        near = np.min([np.hypot(*(at - 0.48 * np.array(s)).T) for s in spots], axis=0)
        return mix(pip, color, step(near, 0.15, 0.21))

    return paint


def block(color: Color, edge: float = 0.05) -> list[Part]:
    """A toy block: pale wood with a colored frame and a disc on each face."""

    def paint(p: Discs) -> DoubleArray:
        at = np.abs(2 * p.uv - 1)
        frame = step(at.max(axis=1), 0.70, 0.75)
        disc = 1 - step(np.hypot(at[:, 0], at[:, 1]), 0.36, 0.42)
        grain = 0.94 + 0.12 * fractal(p.points * [40, 300, 300], 2, 5)
        return mix(rgb("e8c998"), color, np.maximum(frame, disc)) * grain[:, None]

    finish = Material(paint, 0.15, 14.0)
    faces = list(rounded_box((edge, edge, edge), 0.1 * edge).values())
    return moved(parts(faces, finish, 0.0038), pose((0, 0, edge / 2)))


def globe() -> list[Part]:
    """A globe on a brass meridian and a wooden foot."""
    radius, height = 0.085, 0.155

    def paint(p: Discs) -> DoubleArray:
        q = p.points / radius
        land = fractal(q * 1.7 + 4.2, 4, 21)
        dry = fractal(q * 3.0, 3, 5)
        ground = mix(rgb("7f9a4f"), rgb("d3b878"), step(dry, 0.42, 0.6))
        color = mix(rgb("3c7f9c"), ground, step(land, 0.505, 0.53))
        color = mix(color, rgb("f5f2e8"), step(np.abs(q[:, 2]) + 0.15 * dry, 0.93, 0.98))
        ring, turn = np.hypot(q[:, 0], q[:, 1]), np.arctan2(q[:, 1], q[:, 0]) / (np.pi / 6)
        lines = np.minimum(np.abs(turn % 1 - 0.5) * ring, np.abs((q[:, 2] * 3) % 1 - 0.5))
        return mix(color, rgb("2f5c70"), 0.35 * (1 - step(lines, 0.015, 0.05)))

    ball = parts([ellipsoid((radius,) * 3)], Material(paint, 0.55, 30.0), 0.0064)
    brass = Material(plain(rgb("c0913f"), mottle=0.04), 1.0, 25.0)
    wooden = Material(plain(rgb("6b4226"), mottle=0.10, scale=0.01), 0.4, 20.0)
    arc = [
        (0.098 * np.sin(a), 0.0, height - 0.098 * np.cos(a)) for a in np.linspace(-0.05, 3.0, 12)
    ]
    foot = [
        (0.0, 0.0),
        (0.062, 0.0),
        (0.066, 0.005),
        (0.060, 0.014),
        (0.022, 0.022),
        (0.010, 0.034),
        (0.009, 0.058),
        (0.0, 0.06),
    ]
    return [
        *moved(ball, pose((0, 0, height), tilt=23)),
        *moved(parts([tube(arc, [0.0042] * 12)], brass, 0.0046), pose(yaw=35)),
        *parts([revolve(foot)], wooden, 0.0050),
    ]
