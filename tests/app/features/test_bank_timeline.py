"""The replay of the bank as a person drives it: it shows, follows, ends, and changes nothing."""

import numpy as np

from gaga_studio.features import objects, selection
from gaga_studio.features.commands import command, run
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.memory_bank import Timeline
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode


def _opened(session: Session) -> Session:
    assert run("view.timeline", session)
    assert session.jobs.wait()
    assert session.document is not None
    assert session.document.feature(Timeline).is_open, session.notices
    return session


def test_a_replay_goes_from_nothing_to_the_saved_groups(associated: Session) -> None:
    before = associated.scene.labels.copy()  # type: ignore[union-attr]
    session = _opened(associated)
    timeline, cursor = memory_bank.timeline_of(session), session.history.cursor  # type: ignore[union-attr]
    growth = timeline.growth
    assert growth is not None
    assert timeline.is_playing
    assert session.view.mode is Mode.GROUPS
    seen = []
    while timeline.is_playing:
        shown = memory_bank.timeline_labels(session)
        seen.append(0 if shown is None else int((shown > 0).sum()))
        assert shown is None or shown is memory_bank.timeline_labels(
            session
        )  # sent to the card once
        view = memory_bank.view_of_step(session)
        if view:
            assert session.cameras[session.active_view].name == view  # type: ignore[index]
            bank = memory_bank.bank_at(session)
            assert bank is not None
            assert bank.log[-1].view == view
        memory_bank.tick_timeline(session, 10.0)
    assert seen[0] == 0
    assert seen[: growth.last_step] == sorted(seen[: growth.last_step])
    assert timeline.step == growth.last_step
    assert memory_bank.timeline_labels(session) is None  # the scene's own
    assert np.array_equal(growth.labels_at(timeline.step), before)
    memory_bank.close_timeline(session)
    assert session.view.mode is Mode.COLOR
    assert session.history.cursor == cursor
    assert not session.unsaved
    assert np.array_equal(session.scene.labels, before)


def test_a_camera_that_does_not_follow_stays(associated: Session) -> None:
    session = _opened(associated)
    memory_bank.set_follows(session, False)
    session.active_view = None
    memory_bank.go_to_step(session, 3)
    assert session.active_view is None
    memory_bank.go_to_step(session, 999)
    assert memory_bank.timeline_of(session).step == 8
    memory_bank.toggle_timeline_playing(session)
    memory_bank.toggle_timeline_playing(session)
    assert memory_bank.timeline_of(session).step == 0  # from the start again
    memory_bank.set_follows(session, True)
    memory_bank.go_to_step(session, 1)
    assert session.active_view is not None


def test_a_replay_ends_with_its_bank_and_survives_copies(associated: Session) -> None:
    session = _opened(associated)
    memory_bank.go_to_step(session, 4)
    selection.select_groups(session, (3,))
    assert run("edit.duplicate", session)
    shown = memory_bank.timeline_labels(session)
    assert shown is not None
    assert len(shown) == len(session.scene)  # type: ignore[arg-type]
    bank = session.scene.bank  # type: ignore[union-attr]
    assert objects.rename(session, 2, "mug")
    memory_bank.tick_timeline(session, 0.0)
    assert memory_bank.timeline_of(session).is_open
    session.scene.bank = None  # type: ignore[union-attr]  # as an undone association does
    memory_bank.tick_timeline(session, 0.0)
    assert not memory_bank.timeline_of(session).is_open
    assert "Find objects" in command("view.timeline").enabled(session)
    session.scene.bank = bank  # type: ignore[union-attr]
    assert run("view.timeline", session)  # at once: the growth is known
    assert memory_bank.timeline_of(session).is_open


def test_a_replay_ends_with_its_scene(associated: Session) -> None:
    session = _opened(associated)
    session.take(session.need().project)
    assert not memory_bank.timeline_of(session).is_open
    assert session.view.mode is Mode.COLOR
