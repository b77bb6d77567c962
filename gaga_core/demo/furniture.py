"""Table, chairs, rug, lamp, shelf, pictures, clock."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.demo.patches import (
    Patch,
    ellipsoid,
    pose,
    rectangle,
    revolve,
    rod,
    rounded_box,
    tube,
)
from gaga_core.demo.sampling import Discs
from gaga_core.demo.surface import Material, Paint, Part, moved, parts
from gaga_core.demo.textures import Color, fractal, mix, plain, rgb, step, weave, wood

TABLE_TOP = 0.74  # height of its surface
OAK = wood(rgb("c79260"), rgb("85552e"), axis=0, seed=1)
OAK_UP = wood(rgb("c08b58"), rgb("80522d"), axis=2, seed=2)


def table(length: float = 1.50, depth: float = 0.86) -> list[Part]:
    """A wooden table with rounded edges."""
    top = rounded_box((length, depth, 0.036), 0.012)
    varnish = Material(OAK, 0.30, 14.0)
    place = pose((0, 0, TABLE_TOP - 0.018))
    found = moved(parts([top["+z"]], varnish, (0.0140, 0.0088)), place)
    found += moved(parts([top["-z"]], varnish, 0.04), place)
    found += moved(parts([top["-x"], top["+x"]], varnish, (0.0125, 0.008)), place)
    found += moved(parts([top["-y"], top["+y"]], varnish, (0.008, 0.014)), place)
    legs = Material(OAK_UP, 0.15, 12.0)
    leg = list(rounded_box((0.062, 0.062, TABLE_TOP - 0.036), 0.008).values())[:4]
    for x in (-1, 1):
        for y in (-1, 1):
            at = pose((x * (length / 2 - 0.08), y * (depth / 2 - 0.08), (TABLE_TOP - 0.036) / 2))
            found += moved(parts(leg, legs, 0.020), at)
    rail = rounded_box((length - 0.2, 0.022, 0.085), 0.004)
    side = rounded_box((0.022, depth - 0.2, 0.085), 0.004)
    z = TABLE_TOP - 0.036 - 0.0425
    for y in (-1, 1):
        at = pose((0, y * (depth / 2 - 0.085), z))
        found += moved(parts([rail[k] for k in ("-y", "+y", "-z")], Material(OAK), 0.022), at)
    for x in (-1, 1):
        at = pose((x * (length / 2 - 0.085), 0, z))
        found += moved(parts([side[k] for k in ("-x", "+x", "-z")], Material(OAK), 0.022), at)
    return found


def chair(seat_color: Color) -> list[Part]:
    """A chair that faces +y, with a woven seat."""
    frame = Material(OAK_UP, 0.2, 14.0)
    found: list[Part] = []
    for x in (-0.185, 0.185):
        front = [(x, 0.19, 0.0), (x, 0.185, 0.2), (x, 0.18, 0.435)]
        back = [(1.04 * x, -0.24, 0.0), (x, -0.19, 0.42), (x, -0.20, 0.65), (x, -0.25, 0.93)]
        found += parts([tube(front, [0.015, 0.018, 0.020])], frame, (0.015, 0.026))
        found += parts([rod(back, [0.015, 0.020, 0.018, 0.014])], frame, (0.015, 0.026))
        rung = [(x, 0.185, 0.20), (x, -0.21, 0.22)]
        found += parts([tube(rung, [0.011, 0.011])], frame, (0.015, 0.026))
    for z, y in ((0.60, -0.197), (0.73, -0.214), (0.86, -0.237)):
        slat = [(-0.185, y, z), (-0.1, y - 0.022, z), (0.1, y - 0.022, z), (0.185, y, z)]
        found += parts([tube(slat, [0.026] * 4, flat=0.3)], frame, (0.015, 0.026))
    found += parts(
        [tube([(-0.185, 0.185, 0.27), (0.185, 0.185, 0.27)], [0.011, 0.011])], frame, (0.015, 0.026)
    )
    cloth = weave(plain(seat_color, mottle=0.04), thread=0.022, depth=0.22)
    seat = rounded_box((0.42, 0.41, 0.045), 0.02)
    at = pose((0, -0.005, 0.445))
    found += moved(parts([seat["+z"]], Material(cloth), 0.0135), at)
    rest = [seat[k] for k in ("-x", "+x", "-y", "+y")]
    found += moved(parts(rest, Material(cloth), 0.014), at)
    return found + moved(parts([seat["-z"]], Material(cloth), 0.03), at)


def rug(length: float = 2.3, depth: float = 1.6) -> list[Part]:
    """A flat woven rug with a border and rows of diamonds."""
    ground, line, accent = rgb("e9dcc3"), rgb("b4553a"), rgb("33566b")

    def paint(d: Discs) -> DoubleArray:
        x, y = d.points[:, 0], d.points[:, 1]
        inset = np.minimum(length / 2 - np.abs(x), depth / 2 - np.abs(y))
        cell = np.abs((x / 0.32 + 0.5) % 1 - 0.5) + np.abs((y / 0.28 + 0.5) % 1 - 0.5)
        color = mix(ground, line, step(-np.abs(cell - 0.42), -0.075, -0.045))
        color = mix(color, accent, 1 - step(cell, 0.15, 0.2))
        color = mix(color, line, inset < 0.16)
        color = mix(color, ground, (inset < 0.125) & (inset > 0.10))
        return mix(color, accent, inset < 0.05)

    def knotted(d: Discs) -> DoubleArray:
        return weave(paint, thread=0.03, depth=0.16)(d)

    slab = rounded_box((length, depth, 0.014), 0.006)
    found = parts([slab["+z"]], Material(knotted), 0.0255)
    sides = [slab[k] for k in ("-x", "+x", "-y", "+y")]
    return moved(found + parts(sides, Material(knotted), 0.02), pose((0, 0, 0.007)))


def runner(length: float, depth: float, top: float) -> list[Part]:
    """A linen runner across the table that hangs over both long edges."""
    bands = [
        (rgb("ece3d0"), 0.030),
        (rgb("3f6b7a"), 0.012),
        (rgb("ece3d0"), 0.012),
        (rgb("3f6b7a"), 0.006),
    ]

    def paint(d: Discs) -> DoubleArray:
        edge = length / 2 - np.abs(d.uv[:, 0] - 0.5) * length
        color = np.tile(np.array(rgb("ece3d0")), (len(d), 1))
        start = 0.0
        for band, width in bands:
            color[(edge >= start) & (edge < start + width)] = band
            start += width
        thread = 0.95 + 0.1 * fractal(d.points / 0.007, 2, 9)
        return color * thread[:, None]

    hang, bend = 0.15, 0.016
    half = depth / 2 + 0.004

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        arc = bend * np.pi / 2
        total = half - bend + arc + hang
        s = (2 * v - 1) * total
        side, a = np.sign(s), np.abs(s)
        angle = np.clip((a - half + bend) / bend, 0, np.pi / 2)
        fall = np.maximum(a - half + bend - arc, 0)
        y = side * (np.minimum(a, half - bend) + bend * np.sin(angle))
        z = top - bend + bend * np.cos(angle) - fall
        sway = 0.006 * np.sin(u * 21) * fall / hang
        x = (u - 0.5) * length * (1 + 0.01 * fall / hang)
        return np.stack([x, y + side * sway, z], axis=1)

    return parts([Patch(position)], Material(paint, soft=0.2), (0.0068, 0.0115))


def lamp(foot: Color, shade: Color) -> list[Part]:
    """A table lamp with a linen shade that glows."""
    base = [
        (0.0, 0.0),
        (0.06, 0.0),
        (0.066, 0.006),
        (0.06, 0.02),
        (0.05, 0.06),
        (0.062, 0.11),
        (0.058, 0.16),
        (0.03, 0.20),
        (0.013, 0.215),
        (0.012, 0.25),
        (0.0, 0.252),
    ]
    brass = Material(plain(rgb("b98b3e")), 0.9, 25.0)
    rod = tube([(0, 0, 0.24), (0, 0, 0.33)], [0.007, 0.007])
    low, high, z0, z1 = 0.140, 0.095, 0.27, 0.46

    def linen(d: Discs) -> DoubleArray:
        t = (d.points[:, 2] - z0) / (z1 - z0)
        slub = 0.93 + 0.14 * fractal(d.points * [120, 120, 500], 2, 2)
        hem = step(-np.minimum(t, 1 - t), -0.05, -0.035)
        hot = 0.92 + 0.33 * np.exp(-((t - 0.45) ** 2) / 0.08)
        return mix(np.asarray(shade) * (slub * hot)[:, None], rgb("b98b5a"), 0.6 * hem)

    outer = revolve([(low, z0), (high, z1)], smooth=False)
    inner = revolve([(high - 0.004, z1), (low - 0.004, z0)], smooth=False)
    bulb = ellipsoid((0.028, 0.028, 0.035), (0, 0, 0.36))
    return [
        *parts([revolve(base)], Material(plain(foot, mottle=0.04), 0.9, 40.0), 0.0058),
        *parts([rod], brass, 0.006),
        *parts([outer], Material(linen, glow=0.55, soft=0.5), 0.0092),
        *parts([inner], Material(plain(rgb("fff0d0")), glow=1.4), 0.014),
        *parts([bulb], Material(plain(rgb("fff2d6")), glow=4.0), 0.008),
    ]


def shelf(length: float = 0.95) -> list[Part]:
    """A wall shelf 20 cm deep on two brackets; its back is at y = 0, its top at z = 0."""
    plank = list(rounded_box((length, 0.20, 0.026), 0.006).values())
    found = moved(parts(plank, Material(OAK, 0.15, 12.0), 0.015), pose((0, -0.10, -0.013)))
    iron = Material(plain(rgb("3b3a3a")), 0.3, 15.0)
    for x in (-0.36, 0.36):
        arm = tube(
            [(x, -0.01, -0.15), (x, -0.02, -0.14), (x, -0.15, -0.04), (x, -0.155, -0.026)],
            [0.007] * 4,
        )
        found += parts([arm], iron, 0.011)
    return found


def picture(width: float, height: float, art: Paint, frame: Color) -> list[Part]:
    """A framed picture that hangs in the xz-plane and faces -y."""
    rim = 0.026
    moulding = Material(wood(frame, tuple(0.7 * c for c in frame), axis=0, seed=9), 0.3, 16.0)
    bars: list[Part] = []
    for z in (-1, 1):
        bar = rounded_box((width + 2 * rim, 0.028, rim), 0.006)
        bars += moved(
            parts([bar[k] for k in ("-y", "-z", "+z", "-x", "+x")], moulding, 0.0135),
            pose((0, 0, z * (height + rim) / 2)),
        )
    for x in (-1, 1):
        bar = rounded_box((rim, 0.028, height), 0.006)
        bars += moved(
            parts([bar[k] for k in ("-y", "-x", "+x")], moulding, 0.0135),
            pose((x * (width + rim) / 2, 0, 0)),
        )
    canvas = rectangle((-width / 2, -0.004, -height / 2), (width, 0, 0), (0, 0, height))
    return bars + parts([canvas], Material(art, 0.06, 10.0), 0.0105)


def clock(radius: float = 0.145) -> list[Part]:
    """A wall clock that faces -y and shows ten past ten."""

    def paint(d: Discs) -> DoubleArray:
        x, y = d.points[:, 0] / radius, d.points[:, 1] / radius
        r, hour = np.hypot(x, y), np.arctan2(x, y) / (2 * np.pi) * 12
        tick = np.abs((hour + 0.5) % 1 - 0.5) < 0.07 / np.maximum(r, 0.3)
        ink = (tick & (r > 0.74) & (r < 0.88)).astype(np.float64)
        for turn, length, half in ((10.17 / 12, 0.48, 0.045), (10 / 60, 0.70, 0.032)):
            a = 2 * np.pi * turn
            along, side = x * np.sin(a) + y * np.cos(a), x * np.cos(a) - y * np.sin(a)
            ink = np.maximum(ink, (np.abs(side) < half) & (along > -0.1) & (along < length))
        return mix(rgb("f6f0e2"), rgb("2e2a26"), np.maximum(ink, r < 0.07))

    rim = [
        (radius - 0.004, 0.010),
        (radius - 0.002, 0.024),
        (radius + 0.008, 0.028),
        (radius + 0.017, 0.018),
        (radius + 0.016, 0.0),
    ]
    face = revolve([(radius, 0.012), (0.0, 0.012)], smooth=False)
    brass = Material(plain(rgb("c0913f"), mottle=0.04), 0.9, 22.0)
    outer = revolve(rim[::-1])
    flat = parts([face], Material(paint, 0.1, 20.0), 0.0072) + parts([outer], brass, 0.0072)
    return moved(flat, pose(roll=90))


def landscape(low: Color, high: Color, seed: int) -> Paint:
    """A painted evening: a sun over three ranges of hills."""

    def paint(d: Discs) -> DoubleArray:
        x, y = d.uv.T
        color = mix(low, high, step(y, 0.35, 1.0))
        sun = 1 - step(np.hypot((x - 0.64) * 1.35, y - 0.66), 0.10, 0.115)
        color = mix(color, rgb("fbe7b0"), sun)
        hills = [(0.52, 0.10, "b98a86"), (0.40, 0.12, "6f7f7a"), (0.24, 0.14, "3f5c55")]
        for k, (height, swing, code) in enumerate(hills):
            line = fractal(np.stack([x * 2.4 + 7 * k, 0 * x, 0 * x], axis=1), 3, seed + k)
            top = height + swing * (line - 0.5) * 2
            color = mix(color, rgb(code), step(top - y, -0.006, 0.006))
        brush = fractal(d.points * [60, 1, 160], 2, seed + 9)
        return color * (0.92 + 0.16 * brush)[:, None]

    return paint
