"""The tool Object: clicks become a selection, each one entry, and the selection an object."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.progress import Progress, Stage
from gaga_core.scene import edits
from gaga_studio.features import transform
from gaga_studio.features.commands import command, for_shortcut, run
from gaga_studio.features.find import click_object
from gaga_studio.features.find.click_object import ClickState
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.gestures import KeyState
from tests.app.tools.hand import H, Hand, W, titles
from tests.color_oracle import Answer, ColorOracle, clicked_things
from tests.core.segmentation.models.hub_server import fresh_models
from tests.scenes import objects_scene

BALL = 0.28  # radius


def balls(session: Session) -> tuple[DoubleArray, DoubleArray]:
    """Pixels (2, 2) of the nearest two balls, and their centres (2, 3)."""
    angles = 2 * np.pi * np.arange(5) / 5
    centres = np.stack([0.9 * np.cos(angles), 0.9 * np.sin(angles), 0 * angles], axis=1)
    pixels, depth = session.rig.camera(W, H).project(centres)
    nearest = np.argsort(depth)[:2]
    return pixels[nearest], centres[nearest]


def chosen_in_balls(session: Session) -> list[int]:
    """How many of the selected splats lie in each of the two balls, and outside of both."""
    assert session.scene is not None
    means = session.scene.gaussians.means[session.selected_indices()]
    away = np.linalg.norm(means[:, None] - balls(session)[1], axis=2)
    inside = away < 1.1 * BALL
    return [*inside.sum(axis=0).tolist(), int((~inside.any(axis=1)).sum())]


@pytest.fixture
def clicked(looked: Session) -> tuple[Session, Hand]:
    """A session in which two balls were clicked, one after the other."""
    hand = Hand(looked)
    for at in balls(looked)[0]:
        hand.click_at(at)
    return looked, hand


def test_clicks_add_and_alt_clicks_take_away(clicked: tuple[Session, Hand]) -> None:
    session, hand = clicked
    one, two, rest = chosen_in_balls(session)
    assert min(one, two) > 180
    assert rest < 60
    hand.click_at(balls(session)[0][1], KeyState(alt=True))
    after = chosen_in_balls(session)
    assert after[0] > 180
    assert after[1] < 40
    assert titles(session) == ["Click an object", "Click more", "Click off"]


def test_undo_brings_the_clicks_before_back(clicked: tuple[Session, Hand]) -> None:
    session, hand = clicked
    both = session.selected_indices().tolist()
    assert run("edit.undo", session)
    assert chosen_in_balls(session)[1] < 40
    hand.click_at(balls(session)[0][1])
    assert session.selected_indices().tolist() == both
    for _ in range(2):
        assert run("edit.undo", session)
    assert len(session.selected_indices()) == 0
    assert command("object.make").enabled(session)


def test_enter_makes_an_object_and_asks_for_its_name(clicked: tuple[Session, Hand]) -> None:
    session, _ = clicked
    chosen = session.selected_indices()
    enter = for_shortcut("Enter", session)
    assert enter is not None
    assert run(enter.id, session)
    assert session.scene is not None
    assert (session.scene.labels > 0).sum() == len(chosen)
    assert session.focus == session.scene.labels[chosen[0]]
    assert session.take_request() is Request.RENAME
    assert run("edit.undo", session)
    assert not session.scene.labels.any()


def test_escape_clears_and_then_leaves_the_tool(clicked: tuple[Session, Hand]) -> None:
    session, hand = clicked
    assert run("edit.cancel", session)
    assert len(session.selected_indices()) == 0
    assert session.tool is ToolName.OBJECT
    hand.click_at(balls(session)[0][1])
    one, two, _ = chosen_in_balls(session)
    assert one < 40 < 180 < two  # another object
    assert run("edit.cancel", session)
    assert run("edit.cancel", session)
    assert session.tool.value == "pick"


def test_a_box_begins_an_object(looked: Session) -> None:
    session, hand = looked, Hand(looked)
    at = balls(session)[0][0]
    focal = session.rig.camera(W, H).K[0, 0]
    depth = session.rig.camera(W, H).project(balls(session)[1])[1][0]
    reach = 1.2 * BALL * focal / depth
    hand.drag(at - reach, at + reach)
    assert hand.controller.overlay is None
    assert titles(session) == ["Select by a box"]
    assert chosen_in_balls(session)[0] > 180


def test_a_click_before_the_scene_was_looked_at_is_answered_later(session: Session) -> None:
    session.tool = ToolName.OBJECT
    hand = Hand(session)
    hand.click_at(balls(session)[0][0])
    assert titles(session) == []
    assert "1 click waits" in hand.controller.tool(session).hint(session)
    assert len(click_object.waiting(session)) == 1
    assert session.jobs.wait()
    assert titles(session) == ["Click an object"]
    assert not click_object.waiting(session)


def test_a_click_that_waits_does_not_replace_what_is_selected_meanwhile(session: Session) -> None:
    session.tool = ToolName.OBJECT
    Hand(session).click_at(balls(session)[0][0])
    Hand(session).click_at(balls(session)[0][0])
    assert session.need().select(np.arange(9, dtype=np.int32))
    assert session.jobs.wait()
    assert session.selected_indices().tolist() == list(range(9))
    assert not click_object.waiting(session)
    assert session.notices[-1].text.startswith("The 2 clicks that waited are dropped. Other things")


@pytest.mark.parametrize("ends", ["is done", "is cancelled"])
def test_a_click_waits_for_the_job_that_took_the_place_of_the_look(
    session: Session, ends: str
) -> None:
    """*Find objects* dropped it."""
    session.tool = ToolName.OBJECT
    hand = Hand(session)
    hand.click_at(balls(session)[0][0])
    session.settings = replace(session.settings, preset="robust", identities="vote")
    assert run("object.associate", session)
    while (job := session.jobs.running) is not None and job.title != "Find objects":
        session.jobs.poll()
    assert len(click_object.waiting(session)) == 1
    if ends == "is cancelled":
        session.jobs.cancel()
    begun = []
    while (job := session.jobs.running) is not None:
        begun += [job.title] if job.title not in begun else []
        session.jobs.poll()
    found = ["Find objects", "Lift groups to identities"] if ends == "is done" else []
    assert titles(session) == [*found, "Click an object"]
    assert begun[-1] == "Prepare clicks"
    assert chosen_in_balls(session)[0] > 180
    assert not click_object.waiting(session)


def test_a_click_that_waits_while_objects_are_found_selects_one(session: Session) -> None:
    """It selected pieces of several, though the click had been on one."""
    Hand(session).click_at(balls(session)[0][0])
    assert click_object.waiting(session)
    session.settings = replace(session.settings, preset="robust", identities="vote")
    assert run("object.associate", session)
    assert session.jobs.wait()
    assert titles(session)[-1].startswith("Select")
    (group,) = session.selected_groups()
    labels = session.need().scene.labels
    assert np.array_equal(session.selected_indices(), np.flatnonzero(labels == group))
    assert chosen_in_balls(session)[0] > 180
    assert session.tool is ToolName.PICK
    assert not click_object.waiting(session)


def test_a_click_is_answered_in_the_scene_that_the_other_job_left(session: Session) -> None:
    """The look at the scene that waited began before splats moved."""
    session.tool = ToolName.OBJECT
    session.edit(lambda scene: edits.select(scene, np.arange(10), "set"))
    Hand(session).click_at(balls(session)[0][0])

    def moves() -> Stage[None]:
        yield Progress("Move", 0, 1)

    def move(_: None) -> None:
        assert transform.move(session, transform.shift(np.ones(3)))

    assert session.jobs.start("Move", moves(), on_done=move)
    assert session.jobs.wait()
    document = session.need()
    assert titles(session)[-1] == "Click an object"
    assert document.feature(ClickState).is_ready(document.scene)


def test_cancelling_the_look_forgets_the_clicks(session: Session) -> None:
    session.tool = ToolName.OBJECT
    hand = Hand(session)
    hand.click_at(balls(session)[0][0])
    session.jobs.cancel()
    assert session.jobs.wait()
    assert titles(session) == []
    assert session.document is not None
    assert session.document.feature(ClickState).waiting == []
    assert not session.document.feature(ClickState).is_preparing
    assert session.notices[-1].text == "The click that waited is dropped. Click again."


def test_what_cannot_be_clicked_is_told(looked: Session) -> None:
    session, hand = looked, Hand(looked)
    at = balls(session)[0][0]
    hand.click_at(at, KeyState(alt=True))
    assert "Click the object first" in session.hint
    hand.click(2, 2)
    assert "no surface" in session.hint
    assert titles(session) == []


def test_what_was_made_an_object_is_not_offered_again(looked: Session) -> None:
    Hand(looked).click_at(balls(looked)[0][0])
    assert run("object.make", looked)
    assert "one object already" in command("object.make").enabled(looked)


def test_locked_splats_are_not_taken(looked: Session) -> None:
    session, hand = looked, Hand(looked)
    at = balls(session)[0][0]
    hand.click_at(at)
    assert run("object.lock", session)
    assert run("edit.cancel", session)
    hand.click_at(at)
    assert chosen_in_balls(session)[0] == 0


def test_moved_splats_are_looked_at_again(looked: Session) -> None:
    session, hand = looked, Hand(looked)
    hand.click_at(balls(session)[0][0])
    assert run("edit.mirror_x", session)
    hand.click_at(balls(session)[0][1])
    assert session.jobs.running is not None
    session.jobs.cancel()
    assert session.jobs.wait()


_TINY = "sam2.1-tiny"
_ASKED = "Ask SAM 2.1 Hiera tiny"


@pytest.fixture(scope="session")
def random_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny SAM 2 with random weights."""
    pytest.importorskip("transformers", reason="transformers is not installed")
    from tests.core.segmentation.tiny_models import save_tiny

    folder = tmp_path_factory.mktemp("random") / _TINY
    save_tiny("sam2", folder)
    return folder


@pytest.fixture
def with_model(
    looked: Session, random_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Session:
    """A session with the tool, and the random model where people put theirs."""
    folder = fresh_models(tmp_path, monkeypatch)
    folder.mkdir(exist_ok=True)
    (folder / _TINY).symlink_to(random_model, target_is_directory=True)
    looked.feature(ModelsState).promptable = None
    return looked


def _knowing(session: Session, answer: Answer = clicked_things) -> Session:
    """The session, its model replaced by one that knows the truth."""
    session.feature(ModelsState).prompters[_TINY] = ColorOracle(
        objects_scene(5, 220, n_cameras=8), answer
    )
    return session


def _two_balls(things: IntArray, points: FloatArray, is_on: BoolArray) -> BoolArray:
    """All balls for one thing: nothing that the clicks alone lead to."""
    return things > 0


def test_the_models_answer_takes_the_place_of_the_first(with_model: Session) -> None:
    session, hand = _knowing(with_model, _two_balls), Hand(with_model)
    hand.click_at(balls(session)[0][0])
    one, two, _ = chosen_in_balls(session)
    assert two < 40 < 180 < one  # at once, without the model
    assert "The model segments" in hand.controller.tool(session).hint(session)
    assert session.jobs.wait()
    assert min(chosen_in_balls(session)[:2]) > 180
    assert titles(session) == ["Click an object", _ASKED]
    assert run("edit.undo", session)
    assert chosen_in_balls(session)[1] < 40


def test_the_next_click_changes_the_models_answer(with_model: Session) -> None:
    session, hand = _knowing(with_model, _two_balls), Hand(with_model)
    hand.click_at(balls(session)[0][0])
    assert session.jobs.wait()
    hand.click_at(balls(session)[0][1], KeyState(alt=True))
    one, two, _ = chosen_in_balls(session)
    assert two < 60 < 180 < one
    session.jobs.cancel()
    assert session.jobs.wait()
    assert titles(session) == ["Click an object", _ASKED, "Click off"]
    assert command("object.make").enabled(session) == ""


def test_a_click_meanwhile_asks_again_about_all_of_them(with_model: Session) -> None:
    session, hand = _knowing(with_model), Hand(with_model)
    for at in balls(session)[0]:
        hand.click_at(at)
    assert session.jobs.wait()
    assert titles(session) == ["Click an object", "Click more", _ASKED]
    assert min(chosen_in_balls(session)[:2]) > 180


def test_cancel_keeps_the_answer_that_needs_no_model(with_model: Session) -> None:
    session, hand = _knowing(with_model, _two_balls), Hand(with_model)
    hand.click_at(balls(session)[0][0])
    assert run("job.cancel", session)
    assert session.jobs.wait()
    assert titles(session) == ["Click an object"]
    assert not session.need().feature(ClickState).is_asking


def test_an_answer_that_comes_too_late_changes_nothing(with_model: Session) -> None:
    session, hand = _knowing(with_model), Hand(with_model)
    hand.click_at(balls(session)[0][0])
    assert run("select.all", session)
    assert session.jobs.wait()
    assert titles(session) == ["Click an object", "Select all"]
    assert "asks again" in session.hint
    assert run("edit.undo", session)
    click_object.ask_model(session)
    assert session.jobs.wait()
    assert titles(session) == ["Click an object", "Select all"]  # redo is not lost


def test_making_the_object_gives_up_the_question(with_model: Session) -> None:
    session, hand = _knowing(with_model, _two_balls), Hand(with_model)
    hand.click_at(balls(session)[0][0])
    chosen = session.selected_indices()
    assert run("object.make", session)
    assert session.jobs.wait()
    assert titles(session) == ["Click an object", "Make object"]
    assert session.scene is not None
    np.testing.assert_array_equal(np.flatnonzero(session.scene.labels > 0), chosen)


def test_a_random_model_goes_all_the_way_or_says_that_it_finds_nothing(
    with_model: Session,
) -> None:
    hand = Hand(with_model)
    hand.click_at(balls(with_model)[0][0])
    assert with_model.jobs.wait()
    assert _TINY in with_model.feature(ModelsState).prompters  # loaded once, kept
    told = [notice.text for notice in with_model.notices if "finds nothing" in notice.text]
    assert (titles(with_model) == ["Click an object", _ASKED]) != bool(told)


def test_the_user_chooses_whether_a_model_is_asked(with_model: Session) -> None:
    session, hand = _knowing(with_model, _two_balls), Hand(with_model)
    assert command("tool.click_model").is_on is not None
    assert [model.name for model in click_object.models_here(session)] == [_TINY]
    assert run("tool.click_model", session)
    assert click_object.chosen_model(session) is None
    hand.click_at(balls(session)[0][0])
    assert session.jobs.running is None
    click_object.choose_model(session, _TINY)  # asks about what is clicked already
    assert session.jobs.wait()
    assert titles(session) == ["Click an object", _ASKED]


def test_without_a_model_it_is_said_where_one_comes_from(
    looked: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh_models(tmp_path, monkeypatch)
    looked.feature(ModelsState).promptable = None
    assert click_object.chosen_model(looked) is None
    assert "Models in the menu Find" in command("tool.click_model").enabled(looked)
