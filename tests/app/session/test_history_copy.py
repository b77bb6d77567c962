"""What undo and redo need comes back after a crash, or is left out whole."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.project import save_project
from gaga_core.scene.project_file import saved_scene
from gaga_studio.features import files, objects, selection, transform
from gaga_studio.features.autosave import FILE, copy_history, read_history, write_history
from gaga_studio.session.session import Session
from tests.app.looks import finish, objects_of, scene_of, snapshot
from tests.scenes import random_gaussians


def _written(session: Session, folder: Path) -> str:
    """Save the project of a session and its history into a folder; the name of the scene file."""
    save_project(session.need().project, folder)
    write_history(folder, copy_history(session.need()), saved_scene(folder))
    return saved_scene(folder)


def _edit(session: Session) -> None:
    selection.select_groups(session, (objects_of(session)[0],))
    objects.delete(session)
    objects.rename(session, objects_of(session)[-1], "mug")
    session.undo()


def test_a_file_of_splats_that_is_gone_takes_only_its_entry_and_older_ones(
    associated: Session, tmp_path: Path
) -> None:
    more = tmp_path / "more.ply"
    write_ply(more, random_gaussians(30))
    _edit(associated)
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
    _edit(associated)
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
