"""Bodies fall and come to rest: rigid bodies by MuJoCo, an extra."""

import itertools
from collections.abc import Iterator

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.export.simulation.bodies import World, library
from gaga_core.export.simulation.mjcf import mjcf_of
from gaga_core.geometry import quats_to_matrices


def fall(world: World, seconds: float, frame: float = 1 / 30) -> Iterator[DoubleArray]:
    """Let the bodies move under gravity; places (B, 4, 4), world from body, every ``frame`` s.

    The first is where they begin. Raises ``GagaError`` when MuJoCo is not installed.
    """
    mujoco = library("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf_of(world, {}, inline=True))
    data = mujoco.MjData(model)
    n = len(world.bodies)
    for k in itertools.count():
        while data.time < k * frame - model.opt.timestep / 2:
            mujoco.mj_step(model, data)
        state = data.qpos.reshape(n, 7)
        places = np.tile(np.eye(4), (n, 1, 1))
        places[:, :3, :3] = quats_to_matrices(state[:, 3:].copy())
        places[:, :3, 3] = state[:, :3]
        yield places
        if data.time >= seconds - frame / 2:
            return
