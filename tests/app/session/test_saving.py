"""Saving when files are no longer as they were, and two windows on one project."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.io.splats.splat_files import model_fingerprint
from gaga_core.pipeline.film import FilmConfig
from gaga_core.progress import run_stage
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.tree import write_streamed_sog_stage
from gaga_core.scene.project import open_path_stage, reopen_stage, save_project
from gaga_core.scene.selection import algebra
from gaga_studio.features import camera, export, files, objects
from gaga_studio.features.commands import new_session
from gaga_studio.session.notices import Request
from gaga_studio.session.session import COPY, ELSEWHERE, RELOAD, Session
from tests.app.looks import finish, objects_of, scene_of, snapshot
from tests.gltf_files import write_gltf
from tests.scenes import random_gaussians


def _root(session: Session) -> Path:
    folder = session.need().project.folder
    assert folder is not None
    return folder.root


def _change_model(session: Session) -> None:
    """Another program leaves out every second splat."""
    path = session.need().project.model_path
    splats = read_ply(path)
    write_ply(path, splats.take(algebra.everything(scene_of(session))[::2]))


def _asked(session: Session) -> str:
    assert session.jobs.wait()
    assert session.pending_question is not None
    return session.pending_question.text


def test_a_changed_model_is_noticed_and_saved_as_a_copy(associated: Session) -> None:
    objects.rename(associated, objects_of(associated)[0], "mug")
    _change_model(associated)
    associated.save()
    assert "changed by another program" in _asked(associated)
    assert associated.unsaved
    associated.answer("Cancel")
    assert associated.unsaved
    associated.save()
    _asked(associated)
    associated.answer(COPY)
    finish(associated)
    assert not associated.unsaved
    again = run_stage(open_path_stage(_root(associated))).scene
    assert snapshot(again) == snapshot(scene_of(associated))
    objects.rename(associated, objects_of(associated)[0], "jug")
    associated.save()  # asks no more
    finish(associated)
    assert not associated.unsaved


def test_a_changed_model_saved_elsewhere_takes_its_copy_along(
    associated: Session, tmp_path: Path
) -> None:
    objects.rename(associated, objects_of(associated)[0], "mug")
    _change_model(associated)
    associated.save()
    _asked(associated)
    associated.answer(ELSEWHERE)
    assert associated.take_request() is Request.SAVE_AS
    associated.save(tmp_path / "else.gaga")
    finish(associated)
    again = run_stage(open_path_stage(tmp_path / "else.gaga")).scene
    assert snapshot(again) == snapshot(scene_of(associated))


def test_the_focus_notices_a_change_once_and_reload_opens_it(associated: Session) -> None:
    n = len(scene_of(associated))
    assert not associated.look_at_files()
    path = associated.need().project.model_path
    path.touch()  # another time, the same content
    assert not associated.look_at_files()
    _change_model(associated)
    (_root(associated) / "gaga" / "labels.npz").unlink(missing_ok=True)
    assert associated.look_at_files()
    associated.answer("Cancel")
    assert not associated.look_at_files()
    path.unlink()
    assert associated.look_at_files()
    associated.answer(RELOAD)
    assert associated.jobs.wait()
    assert len(scene_of(associated)) == n  # it is gone: what is open stays


def test_a_save_that_fits_no_file_any_more_is_unsaved(associated: Session) -> None:
    """The program ended without a question, with the last copy of the splats."""
    associated.save()
    finish(associated)
    assert not associated.unsaved
    _change_model(associated)
    assert associated.look_at_files()
    associated.answer("Cancel")
    assert associated.unsaved
    associated.quit()
    assert not associated.should_quit
    associated.answer("Save")
    _asked(associated)
    associated.answer(COPY)
    finish(associated)
    assert associated.should_quit
    again = run_stage(open_path_stage(_root(associated))).scene
    assert snapshot(again) == snapshot(scene_of(associated))


def test_reload_shows_the_changed_model_and_keeps_the_former_save(associated: Session) -> None:
    n, where = len(scene_of(associated)), _root(associated) / "gaga" / "project.json"
    before = where.read_bytes()
    _change_model(associated)
    assert associated.look_at_files()
    associated.answer(RELOAD)
    finish(associated)
    assert len(scene_of(associated)) == (n + 1) // 2
    associated.save()
    assert "Another program saved" in _asked(associated)
    associated.answer("Cancel")
    assert where.read_bytes() == before
    associated.save()
    _asked(associated)
    associated.answer("Overwrite")
    finish(associated)
    assert len(run_stage(open_path_stage(where)).scene) == (n + 1) // 2


def test_reload_brings_back_what_was_saved_where_it_fits(
    associated: Session, tmp_path: Path
) -> None:
    """The bare file of splats opened in its place."""
    more = tmp_path / "more.ply"
    write_ply(more, random_gaussians(30))
    objects.rename(associated, objects_of(associated)[0], "mug")
    associated.save(tmp_path / "one.gaga")
    finish(associated)
    before = snapshot(scene_of(associated))
    files.add_splats(associated, more)
    finish(associated)
    more.unlink()
    associated.save()
    assert _asked(associated).endswith("Reloading loses the unsaved edits.")
    associated.answer(RELOAD)
    finish(associated)
    assert snapshot(scene_of(associated)) == before
    assert associated.need().project.path == tmp_path / "one.gaga"
    _change_model(associated)
    objects.rename(associated, objects_of(associated)[0], "jug")
    associated.save()
    assert "Reloading loses all edits" in _asked(associated)
    associated.answer(COPY)  # from now on it fits the copy
    finish(associated)
    before = snapshot(scene_of(associated))
    associated.need().project.model_path.unlink()
    assert snapshot(run_stage(reopen_stage(associated.need().project)).scene) == before


def test_another_saved_project_is_asked_about(associated: Session, tmp_path: Path) -> None:
    """Save project as… into its folder deleted its files without a word."""
    write_ply(tmp_path / "b.ply", random_gaussians(9))
    other = save_project(run_stage(open_path_stage(tmp_path / "b.ply")), tmp_path / "b.gaga")
    before = {file: file.read_bytes() for file in other.glob("*.*")}
    associated.save(other)
    assert "Another project" in _asked(associated)
    associated.answer("Cancel")
    assert {file: file.read_bytes() for file in other.glob("*.*")} == before
    associated.save(other)
    _asked(associated)
    associated.answer("Overwrite")
    finish(associated)
    assert associated.need().project.path == other
    assert len(run_stage(open_path_stage(other)).scene) == len(scene_of(associated))
    associated.save(tmp_path)
    assert associated.jobs.wait()
    assert associated.pending_question is None
    assert "other files" in associated.notices[-1].text
    assert not (tmp_path / "project.json").exists()


def test_no_file_of_a_scene_or_project_is_written_over(associated: Session, tmp_path: Path) -> None:
    """After "exists already" a script took the place of a project, a picture that of a photo."""
    write_ply(tmp_path / "b.ply", random_gaussians(9))
    other = save_project(run_stage(open_path_stage(tmp_path / "b.ply")))
    root = _root(associated)
    (root / "split.json").write_text("{}")
    photo = next((root / "images").iterdir())
    for path in (other / "project.json", root / "split.json", photo, root / "point_cloud.ply"):
        before = path.read_bytes()
        assert not files.save_script(associated, path)
        export.save_picture(associated, path.with_suffix(".png"), (64, 48))
        export.export_film(associated, path, FilmConfig())
        camera.save_path_file(associated, path)
        assert associated.jobs.wait()
        assert path.read_bytes() == before
    assert files.save_script(associated, root / "script.json")


@pytest.fixture
def other_window(grouped_scene: Path, scene_folder: Path) -> Iterator[tuple[Path, int]]:
    """Another program that has a scene open: its folder, and the number of its process."""
    shutil.rmtree(scene_folder)
    shutil.copytree(grouped_scene, scene_folder)
    command = [sys.executable, "-m", "tests.core.scene.two_writers", "hold"]
    holder = subprocess.Popen(
        [*command, str(scene_folder / "gaga"), "0"], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    yield scene_folder, holder.pid
    holder.kill()
    holder.communicate()


def test_the_second_window_is_read_only_and_says_who_has_it(
    other_window: tuple[Path, int], new_session: Callable[[], Session], tmp_path: Path
) -> None:
    folder, pid = other_window
    before = (folder / "gaga" / "project.json").read_bytes()
    session = new_session()
    session.open(folder)
    finish(session)
    assert f"process {pid}" in session.notices[-1].text
    assert session.title.endswith("(read-only)")
    objects.rename(session, objects_of(session)[0], "mug")
    session.save(tmp_path / "else.gaga")
    finish(session)
    assert not session.unsaved
    assert not session.title.endswith("(read-only)")
    assert (folder / "gaga" / "project.json").read_bytes() == before


def test_the_project_is_free_when_the_other_program_is_killed(
    other_window: tuple[Path, int],
    new_session: Callable[[], Session],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, pid = other_window
    monkeypatch.setattr("gaga_core.scene.project._PATIENCE_S", 0.2)
    session = new_session()
    session.open(folder)
    finish(session)
    objects.rename(session, objects_of(session)[0], "mug")
    session.save()
    assert f"process {pid}" in _asked(session)
    assert session.unsaved
    os.kill(pid, signal.SIGKILL)
    session.answer("Try again")
    for _ in range(100):  # the kernel takes a moment to end it
        assert session.jobs.wait()
        if not session.unsaved:
            break
        session.answer("Try again")
    assert not session.unsaved
    assert session.title == folder.name


def test_the_buffer_of_a_gltf_is_a_part_of_the_model(tmp_path: Path) -> None:
    """Noticed when it changes or goes, refused in a saved project, and reloaded."""
    path = write_gltf(tmp_path / "a.gltf", random_gaussians(40))
    session = new_session()
    session.open(path)
    finish(session)
    session.save(tmp_path / "kept.gaga")
    finish(session)
    assert not session.look_at_files()
    path.touch()
    assert not session.look_at_files()
    buffer = path.with_suffix(".bin")
    content = buffer.read_bytes()
    buffer.write_bytes(content[:5] + bytes([content[5] ^ 1]) + content[6:])
    assert session.look_at_files()
    session.answer("Cancel")
    with pytest.raises(GagaError, match="changed since"):
        run_stage(open_path_stage(tmp_path / "kept.gaga"))
    buffer.unlink()
    assert session.look_at_files()
    session.answer("Cancel")
    buffer.write_bytes(content)
    assert not session.look_at_files()
    session.close()
    document = tmp_path / "kept.gaga" / "project.json"
    older = document.read_text(encoding="utf-8").replace(model_fingerprint(path), fingerprint(path))
    document.write_text(older, encoding="utf-8")
    assert len(run_stage(open_path_stage(tmp_path / "kept.gaga")).scene) == 40


def test_chunks_of_a_streamed_sog_are_parts_of_the_model(tmp_path: Path) -> None:
    """Noticed when a picture of a chunk changes or goes, and refused in a saved project."""
    splats = random_gaussians(3000)
    tree = run_stage(build_lod_stage(splats, tmp_path / "lod", "digest"))
    (tmp_path / "web").mkdir()
    path = run_stage(write_streamed_sog_stage(tmp_path / "web", tree, splats))
    session = new_session()
    session.open(path)
    finish(session)
    session.save(tmp_path / "kept.gaga")
    finish(session)
    path.touch()
    assert not session.look_at_files()
    picture = min(path.parent.glob("*/*.webp"))
    content = picture.read_bytes()
    picture.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert session.look_at_files()
    session.answer("Cancel")
    with pytest.raises(GagaError, match="changed since"):
        run_stage(open_path_stage(tmp_path / "kept.gaga"))
    picture.unlink()
    assert session.look_at_files()
    session.answer("Cancel")
    picture.write_bytes(content)
    assert not session.look_at_files()
    session.close()
    assert len(run_stage(open_path_stage(tmp_path / "kept.gaga")).scene) == len(splats)
