"""Discs laid on a patch in staggered rows: quasi-uniform, finer where the surface bends or ends."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.demo.patches import Patch

TURN = 0.62  # radians: the most that the normal may turn from one disc to the next
FINEST = 0.45  # of a step: how close discs come at a bend or at an open edge
GRADE = 0.8  # growth of the distance between discs per unit of length away from there
_JITTER = 0.13  # of a step
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class Discs:
    """Points of one patch, in its object's frame."""

    points: DoubleArray  # (N, 3)
    normals: DoubleArray  # (N, 3) unit, outward
    tangents: DoubleArray  # (N, 3) unit, along u
    sizes: DoubleArray  # (N, 2) distance to the next disc along u and along v
    uv: DoubleArray  # (N, 2)

    def __len__(self) -> int:
        return len(self.points)


def lay_discs(patch: Patch, step: tuple[float, float], rng: np.random.Generator) -> Discs:
    """Cover ``patch`` with discs about ``step`` (along u, along v) apart.

    Rows are equally far from each other along v in a graded metric (`_steps`); each row gets as
    many discs as its own length asks for, shifted against its neighbours by the golden ratio, so
    that no two rows line up.
    """
    rows, edges = _rows(patch, step[1])
    u, width, counts = _columns(patch, rows, step[0], rng)
    row = np.repeat(np.arange(len(rows)), counts)
    gap = edges[row + 1] - edges[row]
    v = np.clip(rows[row] + rng.uniform(-_JITTER, _JITTER, len(row)) * gap, 1e-6, 1 - 1e-6)
    along = _chord(patch, (u - width / 2, v), (u + width / 2, v))
    up = _chord(patch, (u, edges[row]), (u, edges[row + 1]))
    normals, tangents = _frame(patch, u, v)
    return Discs(
        points=patch.position(u, v),
        normals=normals,
        tangents=tangents,
        sizes=np.stack([along, up], axis=1),
        uv=np.stack([u, v], axis=1),
    )


def _rows(patch: Patch, step: float) -> tuple[DoubleArray, DoubleArray]:
    """Row positions (R,) in v and the edges between them (R + 1,)."""
    v = _grid(160, even=False)
    u = np.linspace(0.03, 0.97, 9)
    at = np.tile(u[:, None], (1, len(v))), np.tile(v, (len(u), 1))
    steps = _steps(patch, at, step, axis=1, ends=not patch.closed).mean(axis=0)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    n = max(1, round(total[-1]))
    edges = np.interp(np.linspace(0, total[-1], n + 1), total, v)
    middles = np.interp((np.arange(n) + 0.5) / n * total[-1], total, v)
    return middles, edges


def _columns(
    patch: Patch, rows: DoubleArray, step: float, rng: np.random.Generator
) -> tuple[DoubleArray, DoubleArray, LongArray]:
    """Positions and widths in u of all rows' discs, and the number of discs in each row (R,)."""
    u = _grid(48, even=patch.closed)
    at = np.tile(u, (len(rows), 1)), np.tile(rows[:, None], (1, len(u)))
    steps = _steps(patch, at, step, axis=0, ends=not patch.closed)
    total = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(steps, axis=1)], axis=1)
    counts = np.maximum(3 if patch.closed else 1, np.round(total[:, -1])).astype(np.int64)
    # All rows on one line: row r's share of its steps runs from r to r + 1.
    line = np.arange(len(rows))[:, None]
    share = (total / np.maximum(total[:, -1:], 1e-12) * (1 - 1e-9) + line).ravel()
    value = (np.tile(u, (len(rows), 1)) + line).ravel()
    row = np.repeat(np.arange(len(rows)), counts)
    k = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    shift = (np.arange(len(rows)) * _GOLDEN) % 1.0
    if not patch.closed:  # an open row reaches both ends
        shift = 0.5 + 0.3 * (shift - 0.5)
    place = (k + shift[row] + rng.uniform(-_JITTER, _JITTER, len(row))) / counts[row]
    place = place % 1.0 if patch.closed else np.clip(place, 1e-4, 1 - 1e-4)
    found = np.interp(place + row, share, value) - row
    half = 0.25 / counts[row]
    low, high = np.clip(place - half, 0, 1 - 1e-9), np.clip(place + half, 0, 1 - 1e-9)
    slope = np.interp(high + row, share, value) - np.interp(low + row, share, value)
    return np.clip(found, 1e-6, 1 - 1e-6), slope / (high - low) / counts[row], counts


def _grid(n: int, *, even: bool) -> DoubleArray:
    """``n + 1`` places in 0..1; dense towards both ends unless ``even``."""
    t = np.linspace(0, 1, n + 1)
    return t if even else 0.35 * t + 0.65 * (1 - np.cos(np.pi * t)) / 2


def _steps(
    patch: Patch, at: tuple[DoubleArray, DoubleArray], step: float, *, axis: int, ends: bool
) -> DoubleArray:
    """How many discs (L, n) go between neighbours of each line of grid points (L, n + 1).

    One per ``step``, more where the normal turns by over `TURN` in a step or where the surface
    ends, down to `FINEST` of a step; the distance grows again by `GRADE` per unit of length.
    """
    shape = at[0].shape
    u, v = at[0].ravel(), at[1].ravel()
    points = patch.position(u, v).reshape(*shape, 3)
    normals = _frame(patch, u, v)[0].reshape(*shape, 3)
    length = np.linalg.norm(np.diff(points, axis=1), axis=2)
    turn = 2 * np.arcsin(np.clip(np.linalg.norm(np.diff(normals, axis=1), axis=2) / 2, 0, 1))
    turn[turn > 1.5] = 0.0  # a sharp corner has no bend to follow
    with np.errstate(divide="ignore"):
        wanted = np.clip(np.where(turn > 0, TURN * length / turn, step), FINEST * step, step)
    if ends or axis == 1:
        closes = length[:, [0, -1]] < 1e-9  # a pole is no edge
        edge = np.where(closes | (not ends), step, FINEST * step)
        wanted[:, [0, -1]] = np.minimum(wanted[:, [0, -1]], edge)
    for k in range(1, shape[1] - 1):
        wanted[:, k] = np.minimum(wanted[:, k], wanted[:, k - 1] + GRADE * length[:, k - 1])
    for k in range(shape[1] - 3, -1, -1):
        wanted[:, k] = np.minimum(wanted[:, k], wanted[:, k + 1] + GRADE * length[:, k + 1])
    result: DoubleArray = length / wanted
    return result


def _frame(patch: Patch, u: DoubleArray, v: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Unit normals and tangents along u (N, 3), by central differences kept inside the patch."""
    h = 2e-4
    ui, vi = np.clip(u, 1e-3, 1 - 1e-3), np.clip(v, 1e-3, 1 - 1e-3)
    du = patch.position(ui + h, vi) - patch.position(ui - h, vi)
    dv = patch.position(ui, vi + h) - patch.position(ui, vi - h)
    normals = np.cross(du, dv)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    tangents = du / np.maximum(np.linalg.norm(du, axis=1, keepdims=True), 1e-15)
    return normals, tangents


def _chord(
    patch: Patch, a: tuple[DoubleArray, DoubleArray], b: tuple[DoubleArray, DoubleArray]
) -> DoubleArray:
    """Distance (N,) from P(a) to P(b); what an open end cuts off is made up for."""
    if patch.closed:
        low, high, cut = (a[0] % 1.0, a[1]), (b[0] % 1.0, b[1]), np.ones(len(a[0]))
    else:
        low = np.clip(a[0], 0, 1), a[1]
        high = np.clip(b[0], 0, 1), b[1]
        kept = np.maximum(high[0] - low[0], 1e-9)
        cut = np.where(b[0] > a[0], np.maximum((b[0] - a[0]) / kept, 1.0), 1.0)
    way = patch.position(*high) - patch.position(*low)
    result: DoubleArray = np.linalg.norm(way, axis=1) * cut
    return result
