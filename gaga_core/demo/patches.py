"""Parametric surface patches: maps from the unit square (u, v) to points of an object's own frame.

The outward normal of every patch is the direction of dP/du x dP/dv. Lengths are scene units,
z is up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray

Position = Callable[[DoubleArray, DoubleArray], DoubleArray]  # (N,), (N,) -> (N, 3)
Coordinates = Sequence[float]


@dataclass(frozen=True)
class Patch:
    """A surface over the unit square; ``closed`` says that u = 1 meets u = 0."""

    position: Position
    closed: bool = False


def rectangle(origin: Coordinates, edge_u: Coordinates, edge_v: Coordinates) -> Patch:
    """Flat parallelogram; its outside is where edge_u x edge_v points."""
    o, a, b = (np.asarray(x, np.float64) for x in (origin, edge_u, edge_v))

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        result: DoubleArray = o + u[:, None] * a + v[:, None] * b
        return result

    return Patch(position)


def revolve(profile: Sequence[tuple[float, float]], *, smooth: bool = True) -> Patch:
    """Surface of revolution around z of a profile of (radius, height) points.

    The outside lies to the right of the direction of travel: run up the outer wall, then down the
    inner one. ``smooth`` bends a curve through the points.
    """
    curve = _curve(np.asarray(profile, np.float64), smooth)
    along = np.linspace(0.0, 1.0, len(curve))

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        radius = np.maximum(np.interp(v, along, curve[:, 0]), 0.0)
        angle = 2 * np.pi * u
        height = np.interp(v, along, curve[:, 1])
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)

    return Patch(position, closed=True)


def ellipsoid(radii: Coordinates, centre: Coordinates = (0, 0, 0)) -> Patch:
    """Ellipsoid with its poles on z."""
    r, c = np.asarray(radii, np.float64), np.asarray(centre, np.float64)

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        angle, polar = 2 * np.pi * u, np.pi * (1 - v)
        ring = np.sin(polar)
        unit = np.stack([ring * np.cos(angle), ring * np.sin(angle), np.cos(polar)], axis=1)
        result: DoubleArray = c + r * unit
        return result

    return Patch(position, closed=True)


def tube(path: Sequence[Coordinates], radii: Sequence[float], *, flat: float = 1.0) -> Patch:
    """Round rod along a smooth path; a radius of 0 at an end closes it.

    ``flat`` scales the section across the path's own plane (a mug's handle is a strap).
    """
    points = np.asarray(path, np.float64)
    curve = _curve(np.column_stack([points, np.asarray(radii, np.float64)]), smooth=True)
    centre, radius = curve[:, :3], np.maximum(curve[:, 3], 0.0)
    side, other = _frames(centre)
    along = np.linspace(0.0, 1.0, len(curve))

    def at(table: DoubleArray, v: DoubleArray) -> DoubleArray:
        return np.stack([np.interp(v, along, table[:, k]) for k in range(3)], axis=1)

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        angle = 2 * np.pi * u
        r = np.interp(v, along, radius)[:, None]
        across = np.cos(angle)[:, None] * at(side, v) + flat * np.sin(angle)[:, None] * at(other, v)
        result: DoubleArray = at(centre, v) + r * across
        return result

    return Patch(position, closed=True)


def rod(path: Sequence[Coordinates], radii: Sequence[float], *, flat: float = 1.0) -> Patch:
    """A `tube` with round ends."""
    p, r = np.asarray(path, np.float64), np.asarray(radii, np.float64)
    first, last = p[0] - p[1], p[-1] - p[-2]
    first, last = first / np.linalg.norm(first), last / np.linalg.norm(last)
    bulge = ((0.55, 0.84), (0.88, 0.48), (1.0, 0.0))
    head = [p[0] + a * r[0] * first for a, _ in bulge[::-1]]
    tail = [p[-1] + a * r[-1] * last for a, _ in bulge]
    ends = [b for _, b in bulge]
    return tube(
        [*head, *p, *tail],
        [*(r[0] * b for b in ends[::-1]), *r, *(r[-1] * b for b in ends)],
        flat=flat,
    )


def rounded_box(size: Coordinates, radius: float) -> dict[str, Patch]:
    """The six faces ``-x +x -y +y -z +z`` of a box around the origin, each with its half of the
    rounded edges: a face of the sharp box is pulled onto the inner box grown by ``radius``."""
    half = np.asarray(size, np.float64) / 2
    inner = half - min(radius, float(half.min()) * 0.999)

    def face(axis: int, sign: int) -> Patch:
        i, j = ((axis + 1) % 3, (axis + 2) % 3)[::sign]

        def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
            q = np.empty((len(u), 3))
            q[:, i] = (2 * u - 1) * half[i]
            q[:, j] = (2 * v - 1) * half[j]
            q[:, axis] = sign * half[axis]
            core = np.clip(q, -inner, inner)
            out = q - core
            result: DoubleArray = core + (half - inner).min() * out / np.linalg.norm(
                out, axis=1, keepdims=True
            )
            return result

        return Patch(position)

    names = "xyz"
    return {
        ("+" if sign > 0 else "-") + names[axis]: face(axis, sign)
        for axis in range(3)
        for sign in (-1, 1)
    }


def placed(patch: Patch, matrix: DoubleArray) -> Patch:
    """The patch moved by an affine ``matrix`` (3, 4) of positive determinant."""

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        result: DoubleArray = patch.position(u, v) @ matrix[:, :3].T + matrix[:, 3]
        return result

    return Patch(position, patch.closed)


def pose(
    offset: Coordinates = (0, 0, 0),
    *,
    yaw: float = 0.0,
    tilt: float = 0.0,
    roll: float = 0.0,
    scale: float = 1.0,
) -> DoubleArray:
    """Placement (3, 4): roll about x, then tilt about y, then yaw about z (degrees), then move."""
    a, b, c = np.radians([yaw, tilt, roll])
    rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1.0, 0], [-np.sin(b), 0, np.cos(b)]])
    rx = np.array([[1.0, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    return np.column_stack([scale * rz @ ry @ rx, np.asarray(offset, np.float64)])


def _curve(points: DoubleArray, smooth: bool, n: int = 400) -> DoubleArray:
    """Curve through ``points`` (K, D), as ``n`` points of equal spacing.

    Smooth: cubic Hermite pieces along three-point differences; a slope reaches no farther than the
    shorter of its two chords, so that a short step next to a long one does not overshoot.
    """
    chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(chord)])
    fine = np.linspace(0, at[-1], 8 * n)
    if smooth and len(points) > 2:
        slope = np.gradient(points, at, axis=0)
        slope /= np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
        reach = np.minimum(np.r_[chord, chord[-1]], np.r_[chord[0], chord])[:, None]
        k = np.clip(np.searchsorted(at, fine, side="right") - 1, 0, len(chord) - 1)
        t = (fine - at[k])[:, None] / chord[k][:, None]
        s = t * t * (3 - 2 * t)
        bend = t * (1 - t) * ((1 - t) * (reach * slope)[k] - t * (reach * slope)[k + 1])
        curve = points[k] * (1 - s) + points[k + 1] * s + bend
    else:
        curve = np.stack([np.interp(fine, at, p) for p in points.T], axis=1)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    wanted = np.linspace(0, length[-1], n)
    return np.stack([np.interp(wanted, length, c) for c in curve.T], axis=1)


def _frames(path: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Two unit normals (N, 3) along a path, carried without twist (double reflection)."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-12
    start = np.cross(tangent[0], [0.0, 1.0, 0.0])
    if np.linalg.norm(start) < 0.1:
        start = np.cross(tangent[0], [1.0, 0.0, 0.0])
    side = np.empty_like(path)
    side[0] = start / np.linalg.norm(start)
    for k in range(1, len(path)):
        carried = side[k - 1] - tangent[k] * (side[k - 1] @ tangent[k])
        side[k] = carried / np.linalg.norm(carried)
    return side, np.cross(tangent, side)
