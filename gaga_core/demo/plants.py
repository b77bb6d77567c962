"""Flowers for the vase, a rubber plant for the floor, a small cactus."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.demo.patches import Patch, ellipsoid, pose, revolve, tube
from gaga_core.demo.sampling import Discs
from gaga_core.demo.surface import Material, Paint, Part, moved, parts
from gaga_core.demo.textures import Color, fractal, mix, noise, plain, rgb, step


def blade(length: float, width: float, *, bend: float = 0.3, fold: float = 0.15) -> Patch:
    """A leaf or petal from the origin along +x: pointed, folded at its rib, bent downwards."""

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        s = 2 * u - 1
        half = width / 2 * np.sin(np.pi * np.clip(v, 0, 1) ** 0.75) ** 0.8
        x = length * np.sin(bend * v) / bend
        z = -length * (1 - np.cos(bend * v)) / bend + fold * half * np.abs(s)
        return np.stack([x, -s * half, z], axis=1)

    return Patch(position)


def _leaf_paint(light: Color, dark: Color, seed: int) -> Paint:
    def paint(d: Discs) -> DoubleArray:
        across, along = np.abs(2 * d.uv[:, 0] - 1), d.uv[:, 1]
        rib = 1 - step(across, 0.03, 0.14)
        veins = 0.5 + 0.5 * np.sin(2 * np.pi * (9 * along - 2.5 * across))
        cloud = fractal(d.points / 0.04, 2, seed)
        base = mix(dark, light, 0.25 + 0.5 * cloud + 0.18 * veins)
        return mix(base, light, 0.75 * rib)

    return paint


def _blossom(color: Color, heart: Color, size: float, petals: int, seed: int) -> list[Part]:
    """Two wheels of petals around a heart, opening upwards."""

    def paint(d: Discs) -> DoubleArray:
        along = d.uv[:, 1]
        streak = noise(np.stack([d.uv[:, 0] * 7, along, 0 * along], axis=1), seed)
        inner = mix(color, heart, 0.55 * (1 - step(along, 0.05, 0.45)))
        return inner * (0.88 + 0.2 * streak)[:, None]

    finish = Material(paint, soft=0.75)
    found: list[Part] = []
    for wheel, (lift, scale) in enumerate(((-18, 1.0), (-48, 0.78))):
        petal = blade(size * scale, 0.62 * size, bend=0.7, fold=0.25)
        for k in range(petals):
            yaw = 360 / petals * (k + 0.5 * wheel)
            found += moved(parts([petal], finish, 0.0085), pose(yaw=yaw, tilt=lift))
    core = ellipsoid((0.30 * size, 0.30 * size, 0.22 * size), (0, 0, 0.08 * size))
    middle = Material(plain(heart, mottle=0.25, scale=0.004), soft=0.3)
    return found + parts([core], middle, 0.0040)


def bouquet(seed: int = 4) -> list[Part]:
    """Blossoms and leaves on stems that come out of the vase's neck at z = 0."""
    rng = np.random.default_rng(seed)
    kinds = [
        (rgb("e2603f"), rgb("5a2a20"), 0.046, 6),
        (rgb("f6efe0"), rgb("e0a92e"), 0.042, 9),
        (rgb("eda73c"), rgb("7a4a1e"), 0.044, 8),
        (rgb("e99a94"), rgb("c24d4d"), 0.045, 7),
    ]
    green = Material(plain(rgb("5f7f3c"), mottle=0.1, scale=0.01), soft=0.3)
    leaf = Material(_leaf_paint(rgb("8fae5a"), rgb("4d7035"), 2), 0.1, 10.0, 0.0, 0.7)
    found: list[Part] = []
    for k in range(9):
        yaw = 360 * k * 0.382 + rng.uniform(-12, 12)
        lean = 0.20 + 0.55 * (k / 8) ** 0.8
        reach = 0.23 - 0.055 * (k / 8) + rng.uniform(-0.02, 0.02)
        tip = (reach * np.sin(lean), 0.0, reach * np.cos(lean))
        path = [(0.0, 0, -0.08), (0.008, 0, 0.0), (0.45 * tip[0], 0, 0.6 * tip[2]), tip]
        found += moved(parts([tube(path, [0.0023] * 4)], green, (0.006, 0.008)), pose(yaw=yaw))
        color, heart, size, petals = kinds[k % 4]
        head = _blossom(color, heart, size, petals, k)
        head = moved(head, pose(tip, tilt=float(np.degrees(lean)) * 0.9))
        found += moved(head, pose(yaw=yaw))
    for k in range(8):
        yaw, lift = 45 * k + rng.uniform(-10, 10), rng.uniform(-62, -30)
        frond = moved(parts([blade(0.15, 0.036, bend=1.1)], leaf, 0.0095), pose(tilt=lift))
        found += moved(frond, pose((0, 0, 0.004), yaw=yaw))
    return found


def rubber_plant(seed: int = 8) -> list[Part]:
    """Large glossy leaves around a stem that starts at z = 0."""
    rng = np.random.default_rng(seed)
    leaf = Material(_leaf_paint(rgb("6f9a4e"), rgb("2f5a34"), 6), 0.35, 12.0, 0.0, 0.45)
    bark = Material(plain(rgb("6a5138"), mottle=0.15, scale=0.02))
    trunk = [(0, 0, -0.05), (0.02, 0.01, 0.25), (-0.01, 0.02, 0.55), (0.02, 0.0, 0.95)]
    found = parts([tube(trunk, [0.016, 0.013, 0.010, 0.006])], bark, (0.014, 0.02))
    for k in range(17):
        height = 0.16 + 0.80 * k / 16
        lift = -8 - 58 * (k / 16) ** 2 + rng.uniform(-8, 8)
        length = 0.34 - 0.13 * (k / 16) + rng.uniform(-0.02, 0.02)
        yaw = 137.5 * k + rng.uniform(-10, 10)
        stalk = tube([(0, 0, 0), (0.04, 0, 0.004), (0.085, 0, 0.0)], [0.005, 0.004, 0.003])
        surface = parts([blade(length, 0.42 * length, bend=0.9)], leaf, 0.0155)
        one = moved(surface, pose((0.08, 0, 0)))
        one += parts([stalk], bark, (0.012, 0.02))
        found += moved(moved(one, pose(tilt=lift)), pose((0.012, 0.01, height), yaw=yaw))
    return found


def pot(color: Color, size: float = 1.0) -> list[Part]:
    """A terracotta pot with earth in it; 30 cm high at size 1."""
    clay = Material(plain(color, mottle=0.08, scale=0.05), 0.05, 8.0)
    earth = Material(plain(rgb("4a3626"), mottle=0.35, scale=0.012))
    wall = [
        (0.0, 0.0),
        (0.11, 0.0),
        (0.118, 0.006),
        (0.15, 0.25),
        (0.165, 0.252),
        (0.168, 0.258),
        (0.170, 0.30),
        (0.164, 0.305),
        (0.155, 0.300),
        (0.150, 0.26),
    ]
    points = [(size * r, size * z) for r, z in wall]
    soil = [(size * 0.152, size * 0.272), (size * 0.08, size * 0.278), (0.0, size * 0.276)]
    fine = 0.0145 * size**0.7
    return [*parts([revolve(points)], clay, fine), *parts([revolve(soil)], earth, fine)]


def cactus() -> list[Part]:
    """A ribbed ball with pale spines, for a small pot; its foot is at z = 0."""

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        turn, polar = 2 * np.pi * u, np.pi * (1 - v) * 0.93
        rib = 1 + 0.10 * np.abs(np.cos(6 * turn)) * np.sin(polar)
        ring = 0.036 * np.sin(polar) * rib
        return np.stack(
            [ring * np.cos(turn), ring * np.sin(turn), 0.036 + 0.046 * np.cos(polar)], axis=1
        )

    def paint(d: Discs) -> DoubleArray:
        ridge = np.abs(np.cos(12 * np.pi * d.uv[:, 0]))
        dots = ((d.uv[:, 1] * 14) % 1 > 0.55) & (ridge > 0.9)
        return mix(mix(rgb("3f6b41"), rgb("7fa25c"), ridge), rgb("f3ecd2"), dots)

    finish = Material(paint, 0.05, 8.0, 0.0, 0.2)
    bloom = _blossom(rgb("e86a8a"), rgb("f4d35e"), 0.024, 7, 3)
    return parts([Patch(position, closed=True)], finish, 0.0040) + moved(bloom, pose((0, 0, 0.083)))
