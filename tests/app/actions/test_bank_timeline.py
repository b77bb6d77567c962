"""The replay of the bank as a person drives it: it shows, follows, ends, and changes nothing."""

import numpy as np

from gaga_studio.actions import bank_timeline, objects, selection
from gaga_studio.commands import command, run
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Mode


def _opened(session: Session) -> Session:
    assert run("view.timeline", session)
    assert session.jobs.wait()
    assert session.document is not None
    assert session.document.timeline.is_open, session.notices
    return session


def test_a_replay_goes_from_nothing_to_the_saved_groups(associated: Session) -> None:
    before = associated.scene.labels.copy()  # type: ignore[union-attr]
    session = _opened(associated)
    timeline, cursor = bank_timeline.timeline_of(session), session.history.cursor  # type: ignore[union-attr]
    growth = timeline.growth
    assert growth is not None
    assert timeline.is_playing
    assert session.view.mode is Mode.GROUPS
    seen = []
    while timeline.is_playing:
        shown = bank_timeline.labels(session)
        seen.append(0 if shown is None else int((shown > 0).sum()))
        assert shown is None or shown is bank_timeline.labels(session)  # sent to the card once
        view = bank_timeline.view_of_step(session)
        if view:
            assert session.cameras[session.active_view].name == view  # type: ignore[index]
            bank = bank_timeline.bank_at(session)
            assert bank is not None
            assert bank.log[-1].view == view
        bank_timeline.tick(session, 10.0)
    assert seen[0] == 0
    assert seen[: growth.last_step] == sorted(seen[: growth.last_step])
    assert timeline.step == growth.last_step
    assert bank_timeline.labels(session) is None  # the scene's own
    assert np.array_equal(growth.labels_at(timeline.step), before)
    bank_timeline.close(session)
    assert session.view.mode is Mode.COLOR
    assert session.history.cursor == cursor
    assert not session.unsaved
    assert np.array_equal(session.scene.labels, before)


def test_a_camera_that_does_not_follow_stays(associated: Session) -> None:
    session = _opened(associated)
    bank_timeline.set_follows(session, False)
    session.active_view = None
    bank_timeline.go_to_step(session, 3)
    assert session.active_view is None
    bank_timeline.go_to_step(session, 999)
    assert bank_timeline.timeline_of(session).step == 8
    bank_timeline.toggle_playing(session)
    bank_timeline.toggle_playing(session)
    assert bank_timeline.timeline_of(session).step == 0  # from the start again
    bank_timeline.set_follows(session, True)
    bank_timeline.go_to_step(session, 1)
    assert session.active_view is not None


def test_a_replay_ends_with_its_bank_and_survives_copies(associated: Session) -> None:
    session = _opened(associated)
    bank_timeline.go_to_step(session, 4)
    selection.select_groups(session, (3,))
    assert run("edit.duplicate", session)
    shown = bank_timeline.labels(session)
    assert shown is not None
    assert len(shown) == len(session.scene)  # type: ignore[arg-type]
    bank = session.scene.bank  # type: ignore[union-attr]
    assert objects.rename(session, 2, "mug")
    bank_timeline.tick(session, 0.0)
    assert bank_timeline.timeline_of(session).is_open
    session.scene.bank = None  # type: ignore[union-attr]  # as an undone association does
    bank_timeline.tick(session, 0.0)
    assert not bank_timeline.timeline_of(session).is_open
    assert "Find objects" in command("view.timeline").enabled(session)
    session.scene.bank = bank  # type: ignore[union-attr]
    assert run("view.timeline", session)  # at once: the growth is known
    assert bank_timeline.timeline_of(session).is_open


def test_a_replay_ends_with_its_scene(associated: Session) -> None:
    session = _opened(associated)
    session.take(session.need().project)
    assert not bank_timeline.timeline_of(session).is_open
    assert session.view.mode is Mode.COLOR
