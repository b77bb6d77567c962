"""Splats that came after the scene was moved: reset puts them where they were put."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.edit_script import run_script
from gaga_core.errors import GagaError
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.edits.splats import append_made
from gaga_core.scene.edits.values import read_added_stage
from gaga_core.scene.orientation import degrees_of, pose_of
from gaga_core.scene.project import Project, open_path_stage, save_project
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from tests.core.scene.projects import assert_same
from tests.scenes import random_gaussians

_N = 40  # splats of each file


def _turn(degrees: float, scale: float, offset: tuple[float, float, float]) -> DoubleArray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.column_stack([scale * np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), offset])


_FIRST, _THEN = _turn(30, 2.0, (1, 0, 3)), _turn(-70, 0.5, (0, 5, 0))


@pytest.fixture
def project(tmp_path: Path) -> Project:
    """A file, another one, a motion of all, a third file and splats that an edit made, and another
    motion: 40 splats each."""
    for seed in range(3):
        write_splats(tmp_path / f"{seed}.ply", random_gaussians(_N, seed=seed, sh_degree=1))
    project: Project = run_stage(open_path_stage(tmp_path / "0.ply"))
    scene = project.scene
    history = History(scene)
    _do(history, _added(scene, tmp_path / "1.ply"))
    _do(history, edits.move_scene(scene, _FIRST, "Move"))
    _do(history, _added(scene, tmp_path / "2.ply"))
    made = random_gaussians(_N, seed=3, sh_degree=1)
    _do(history, append_made(scene, made, np.full(_N, 50, np.int32), "Made"))
    _do(history, edits.move_scene(scene, _THEN, "Move"))
    (tmp_path / "script.json").write_text(json.dumps(history.recorded()))
    return project


def _added(scene: Scene, path: Path) -> Edit | None:
    splats, digest = run_stage(read_added_stage(path))
    return edits.append(scene, splats, path, digest)


def _do(history: History, edit: Edit | None) -> None:
    assert history.do(edit)


def _file(k: int) -> IntArray:
    return np.arange(k * _N, (k + 1) * _N, dtype=np.int32)


def _moved_and_reset(scene: Scene, history: History) -> None:
    """Each file in another way; then all are reset at once."""
    for k in range(4):
        some = _file(k)[: _N // (1 + k % 2)]
        _do(history, edits.transform(scene, some, _turn(20 * k + 5, 3, (k, k, 0))))
    _do(history, edits.reset_placement(scene, np.arange(len(scene))))


def test_reset_puts_each_file_where_it_was_put(project: Project) -> None:
    scene = project.scene
    history, before = History(scene), world_means(scene)
    assert edits.reset_placement(scene, np.arange(len(scene))) is None, "nothing was moved alone"
    _moved_and_reset(scene, history)
    np.testing.assert_allclose(world_means(scene), before, atol=1e-5)
    _do(history, edits.duplicate(scene, _file(2), _turn(0, 1, (9, 0, 0))))
    copy = _file(4)
    _do(history, edits.reset_placement(scene, copy))
    np.testing.assert_allclose(world_means(scene, copy), before[_file(2)], atol=1e-5)


def test_rotation_and_scale_count_from_when_the_file_came(project: Project) -> None:
    scene = project.scene
    for k in range(4):
        pose = pose_of(scene, _file(k), np.zeros(3))
        np.testing.assert_allclose(degrees_of(pose, local=False), 0, atol=1e-9)
        np.testing.assert_allclose(pose.scale, 1, rtol=1e-9)


def test_a_saved_project_and_a_script_know_it(project: Project, tmp_path: Path) -> None:
    before = world_means(project.scene)
    again = run_stage(open_path_stage(save_project(project, tmp_path / "saved.gaga"))).scene
    replayed = run_stage(open_path_stage(tmp_path / "0.ply")).scene
    run_script(replayed, json.loads((tmp_path / "script.json").read_text()))
    for scene in (again, replayed):
        assert scene.added == project.scene.added
        _moved_and_reset(scene, History(scene))
        np.testing.assert_allclose(world_means(scene), before, atol=1e-5)
    assert_same(again, replayed)


def test_a_frame_that_is_none_is_a_sentence(project: Project, tmp_path: Path) -> None:
    where = save_project(project, tmp_path / "saved.gaga")
    text = (where / "project.json").read_text()
    for frame in ([[1, 0, 0, 0]], [[0, 0, 0, 0]] * 4):
        content = json.loads(text)
        content["added"][1]["frame"] = frame
        (where / "project.json").write_text(json.dumps(content))
        with pytest.raises(GagaError, match="damaged"):
            run_stage(open_path_stage(where))
