"""Objects fall and come to rest: rigid bodies by MuJoCo, an extra for tools."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.geometry import quats_to_matrices

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
