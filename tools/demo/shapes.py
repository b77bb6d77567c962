"""Surfaces of objects: parametric patches, the parts of an object, and the discs that cover them.

A patch maps the unit square (u, v) to points of an object's own frame; its outward normal is the
direction of dP/du x dP/dv. Lengths are scene units, z is up. Discs lie on a patch in staggered
rows: quasi-uniform, finer where the surface bends or ends.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray

Position = Callable[[DoubleArray, DoubleArray], DoubleArray]  # (N,), (N,) -> (N, 3)
Coordinates = Sequence[float]
Step = float | tuple[float, float]  # of discs: along u and v
Steps = Mapping[str, Step]  # by faces of a box: {"+z": 0.01, "-x +x": (0.01, 0.02)}

TURN = 0.62  # radians: the most that the normal may turn from one disc to the next
FINEST = 0.45  # of a step: how close discs come at a bend or at an open edge
GRADE = 0.8  # growth of the distance between discs per unit of length away from there
_JITTER = 0.13  # of a step
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Patch:
    """A surface over the unit square; ``closed`` says that u = 1 meets u = 0."""

    position: Position
    closed: bool = False


def rectangle(origin: Coordinates, edge_u: Coordinates, edge_v: Coordinates) -> Patch:
    """Flat parallelogram; its outside is where edge_u x edge_v points."""
    o, a, b = (np.asarray(x, np.float64) for x in (origin, edge_u, edge_v))

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        return o + u[:, None] * a + v[:, None] * b

    return Patch(position)


def outline(text: str) -> list[tuple[float, ...]]:
    """Points of a profile or a path, written in thousandths of a unit: "0 0, 34 0, 41.5 6"."""
    return [tuple(float(f"{number}e-3") for number in point.split()) for point in text.split(",")]


def revolve(profile: Sequence[Coordinates], *, smooth: bool = True) -> Patch:
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
        return c + r * unit

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
        return at(centre, v) + r * across

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


ALL_FACES = "-x +x -y +y -z +z"


def rounded_box(size: Coordinates, radius: float, faces: str = ALL_FACES) -> list[Patch]:
    """Faces of a box around the origin, each with its half of the rounded edges: a face of the
    sharp box is pulled onto the inner box grown by ``radius``."""
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
            reach = np.linalg.norm(out, axis=1, keepdims=True)
            return core + (half - inner).min() * out / reach

        return Patch(position)

    return [face("xyz".index(name[1]), 1 if name[0] == "+" else -1) for name in faces.split()]


def placed(patch: Patch, matrix: DoubleArray) -> Patch:
    """The patch moved by an affine ``matrix`` (3, 4) of positive determinant."""

    def position(u: DoubleArray, v: DoubleArray) -> DoubleArray:
        return patch.position(u, v) @ matrix[:, :3].T + matrix[:, 3]

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
    return length / wanted


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
    return np.linalg.norm(way, axis=1) * cut


Paint = Callable[[Discs], DoubleArray]  # -> (N, 3) gamma-space albedo 0..1


@dataclass(frozen=True)
class Material:
    """What a part looks like."""

    paint: Paint
    gloss: float = 0.0  # 0 matt .. 1 wet glaze
    shine: float = 40.0  # exponent of the highlight: how small it is
    glow: float = 0.0  # light of its own, times albedo
    soft: float = 0.0  # 0..1 light that comes through (leaves, cloth, wax)


@dataclass(frozen=True)
class Part:
    """A patch with its finish; ``step`` is the distance of its discs along u and along v."""

    patch: Patch
    finish: Material
    step: tuple[float, float]


@dataclass(frozen=True)
class Item:
    """An object: name, parts in its own frame, placement (3, 4) in the room."""

    name: str
    parts: tuple[Part, ...]
    matrix: DoubleArray  # (3, 4)


@dataclass(frozen=True, eq=False)
class Surface:
    """Discs of many parts, world frame."""

    points: DoubleArray  # (N, 3)
    normals: DoubleArray  # (N, 3)
    tangents: DoubleArray  # (N, 3)
    sizes: DoubleArray  # (N, 2)
    albedo: DoubleArray  # (N, 3) gamma space
    finish: DoubleArray  # (N, 4) gloss, shine, glow, soft
    labels: IntArray  # (N,) object id, 0 = room

    def __len__(self) -> int:
        return len(self.points)

    def take(self, chosen: BoolArray) -> "Surface":
        """The discs that are ``chosen`` (N,)."""
        return Surface(**{f.name: getattr(self, f.name)[chosen] for f in fields(Surface)})


def parts(
    patches: Patch | Sequence[Patch],
    finish: Material,
    step: Step,
    place: DoubleArray | None = None,
) -> list[Part]:
    """Patches of one finish, moved to ``place`` (3, 4) in their object's frame."""
    both = (step, step) if isinstance(step, float) else step
    several = [patches] if isinstance(patches, Patch) else patches
    found = [Part(patch, finish, both) for patch in several]
    return found if place is None else moved(found, place)


def box(
    size: Coordinates,
    radius: float,
    finish: Material,
    steps: Steps,
    place: DoubleArray | None = None,
) -> list[Part]:
    """Parts of a `rounded_box`: of the faces that ``steps`` names, in its order."""
    return [
        part
        for faces, step in steps.items()
        for part in parts(rounded_box(size, radius, faces), finish, step, place)
    ]


def moved(group: Sequence[Part], matrix: DoubleArray) -> list[Part]:
    """Parts moved inside their object's frame; paints keep seeing the unmoved points."""
    return [
        replace(
            part,
            patch=placed(part.patch, matrix),
            finish=replace(part.finish, paint=_unmoved(part.finish.paint, matrix)),
        )
        for part in group
    ]


def cover(item: Item, label: int, coarseness: float, rng: np.random.Generator) -> Surface:
    """Discs of one object in the room; ``coarseness`` scales all its steps."""
    found = [_cover_part(part, item.matrix, label, coarseness, rng) for part in item.parts]
    return joined(found)


def joined(surfaces: Sequence[Surface]) -> Surface:
    """All discs, in order."""
    names = [field.name for field in fields(Surface)]
    return Surface(**{n: np.concatenate([getattr(s, n) for s in surfaces]) for n in names})


def _cover_part(
    part: Part, matrix: DoubleArray, label: int, coarseness: float, rng: np.random.Generator
) -> Surface:
    scale = float(np.cbrt(np.linalg.det(matrix[:, :3])))
    step = (part.step[0] * coarseness / scale, part.step[1] * coarseness / scale)
    discs = lay_discs(part.patch, step, rng)
    turn = matrix[:, :3] / scale
    finish = part.finish
    row = np.array([finish.gloss, finish.shine, finish.glow, finish.soft])
    return Surface(
        points=discs.points @ matrix[:, :3].T + matrix[:, 3],
        normals=discs.normals @ turn.T,
        tangents=discs.tangents @ turn.T,
        sizes=discs.sizes * scale,
        albedo=np.clip(finish.paint(discs), 0.0, 1.0),
        finish=np.tile(row, (len(discs), 1)),
        labels=np.full(len(discs), label, np.int32),
    )


def _unmoved(paint: Paint, matrix: DoubleArray) -> Paint:
    inverse = np.linalg.inv(matrix[:, :3])

    def painted(discs: Discs) -> DoubleArray:
        local = (discs.points - matrix[:, 3]) @ inverse.T
        return paint(replace(discs, points=local))

    return painted
