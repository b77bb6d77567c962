"""What stands, what falls where (rigid bodies by MuJoCo, an extra for tools): the kinds of scenes,
and where they are seen from."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import mujoco
import numpy as np
from scipy.spatial import ConvexHull

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.geometry import quats_to_matrices
from tools.demo.scene import posed
from tools.scenes.scans import Mesh, Scan, read_scan, scan_names

_STEP = 0.004  # s
_SECONDS = 2.4  # of falling
_MOST_SECONDS = 6.0  # ... where something still moves
_FASTEST = 1.0  # m/s downwards: so that what falls late does not scatter what lies
_AT_REST = 0.03  # m/s or rad/s
_MOST_CORNERS = 48  # of a convex hull
_FRICTION = "0.8 0.01 0.002"  # sliding, spinning, rolling: so that balls stop


@dataclass(frozen=True, eq=False)
class Body:
    """What falls: a union of convex pieces."""

    pieces: Sequence[DoubleArray]  # (C, 3) corners of each, in the body's axes, metres
    mass: float  # kg
    place: DoubleArray  # (4, 4) world from body, at the beginning
    push: tuple[float, float] = (0.0, 0.0)  # m/s along x and y, at the beginning


@dataclass(frozen=True)
class Block:
    """A box that stays: of the table, a board, a wall."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    furniture: int = 0  # the piece of furniture that it is a part of, 1..; 0 = the room


@dataclass(frozen=True, eq=False)
class Rest:
    """Where bodies lie in the end."""

    places: DoubleArray  # (B, 4, 4) world from body
    speeds: DoubleArray  # (B,) m/s
    touches: tuple[frozenset[int], ...]  # of each body: bodies, -1 for a block
    deepest: float  # metres that two hulls run into each other


def settle(bodies: Sequence[Body], blocks: Sequence[Block]) -> Rest:
    """Let bodies fall onto blocks until they rest, or for six seconds."""
    model = mujoco.MjModel.from_xml_string(_xml(bodies, blocks))
    data = mujoco.MjData(model)
    velocities = data.qvel.reshape(len(bodies), 6)
    velocities[:, :2] = np.array([body.push for body in bodies]).reshape(-1, 2)
    while data.time < _MOST_SECONDS:
        mujoco.mj_step(model, data)
        np.maximum(velocities[:, 2], -_FASTEST, out=velocities[:, 2])
        if data.time > _SECONDS and np.abs(data.qvel).max(initial=0) < _AT_REST:
            break
    mujoco.mj_forward(model, data)
    n = len(bodies)
    state = data.qpos.reshape(n, 7)
    places = np.tile(np.eye(4), (n, 1, 1))
    places[:, :3, :3] = quats_to_matrices(state[:, 3:].copy())
    places[:, :3, 3] = state[:, :3]
    speeds = np.linalg.norm(data.qvel.reshape(n, 6)[:, :3], axis=1)
    touches: list[set[int]] = [set() for _ in bodies]
    deepest = 0.0
    for k in range(data.ncon):
        pair = model.geom_bodyid[data.contact[k].geom] - 1  # body 0 is the world
        deepest = max(deepest, -float(data.contact[k].dist))
        for one, other in (pair, pair[::-1]):
            if one >= 0:
                touches[one].add(int(other))
    return Rest(places, speeds, tuple(frozenset(t) for t in touches), deepest)


def _xml(bodies: Sequence[Body], blocks: Sequence[Block]) -> str:
    """MJCF of the scene."""
    meshes, world = list[str](), list[str]()
    for block in blocks:
        low, high = np.array(block.low), np.array(block.high)
        world.append(f'<geom type="box" {_at((low + high) / 2)} size="{_row((high - low) / 2)}"/>')
    for b, body in enumerate(bodies):
        geoms = []
        for p, corners in enumerate(body.pieces):
            meshes.append(
                f'<mesh name="{b}_{p}" vertex="{_row(corners.ravel())}" inertia="convex" '
                f'maxhullvert="{_MOST_CORNERS}"/>'
            )
            mass = body.mass / len(body.pieces)
            geoms.append(f'<geom type="mesh" mesh="{b}_{p}" mass="{mass:.9g}"/>')
        axes = _row(body.place[:3, :2].T.ravel())
        world.append(
            f'<body {_at(body.place[:3, 3])} xyaxes="{axes}"><freejoint/>{"".join(geoms)}</body>'
        )
    return (
        f'<mujoco><option timestep="{_STEP}" integrator="implicitfast" cone="elliptic"/>'
        '<compiler boundmass="1e-4" boundinertia="1e-7"/>'
        f'<default><geom condim="6" friction="{_FRICTION}" solref="0.008 1"/></default>'
        f"<asset>{''.join(meshes)}</asset><worldbody>{''.join(world)}</worldbody></mujoco>"
    )


def _at(point: DoubleArray) -> str:
    return f'pos="{_row(point)}"'


def _row(values: DoubleArray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


Kind = Literal["single", "table", "touching", "pile", "box", "bowl", "shelf", "leaning"]
KINDS: tuple[Kind, ...] = get_args(Kind)
_MOST: dict[str, tuple[int, int]] = {  # objects of a scene: from, to
    "single": (1, 1),
    "table": (3, 14),
    "touching": (4, 12),
    "pile": (8, 30),
    "box": (4, 12),
    "bowl": (4, 10),
    "shelf": (5, 14),
    "leaning": (3, 9),
}
_SMALL = 0.11  # metres: what goes into a bowl
_SECTORS = 14  # pieces of a bowl's wall
_PUSH = 1.1  # m/s
_SPEED = 0.25  # m/s: what is faster in the end never came to rest, and is taken away
_UPRIGHT = 0.6  # share of what is set down as it was scanned
_BOARD, _DEEP, _FLOOR = 0.02, 0.32, -0.75  # metres: boards, their depth, floor under a table


@dataclass(frozen=True, eq=False)
class Placed:
    """An object at rest."""

    name: str
    mesh: Mesh
    body: Body


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A scene before it is drawn."""

    kind: Kind
    objects: tuple[Placed, ...]
    rest: Rest
    blocks: tuple[Block, ...]  # the surroundings

    @property
    def n_furniture(self) -> int:
        """Tables, shelves and boards: objects that others stand on, numbered after the objects."""
        return max((block.furniture for block in self.blocks), default=0)


def kind_of(seed: int) -> Kind:
    """The kind of a seed of mixed scenes: every third is of one object alone."""
    others = KINDS[1:]
    return KINDS[0] if seed % 3 == 0 else others[(seed - seed // 3 - 1) % len(others)]


def arrange(scans: Path, split: str, kind: Kind, rng: np.random.Generator) -> Arrangement:
    """Choose objects, let them fall, and leave out what fell off or does not rest."""
    names = scan_names(scans, split)
    low, high = _MOST[kind]
    drawn = rng.choice(names, min(int(rng.integers(low, high + 1)), len(names)), replace=False)
    found = [read_scan(scans, str(name)) for name in drawn]
    blocks, containers = _surroundings(kind, rng), _containers(kind, rng)
    falling = [*containers, *_falling(kind, found, containers, rng)]
    rest = settle([thing.body for thing in falling], blocks)
    for _ in range(3):  # what is taken away may have held others
        kept = [
            k
            for k, place in enumerate(rest.places)
            if place[2, 3] > -0.02 and rest.speeds[k] < _SPEED
        ]
        if len(kept) == len(falling) or not kept:
            break
        falling = [
            Placed(t.name, t.mesh, Body(t.body.pieces, t.body.mass, rest.places[k]))
            for k, t in enumerate(falling)
            if k in kept
        ]
        rest = settle([thing.body for thing in falling], blocks)
    return Arrangement(kind, tuple(falling), rest, tuple(blocks))


def _surroundings(kind: Kind, rng: np.random.Generator) -> list[Block]:
    """Floor, table or boards, walls; things stand on z = 0 and above."""
    if kind == "shelf":
        half, gap = rng.uniform(0.4, 0.6), rng.uniform(0.34, 0.42)
        n = int(rng.integers(2, 4))
        boards = [
            Block((-half, 0.0, k * gap - _BOARD), (half, _DEEP, k * gap), 1) for k in range(n)
        ]
        sides = [
            Block((x - _BOARD, 0.0, -_BOARD), (x, _DEEP, n * gap), 1)
            for x in (-half, half + _BOARD)
        ]
        back = Block((-2.0, _DEEP, _FLOOR), (2.0, _DEEP + _BOARD, 1.6))
        return [*boards, *sides, back]
    half = rng.uniform(0.45, 0.75) if kind != "single" else rng.uniform(0.3, 0.6)
    if rng.random() < 0.35:  # on the floor itself
        half = 1.6
        found = [Block((-half, -half, -0.05), (half, half, 0.0))]
    else:
        deep = half * rng.uniform(0.7, 1.0)
        found = [
            Block((-half, -deep, -0.04), (half, deep, 0.0), 1),
            Block((-2.0, -2.0, _FLOOR - 0.05), (2.0, 2.0, _FLOOR)),
        ]
    if kind == "leaning":
        y = rng.uniform(0.1, 0.16)
        found.append(Block((-half, y, 0.0), (half, y + 0.03, 0.4), 1 + found[0].furniture))
    elif rng.random() < 0.4:
        found.append(Block((-2.0, 1.7, _FLOOR), (2.0, 1.75, 1.5)))
    return found


def _containers(kind: Kind, rng: np.random.Generator) -> list[Placed]:
    """The box or the bowl that others fall into: objects as all others."""
    color = rng.uniform(0.15, 0.9, 3)
    if kind == "box":
        x, y, z = rng.uniform(0.14, 0.22), rng.uniform(0.11, 0.18), rng.uniform(0.06, 0.14)
        t = 0.006
        cuts = [
            ((-x, -y, 0), (x, y, t)),
            ((-x, -y, t), (-x + t, y, z)),
            ((x - t, -y, t), (x, y, z)),
            ((-x + t, -y, t), (x - t, -y + t, z)),
            ((-x + t, y - t, t), (x - t, y, z)),
        ]
        pieces = [np.array(np.meshgrid(*zip(*cut, strict=True))).reshape(3, -1).T for cut in cuts]
        return [_drawn("box", pieces, 1.5, color)]
    if kind == "bowl":
        r, h, t = rng.uniform(0.11, 0.17), rng.uniform(0.05, 0.09), 0.006
        outer = np.array([(0.45 * r, 0), (0.8 * r, 0.45 * h), (r, h)])
        inner = np.array([(0.45 * r, t), (0.8 * r - t, 0.45 * h + t), (r - t, h)])
        angles = np.linspace(0, 2 * np.pi, _SECTORS + 1)
        pieces = [_turned(np.array([(0, 0), (0, t), outer[0], inner[0]]), angles[:-1])]
        for one, other in itertools.pairwise(angles):
            for k in range(2):
                profile = np.concatenate([outer[k : k + 2], inner[k : k + 2]])
                pieces.append(_turned(profile, np.array([one, other])))
        return [_drawn("bowl", pieces, 1.0, color)]
    return []


def _turned(profile: DoubleArray, angles: DoubleArray) -> DoubleArray:
    """Points (A * P, 3) of a profile (P, 2) of radius and height at angles (A,)."""
    r, z = profile.T
    points = [np.stack([r * np.cos(a), r * np.sin(a), z], axis=1) for a in angles]
    return np.concatenate(points)


def _drawn(name: str, pieces: list[DoubleArray], mass: float, color: DoubleArray) -> Placed:
    """A plain object of convex pieces."""
    vertices, faces, n = list[DoubleArray](), list[IntArray](), 0
    for piece in pieces:
        hull = ConvexHull(piece)
        triangles = hull.simplices.astype(np.int32)
        a, b, c = (piece[triangles[:, k]] for k in range(3))
        inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
        triangles[inwards] = triangles[inwards][:, ::-1]
        vertices.append(piece)
        faces.append(triangles + np.int32(n))
        n += len(piece)
    texture = np.broadcast_to(color, (1, 1, 3))
    mesh = Mesh(np.concatenate(vertices), np.concatenate(faces), np.zeros((n, 2)), texture)
    place = np.eye(4)
    place[2, 3] = 0.001
    return Placed(name, mesh, Body(pieces, mass, place))


def _falling(
    kind: Kind, scans: list[Scan], containers: list[Placed], rng: np.random.Generator
) -> list[Placed]:
    """Objects at the beginning of their fall, none in another."""
    spots, found = list[tuple[float, float, float]](), list[Placed]()
    height = 0.02
    for scan in scans:
        hull = scan.mesh.corners
        center = (hull.min(axis=0) + hull.max(axis=0)) / 2
        extent = hull.max(axis=0) - hull.min(axis=0)
        within = kind == "pile" or (
            bool(containers)
            and (extent.max() < _SMALL if kind == "bowl" else extent.max() < 0.24)
            and rng.random() < 0.75
        )
        turn = _turn(rng, upright=not within and rng.random() < _UPRIGHT)
        shape = (hull - center) @ turn.T
        low = shape[:, 2].min()
        radius = float(np.linalg.norm(shape[:, :2], axis=1).max())
        if within:
            spread = 0.1 if kind == "pile" else 0.035
            x, y = rng.uniform(-spread, spread, 2)
            z = height + 0.12
            height = z + float(shape[:, 2].max() - low) + 0.01 - 0.12
            at = np.array([x, y, z - low])
        else:
            at = np.array([*_spot(kind, radius, shape, spots, rng), 0.0])
            if kind == "shelf":
                at[1] = min(max(at[1], radius + 0.01), _DEEP - radius) if radius < 0.15 else 0.16
            at[2] = 0.003 - low
            spots.append((at[0], at[1], radius))
        place = np.eye(4)
        place[:3, :3] = turn
        place[:3, 3] = at - turn @ center
        push = (0.0, 0.0)
        if kind == "touching":  # towards the middle, until something is in the way
            away = max(float(np.hypot(at[0], at[1])), 1e-6)
            push = (-_PUSH * at[0] / away, -_PUSH * at[1] / away)
        found.append(Placed(scan.name, scan.mesh, Body([hull], scan.mass, place, push)))
    return found


def _turn(rng: np.random.Generator, *, upright: bool) -> DoubleArray:
    """A random rotation (3, 3), or one about the vertical."""
    if upright:
        a = rng.uniform(0, 2 * np.pi)
        return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    return quats_to_matrices(rng.normal(size=(1, 4)))[0]


def _spot(
    kind: Kind,
    radius: float,
    shape: DoubleArray,
    spots: list[tuple[float, float, float]],
    rng: np.random.Generator,
) -> tuple[float, float]:
    """A free place for a thing: anywhere, next to another, or at the wall."""
    reach = {"single": 0.03, "touching": 0.06, "shelf": 0.36}.get(kind, 0.22)
    for _ in range(400):
        reach *= 1.006
        x, y = rng.uniform(-reach, reach, 2)
        if kind in ("box", "bowl") and np.hypot(x, y) < 0.27 + radius:
            continue
        if kind == "leaning":
            y = min(y, 0.09 - float(shape[:, 1].max()))
            y = max(y, 0.085 - float(shape[:, 1].max()) - 0.15 * rng.random())
        if kind == "shelf":
            y = _DEEP / 2
        if all(np.hypot(x - a, y - b) > radius + r for a, b, r in spots):
            return float(x), float(y)
    return float(x), float(y)


def cameras(
    found: Arrangement, n: int, size: tuple[int, int], rng: np.random.Generator
) -> tuple[Camera, ...]:
    """``n`` cameras ``view_000.jpg`` ...: a ring, a half ring, or a walk by hand."""
    at_rest = zip(found.objects, found.rest.places, strict=True)
    points = np.concatenate([thing.body.pieces[0] @ p[:3, :3].T + p[:3, 3] for thing, p in at_rest])
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = max(float(np.linalg.norm(points - target, axis=1).max()), 0.08)
    fov = rng.uniform(42, 55)
    near = radius / np.sin(np.radians(fov) / 2) * rng.uniform(0.95, 1.25) + 0.05
    walls = found.kind in ("shelf", "leaning")
    way = "half" if walls else str(rng.choice(["ring", "ring", "half", "walk"]))
    start = -np.pi / 2 if walls else rng.uniform(0, 2 * np.pi)
    span = {"ring": 2 * np.pi, "half": 0.85 * np.pi, "walk": rng.uniform(1.1, 1.8) * np.pi}[way]
    phase, result = rng.uniform(0, 6, 3), []
    for k in range(n):
        t = (k + 0.5) / n - 0.5
        azimuth = start + span * t
        rise = np.radians(38 + 20 * np.sin(phase[0] + 17 * t * (1 if way != "walk" else 0.4)))
        if walls:
            rise *= 0.6
        distance = near * (1 + 0.13 * np.sin(phase[1] + 11 * t))
        shake = rng.normal(0, 0.04 if way == "walk" else 0.015, 3) * near
        eye = target + distance * np.array(
            [np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.sin(rise)]
        )
        eye[2] = max(eye[2], 0.05)
        aim = target + shake
        result.append(posed(tuple(eye), tuple(aim), fov, size, f"view_{k:03d}.jpg"))
    return tuple(result)
