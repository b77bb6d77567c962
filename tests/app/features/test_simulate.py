"""Simulate: what hangs in the air lands on its support, as one entry that is undone as one."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import Progress, Stage
from gaga_core.scene.bake import bake
from gaga_core.scene.objects import group_indices
from gaga_studio.features import selection, simulate, transform
from gaga_studio.session.session import Session
from tests.app.looks import finish, snapshot
from tests.scenes import box_on_table

for _package in ("coacd", "manifold3d", "mujoco"):
    pytest.importorskip(_package, reason=f"{_package} is not installed")
_GAP = 0.05  # m: from 5 cm it falls for 0.1 s


def _nothing() -> Stage[None]:
    yield Progress("Another", 0, 1)


def _lowest(session: Session) -> float:
    """Height of the box over the table."""
    scene = session.need().scene
    return float(-bake(scene, indices=group_indices(scene, 1)).means[:, 1].max())


@pytest.fixture
def session(new_session: Callable[[], Session], tmp_path: Path) -> Session:
    """A box that hangs over a table, selected."""
    write_ply(tmp_path / "a.ply", box_on_table(_GAP))
    session = new_session()
    session.open(tmp_path / "a.ply")
    finish(session)
    session.rig.up = np.array([0.0, -1.0, 0.0])
    selection.select_groups(session, (1,))
    return session


@pytest.mark.parametrize("let_go_after", [1, 30])
def test_bodies_are_made_also_when_it_is_let_go_and_fall_when_it_is_held_again(
    session: Session, let_go_after: int
) -> None:
    """It took half a minute with the button held, and nothing was kept when it was let go."""
    before = snapshot(session.need().scene)
    assert simulate.start(session)
    for _ in range(let_go_after):
        session.jobs.poll()
    assert simulate.label(session).startswith(simulate.PREPARES)
    assert simulate.stop(session)
    assert simulate.not_possible(session) == ""
    finish(session)
    assert simulate.label(session) == "Hold to simulate"
    assert snapshot(session.need().scene) == before
    world = session.need().feature(simulate.PartsState).world
    assert world is not None
    assert simulate.start(session)
    job = session.jobs.running
    assert job is not None
    assert job.title == "Simulate", "nothing is prepared"
    finish(session)
    assert abs(_lowest(session)) < 0.005


def test_what_is_held_again_while_bodies_are_made_falls_when_they_are(session: Session) -> None:
    assert simulate.start(session)
    assert simulate.stop(session)
    assert simulate.start(session)
    finish(session)
    assert abs(_lowest(session)) < 0.005


def test_bodies_of_another_selection_or_place_begin_again(session: Session) -> None:
    assert simulate.start(session)
    assert simulate.stop(session)
    transform.move(session, transform.shift(np.array([0.0, -_GAP, 0.0])))
    finish(session)
    assert session.need().feature(simulate.PartsState).world is None, "they are of where it was"
    assert simulate.start(session)
    assert simulate.stop(session)
    selection.select_none(session)
    assert simulate.start(session)
    state = simulate.state_of(session)
    assert state is not None
    while (job := session.jobs.running) is None or job.is_cancelling:
        session.jobs.poll()  # until the former ones have ended
    assert state.is_held, "that does not let go of these"
    session.jobs.cancel()
    finish(session)
    assert state == simulate.SimulateState()


def test_what_hangs_in_the_air_lands(session: Session) -> None:
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


@pytest.mark.parametrize("are_made", [False, True])
def test_what_falls_gives_way_to_no_other_job(session: Session, are_made: bool) -> None:
    """Bodies that were made in the same hold fell as a job that gave way, and it ended unsaid."""
    if are_made:
        assert simulate.start(session)
        assert simulate.stop(session)
        finish(session)
    assert simulate.start(session)
    state, until = simulate.state_of(session), time.monotonic() + 60
    assert state is not None
    while not state.is_falling and time.monotonic() < until:
        session.jobs.poll()
    assert session.jobs.why_busy == "Simulate is still running."
    assert not session.jobs.start("Another", _nothing())
    assert state.is_held
    finish(session)
    assert abs(_lowest(session)) < 0.005


def test_bodies_fall_that_were_held_whatever_is_selected_by_then(session: Session) -> None:
    assert simulate.start(session)
    selection.select_none(session)
    finish(session)
    assert abs(_lowest(session)) < 0.005


def test_what_is_cancelled_while_it_is_held_does_not_begin_again(session: Session) -> None:
    assert simulate.start(session)
    assert simulate.stop(session)
    finish(session)
    before = snapshot(session.need().scene)
    assert simulate.start(session)
    session.jobs.cancel()
    finish(session)
    assert session.jobs.running is None
    assert simulate.state_of(session) == simulate.SimulateState()
    assert snapshot(session.need().scene) == before
