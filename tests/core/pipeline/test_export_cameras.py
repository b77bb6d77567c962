"""Exported cameras see the exported splats as the photos saw the scene."""

import json
from pathlib import Path

import numpy as np
import pytest

from gaga_core.cli.main import main
from gaga_core.io.cameras_json import read_cameras_json
from gaga_core.io.ply import read_ply
from gaga_core.io.scene_folder import open_scene_folder
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.project import open_path_stage, save_project
from tests.app.folders import write_scene


@pytest.mark.parametrize("switches", [[], ["--centre", "--ground", "--scale", "3"]])
def test_exported_cameras_fit_the_exported_scene(
    tmp_path: Path, switches: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "table", masks=False, n_objects=2)
    folder = open_scene_folder(tmp_path / "table")
    project = run_stage(open_path_stage(tmp_path / "table"))
    means = project.scene.gaussians.means.astype(np.float64)
    turned = 0.5 * np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]])
    History(project.scene).do(
        edits.move_scene(project.scene, np.column_stack([turned, [1, 2, 3]]), "x")
    )
    save_project(project)
    args = ["export", str(tmp_path / "table"), "--out"]
    assert main([*args, str(tmp_path / "moved.ply"), *switches]) == 0
    command = [*args, str(tmp_path / "moved.json"), "--what", "cameras", "--json", *switches]
    capsys.readouterr()
    assert main(command) == 0
    assert json.loads(capsys.readouterr().out)["cameras"] == len(folder.cameras)
    moved = read_ply(tmp_path / "moved.ply").means.astype(np.float64)
    assert not np.allclose(moved, means, atol=0.1)
    cameras = read_cameras_json(tmp_path / "moved.json")
    for was, now in zip(folder.cameras, cameras, strict=True):
        np.testing.assert_allclose(now.project(moved)[0], was.project(means)[0], atol=0.05)


def test_a_lone_file_has_no_cameras(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(tmp_path / "table", masks=False, n_objects=2)
    lone = next((tmp_path / "table").glob("*.ply")).rename(tmp_path / "lone.ply")
    assert main(["export", str(lone), "--out", str(tmp_path / "a.json"), "--what", "cameras"]) == 1
    assert "scene folder" in capsys.readouterr().err
    assert not (tmp_path / "a.json").exists()


def test_the_ground_of_a_scene_that_was_turned_is_below_it(tmp_path: Path) -> None:
    write_scene(tmp_path / "table", masks=False, n_objects=2)
    project = run_stage(open_path_stage(tmp_path / "table"))
    assert project.folder is not None
    up = estimate_up(project.folder.cameras)
    turn = np.eye(3)[[2, 0, 1]]  # axes take each other's places
    History(project.scene).do(
        edits.move_scene(project.scene, np.column_stack([turn, [5, 6, 7]]), "x")
    )
    save_project(project)
    target = tmp_path / "moved.ply"
    assert main(["export", str(tmp_path / "table"), "--out", str(target), "--ground"]) == 0
    heights = read_ply(target).means.astype(np.float64) @ (turn @ up)
    assert abs(np.percentile(heights, 0.5)) < 1e-3
