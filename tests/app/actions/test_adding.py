"""Other kinds of files in the window: opened, added to the scene, and exported after a question."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.splat_files import SplatFormat, read_splats, write_splats
from gaga_core.scene.export import listed_files, objects_losses
from gaga_core.scene.objects import group_indices
from gaga_studio.actions import cleanup, history, selection
from gaga_studio.actions import files as files_actions
from gaga_studio.session.session import Session
from tests.scenes import random_gaussians


def test_splats_of_another_file_come_as_one_undoable_edit(session: Session, tmp_path: Path) -> None:
    write_splats(tmp_path / "chair.spz", random_gaussians(50, sh_degree=1))
    scene = session.need().scene
    n, state = len(scene), session.need().history.state_id
    files_actions.add_splats(session, tmp_path / "chair.spz")
    assert session.jobs.wait()
    assert len(scene) == n + 50
    assert np.array_equal(session.selected_indices(), np.arange(n, n + 50))
    assert "chair" in {session.need().name_of(g) for g in session.selected_groups()}
    assert session.unsaved
    assert history.undo(session) == "Add chair.spz"
    assert len(scene) == n
    assert session.need().history.state_id == state


def test_groups_are_found_next_to_added_splats(session: Session, tmp_path: Path) -> None:
    write_splats(tmp_path / "chair.ply", random_gaussians(50))
    scene = session.need().scene
    n = len(scene)
    files_actions.add_splats(session, tmp_path / "chair.ply")
    assert session.jobs.wait()
    files_actions.associate(session)
    assert session.jobs.wait()
    assert (scene.labels[:n] > 0).any()
    group = int(scene.labels[-1])
    assert (scene.labels[n:] == group).all()
    assert group not in scene.labels[:n]
    assert session.need().name_of(group) == "chair"


def test_an_export_that_loses_asks_first(session: Session, tmp_path: Path) -> None:
    target = tmp_path / "out.splat"

    def export(path: Path) -> None:
        files_actions.when_agreed(
            session, "scene", path, lambda: files_actions.export(session, "scene", path)
        )

    export(target)
    question = session.pending_question
    assert question is not None
    assert "does not keep everything" in question.text
    session.pending_question = None
    question.on_choice("Cancel")
    assert session.jobs.running is None
    question.on_choice("Export")
    assert session.jobs.wait()
    assert len(read_splats(target)) == int(session.need().scene.visible.sum())
    export(tmp_path / "out.ply")  # keeps all: no question
    assert session.pending_question is None
    assert session.jobs.wait()
    assert (tmp_path / "out.ply").is_file()
    export(tmp_path / "out.xyz")
    assert "choose a name" in session.notices[-1].text


@pytest.mark.parametrize("form", [SplatFormat.COMPRESSED_PLY, SplatFormat.SPLAT, SplatFormat.SPZ])
def test_objects_are_written_in_any_form_after_the_same_question(
    associated: Session, tmp_path: Path, form: SplatFormat
) -> None:
    chosen = [int(group) for group in associated.objects().ids if group > 0][:2]
    for group in chosen:
        selection.select_groups(associated, (group,), "add")
    scene = associated.need().scene
    sh = scene.gaussians.sh.copy()
    sh[group_indices(scene, chosen[0]), 0] = 9.0  # more than the small forms hold
    scene.gaussians = replace(scene.gaussians, sh=sh)

    def write() -> None:
        cleanup.export(associated, "objects", tmp_path, form=form)

    files_actions.when_agreed(associated, "objects", tmp_path, write, form)
    question = associated.pending_question
    assert question is not None
    lost = objects_losses(scene, form, chosen)
    assert question.text == f"Files that end in {form.suffix} do not keep everything. " + " ".join(
        lost
    )
    associated.answer("Export")
    assert associated.jobs.wait()
    files = listed_files(tmp_path / "groups.json")
    assert [file.name.endswith(form.suffix) for file in files] == [True, True]
    counts = [len(group_indices(scene, group)) for group in chosen]
    assert [len(read_splats(file)) for file in files] == counts
    assert "2 files" in associated.notices[-1].text
    assert associated.has_exported
    files_actions.when_agreed(associated, "objects", tmp_path, write, SplatFormat.PLY)
    assert associated.pending_question is None


def test_a_broken_file_leaves_what_is_open(session: Session, tmp_path: Path) -> None:
    write_splats(tmp_path / "a.spz", random_gaussians(50), SplatFormat.SPZ)
    whole = (tmp_path / "a.spz").read_bytes()
    (tmp_path / "a.spz").write_bytes(whole[: len(whole) // 2])
    document = session.document
    n = len(session.need().scene)
    files_actions.add_splats(session, tmp_path / "a.spz")
    session.jobs.wait()
    session.open(tmp_path / "a.spz")
    session.jobs.wait()
    assert session.document is document
    assert len(session.need().scene) == n
    assert "truncated" in session.notices[-1].text
