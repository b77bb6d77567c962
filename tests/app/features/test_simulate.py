"""Simulate: what hangs in the air lands on its support, as one entry that is undone as one."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.bake import bake
from gaga_core.scene.objects import group_indices
from gaga_studio.features import selection, simulate
from gaga_studio.session.session import Session
from tests.app.looks import finish, snapshot
from tests.scenes import box_on_table

for _package in ("coacd", "manifold3d", "mujoco"):
    pytest.importorskip(_package, reason=f"{_package} is not installed")
_GAP = 0.05  # m: from 5 cm it falls for 0.1 s


def _lowest(session: Session) -> float:
    """Height of the box over the table."""
    scene = session.need().scene
    return float(-bake(scene, indices=group_indices(scene, 1)).means[:, 1].max())


def test_what_hangs_in_the_air_lands(new_session: Callable[[], Session], tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", box_on_table(_GAP))
    session = new_session()
    session.open(tmp_path / "a.ply")
    finish(session)
    session.rig.up = np.array([0.0, -1.0, 0.0])
    selection.select_groups(session, (1,))
    document = session.need()
    before, cursor = snapshot(document.scene), document.history.cursor
    assert simulate.start(session)
    until = time.monotonic() + 60
    while _lowest(session) > 0.01 and time.monotonic() < until:
        session.jobs.poll()
    assert simulate.stop(session)
    finish(session)
    assert document.history.cursor == cursor + 1
    assert abs(_lowest(session)) < 0.005
    bodies = document.feature(simulate.PartsState).world
    assert bodies is not None
    assert simulate.start(session)  # they lie already
    finish(session)
    assert abs(_lowest(session)) < 0.005
    again = document.feature(simulate.PartsState).world
    assert again is not None
    assert again.bodies[0].parts is bodies.bodies[0].parts  # not made again
    session.undo()
    session.undo()
    assert snapshot(document.scene) == before
