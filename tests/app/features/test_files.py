"""Other kinds of files in the window: opened, added to the scene, and exported."""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gaga_core.export.export import MeshExport, MeshForm, objects_losses
from gaga_core.export.options import ExportOptions
from gaga_core.export.solids import MeshConfig
from gaga_core.io.splats.splat_files import SplatFormat, read_splats, write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.export_manifest import listed_files
from gaga_core.scene.objects import group_indices
from gaga_core.scene.orientation import degrees_of
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import camera, export, selection
from gaga_studio.features import files as files_actions
from gaga_studio.features.export import ExportPlan
from gaga_studio.features.find import association
from gaga_studio.session.session import Session
from tests.pages import page_data
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
    assert session.undo() == "Add chair.spz"
    assert len(scene) == n
    assert session.need().history.state_id == state


def test_a_folder_of_sog_is_called_by_its_name(session: Session, tmp_path: Path) -> None:
    write_splats(tmp_path / "bowl.sog", random_gaussians(50))
    with ZipFile(tmp_path / "bowl.sog") as archive:
        archive.extractall(tmp_path / "bowl v1.2")
    files_actions.add_splats(session, tmp_path / "bowl v1.2" / "meta.json")
    assert session.jobs.wait()
    assert {session.need().name_of(g) for g in session.selected_groups()} == {"bowl v1.2"}
    assert session.undo() == "Add bowl v1.2"


@pytest.mark.parametrize("end", ["broken", "cancelled"])
def test_files_dropped_with_one_that_did_not_open_are_not_added_to_the_next(
    new_session: Callable[[], Session], tmp_path: Path, end: str
) -> None:
    for name in ("chair.ply", "table.ply", "room.ply"):
        write_splats(tmp_path / name, random_gaussians(50))
    if end == "broken":
        (tmp_path / "chair.ply").write_bytes(b"ply\nnothing")
    session = new_session()
    files_actions.drop(session, [tmp_path / "chair.ply", tmp_path / "table.ply"])
    if end == "cancelled":
        session.jobs.cancel()
    session.jobs.wait()
    session.jobs.wait()
    assert session.document is None
    session.open(tmp_path / "room.ply")
    for _ in range(3):
        session.jobs.wait()
    assert len(session.need().scene) == 50
    if end == "broken":
        session.close()
        files_actions.drop(session, [tmp_path / "room.ply", tmp_path / "table.ply"])
        for _ in range(3):
            session.jobs.wait()
        assert len(session.need().scene) == 100


def test_groups_are_found_next_to_added_splats(session: Session, tmp_path: Path) -> None:
    write_splats(tmp_path / "chair.ply", random_gaussians(50))
    scene = session.need().scene
    n = len(scene)
    files_actions.add_splats(session, tmp_path / "chair.ply")
    assert session.jobs.wait()
    association.associate(session)
    assert session.jobs.wait()
    assert (scene.labels[:n] > 0).any()
    group = int(scene.labels[-1])
    assert (scene.labels[n:] == group).all()
    assert group not in scene.labels[:n]
    assert session.need().name_of(group) == "chair"


@pytest.mark.parametrize("form", [SplatFormat.GLB, SplatFormat.USD, SplatFormat.PLY])
def test_what_was_exported_comes_back_to_its_place(
    session: Session, tmp_path: Path, form: SplatFormat
) -> None:
    """Up is y in a .glb: added to the scene that it is of, it lay on its side under the floor."""
    document = session.need()
    scene, n = document.scene, len(document.scene)
    plan = ExportPlan(tmp_path / f"out.{form.value}", form=form)
    assert export.start(session, plan)
    assert session.jobs.wait()
    files_actions.add_splats(session, plan.path)
    assert session.jobs.wait()
    rows = np.arange(2 * n, dtype=np.int32)
    added, where = rows[n:], world_means(scene, rows[:n])
    assert np.max(cKDTree(where).query(world_means(scene, added))[0]) < 1e-3
    pose = document.selected_pose()
    assert pose is not None
    np.testing.assert_allclose(degrees_of(pose, local=False), 0, atol=1e-4)
    moved = np.eye(4)[:3]
    moved[:, 3] = 1.0
    document.do(edits.transform(scene, added, moved))
    document.do(edits.reset_placement(scene, added, "Reset"))
    assert np.max(cKDTree(where).query(world_means(scene, added))[0]) < 1e-3
    for _ in range(3):
        document.undo()
    assert len(scene) == n


def test_an_export_says_before_what_it_loses(session: Session, tmp_path: Path) -> None:
    plan = ExportPlan(tmp_path / "new" / "out.splat", form=SplatFormat.SPLAT)
    told = export.summary(session, plan)
    assert told.n_splats == int(session.need().scene.visible.sum())
    assert "rounded" in " ".join(told.lost)
    assert not plan.path.parent.exists(), "nothing is written before it is wanted"
    assert export.start(session, plan)
    assert session.jobs.wait()
    assert len(read_splats(plan.path)) == told.n_splats
    assert session.notices[-1].shows == plan.path
    assert not export.summary(session, ExportPlan(tmp_path / "out.ply")).lost
    inside = replace(plan, options=ExportOptions(crop=((-1, -1, -1), (0, 1, 1)), scale=3.0))
    assert 0 < export.summary(session, inside).n_splats < told.n_splats
    session.need().do(edits.hide(session.need().scene, np.arange(7, dtype=np.int32)))
    hidden = export.summary(session, ExportPlan(tmp_path / "out.ply")).lost
    assert hidden == ("7 splats are hidden, and not exported.",)


def test_an_export_of_a_scene_says_that_its_objects_are_not_in_the_file(
    associated: Session, tmp_path: Path
) -> None:
    """True of every form but the web page, which lists them; exported objects are objects."""
    for form in SplatFormat:
        told = export.summary(associated, ExportPlan(tmp_path / "out", form=form)).lost
        assert ("Objects and their names" in " ".join(told)) == (form is not SplatFormat.HTML)
    objects = ExportPlan(tmp_path / "objects", "objects", SplatFormat.PLY)
    assert not export.summary(associated, objects).lost
    plan = ExportPlan(tmp_path / "out.ply")
    assert export.start(associated, plan)
    assert associated.jobs.wait()
    assert not run_stage(open_path_stage(plan.path)).scene.labels.any()


def test_an_export_into_what_is_no_folder_is_told(session: Session, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    assert not export.start(session, ExportPlan(tmp_path / "taken" / "out.ply"))
    assert str(tmp_path / "taken") in session.notices[-1].text
    assert session.jobs.running is None


def test_exports_of_our_own_scene_go_where_they_are_found(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of the demo, which lies in a hidden folder; others stay with their scene."""
    assert session.project is not None
    assert session.project.folder is not None
    root = session.project.folder.root
    assert export.proposed(session, "scene", SplatFormat.SPZ).parent == root
    monkeypatch.delenv("GAGA_HOME")
    monkeypatch.setenv("XDG_DATA_HOME", str(root.parent / ".local"))
    hidden = root.parent / ".local" / "gaga-studio" / "demo"
    session.project.folder = replace(session.project.folder, root=hidden)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    assert export.folder(session) == tmp_path / "gaga-studio"
    (tmp_path / "Papers").mkdir()
    (tmp_path / "config").mkdir()
    named = 'XDG_DOCUMENTS_DIR="$HOME/Papers"\n'
    (tmp_path / "config" / "user-dirs.dirs").write_text(named)
    assert export.folder(session) == tmp_path / "Papers" / "gaga-studio"


def test_what_was_written_is_shown_in_its_folder(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if sys.platform != "linux":
        pytest.skip("xdg-open is of Linux")
    opened, program = tmp_path / "opened", tmp_path / "bin" / "xdg-open"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "$1" > {opened}\n')
    monkeypatch.setenv("PATH", str(program.parent))
    written = tmp_path / "out.ply"
    assert not export.show_in_folder(session, written), "not executable yet"
    assert str(tmp_path) in session.notices[-1].text
    program.chmod(0o755)
    assert export.show_in_folder(session, written)
    end = time.monotonic() + 10
    while not (opened.exists() and opened.read_text()) and time.monotonic() < end:
        time.sleep(0.01)
    assert opened.read_text().strip() == str(tmp_path)


@pytest.mark.parametrize("form", [SplatFormat.COMPRESSED_PLY, SplatFormat.SPLAT, SplatFormat.SPZ])
def test_objects_are_written_in_any_form(
    associated: Session, tmp_path: Path, form: SplatFormat
) -> None:
    chosen = [int(group) for group in associated.objects().ids if group > 0][:2]
    for group in chosen:
        selection.select_groups(associated, (group,), "add")
    scene = associated.need().scene
    sh = scene.gaussians.sh.copy()
    sh[group_indices(scene, chosen[0]), 0] = 9.0  # more than the small forms hold
    scene.gaussians = replace(scene.gaussians, sh=sh)

    plan = ExportPlan(tmp_path, "objects", form)
    told = export.summary(associated, plan)
    assert told.lost == objects_losses(scene, form, chosen)
    assert told.n_files == 2
    assert export.start(associated, plan)
    assert associated.jobs.wait()
    files = listed_files(tmp_path / "groups.json")
    assert [file.name.endswith(form.suffix) for file in files] == [True, True]
    counts = [len(group_indices(scene, group)) for group in chosen]
    assert [len(read_splats(file)) for file in files] == counts
    assert "2 files" in associated.notices[-1].text
    assert associated.has_exported


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


def test_a_page_begins_with_the_present_view(associated: Session, tmp_path: Path) -> None:
    """With the bookmarks of the project, the names of the list, and the size that was told."""
    selection.select_groups(associated, (1,))
    associated.rig.orbit(70, 20)
    camera.add_bookmark(associated, "from here", 3)
    associated.rig.orbit(-40, 5)
    plan = ExportPlan(tmp_path / "page.html", form=SplatFormat.HTML)
    told = export.summary(associated, plan)
    assert export.start(associated, plan)
    assert associated.jobs.wait()
    page, _ = page_data(plan.path)
    assert page["start"][:3] == pytest.approx(associated.rig.shot().eye, rel=1e-5)
    assert [mark["name"] for mark in page["bookmarks"]] == ["from here"]
    listed = {int(g) for g in associated.objects().ids}
    assert {item["id"] for item in page["objects"]} == {0, *listed}
    names = {item["id"]: item["name"] for item in page["objects"]}
    assert all(names[g] == associated.need().name_of(g) for g in listed)
    assert page["splats"]["count"] == told.n_splats
    assert 0.6 < told.n_bytes / plan.path.stat().st_size < 1.5


@pytest.mark.parametrize("form", MeshForm)
def test_files_of_solids_are_as_large_as_was_told(
    associated: Session, tmp_path: Path, form: MeshForm
) -> None:
    """A mesh that has few triangles by itself is smaller than its limit, which was told as its
    size."""
    solid = MeshExport(form, config=MeshConfig(voxels=24, triangles=2000))
    plan = ExportPlan(tmp_path / "solids", what="objects", form=solid)
    told = export.summary(associated, plan)
    assert export.start(associated, plan)
    assert associated.jobs.wait()
    written = sum(path.stat().st_size for path in (tmp_path / "solids").glob(f"*{solid.suffix}"))
    assert told.is_most == (form is MeshForm.MESH)
    assert written <= (1 if told.is_most else 1.2) * told.n_bytes
    if not told.is_most:
        assert written > 0.8 * told.n_bytes
