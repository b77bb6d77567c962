"""Paints: colors of a surface as functions of its own frame (solid textures)."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.demo.sampling import Discs
from gaga_core.demo.surface import Paint

Color = Sequence[float]  # RGB 0..1, gamma space


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
    result: DoubleArray = (h >> np.uint64(40)).astype(np.float64) / float(1 << 24)
    return result


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
    result: DoubleArray = total / weight
    return result


def mix(a: Color | DoubleArray, b: Color | DoubleArray, t: DoubleArray | BoolArray) -> DoubleArray:
    """Blend (N, 3) from ``a`` where t (N,) is 0 to ``b`` where it is 1."""
    w = np.clip(np.asarray(t, np.float64), 0, 1)[:, None]
    result: DoubleArray = np.asarray(a) * (1 - w) + np.asarray(b) * w
    return result


def step(x: DoubleArray, low: float, high: float) -> DoubleArray:
    """Smooth step: 0 below ``low``, 1 above ``high``."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def plain(color: Color, *, mottle: float = 0.03, scale: float = 0.02, seed: int = 0) -> Paint:
    """One color with faint clouds."""

    def paint(d: Discs) -> DoubleArray:
        cloud = fractal(d.points / scale, 2, seed) - 0.5
        result: DoubleArray = np.asarray(color) * (1 + 2 * mottle * cloud[:, None])
        return result

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
        result: DoubleArray = base(d) * (1 + depth * (0.5 * np.sign(a * b) + fuzz))[:, None]
        return result

    return paint
