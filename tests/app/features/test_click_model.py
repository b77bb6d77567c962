"""Clicks that ask a model in the background: its answer comes after the one without it."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import click_object
from gaga_studio.features.find.click_object import ClickState
from gaga_studio.features.find.masks import ModelsState
from gaga_studio.session.session import Session
from gaga_studio.tools.gestures import KeyState
from tests.app.features.clicking import balls, chosen_in_balls
from tests.app.tools.hand import Hand, titles
from tests.color_oracle import Answer, ColorOracle, clicked_things
from tests.core.models.hub_server import fresh_models
from tests.scenes import objects_scene

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
    assert "The model looks" in hand.controller.tool(session).hint(session)
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
    assert "Models…" in command("tool.click_model").enabled(looked)
