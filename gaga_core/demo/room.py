"""The room: a floor and two walls, open to the front and to the right, and the light in it."""

from dataclasses import fields

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.demo.patches import pose, rectangle, rounded_box
from gaga_core.demo.surface import Item, Material, Part, Surface, cover, joined, moved, parts
from gaga_core.demo.textures import plain, rgb, wood

LEFT, RIGHT, FRONT, BACK, TOP = -1.75, 1.95, -1.75, 1.3, 2.25
LAMP = np.array([-0.52, 0.22, 1.12])  # where the lamp's bulb is
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
        found.append(_kept(plane, keep))
    found.append(cover(Item("room", (*_behind(), *_skirting()), pose()), 0, coarseness, rng))
    return joined(found)


def _inside(at: DoubleArray, centre: tuple[float, float], half: tuple[float, float]) -> BoolArray:
    near = np.abs(at - centre) < np.asarray(half) + _GAP
    return near[:, 0] & near[:, 1]


def _kept(surface: Surface, keep: BoolArray) -> Surface:
    return Surface(**{f.name: getattr(surface, f.name)[keep] for f in fields(Surface)})


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
    board = [p for k, p in rounded_box((w, 0.02, 0.11), 0.006).items() if k in ("-y", "+z")]
    side = [p for k, p in rounded_box((0.02, d, 0.11), 0.006).items() if k in ("+x", "+z")]
    return [
        *moved(parts(board, _TRIM, (0.05, 0.022)), pose((LEFT + w / 2, BACK - 0.01, 0.055))),
        *moved(parts(side, _TRIM, 0.03), pose((LEFT + 0.01, FRONT + d / 2, 0.055))),
    ]


def radiance(
    points: DoubleArray, towards: DoubleArray, sky: tuple[float, float, float]
) -> DoubleArray:
    """Light (N, 3) that reaches points from a direction when no object stands in it: the sky, or
    what floor and walls throw back."""
    sky_color = np.array(sky) * (0.75 + 0.45 * max(0.0, float(towards @ [0.5, -0.6, 0.6])))
    result = np.tile(sky_color, (len(points), 1))
    if towards[2] < 0:
        result[:] = np.array([0.30, 0.22, 0.15]) * (0.6 + 0.4 * -towards[2])
    wall = np.array([0.46, 0.48, 0.42])
    if towards[1] > 1e-6:
        at = points + ((BACK - points[:, 1]) / towards[1])[:, None] * towards
        hit = (at[:, 2] > 0) & (at[:, 2] < TOP) & (at[:, 0] > LEFT) & (at[:, 0] < RIGHT)
        result[hit] = wall
    if towards[0] < -1e-6:
        at = points + ((LEFT - points[:, 0]) / towards[0])[:, None] * towards
        hit = (at[:, 2] > 0) & (at[:, 2] < TOP) & (at[:, 1] > FRONT) & (at[:, 1] < BACK)
        result[hit] = wall
    return result


def window(points: DoubleArray, key: DoubleArray) -> DoubleArray:
    """Share (N,) of the key light that comes through a tall window of two by four panes.

    The window stands far off; its picture is thrown along ``key`` and blurred by the sun's size.
    """
    across = np.cross(key, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, key)
    a, b = (points - [0.05, 0.0, 0.95]) @ across, (points - [0.05, 0.0, 0.95]) @ up
    soft = 0.025
    frame = _band(a + 0.1, 1.15, soft) * _band(b - 0.1, 1.1, soft)
    bars = np.ones(len(points))
    for at in (0.27, -0.58):
        bars *= 1 - _band(a - at, 0.045, soft)
    for at in (0.32, 0.95, -0.75):
        bars *= 1 - _band(b - at, 0.04, soft)
    result: DoubleArray = 0.12 + 0.88 * frame * bars
    return result


def _band(x: DoubleArray, half: float, soft: float) -> DoubleArray:
    """1 where |x| < half, 0 outside, with a soft rim."""
    t = np.clip((half - np.abs(x)) / (2 * soft) + 0.5, 0, 1)
    result: DoubleArray = t * t * (3 - 2 * t)
    return result


def lamp_light(points: DoubleArray, normals: DoubleArray) -> DoubleArray:
    """Light (N, 3) of the table lamp: warm, falling off with distance."""
    way = LAMP - points
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    facing = np.maximum((normals * way).sum(axis=1, keepdims=True) / distance, 0)
    result: DoubleArray = 0.055 * facing / (distance**2 + 0.02) * np.array([1.0, 0.72, 0.40])
    return result
