"""Autosave and what comes back after a crash."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import run_stage
from gaga_core.scene.project import open_path_stage, save_project, saved_scene
from gaga_studio.features import autosave as autosave_actions
from gaga_studio.features import files, level_of_detail, objects, selection, transform
from gaga_studio.features.autosave import (
    FILE,
    Autosave,
    copy_history,
    left_over,
    offer,
    read_history,
    write_history,
)
from gaga_studio.features.find import memory_bank
from gaga_studio.session.session import Session
from tests.app.looks import finish, objects_of, scene_of, snapshot
from tests.scenes import random_gaussians


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def _edit_and_wait(session: Session) -> None:
    group = int(session.objects().ids[1])
    selection.select_groups(session, (group,))
    objects.delete(session)


def _place_of_save(session: Session) -> Path:
    """Save; where that is."""
    session.save()
    finish(session)
    place = session.need().project.path
    assert place is not None
    return place


def _saved(session: Session) -> Autosave:
    """Autosave once, as if the time had come."""
    autosave = Autosave(0.0)
    autosave.tick(session)
    autosave.wait()
    autosave.tick(session)
    return autosave


def _crash() -> None:
    """The program that wrote is no more: its process number belongs to one that has ended."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    for note in autosave_actions.root().glob("*/recovery.json"):
        content = json.loads(note.read_text())
        content["pid"] = ended.pid
        note.write_text(json.dumps(content))


def test_another_scene_is_autosaved_where_the_first_was(
    associated: Session, tmp_path: Path
) -> None:
    """What was written of the first while the second opened kept the second from being saved."""
    saver = Autosave(0.0)
    _edit_and_wait(associated)
    saver.tick(associated)
    saver.wait()
    write_ply(tmp_path / "b.ply", random_gaussians(30))
    associated.open(tmp_path / "b.ply")
    finish(associated)
    associated.answer("Discard")
    finish(associated)
    selection.select_all(associated)
    objects.delete(associated)
    for _ in range(3):
        saver.tick(associated)
        saver.wait()
    assert not [n for n in associated.notices if "kept safe" in n.text]
    (kept,) = autosave_actions.root().iterdir()
    assert len(run_stage(open_path_stage(kept)).scene) == 30


def test_without_edits_nothing_is_written(associated: Session) -> None:
    associated.save()
    finish(associated)
    autosave = _saved(associated)
    selection.select_all(associated)
    autosave.tick(associated)
    assert not autosave_actions.root().exists()


@pytest.mark.skipif(sys.platform != "linux", reason="others tell no more than the number")
@pytest.mark.parametrize("how", ["runs", "was killed", "is another"])
def test_a_program_that_was_killed_or_has_the_number_of_another_does_not_run(
    associated: Session, how: str
) -> None:
    """One started right after the kill was offered nothing, nor was one after a restart whose
    machine had given the number to another program."""
    _edit_and_wait(associated)
    _saved(associated)
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as program:
        (note,) = autosave_actions.root().glob("*/recovery.json")
        note.write_text(json.dumps(json.loads(note.read_text()) | {"pid": program.pid}))
        if how == "was killed":
            program.kill()
            os.waitid(os.P_PID, program.pid, os.WEXITED | os.WNOWAIT)  # nobody takes its end
        if how == "is another":
            os.utime(note, (time.time() - 3600,) * 2)
        assert len(left_over()[0]) == (how != "runs")
        program.kill()


def test_edits_of_a_crashed_program_come_back_unsaved(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    place = _place_of_save(associated)
    before = {p.name: p.read_bytes() for p in place.glob("*.json")}
    _edit_and_wait(associated)
    state = associated.need().scene.state.copy()
    _saved(associated)
    assert left_over()[0] == ()  # its program runs
    _crash()
    assert [r.name for r in left_over()[0]] == [associated.need().name]
    fresh = new_session()
    assert offer(fresh)
    assert fresh.pending_question is not None
    assert "Recover" in fresh.pending_question.choices
    fresh.answer("Recover")
    finish(fresh)
    deleted = np.uint8(8)
    assert np.array_equal(fresh.need().scene.state & deleted, state & deleted)
    assert fresh.unsaved
    assert fresh.need().project.path == place
    assert {p.name: p.read_bytes() for p in place.glob("*.json")} == before
    assert left_over()[0] == ()  # the second program has it now
    (copy,) = autosave_actions.root().iterdir()
    saver = Autosave(1000.0)
    saver.tick(fresh)
    assert copy.exists()
    fresh.save()
    finish(fresh)
    assert not fresh.unsaved
    saver.tick(fresh)
    saver.wait()
    assert not copy.exists()


def test_the_level_of_detail_of_a_crashed_program_is_used_again(
    associated: Session, new_session: Callable[[], Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(level_of_detail, "LARGE", 100)
    associated.save()
    finish(associated)
    level_of_detail.build(associated)
    finish(associated)
    _edit_and_wait(associated)
    _saved(associated)
    _crash()
    fresh = new_session()
    assert offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    assert level_of_detail.tree_of(fresh) is not None


def test_what_was_recovered_stays_until_it_is_written_again(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    _edit_and_wait(associated)
    _saved(associated)
    for _ in range(2):  # the program that recovered crashes too
        _crash()
        fresh = new_session()
        assert offer(fresh)
        fresh.answer("Recover")
        finish(fresh)
    (copy,) = autosave_actions.root().iterdir()
    saver = _saved(fresh)
    (again,) = autosave_actions.root().iterdir()
    assert again != copy
    _crash()
    assert len(left_over()[0]) == 1
    saver.finish()


def test_later_keeps_and_discard_removes(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    _edit_and_wait(associated)
    _saved(associated)
    _crash()
    fresh = new_session()
    offer(fresh)
    fresh.answer("Later")
    assert len(left_over()[0]) == 1
    offer(fresh)
    fresh.answer("Discard")
    assert left_over()[0] == ()
    assert not offer(fresh)


def test_saving_and_ending_in_order_leave_nothing(associated: Session) -> None:
    _edit_and_wait(associated)
    autosave = _saved(associated)
    assert list(autosave_actions.root().iterdir())
    associated.save()
    finish(associated)
    autosave.tick(associated)
    autosave.wait()
    assert list(autosave_actions.root().iterdir()) == []
    _edit_and_wait(associated)
    again = _saved(associated)
    again.finish()
    assert list(autosave_actions.root().iterdir()) == []


def test_the_same_state_is_written_once_and_a_drag_never(associated: Session) -> None:
    _edit_and_wait(associated)
    autosave = _saved(associated)
    note = next(autosave_actions.root().glob("*/recovery.json"))
    first = note.stat().st_mtime_ns
    autosave.tick(associated)
    autosave.wait()
    assert note.stat().st_mtime_ns == first
    group = int(associated.objects().ids[1])
    selection.select_groups(associated, (group,))
    transform.preview_move(associated, np.eye(3, 4) + np.array([[0, 0, 0, 1.0]] * 3))
    autosave.tick(associated)
    autosave.wait()
    assert note.stat().st_mtime_ns == first


def test_a_disk_that_says_no_is_a_notice(
    associated: Session, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where a folder must be")
    monkeypatch.setenv("GAGA_HOME", str(blocked))
    _edit_and_wait(associated)
    _saved(associated)
    assert "could not be kept safe" in associated.notices[-1].text


_DAMAGED = [
    "{",
    '{"pid": 1, "name": "a", "project": null, "saved_at": NaN}',
    '{"pid": 1, "name": "a", "project": null, "saved_at": 1e300}',
    '{"pid": 1000000000000000000, "name": "a", "project": null, "saved_at": 1}',
    '{"pid": 1, "name": "a", "project": "\\u0000", "saved_at": 1}',
    '{"pid": ' + "[" * 1_000_000,
]


@pytest.mark.parametrize("content", _DAMAGED, ids=range(len(_DAMAGED)))
def test_a_damaged_note_is_set_aside_and_told(
    new_session: Callable[[], Session], content: str
) -> None:
    folder = autosave_actions.root() / "1-x"
    folder.mkdir(parents=True)
    (folder / "recovery.json").write_text(content)
    session = new_session()
    assert not offer(session)
    assert str(folder) in session.notices[-1].text
    assert (folder / "recovery.json.damaged").read_text() == content
    assert not (folder / "recovery.json").exists()
    n = len(session.notices)
    assert not offer(session)
    assert len(session.notices) == n


def test_edits_after_the_highest_number_of_a_content_are_autosaved(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    _edit_and_wait(associated)
    _saved(associated)
    _crash()
    file = next(autosave_actions.root().glob(f"*/{FILE}"))
    with np.load(file) as npz:
        arrays = dict(npz)
    arrays["contents"][-1] = np.iinfo(np.int64).max
    np.savez(file, **arrays)
    fresh = new_session()
    offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    _edit_and_wait(fresh)
    _saved(fresh)
    assert [notice.text for notice in fresh.notices if "see the log" in notice.text] == []


def test_what_was_measured_of_the_objects_comes_back(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    _edit_and_wait(associated)
    assert memory_bank.measure_quality(associated)
    finish(associated)
    before, is_now = memory_bank.shown_quality(associated)
    assert is_now
    _saved(associated)
    _crash()
    fresh = new_session()
    assert offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    after, is_now = memory_bank.shown_quality(fresh)
    assert is_now
    assert after is not None
    assert before is not None
    assert dict(after.groups) == dict(before.groups)


def test_undo_and_redo_come_back(associated: Session, new_session: Callable[[], Session]) -> None:
    _edit_and_wait(associated)
    _edit_and_wait(associated)
    associated.undo()
    document = associated.need()
    entries, script = document.history.entries(), document.history.recorded()
    _saved(associated)
    states = []
    for cursor in range(len(entries) + 1):
        document.go_to(cursor)
        states.append(snapshot(document.scene))
    _crash()
    fresh = new_session()
    offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    again = fresh.need()
    assert again.history.entries() == entries
    assert again.history.recorded() == script
    for cursor in range(len(entries) + 1):
        again.go_to(cursor)
        assert snapshot(again.scene) == states[cursor]
    assert fresh.unsaved


def test_a_recovery_record_of_an_older_version_is_read(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    _edit_and_wait(associated)
    _saved(associated)
    next(autosave_actions.root().glob("*/history.npz")).unlink()
    _crash()
    fresh = new_session()
    offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    assert fresh.unsaved
    assert fresh.need().history.entries() == ()


def test_the_question_says_that_the_project_was_saved_since(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    place = _place_of_save(associated)
    _edit_and_wait(associated)
    _saved(associated)
    _crash()
    fresh = new_session()
    for later, says in ((-5.0, False), (5.0, True)):
        at = left_over()[0][0].saved_at + later
        os.utime(place / "project.json", (at, at))
        assert offer(fresh)
        assert fresh.pending_question is not None
        assert ("saved since then" in fresh.pending_question.text) == says
        fresh.answer("Later")


def test_a_model_that_was_gone_is_kept_with_what_is_saved_after_recovery(
    associated: Session, new_session: Callable[[], Session]
) -> None:
    """The autosave holds the only copy of the splats, and is removed after the save."""
    associated.save()
    finish(associated)
    _edit_and_wait(associated)
    associated.need().project.model_path.unlink()
    _saved(associated)
    state = associated.need().scene.state.copy()
    associated.shut_down()
    _crash()
    fresh = new_session()
    assert offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    fresh.save()
    finish(fresh)
    assert not fresh.unsaved
    saver = _saved(fresh)
    saver.finish()
    assert not list(autosave_actions.root().iterdir())
    place = fresh.need().project.path
    assert place is not None
    again = new_session()
    again.open(place)
    finish(again)
    assert np.array_equal(again.need().scene.state, state)


def _written(session: Session, folder: Path) -> str:
    """Save the project of a session and its history into a folder; the name of the scene file."""
    save_project(session.need().project, folder)
    write_history(folder, copy_history(session.need()), saved_scene(folder))
    return saved_scene(folder)


def _edit_at_random(session: Session) -> None:
    selection.select_groups(session, (objects_of(session)[0],))
    objects.delete(session)
    objects.rename(session, objects_of(session)[-1], "mug")
    session.undo()


def test_what_was_added_comes_back_without_its_file(
    associated: Session, new_session: Callable[[], Session], tmp_path: Path
) -> None:
    """All unsaved edits could not be recovered any more when a file that was added had moved."""
    more = tmp_path / "more.ply"
    write_ply(more, random_gaussians(30))
    _edit_and_wait(associated)
    files.add_splats(associated, more)
    finish(associated)
    before = snapshot(scene_of(associated))
    _saved(associated)
    _crash()
    more.unlink()
    fresh = new_session()
    assert offer(fresh)
    fresh.answer("Recover")
    finish(fresh)
    assert snapshot(scene_of(fresh)) == before
    fresh.save()
    finish(fresh)
    place = fresh.need().project.path
    assert place is not None
    saver = Autosave(0.0)
    saver.tick(fresh)
    saver.wait()
    assert not list(autosave_actions.root().iterdir())
    again = new_session()
    again.open(place)
    finish(again)
    assert snapshot(scene_of(again)) == before


def test_a_file_of_splats_that_is_gone_takes_only_its_entry_and_older_ones(
    associated: Session, tmp_path: Path
) -> None:
    more = tmp_path / "more.ply"
    write_ply(more, random_gaussians(30))
    _edit_at_random(associated)
    files.add_splats(associated, more)
    finish(associated)
    transform.move(associated, np.c_[np.eye(3), [1.0, 0, 0]])
    name = _written(associated, tmp_path / "kept")
    whole = read_history(tmp_path / "kept", name, scene_of(associated))
    assert whole is not None
    more.unlink()
    rest = read_history(tmp_path / "kept", name, scene_of(associated))
    assert rest is not None
    assert [edit.title for edit in rest.record.edits] == [whole.record.edits[-1].title]
    assert rest.record.cursor == 1
    assert len(rest.contents) == 2
    recorded = associated.need().history.recorded()
    assert [*rest.record.forgotten] == recorded[:-1]


@pytest.mark.parametrize("damage", ["bytes", "other scene", "other history", "none"])
def test_a_history_that_does_not_lead_to_the_scene_is_left_out(
    associated: Session, tmp_path: Path, damage: str
) -> None:
    _edit_at_random(associated)
    name, folder = _written(associated, tmp_path / "kept"), tmp_path / "kept"
    scene, before = scene_of(associated), snapshot(scene_of(associated))
    assert read_history(folder, name, scene) is not None
    assert snapshot(scene) == before
    if damage == "bytes":
        content = bytearray((folder / FILE).read_bytes())
        content[len(content) // 2] ^= 1
        (folder / FILE).write_bytes(content)
    elif damage == "other scene":
        name = "scene-000000000000.npz"
    elif damage == "other history":
        copied = copy_history(associated.need())
        associated.redo()  # the cursor is another one
        write_history(folder, copied, name)
    else:
        (folder / FILE).unlink()
    assert read_history(folder, name, scene_of(associated)) is None
