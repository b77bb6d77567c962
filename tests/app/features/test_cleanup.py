"""Clean up: a preview that changes nothing, one entry when applied, and cleaning first."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene.objects import group_indices
from gaga_core.scene.project import Project, open_path_stage
from gaga_core.scene.reduce import LossCurve
from gaga_core.scene.scene import Scene, State
from gaga_studio.features import cleanup, export, objects, selection, transform
from gaga_studio.features.cleanup import ReducePlan
from gaga_studio.features.commands import command, run
from gaga_studio.features.transform import shift
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, PreviewWaitsError
from gaga_studio.session.session import Session
from gaga_studio.session.settings import load_settings
from gaga_studio.tools.controller import ToolController
from gaga_studio.ui.chrome.status import status_text
from tests.app.floaters import GROUP, PER, planted
from tests.app.looks import finish, snapshot
from tests.scenes import objects_scene


@pytest.fixture
def floating(new_session: Callable[[], Session], tmp_path: Path) -> tuple[Session, np.ndarray]:
    """A session in which the object with the floaters is selected, and the floaters."""
    scene, rows = planted()
    session = new_session()
    model = tmp_path / "balls.ply"
    write_ply(model, scene.gaussians)
    project = Project(model_path=model, scene=scene, path=tmp_path / "balls.gaga", folder=None)
    session.document = Document(project)
    selection.select_groups(session, (GROUP,))
    return session, rows


def preview(session: Session) -> None:
    assert run("object.clean", session)
    finish(session)
    assert cleanup.shown(session) is not None, [n.text for n in session.notices]


def test_a_preview_is_seen_and_leaves_nothing(floating: tuple[Session, np.ndarray]) -> None:
    session, rows = floating
    scene, history = session.need().scene, session.need().history
    before, cursor = snapshot(scene), history.cursor
    preview(session)
    found = cleanup.shown(session)
    assert found is not None
    assert np.isin(rows, found.remove).mean() > 0.9
    assert snapshot(scene) != before, "the preview is in the picture"
    run("edit.cancel", session)
    assert cleanup.shown(session) is None
    assert snapshot(scene) == before
    assert history.cursor == cursor
    assert session.selected_groups() == (GROUP,)


def test_apply_is_one_entry_that_undo_restores(floating: tuple[Session, np.ndarray]) -> None:
    session, rows = floating
    scene, history = session.need().scene, session.need().history
    before, cursor = snapshot(scene), history.cursor
    preview(session)
    found = cleanup.shown(session)
    assert found is not None
    tool = ToolController().tool(session)
    assert status_text(session, tool).startswith("Enter applies")
    assert not objects.hide(session)
    assert status_text(session, tool).startswith("Apply or cancel"), "why nothing was hidden"
    assert cleanup.cancel(session)
    assert not status_text(session, tool).startswith("Apply or cancel"), "nothing waits any more"
    preview(session)
    assert run("object.clean_apply", session)
    assert cleanup.shown(session) is None
    assert history.cursor == cursor + 1
    assert history.undo_title == "Clean an object"
    assert (scene.labels[rows] == 0).mean() > 0.9
    np.testing.assert_array_equal(group_indices(scene, GROUP), found.after)
    np.testing.assert_array_equal(session.selected_indices(), found.after)
    assert (scene.placement == 0).all(), "the colors of the preview are gone"
    session.need().undo()
    assert snapshot(scene) == before
    assert not session.unsaved


@pytest.mark.parametrize(
    "other",
    [
        lambda s: selection.select_groups(s, (1,)),
        lambda s: run("edit.undo", s),
        objects.hide,
        lambda s: transform.preview_move(s, shift(np.array([1.0, 0.0, 0.0]))),
    ],
    ids=["select", "undo", "hide", "drag"],
)
def test_whatever_is_done_next_leaves_the_preview(
    floating: tuple[Session, np.ndarray], other: Callable[[Session], object]
) -> None:
    session, _ = floating
    preview(session)
    found, cursor = cleanup.shown(session), session.need().history.cursor
    try:
        other(session)
    except PreviewWaitsError as error:  # the window makes a notice of it
        session.notify(Level.HINT, str(error))
    assert cleanup.shown(session) is found
    assert session.need().history.cursor == cursor
    assert "preview of" in session.notices[-1].text
    assert run("object.clean_apply", session)
    assert (session.need().scene.placement == 0).all()


def test_a_preview_never_becomes_an_entry_by_the_end_of_a_drag(
    floating: tuple[Session, np.ndarray],
) -> None:
    session, _ = floating
    preview(session)
    cursor = session.need().history.cursor
    assert not session.commit_preview()
    assert session.need().history.cursor == cursor
    assert cleanup.shown(session) is not None


def test_what_changed_meanwhile_is_not_cleaned(floating: tuple[Session, np.ndarray]) -> None:
    session, _ = floating
    run("object.clean", session)
    selection.select_groups(session, (1,))
    assert session.jobs.wait()
    assert cleanup.shown(session) is None
    assert "changed" in session.notices[-1].text


def test_a_clean_object_gets_a_sentence_and_no_preview(
    floating: tuple[Session, np.ndarray],
) -> None:
    session, _ = floating
    preview(session)
    cleanup.apply(session)
    for _ in range(3):  # what one pass leaves, if anything
        run("object.clean", session)
        finish(session)
        if not cleanup.apply(session):
            break
    assert session.notices[-1].text.startswith("Nothing to clean")


def test_it_needs_one_object(floating: tuple[Session, np.ndarray]) -> None:
    session, _ = floating
    selection.select_groups(session, (1,), "add")
    assert "2 objects" in command("object.clean").enabled(session)
    cleanup.start(session)
    assert session.jobs.running is None
    selection.select_none(session)
    assert "Nothing is selected" in command("object.clean").enabled(session)


def test_the_choice_is_kept(floating: tuple[Session, np.ndarray]) -> None:
    session, _ = floating
    assert not session.settings.clean_first
    run("object.clean_first", session)
    assert load_settings()[0].clean_first
    run("object.clean_first", session)
    assert not load_settings()[0].clean_first


@pytest.mark.parametrize("act", ["object.isolate", "edit.delete"])
def test_objects_are_cleaned_first_as_one_entry(
    floating: tuple[Session, np.ndarray], act: str
) -> None:
    session, rows = floating
    scene, history = session.need().scene, session.need().history
    before, cursor = snapshot(scene), history.cursor
    run("object.clean_first", session)
    run(act, session)
    finish(session)
    assert history.cursor == cursor + 1
    assert (scene.labels[rows] == 0).mean() > 0.9
    if act == "object.isolate":
        assert set(np.unique(scene.labels[scene.visible])) == {GROUP}
        np.testing.assert_array_equal(np.flatnonzero(scene.visible), session.selected_indices())
    else:
        assert scene.has(State.DELETED)[rows].all(), "no floater is left in the air"
        assert len(group_indices(scene, GROUP)) == 0
    session.need().undo()
    assert snapshot(scene) == before


def test_without_the_choice_nothing_is_cleaned(floating: tuple[Session, np.ndarray]) -> None:
    session, rows = floating
    run("object.isolate", session)
    assert session.jobs.running is None
    assert session.need().scene.visible[rows].all()


def test_a_part_of_an_object_is_left_as_chosen(floating: tuple[Session, np.ndarray]) -> None:
    session, rows = floating
    run("object.clean_first", session)
    session.need().select(rows, "remove")
    chosen = session.selected_indices()
    run("edit.delete", session)
    assert session.jobs.running is None
    np.testing.assert_array_equal(np.flatnonzero(session.need().scene.has(State.DELETED)), chosen)


@pytest.mark.parametrize("what", ["selected", "objects"])
def test_exports_are_cleaned_and_the_scene_is_not(
    floating: tuple[Session, np.ndarray], tmp_path: Path, what: str
) -> None:
    session, rows = floating
    scene = session.need().scene
    run("object.clean_first", session)
    before = snapshot(scene)
    high = scene.gaussians.means[rows, 2].min()
    if what == "selected":
        target = tmp_path / "ball.ply"
        export.export(session, "selected", target)
    else:
        export.export(session, "objects", tmp_path / "objects")
        target = tmp_path / "objects" / f"group-{GROUP}.ply"
    finish(session)
    written = read_ply(target)
    assert PER * 0.8 < len(written) < PER
    assert (written.means[:, 2] >= high).mean() < 0.01
    assert snapshot(scene) == before


def test_a_save_is_without_the_colors_of_the_preview(
    floating: tuple[Session, np.ndarray],
) -> None:
    session, _ = floating
    colors = session.need().scene.gaussians.sh.copy()
    preview(session)
    session.save()
    finish(session)
    assert cleanup.shown(session) is not None
    path = session.need().project.path
    assert path is not None
    saved = run_stage(open_path_stage(path)).scene
    assert not saved.placement.any()
    np.testing.assert_array_equal(saved.gaussians.sh, colors)


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
    assert known == "About 30.0 dB against the current pictures; measured when it is done."
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
