"""Two programs on one project: one writes at a time, readers find a whole project, the dead hold
nothing; a model that changed is noticed and copied."""

import os
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.files import fingerprint
from gaga_core.io.folder.lock import OWNER, InUseError, lock_folder
from gaga_core.io.splats.ply import write_ply
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.project import (
    ModelChangedError,
    SavedElsewhereError,
    open_path_stage,
    save_project,
)
from tests.core.scene import two_writers
from tests.core.scene.projects import assert_same, edited, model_in, opened
from tests.scenes import objects_scene

Process = BaseProcess
_KILLS = int(os.environ.get("GAGA_TEST_KILLS", "8"))


def _start(programs: Any, work: Callable[..., None], *args: object) -> Process:
    process: Process = programs.Process(target=work, args=args, daemon=True)
    process.start()
    return process


def test_two_programs_save_and_two_read_at_once(programs: Any, tmp_path: Path) -> None:
    project = edited(opened(model_in(tmp_path)))
    where = save_project(project)
    begin, stop = programs.Barrier(4), programs.Event()
    counts = [programs.Value("i", 0) for _ in range(2)]
    readers = [_start(programs, two_writers.read, where, n, begin, stop) for n in counts]
    writers = [_start(programs, two_writers.save, where, 25, begin) for _ in range(2)]
    for writer in writers:
        writer.join(300)
    stop.set()
    for reader in readers:
        reader.join(60)
    assert [process.exitcode for process in (*writers, *readers)] == [0] * 4
    assert all(count.value > 5 for count in counts)
    assert len(list(where.glob("scene-*.npz"))) == 1
    assert_same(project.scene, opened(where).scene)
    assert not list(where.glob("*.part"))


def test_a_writer_killed_at_any_moment_leaves_a_whole_project(
    programs: Any, tmp_path: Path
) -> None:
    project = edited(opened(model_in(tmp_path)))
    where = save_project(project)
    for pause in np.random.default_rng(7).uniform(0, 0.15, _KILLS):
        begin = programs.Barrier(2)
        writer = _start(programs, two_writers.save, where, 10**6, begin)
        begin.wait(60)
        time.sleep(pause)
        writer.kill()
        writer.join()
        assert_same(project.scene, opened(where).scene)
        with lock_folder(where):  # the dead holds nothing
            pass
    save_project(project, overwrites=True)
    assert len(list(where.glob("scene-*.npz"))) == 1
    assert_same(project.scene, opened(where).scene)


def test_who_has_a_folder_is_named_and_a_dead_program_has_none(
    programs: Any, tmp_path: Path
) -> None:
    for _ in range(2):
        begin = programs.Barrier(2)
        holder = _start(programs, two_writers.hold, tmp_path / "it", begin)
        begin.wait(60)
        with pytest.raises(InUseError, match=f"process {holder.pid}") as caught:
            lock_folder(tmp_path / "it")
        assert caught.value.owner is not None
        assert caught.value.owner.pid == holder.pid
        holder.kill()
        holder.join()
    with lock_folder(tmp_path / "it"), lock_folder(tmp_path / "it"):
        pass


def test_a_save_that_is_not_known_is_not_overwritten(tmp_path: Path) -> None:
    path = model_in(tmp_path)
    where = save_project(opened(path))
    ours, theirs = opened(where), opened(where)
    save_project(theirs)
    before = (where / "project.json").read_bytes()
    with pytest.raises(SavedElsewhereError):
        save_project(ours)
    assert (where / "project.json").read_bytes() == before
    save_project(ours, overwrites=True)
    save_project(ours)
    with pytest.raises(SavedElsewhereError):
        save_project(theirs)


@pytest.mark.parametrize("change", ["other", "gone", "folder gone"])
def test_a_model_that_changed_is_noticed_and_copied(tmp_path: Path, change: str) -> None:
    home = tmp_path / "home"
    home.mkdir()
    path, more = model_in(home), home / "more.ply"
    write_ply(more, objects_scene(seed=5).gaussians)
    project = edited(opened(path))
    scene, history = project.scene, History(project.scene)
    splats = objects_scene(seed=5).gaussians
    digest = fingerprint(more)
    history.do(edits.append(scene, splats, more, digest))
    history.do(edits.duplicate(scene, np.arange(len(scene) - 5, len(scene))))
    where = save_project(project)
    if change == "other":
        write_ply(path, objects_scene(seed=9).gaussians)
        write_ply(more, objects_scene(seed=9).gaussians)
    elif change == "gone":
        path.unlink()
        more.unlink()
    else:
        home.rename(tmp_path / "moved")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*.json")}
    with pytest.raises(ModelChangedError, match=path.name):
        save_project(project)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*.json")} == before
    if change == "folder gone":
        assert not home.exists()
    save_project(project, copies_model=True)
    assert_same(project.scene, opened(where).scene)
    n = len(list(where.iterdir()))
    save_project(project)  # the copies are known now
    assert len(list(where.iterdir())) == n
    again = opened(where)
    save_project(again, tmp_path / "elsewhere")
    assert_same(project.scene, opened(tmp_path / "elsewhere").scene)


def test_a_scene_file_that_is_gone_is_a_sentence(tmp_path: Path) -> None:
    where = save_project(opened(model_in(tmp_path)))
    next(where.glob("scene-*.npz")).unlink()
    with pytest.raises(GagaError, match=r"scene-.* is gone"):
        run_stage(open_path_stage(where))


def test_a_folder_in_the_place_of_the_owner_harms_nothing(tmp_path: Path) -> None:
    held = lock_folder(tmp_path)
    (tmp_path / OWNER).unlink()
    (tmp_path / OWNER).mkdir()
    held.release()
    with pytest.raises(GagaError):
        lock_folder(tmp_path)
    (tmp_path / OWNER).rmdir()
    lock_folder(tmp_path).release()
