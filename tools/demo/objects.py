"""Things of a breakfast room as parts in their own frames, the paints on them, and the empty room.

Paints are colors of a surface as functions of its own frame (solid textures). Lengths are scene
units, z is up; an object stands on z = 0 unless its docstring says otherwise.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from tools.demo.shapes import (
    ALL_FACES,
    Discs,
    Item,
    Material,
    Paint,
    Part,
    Patch,
    Steps,
    Surface,
    box,
    cover,
    ellipsoid,
    joined,
    moved,
    outline,
    parts,
    pose,
    rectangle,
    revolve,
    rod,
    tube,
)

Color = Sequence[float]  # RGB 0..1, gamma space

TABLE_TOP = 0.74  # height of its surface
# The room is open to the front and to the right.
LEFT, RIGHT, FRONT, BACK, TOP = -1.75, 1.95, -1.75, 1.3, 2.25
LAMP = np.array([-0.52, 0.22, 1.12])  # where the lamp's bulb is


def rgb(code: str) -> tuple[float, float, float]:
    """Color of a hex code such as ``c8a064``."""
    r, g, b = (int(code[k : k + 2], 16) / 255 for k in (0, 2, 4))
    return r, g, b


def _hash(cell: LongArray, seed: int) -> DoubleArray:
    """A number in 0..1 for each integer cell (..., 3): the same everywhere and always."""
    c = cell.astype(np.uint64)
    with np.errstate(over="ignore"):
        h = (
            c[..., 0] * np.uint64(73856093)
            ^ c[..., 1] * np.uint64(19349663)
            ^ c[..., 2] * np.uint64(83492791)
            ^ np.uint64(seed * 2654435761 + 97)
        )
        h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)
    return (h >> np.uint64(40)).astype(np.float64) / float(1 << 24)


def noise(points: DoubleArray, seed: int = 0) -> DoubleArray:
    """Smooth value noise in 0..1 at points (N, 3); its features are one unit large."""
    base = np.floor(points)
    f = points - base
    f = f * f * (3 - 2 * f)
    cell = base.astype(np.int64)
    value = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        c = np.array(corner)
        weight = np.prod(np.where(c == 1, f, 1 - f), axis=1)
        value += weight * _hash(cell + c, seed)
    return value


def fractal(points: DoubleArray, octaves: int = 3, seed: int = 0) -> DoubleArray:
    """Sum of noises, each twice as fine and half as strong, in 0..1."""
    total, weight = np.zeros(len(points)), 0.0
    for k in range(octaves):
        total += 0.5**k * noise(points * 2.0**k + 17.3 * k, seed + k)
        weight += 0.5**k
    return total / weight


def mix(a: Color | DoubleArray, b: Color | DoubleArray, t: DoubleArray | BoolArray) -> DoubleArray:
    """Blend (N, 3) from ``a`` where t (N,) is 0 to ``b`` where it is 1."""
    w = np.clip(np.asarray(t, np.float64), 0, 1)[:, None]
    return np.asarray(a) * (1 - w) + np.asarray(b) * w


def step(x: DoubleArray, low: float, high: float) -> DoubleArray:
    """Smooth step: 0 below ``low``, 1 above ``high``."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def plain(color: Color, *, mottle: float = 0.03, scale: float = 0.02, seed: int = 0) -> Paint:
    """One color with faint clouds."""

    def paint(d: Discs) -> DoubleArray:
        cloud = fractal(d.points / scale, 2, seed) - 0.5
        return np.asarray(color) * (1 + 2 * mottle * cloud[:, None])

    return paint


def wood(light: Color, dark: Color, *, axis: int = 0, board: float = 0.0, seed: int = 0) -> Paint:
    """Grain along ``axis``; with ``board`` also joints: boards that wide lie side by side."""
    others = [k for k in range(3) if k != axis]

    def paint(d: Discs) -> DoubleArray:
        p = d.points.copy()
        shade = np.zeros(len(p))
        joint = np.zeros(len(p))
        if board > 0:
            lane = np.floor(p[:, others[0]] / board)
            lane_id = np.stack([lane, 0 * lane, 0 * lane], axis=1).astype(np.int64)
            shade = _hash(lane_id, seed + 5) - 0.5
            p[:, axis] += 3.7 * _hash(lane_id, seed + 6)
            p[:, others[1]] += 0.31 * lane
            edge = np.abs(p[:, others[0]] / board - lane - 0.5) * board
            joint = step(edge, board / 2 - 0.006, board / 2 - 0.001)
        warp = fractal(p * 2.2, 2, seed + 1)
        stretched = p * np.where(np.arange(3) == axis, 1.3, 16.0) + warp[:, None] * 2.5
        rings = 0.5 + 0.5 * np.sin(14 * fractal(stretched * 0.35, 2, seed + 2))
        fibre = fractal(p * np.where(np.arange(3) == axis, 6.0, 160.0), 2, seed + 3)
        t = 0.25 + 0.45 * rings * warp + 0.5 * (fibre - 0.4) + 0.35 * shade
        return mix(light, dark, t) * (1 - 0.55 * joint[:, None])

    return paint


def weave(base: Paint, *, thread: float = 0.01, depth: float = 0.12) -> Paint:
    """Cloth: the paint with the over and under of its threads."""

    def paint(d: Discs) -> DoubleArray:
        a = np.sin(np.pi * d.points[:, 0] / thread)
        b = np.sin(np.pi * d.points[:, 1] / thread)
        fuzz = fractal(d.points / (0.6 * thread), 2, 3) - 0.5
        return base(d) * (1 + depth * (0.5 * np.sign(a * b) + fuzz))[:, None]

    return paint


OAK = wood(rgb("c79260"), rgb("85552e"), axis=0, seed=1)
OAK_UP = wood(rgb("c08b58"), rgb("80522d"), axis=2, seed=2)


def table(length: float = 1.50, depth: float = 0.86) -> list[Part]:
    """A wooden table with rounded edges."""
    steps: Steps = {
        "+z": (0.0140, 0.0088),
        "-z": 0.04,
        "-x +x": (0.0125, 0.008),
        "-y +y": (0.008, 0.014),
    }
    at = pose((0, 0, TABLE_TOP - 0.018))
    found = box((length, depth, 0.036), 0.012, Material(OAK, 0.30, 14.0), steps, at)
    high, legs = TABLE_TOP - 0.036, Material(OAK_UP, 0.15, 12.0)
    for x in (-1, 1):
        for y in (-1, 1):
            at = pose((x * (length / 2 - 0.08), y * (depth / 2 - 0.08), high / 2))
            found += box((0.062, 0.062, high), 0.008, legs, {"-x +x -y +y": 0.020}, at)
    rail, side = (length - 0.2, 0.022, 0.085), (0.022, depth - 0.2, 0.085)
    for y in (-1, 1):
        at = pose((0, y * (depth / 2 - 0.085), high - 0.0425))
        found += box(rail, 0.004, Material(OAK), {"-y +y -z": 0.022}, at)
    for x in (-1, 1):
        at = pose((x * (length / 2 - 0.085), 0, high - 0.0425))
        found += box(side, 0.004, Material(OAK), {"-x +x -z": 0.022}, at)
    return found


def chair(seat_color: Color) -> list[Part]:
    """A chair that faces +y, with a woven seat."""
    frame = Material(OAK_UP, 0.2, 14.0)
    found: list[Part] = []
    for x in (-0.185, 0.185):
        front = [(x, 0.19, 0.0), (x, 0.185, 0.2), (x, 0.18, 0.435)]
        back = [(1.04 * x, -0.24, 0.0), (x, -0.19, 0.42), (x, -0.20, 0.65), (x, -0.25, 0.93)]
        found += parts(tube(front, [0.015, 0.018, 0.020]), frame, (0.015, 0.026))
        found += parts(rod(back, [0.015, 0.020, 0.018, 0.014]), frame, (0.015, 0.026))
        rung = [(x, 0.185, 0.20), (x, -0.21, 0.22)]
        found += parts(tube(rung, [0.011, 0.011]), frame, (0.015, 0.026))
    for z, y in ((0.60, -0.197), (0.73, -0.214), (0.86, -0.237)):
        slat = [(-0.185, y, z), (-0.1, y - 0.022, z), (0.1, y - 0.022, z), (0.185, y, z)]
        found += parts(tube(slat, [0.026] * 4, flat=0.3), frame, (0.015, 0.026))
    found += parts(
        tube([(-0.185, 0.185, 0.27), (0.185, 0.185, 0.27)], [0.011, 0.011]), frame, (0.015, 0.026)
    )
    cloth = weave(plain(seat_color, mottle=0.04), thread=0.022, depth=0.22)
    steps = {"+z": 0.0135, "-x +x -y +y": 0.014, "-z": 0.03}
    at = pose((0, -0.005, 0.445))
    return found + box((0.42, 0.41, 0.045), 0.02, Material(cloth), steps, at)


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

    steps = {"+z": 0.0255, "-x +x -y +y": 0.02}
    cloth = Material(weave(paint, thread=0.03, depth=0.16))
    return box((length, depth, 0.014), 0.006, cloth, steps, pose((0, 0, 0.007)))


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

    return parts(Patch(position), Material(paint, soft=0.2), (0.0068, 0.0115))


def lamp(foot: Color, shade: Color) -> list[Part]:
    """A table lamp with a linen shade that glows."""
    base = outline("0 0, 60 0, 66 6, 60 20, 50 60, 62 110, 58 160, 30 200, 13 215, 12 250, 0 252")
    brass = Material(plain(rgb("b98b3e")), 0.9, 25.0)
    stem = tube([(0, 0, 0.24), (0, 0, 0.33)], [0.007, 0.007])
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
        *parts(revolve(base), Material(plain(foot, mottle=0.04), 0.9, 40.0), 0.0058),
        *parts(stem, brass, 0.006),
        *parts(outer, Material(linen, glow=0.55, soft=0.5), 0.0092),
        *parts(inner, Material(plain(rgb("fff0d0")), glow=1.4), 0.014),
        *parts(bulb, Material(plain(rgb("fff2d6")), glow=4.0), 0.008),
    ]


def shelf(length: float = 0.95) -> list[Part]:
    """A wall shelf 20 cm deep on two brackets; its back is at y = 0, its top at z = 0."""
    at, finish = pose((0, -0.10, -0.013)), Material(OAK, 0.15, 12.0)
    found = box((length, 0.20, 0.026), 0.006, finish, {ALL_FACES: 0.015}, at)
    iron = Material(plain(rgb("3b3a3a")), 0.3, 15.0)
    for x in (-0.36, 0.36):
        arm = tube(
            [(x, -0.01, -0.15), (x, -0.02, -0.14), (x, -0.15, -0.04), (x, -0.155, -0.026)],
            [0.007] * 4,
        )
        found += parts(arm, iron, 0.011)
    return found


def picture(width: float, height: float, art: Paint, frame: Color) -> list[Part]:
    """A framed picture that hangs in the xz-plane and faces -y."""
    rim = 0.026
    moulding = Material(wood(frame, tuple(0.7 * c for c in frame), axis=0, seed=9), 0.3, 16.0)
    found: list[Part] = []
    for z in (-1, 1):
        at = pose((0, 0, z * (height + rim) / 2))
        steps = {"-y -z +z -x +x": 0.0135}
        found += box((width + 2 * rim, 0.028, rim), 0.006, moulding, steps, at)
    for x in (-1, 1):
        at = pose((x * (width + rim) / 2, 0, 0))
        found += box((rim, 0.028, height), 0.006, moulding, {"-y -x +x": 0.0135}, at)
    canvas = rectangle((-width / 2, -0.004, -height / 2), (width, 0, 0), (0, 0, height))
    return found + parts(canvas, Material(art, 0.06, 10.0), 0.0105)


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
    flat = parts(face, Material(paint, 0.1, 20.0), 0.0072) + parts(outer, brass, 0.0072)
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


CREAM = rgb("f3ead7")
CLAY = rgb("b5764f")
GOLD = rgb("d8b45a")
_PAPER = rgb("efe6d2")


def glaze(
    outside: Color, inside: Color = CREAM, *, bare: float = -1.0, dots: bool = False
) -> Paint:
    """Glazed outside, lighter inside, bare clay under the height ``bare``."""

    def paint(d: Discs) -> DoubleArray:
        color = np.asarray(outside) * (0.97 + 0.06 * fractal(d.points / 0.03, 2, 4))[:, None]
        if dots:
            angle = np.arctan2(d.points[:, 1], d.points[:, 0]) / (2 * np.pi) * 14
            row = d.points[:, 2] / 0.022
            a = (angle + 0.5 * np.floor(row)) % 1 - 0.5
            speck = 1 - step(np.hypot(a, row % 1 - 0.5), 0.16, 0.26)
            color = mix(color, CREAM, speck)
        color = mix(color, CLAY, 1 - step(d.points[:, 2], bare - 0.001, bare + 0.002))
        rim = d.uv[np.argmax(d.points[:, 2]), 1]  # the wall runs up outside, then down inside
        hidden = d.uv[:, 1] > rim + 0.03
        return np.where(hidden[:, None], np.asarray(inside), color)

    return paint


def mug(color: Color, inside: Color = CREAM) -> list[Part]:
    """A mug 9.5 cm high; its handle points to +x."""
    finish = Material(glaze(color, inside), 0.9, 50.0)
    wall = outline(
        "0 0, 34 0, 41.5 6, 43 20, 43 86, 42.3 94.5, 40 97, 37.7 94.5, 37 86, 36.5 20, 33 12, 0 11"
    )
    strap = outline("38 0 78, 58 0 82, 73 0 66, 72 0 42, 58 0 24, 38 0 22")
    handle = Material(glaze(color, color), 0.9, 50.0)
    return [
        *parts(revolve(wall), finish, 0.0050),
        *parts(tube(strap, [0.0055] * 6, flat=1.5), handle, 0.0050),
    ]


def tea(radius: float, height: float) -> list[Part]:
    """The surface of a drink."""
    finish = Material(plain(rgb("5a2e14"), mottle=0.04), 0.8, 60.0)
    return parts(revolve([(radius, height), (0.0, height)], smooth=False), finish, 0.006)[::1]


def teapot(color: Color) -> list[Part]:
    """A round pot; its spout points to +x."""
    finish = Material(glaze(color, color, bare=0.012, dots=True), 1.0, 45.0)
    smooth = Material(glaze(color, color), 1.0, 45.0)
    body = outline("0 0, 50 0, 60 6, 88 40, 94 75, 78 115, 52 133, 46 135")
    lid = outline("50 133, 50 138, 38 147, 14 153, 7 157, 8 163, 14 170, 11 178, 0 180")
    spout = outline("70 0 50, 105 0 62, 128 0 98, 150 0 128")
    handle = outline("-70 0 115, -105 0 124, -138 0 104, -140 0 70, -118 0 45, -78 0 42")
    knob = Material(glaze(rgb("d9a441"), CREAM), 1.0, 45.0)
    return [
        *parts(revolve(body), finish, 0.0064),
        *parts(revolve(lid), knob, 0.0050),
        *parts(tube(spout, [0.024, 0.019, 0.012, 0.011]), smooth, 0.0050),
        *parts(tube(handle, [0.0085] * 6, flat=1.4), smooth, 0.0050),
    ]


def bowl(color: Color) -> list[Part]:
    """A wide footed bowl, 30 cm across."""
    finish = Material(glaze(color, rgb("e8dcc0"), bare=0.006), 0.8, 35.0)
    wall = outline(
        "0 0, 55 0, 60 3, 58 14, 100 35, 136 70, 150 102, 146.5 106.5, 142 103, 127 77, 92 47, 0 32"
    )
    return parts(revolve(wall), finish, 0.0074)


def plate(color: Color, rim: Color) -> list[Part]:
    """A plate 19 cm across with a colored rim."""

    def paint(d: Discs) -> DoubleArray:
        radius = np.hypot(d.points[:, 0], d.points[:, 1])
        band = step(radius, 0.086, 0.088) + 0.7 * step(-np.abs(radius - 0.079), -0.0025, -0.001)
        return mix(color, rim, band * (d.normals[:, 2] > 0.2))

    profile = outline("0 0, 45 0, 55 3, 90 16, 95 19, 94.5 22.5, 90 22.5, 58 11.5, 45 9, 0 9")
    return parts(revolve(profile), Material(paint, 0.8, 45.0), 0.0062)


def bottle(glass: Color) -> list[Part]:
    """A dark oil bottle with a paper label and a cork."""

    def paint(d: Discs) -> DoubleArray:
        z = d.points[:, 2]
        angle = np.arctan2(d.points[:, 1], d.points[:, 0])
        color = np.asarray(glass) * (0.9 + 0.25 * step(z, 0.05, 0.26))[:, None]
        label = step(z, 0.056, 0.058) * (1 - step(z, 0.138, 0.140)) * (np.abs(angle + 1.2) < 1.5)
        leaf = step(-np.hypot((angle + 1.2) * 0.036, (z - 0.108) * 0.9), -0.018, -0.016)
        line = (np.abs(z - 0.075) < 0.003) | (np.abs(z - 0.066) < 0.0015)
        printed = mix(mix(CREAM, rgb("7d8f3c"), leaf), rgb("4c4032"), np.where(line, 0.8, 0.0))
        return mix(color, printed, label)

    body = outline(
        "0 0, 30 0, 36 6, 37 20, 37 155, 31 182, "
        "16 205, 13.5 225, 13.5 262, 16.5 264, 16.5 274, 13.5 276"
    )
    cork = outline("12.5 274, 12.5 294, 11 296, 0 296")
    return [
        *parts(revolve(body), Material(paint, 0.9, 60.0), 0.0048),
        *parts(revolve(cork), Material(plain(rgb("c49a6a"), mottle=0.12, scale=0.006)), 0.0048),
    ]


def vase(color: Color) -> list[Part]:
    """A tall vase with a speckled matt glaze."""

    def paint(d: Discs) -> DoubleArray:
        speck = step(noise(d.points / 0.004, 8), 0.80, 0.9)
        drip = 0.175 + 0.02 * np.sin(5 * np.arctan2(d.points[:, 1], d.points[:, 0]))
        lower = mix(color, rgb("6b5a48"), 0.6 * speck)
        return mix(lower, CREAM, step(d.points[:, 2], drip - 0.004, drip + 0.004))

    wall = outline(
        "0 0, 40 0, 48 5, 66 60, 66 110, 45 175, 34 205, 40 232, 38.5 235.5, 36 233, 30 205, 40 170"
    )
    return parts(revolve(wall), Material(paint, 0.45, 18.0), 0.0062)


def candle(wax: Color, height: float) -> list[Part]:
    """A candle burning in a small brass dish."""
    brass = Material(plain(rgb("b98b3e"), mottle=0.05), 1.0, 25.0)
    dish = outline("0 0, 36 0, 45 6, 47 13, 45.5 14, 43 8, 24 6, 24 22, 21 23")
    stick = [
        (0.0195, 0.006),
        (0.0195, height - 0.003),
        (0.0175, height),
        (0.010, height - 0.002),
        (0.0, height - 0.004),
    ]
    wick = tube([(0, 0, height - 0.004), (0, 0, height + 0.010)], [0.0014, 0.0012])
    flame = ellipsoid((0.0052, 0.0052, 0.0145), (0, 0, height + 0.016))
    return [
        *parts(revolve(dish), brass, 0.0042),
        *parts(revolve(stick), Material(plain(wax, mottle=0.02), 0.25, 12.0, 0.10, 0.7), 0.0048),
        *parts(wick, Material(plain(rgb("3a3029"))), 0.003),
        *parts(flame, Material(plain(rgb("ffd27a")), glow=6.0), 0.0034),
    ]


def _bumpy(patch: Patch, height: float, scale: float, seed: int) -> Patch:
    """The patch swollen by noise: no fruit is quite round."""

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        p = patch.position(u, v)
        out = p / np.maximum(np.linalg.norm(p, axis=1, keepdims=True), 1e-9)
        return p + height * (noise(p / scale, seed) - 0.5)[:, None] * out

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

    profile = outline("0 6, 10 1, 22 3, 34 22, 38.5 43, 32 64, 18 71, 8 67, 0 58")
    stem = tube([(0, 0, 0.058), (0.002, 0, 0.070), (0.006, 0.002, 0.080)], [0.0016, 0.0014, 0.0020])
    return [
        *parts(_bumpy(revolve(profile), 0.004, 0.04, seed), Material(paint, 0.55, 28.0), 0.0048),
        *parts(stem, Material(plain(rgb("5d4426"))), 0.004),
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

    profile = outline("0 0, 16 2, 31 14, 38 36, 32 59, 16 71, 0 72.5")
    skin = _bumpy(revolve(profile), 0.002, 0.03, seed)
    return parts(skin, Material(paint, 0.35, 12.0), 0.0048)


def lemon(seed: int) -> list[Part]:
    """A lemon lying on its side."""

    def paint(d: Discs) -> DoubleArray:
        pits = fractal(d.points / 0.004, 2, seed)
        color = mix(rgb("f3d03e"), rgb("e6bd2a"), fractal(d.points / 0.02, 2, seed + 1))
        return color * (0.92 + 0.14 * pits)[:, None]

    profile = outline("0 -46, 6 -43, 12 -35, 26 -18, 29 0, 26 18, 12 35, 7 42, 0 45")
    lying = pose((0, 0, 0.028), tilt=90)
    return parts(revolve(profile), Material(paint, 0.4, 16.0), 0.0046, lying)


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
        found += parts(peel, Material(paint, 0.2, 10.0), 0.0050, pose(yaw=yaw))
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
        *parts(revolve(ring), dough, 0.0062),
        *parts(_icing(big, small, seed), glaze, 0.0054),
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
            outline("-4.5 0 0, -4 0 0, 4 0 0, 4.5 0 0"),
            [0.0006, 0.0017, 0.0017, 0.0006],
        )
        tilt = float(np.degrees(angle))
        place = pose(
            (radius * np.cos(np.radians(turn)), radius * np.sin(np.radians(turn)), height),
            yaw=turn,
            tilt=tilt,
        )
        finish = Material(plain(colors[k % 4]), 0.3, 20.0)
        found += moved(parts(body, finish, (0.0055, 0.0036), pose(yaw=yaw)), place)
    return found


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
    for z, outside, inside in ((h - board / 2, "+z", "-z"), (board / 2, "-z", "+z")):
        steps: Steps = {outside: 0.0095, inside: 0.02, "+x -y +y": (0.0045, 0.0095)}
        found += box((w, d, board), 0.0012, cover, steps, pose((0, 0, z)))
    found += _spine(size, cloth, accent)
    pages, leaves = (w - 0.009, d - 0.014, h - 2 * board), Material(_leaves())
    steps = {"+x": (0.0095, 0.0038), "-y +y": (0.0038, 0.0095)}
    return found + box(pages, 0.0006, leaves, steps, pose((0, 0, h / 2)))


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

    return parts(Patch(position), Material(paint, 0.12, 10.0), (0.0065, 0.0075))


def _leaves() -> Paint:
    def paint(p: Discs) -> DoubleArray:
        line = noise(np.stack([0 * p.points[:, 0], 0 * p.points[:, 1], p.points[:, 2] / 0.0022], 1))
        return np.asarray(_PAPER) * (0.92 + 0.08 * line)[:, None]

    return paint


def die(color: Color, pip: Color, edge: float = 0.036) -> list[Part]:
    """A large wooden die; opposite faces sum to seven."""
    found: list[Part] = []
    for face, count in {"-x": 5, "+x": 2, "-y": 4, "+y": 3, "-z": 6, "+z": 1}.items():
        finish = Material(_pips(count, color, pip), 0.5, 30.0)
        found += box((edge,) * 3, 0.2 * edge, finish, {face: 0.0030}, pose((0, 0, edge / 2)))
    return found


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
    return box((edge,) * 3, 0.1 * edge, finish, {ALL_FACES: 0.0038}, pose((0, 0, edge / 2)))


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

    ball = parts(ellipsoid((radius,) * 3), Material(paint, 0.55, 30.0), 0.0064)
    brass = Material(plain(rgb("c0913f"), mottle=0.04), 1.0, 25.0)
    wooden = Material(plain(rgb("6b4226"), mottle=0.10, scale=0.01), 0.4, 20.0)
    arc = [
        (0.098 * np.sin(a), 0.0, height - 0.098 * np.cos(a)) for a in np.linspace(-0.05, 3.0, 12)
    ]
    foot = outline("0 0, 62 0, 66 5, 60 14, 22 22, 10 34, 9 58, 0 60")
    return [
        *moved(ball, pose((0, 0, height), tilt=23)),
        *parts(tube(arc, [0.0042] * 12), brass, 0.0046, pose(yaw=35)),
        *parts(revolve(foot), wooden, 0.0050),
    ]


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
            found += parts(petal, finish, 0.0085, pose(yaw=yaw, tilt=lift))
    core = ellipsoid((0.30 * size, 0.30 * size, 0.22 * size), (0, 0, 0.08 * size))
    middle = Material(plain(heart, mottle=0.25, scale=0.004), soft=0.3)
    return found + parts(core, middle, 0.0040)


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
        found += parts(tube(path, [0.0023] * 4), green, (0.006, 0.008), pose(yaw=yaw))
        color, heart, size, petals = kinds[k % 4]
        head = _blossom(color, heart, size, petals, k)
        head = moved(head, pose(tip, tilt=float(np.degrees(lean)) * 0.9))
        found += moved(head, pose(yaw=yaw))
    for k in range(8):
        yaw, lift = 45 * k + rng.uniform(-10, 10), rng.uniform(-62, -30)
        frond = parts(blade(0.15, 0.036, bend=1.1), leaf, 0.0095, pose(tilt=lift))
        found += moved(frond, pose((0, 0, 0.004), yaw=yaw))
    return found


def rubber_plant(seed: int = 8) -> list[Part]:
    """Large glossy leaves around a stem that starts at z = 0."""
    rng = np.random.default_rng(seed)
    leaf = Material(_leaf_paint(rgb("6f9a4e"), rgb("2f5a34"), 6), 0.35, 12.0, 0.0, 0.45)
    bark = Material(plain(rgb("6a5138"), mottle=0.15, scale=0.02))
    trunk = outline("0 0 -50, 20 10 250, -10 20 550, 20 0 950")
    found = parts(tube(trunk, [0.016, 0.013, 0.010, 0.006]), bark, (0.014, 0.02))
    for k in range(17):
        height = 0.16 + 0.80 * k / 16
        lift = -8 - 58 * (k / 16) ** 2 + rng.uniform(-8, 8)
        length = 0.34 - 0.13 * (k / 16) + rng.uniform(-0.02, 0.02)
        yaw = 137.5 * k + rng.uniform(-10, 10)
        stalk = tube([(0, 0, 0), (0.04, 0, 0.004), (0.085, 0, 0.0)], [0.005, 0.004, 0.003])
        surface = parts(blade(length, 0.42 * length, bend=0.9), leaf, 0.0155)
        one = moved(surface, pose((0.08, 0, 0)))
        one += parts(stalk, bark, (0.012, 0.02))
        found += moved(moved(one, pose(tilt=lift)), pose((0.012, 0.01, height), yaw=yaw))
    return found


def pot(color: Color, size: float = 1.0) -> list[Part]:
    """A terracotta pot with earth in it; 30 cm high at size 1."""
    clay = Material(plain(color, mottle=0.08, scale=0.05), 0.05, 8.0)
    earth = Material(plain(rgb("4a3626"), mottle=0.35, scale=0.012))
    wall = outline(
        "0 0, 110 0, 118 6, 150 250, 165 252, 168 258, 170 300, 164 305, 155 300, 150 260"
    )
    points = [(size * r, size * z) for r, z in wall]
    soil = [(size * 0.152, size * 0.272), (size * 0.08, size * 0.278), (0.0, size * 0.276)]
    fine = 0.0145 * size**0.7
    return [*parts(revolve(points), clay, fine), *parts(revolve(soil), earth, fine)]


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
    return parts(Patch(position, closed=True), finish, 0.0040) + moved(bloom, pose((0, 0, 0.083)))


_OAK = Material(wood(rgb("b98a5c"), rgb("8a5f3b"), axis=0, board=0.16, seed=3), 0.10, 12.0)
_PAINT = Material(plain(rgb("93a58f"), mottle=0.025, scale=0.35))
_TRIM = Material(plain(rgb("efe9dc"), mottle=0.01), 0.08, 20.0)
# Splats are drawn by the depth of their centres, so a wide one close behind a picture or a rug
# would show through it. There the room is covered more finely and a little deeper.
_DEPTH = 0.05
_GAP = 0.035
_RUG = ((0.05, -0.15), (1.17, 0.82))  # centre, half size on the floor: x, y
_ON_BACK = (((0.78, 1.50), (0.345, 0.265)), ((1.46, 1.62), (0.16, 0.16)))  # x, z
_ON_LEFT = (((-0.15, 1.42), (0.235, 0.295)),)  # y, z
_MARGIN = 0.2


def shell(coarseness: float, rng: np.random.Generator) -> Surface:
    """Discs of floor, walls and skirting boards; they are no object (label 0)."""
    w, d = RIGHT - LEFT, BACK - FRONT
    floor = Part(rectangle((LEFT, FRONT, 0), (w, 0, 0), (0, d, 0)), _OAK, (0.070, 0.026))
    back = Part(rectangle((LEFT, BACK, 0.09), (w, 0, 0), (0, 0, TOP - 0.09)), _PAINT, (0.05, 0.05))
    left = Part(rectangle((LEFT, FRONT, 0.09), (0, d, 0), (0, 0, TOP - 0.09)), _PAINT, (0.05, 0.05))
    found = []
    for part, axes, holes in (
        (floor, (0, 1), (_RUG,)),
        (back, (0, 2), _ON_BACK),
        (left, (1, 2), _ON_LEFT),
    ):
        plane = cover(Item("room", (part,), pose()), 0, coarseness, rng)
        keep = np.ones(len(plane), np.bool_)
        for centre, half in holes:
            keep[_inside(plane.points[:, axes], centre, half)] = False
        found.append(plane.take(keep))
    found.append(cover(Item("room", (*_behind(), *_skirting()), pose()), 0, coarseness, rng))
    return joined(found)


def _inside(at: DoubleArray, centre: tuple[float, float], half: tuple[float, float]) -> BoolArray:
    near = np.abs(at - centre) < np.asarray(half) + _GAP
    return near[:, 0] & near[:, 1]


def _behind() -> list[Part]:
    """What of floor and walls lies behind rug, pictures and clock, a little deeper."""
    m, deep = _MARGIN, _DEPTH
    (x, y), (a, b) = _RUG
    rug = rectangle((x - a - m, y - b - m, -deep), (2 * (a + m), 0, 0), (0, 2 * (b + m), 0))
    found = [Part(rug, _OAK, (0.05, 0.04))]
    for (x, z), (a, b) in _ON_BACK:
        corner = (x - a - m, BACK + deep, z - b - m)
        patch = rectangle(corner, (2 * (a + m), 0, 0), (0, 0, 2 * (b + m)))
        found.append(Part(patch, _PAINT, (0.04, 0.04)))
    for (y, z), (a, b) in _ON_LEFT:
        corner = (LEFT - deep, y - a - m, z - b - m)
        patch = rectangle(corner, (0, 2 * (a + m), 0), (0, 0, 2 * (b + m)))
        found.append(Part(patch, _PAINT, (0.04, 0.04)))
    return found


def _skirting() -> list[Part]:
    w, d = RIGHT - LEFT, BACK - FRONT
    at, at_left = ((LEFT + w / 2, BACK - 0.01, 0.055), (LEFT + 0.01, FRONT + d / 2, 0.055))
    return [
        *box((w, 0.02, 0.11), 0.006, _TRIM, {"-y +z": (0.05, 0.022)}, pose(at)),
        *box((0.02, d, 0.11), 0.006, _TRIM, {"+x +z": 0.03}, pose(at_left)),
    ]
