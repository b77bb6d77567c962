"""Fruit and doughnuts."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.demo.patches import Patch, pose, revolve, tube
from gaga_core.demo.sampling import Discs
from gaga_core.demo.surface import Material, Part, moved, parts
from gaga_core.demo.textures import Color, fractal, mix, noise, plain, rgb, step


def _bumpy(patch: Patch, height: float, scale: float, seed: int) -> Patch:
    """The patch swollen by noise: no fruit is quite round."""

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        p = patch.position(u, v)
        out = p / np.maximum(np.linalg.norm(p, axis=1, keepdims=True), 1e-9)
        result: DoubleArray = p + height * (noise(p / scale, seed) - 0.5)[:, None] * out
        return result

    return replace(patch, position=position)


def apple(red: Color, yellow: Color, seed: int) -> list[Part]:
    """An apple 7.5 cm across, redder on its sunny side."""

    def paint(d: Discs) -> DoubleArray:
        angle = np.arctan2(d.points[:, 1], d.points[:, 0])
        top = step(np.hypot(d.points[:, 0], d.points[:, 1]), 0.004, 0.022)
        streak = noise(np.stack([angle * 9, d.points[:, 2] * 25, 0 * angle], axis=1), seed)
        blush = 0.55 + 0.45 * np.sin(angle + seed) + 0.5 * (streak - 0.5)
        spots = 0.35 * step(noise(d.points / 0.0035, seed + 1), 0.82, 0.92)
        return mix(mix(yellow, red, step(blush * top, 0.05, 0.6)), yellow, spots)

    profile = [
        (0.0, 0.006),
        (0.010, 0.001),
        (0.022, 0.003),
        (0.034, 0.022),
        (0.0385, 0.043),
        (0.032, 0.064),
        (0.018, 0.071),
        (0.008, 0.067),
        (0.0, 0.058),
    ]
    stem = tube([(0, 0, 0.058), (0.002, 0, 0.070), (0.006, 0.002, 0.080)], [0.0016, 0.0014, 0.0020])
    return [
        *parts([_bumpy(revolve(profile), 0.004, 0.04, seed)], Material(paint, 0.55, 28.0), 0.0048),
        *parts([stem], Material(plain(rgb("5d4426"))), 0.004),
    ]


def orange(seed: int) -> list[Part]:
    """An orange with pitted skin."""

    def paint(d: Discs) -> DoubleArray:
        pits = fractal(d.points / 0.0035, 2, seed)
        cloud = fractal(d.points / 0.03, 2, seed + 1)
        navel = step(np.hypot(d.points[:, 0], d.points[:, 1]), 0.002, 0.0045)
        skin = mix(rgb("e06c08"), rgb("ec8414"), cloud) * (0.90 + 0.18 * pits)[:, None]
        low = mix(rgb("6f7a34"), skin, navel)
        return np.where(d.points[:, 2:] > 0.03, low, skin)

    profile = [
        (0.0, 0.0),
        (0.016, 0.002),
        (0.031, 0.014),
        (0.038, 0.036),
        (0.032, 0.059),
        (0.016, 0.071),
        (0.0, 0.0725),
    ]
    skin = _bumpy(revolve(profile), 0.002, 0.03, seed)
    return parts([skin], Material(paint, 0.35, 12.0), 0.0048)


def lemon(seed: int) -> list[Part]:
    """A lemon lying on its side."""

    def paint(d: Discs) -> DoubleArray:
        pits = fractal(d.points / 0.004, 2, seed)
        color = mix(rgb("f3d03e"), rgb("e6bd2a"), fractal(d.points / 0.02, 2, seed + 1))
        return color * (0.92 + 0.14 * pits)[:, None]

    profile = [
        (0.0, -0.046),
        (0.006, -0.043),
        (0.012, -0.035),
        (0.026, -0.018),
        (0.029, 0.0),
        (0.026, 0.018),
        (0.012, 0.035),
        (0.007, 0.042),
        (0.0, 0.045),
    ]
    lying = pose((0, 0, 0.028), tilt=90)
    return moved(parts([revolve(profile)], Material(paint, 0.4, 16.0), 0.0046), lying)


def bananas() -> list[Part]:
    """Three bananas of one bunch."""

    def paint(d: Discs) -> DoubleArray:
        along = d.uv[:, 1]
        tip = step(along, 0.955, 0.985) + 1 - step(along, 0.02, 0.05)
        speck = step(noise(d.points / 0.005, 12), 0.80, 0.90) * step(along, 0.1, 0.2)
        green = 0.45 * (1 - step(along, 0.05, 0.22))
        color = mix(mix(rgb("f2cb3d"), rgb("b7bd4a"), green), rgb("7a5524"), 0.55 * speck)
        return mix(color, rgb("4f3a1f"), tip)

    found: list[Part] = []
    for k, yaw in enumerate((-26, 0, 24)):
        lift = 0.004 * (k == 1)
        path = [
            (0.0, 0.0, 0.030),
            (0.022, 0.0, 0.022),
            (0.065, 0.0, 0.018 + lift),
            (0.115, 0.0, 0.026 + lift),
            (0.155, 0.0, 0.052 + lift),
            (0.172, 0, 0.072 + lift),
        ]
        peel = tube(path, [0.006, 0.009, 0.0172, 0.0178, 0.0125, 0.0045])
        found += moved(parts([peel], Material(paint, 0.2, 10.0), 0.0050), pose(yaw=yaw))
    return found


def doughnut(icing: Color, seed: int) -> list[Part]:
    """A doughnut with icing that runs down unevenly, and sugar sprinkles."""
    dough = Material(plain(rgb("c98b4b"), mottle=0.10, scale=0.012), 0.06, 8.0)
    glaze = Material(plain(icing, mottle=0.02), 0.7, 30.0)
    big, small = 0.032, 0.0215
    ring = [
        (big + small * np.sin(a), small * (1 - 0.92 * np.cos(a)))
        for a in np.linspace(0, 2 * np.pi, 15)
    ]
    return [
        *parts([revolve(ring)], dough, 0.0062),
        *parts([_icing(big, small, seed)], glaze, 0.0054),
        *_sprinkles(big, small, seed),
    ]


def _icing(big: float, small: float, seed: int) -> Patch:
    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        turn = 2 * np.pi * u
        drip = np.sin(3 * turn + seed) + 0.7 * np.sin(7 * turn + 2 * seed)
        outer, inner = 1.45 + 0.16 * drip, 1.25 + 0.1 * np.sin(5 * turn)
        angle = outer + v * (-inner - outer)  # from the outer edge over the top to the inner edge
        lip = 1 + 0.07 * np.clip(np.minimum(v, 1 - v) / 0.06, 0, 1) ** 0.5
        radius = big + small * lip * np.sin(angle)
        height = small * (1 + 0.92 * lip * np.cos(angle)) + 0.0005
        return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)

    return Patch(position, closed=True)


def _sprinkles(big: float, small: float, seed: int) -> list[Part]:
    rng = np.random.default_rng(seed)
    colors = [rgb("fff6e8"), rgb("f4c542"), rgb("5aa9c9"), rgb("7fb069")]
    found: list[Part] = []
    for k in range(30):
        turn, angle, yaw = rng.uniform(0, 360), rng.uniform(-0.9, 1.0), rng.uniform(0, 180)
        radius = big + 1.07 * small * np.sin(angle)
        height = small * (1 + 0.99 * np.cos(angle)) + 0.001
        body = tube(
            [(-0.0045, 0, 0), (-0.004, 0, 0), (0.004, 0, 0), (0.0045, 0, 0)],
            [0.0006, 0.0017, 0.0017, 0.0006],
        )
        tilt = float(np.degrees(angle))
        place = pose(
            (radius * np.cos(np.radians(turn)), radius * np.sin(np.radians(turn)), height),
            yaw=turn,
            tilt=tilt,
        )
        finish = Material(plain(colors[k % 4]), 0.3, 20.0)
        found += moved(moved(parts([body], finish, (0.0055, 0.0036)), pose(yaw=yaw)), place)
    return found
