"""Reduce splats in the window: an estimate, a job, one entry of the history."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import Progress, Stage
from gaga_core.scene.project import Project
from gaga_core.scene.reduce import LossCurve
from gaga_core.scene.scene import Scene, State
from gaga_studio.features import cleanup, objects, selection
from gaga_studio.features.cleanup import ReducePlan
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from tests.app.looks import finish, snapshot
from tests.scenes import objects_scene


@pytest.fixture
def at_balls(new_session: Callable[[], Session], tmp_path: Path) -> Session:
    """A session in which one of three balls is selected, and one is locked."""
    made = objects_scene(3, 80, n_cameras=2)
    model = tmp_path / "balls.ply"
    write_ply(model, made.gaussians)
    session = new_session()
    project = Project(Scene.of(made.gaussians, made.labels), model, path=tmp_path / "balls.gaga")
    session.document = Document(project)
    objects.set_locked(session, 3, True)
    selection.select_groups(session, (2,))
    return session


def test_an_estimate_makes_way_for_the_reduction(at_balls: Session) -> None:
    session, plan = at_balls, ReducePlan(percent=25)
    document = session.need()
    scene, before = document.scene, snapshot(document.scene)
    cleanup.open_reduce_plan(session, plan)
    assert plan.what == "selection"
    cleanup.estimate_loss(session, plan)
    assert session.jobs.running is not None
    cleanup.start_reducing(session, plan)
    finish(session)
    assert session.jobs.wait()
    finish(session)
    left = scene.visible & (scene.labels == 2)
    assert np.count_nonzero(left) == 20
    assert scene.has(State.SELECTED)[left].all()
    assert "80 splats became 20: " in session.notices[-1].text
    assert document.history.undo_title is not None
    assert "group 2 to 20" in document.history.undo_title
    session.undo()
    assert snapshot(scene) == before


def test_an_estimate_is_made_once_for_each_choice(at_balls: Session) -> None:
    session, plan = at_balls, ReducePlan()
    cleanup.open_reduce_plan(session, plan)
    cleanup.estimate_loss(session, plan)
    finish(session)
    assert plan.curve is not None
    cleanup.estimate_loss(session, plan)
    assert session.jobs.running is None
    plan.what = "scene"
    cleanup.estimate_loss(session, plan)
    assert plan.curve is None
    finish(session)
    assert plan.curve is not None


def test_an_estimate_that_nobody_waits_for_stops(at_balls: Session) -> None:
    """Other jobs can run at once; with a reduction that waits for its end it is another matter."""
    session, plan = at_balls, ReducePlan()
    cleanup.open_reduce_plan(session, plan)
    cleanup.estimate_loss(session, plan)
    assert cleanup.what_is_known_of_loss(session, plan) == "Estimating the loss…"
    cleanup.close_reduce_plan(session, plan)
    job = session.jobs.running
    assert job is None or job.is_cancelling
    assert session.jobs.wait()
    assert plan.curve is None
    cleanup.estimate_loss(session, plan)
    session.jobs.cancel()
    assert session.jobs.wait()
    cleanup.estimate_loss(session, plan)
    assert session.jobs.running is None, "a person stopped it"
    assert cleanup.what_is_known_of_loss(session, plan) == "The loss is measured when it is done."
    cleanup.open_reduce_plan(session, plan)
    cleanup.estimate_loss(session, plan)
    cleanup.start_reducing(session, plan)
    cleanup.close_reduce_plan(session, plan)
    assert plan.starts
    assert session.jobs.wait()
    finish(session)
    assert (session.need().history.undo_title or "").startswith("Reduce splats")


def test_what_is_said_of_the_loss(at_balls: Session) -> None:
    session, plan = at_balls, ReducePlan(percent=50)
    plan.curve = LossCurve(((0.5, 30.0), (0.05, 20.0)))
    known = cleanup.what_is_known_of_loss(session, plan)
    assert known == "About 30.0 dB against pictures of now; measured when it is done."
    plan.curve = LossCurve(())
    assert cleanup.what_is_known_of_loss(session, plan).startswith("Nearly nothing is lost; ")
    plan.curve = None
    objects.set_locked(session, 1, True)
    objects.set_locked(session, 2, True)
    session.need().scene.state[session.need().scene.labels == 0] |= np.uint8(State.LOCKED)
    reason = cleanup.why_not_reducible(session, "scene")
    assert "there are no others" in reason
    assert cleanup.what_is_known_of_loss(session, plan) == reason


def test_why_nothing_can_be_reduced(at_balls: Session) -> None:
    session, plan = at_balls, ReducePlan()
    scene = session.need().scene
    n_free = np.count_nonzero(scene.visible & ~scene.has(State.LOCKED))
    assert len(cleanup.reducible_splats(session, "scene")) == n_free == len(scene) - 80
    selection.select_groups(session, ())
    assert cleanup.why_not_reducible(session, "objects") == "Nothing is selected."
    cleanup.open_reduce_plan(session, plan)
    assert plan.what == "scene"

    def waiting() -> Stage[None]:
        while True:
            yield Progress("Wait", 0, 0)

    session.jobs.start("Wait", waiting())
    cleanup.estimate_loss(session, plan)
    assert plan.asked is None, "later"
    assert "Wait is still running" in cleanup.why_not_reducing(session, plan)
    session.jobs.cancel()
    assert session.jobs.wait()
