"""The tool Object: clicks become a selection, each one entry, and the selection an object."""

import pytest

from gaga_studio.features.commands import command, for_shortcut, run
from gaga_studio.features.find.click_object import ClickState
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.gestures import KeyState
from tests.app.features.clicking import BALL, balls, chosen_in_balls
from tests.app.tools.hand import H, Hand, W, titles


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
    assert "clicks are answered" in hand.controller.tool(session).hint(session)
    assert session.jobs.wait()
    assert titles(session) == ["Click an object"]


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


def test_what_cannot_be_clicked_is_told(looked: Session) -> None:
    session, hand = looked, Hand(looked)
    at = balls(session)[0][0]
    hand.click_at(at, KeyState(alt=True))
    assert "Click the object first" in session.hint
    hand.click(2, 2)
    assert "no surface" in session.hint
    assert titles(session) == []


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
