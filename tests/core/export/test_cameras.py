"""Exported cameras see the exported splats as the photos saw the scene."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.export.cameras import camera_form_of, estimated_camera_bytes, export_cameras
from gaga_core.export.options import ExportOptions
from gaga_core.io.cameras.cameras_json import read_cameras_json
from gaga_core.io.cameras.colmap import count_points, read_colmap, write_colmap
from gaga_core.io.folder.scene_folder import find_sparse, open_scene_folder
from gaga_core.io.splats.ply import read_ply
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.orientation import estimate_up
from gaga_core.scene.project import Project, open_path_stage, save_project
from tests.app.folders import write_scene


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A scene folder of two balls."""
    write_scene(tmp_path / "table", masks=False, n_objects=2)
    return tmp_path / "table"


@pytest.fixture
def project(table: Path) -> Project:
    return run_stage(open_path_stage(table))


@pytest.mark.parametrize("switches", [[], ["--centre", "--ground", "--scale", "3"]])
def test_exported_cameras_fit_the_exported_scene(
    project: Project, tmp_path: Path, switches: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = open_scene_folder(tmp_path / "table")
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


def _transforms(path: Path) -> tuple[Camera, ...]:
    """Read as the nerfstudio documentation says: camera to world, OpenGL's axes."""
    read = json.loads(path.read_text())
    assert read["camera_model"] == "PINHOLE"
    cameras = []
    for frame in read["frames"]:
        world_from_cam = np.array(frame["transform_matrix"])
        world_from_cam[:3, 1:3] *= -1
        K = np.array([[frame["fl_x"], 0, frame["cx"]], [0, frame["fl_y"], frame["cy"]], [0, 0, 1]])
        pose = np.linalg.inv(world_from_cam)
        cameras.append(Camera(K, pose, frame["w"], frame["h"], Path(frame["file_path"]).name))
    return tuple(cameras)


def test_every_form_holds_the_same_cameras_and_replaces_nothing_that_is_read(
    project: Project, tmp_path: Path
) -> None:
    assert project.folder is not None
    cameras = project.folder.cameras
    (tmp_path / "far").mkdir()
    for name in ("t cameras.json", "table/transforms.json", "far/transforms.json", "model"):
        assert export_cameras(project, tmp_path / name, ExportOptions(scale=3)) == len(cameras)
    model, own = read_colmap(tmp_path / "model"), read_colmap(tmp_path / "table" / "sparse" / "0")
    frames = _transforms(tmp_path / "table/transforms.json")
    plain = read_cameras_json(tmp_path / "t cameras.json")
    for was, a, b, c in zip(cameras, model.cameras, frames, plain, strict=True):
        assert was.name == a.name == b.name
        for camera in (a, b, c):
            np.testing.assert_allclose(camera.position, 3 * was.position, atol=1e-9)
            rotation, expected = camera.cam_from_world[:3, :3], was.cam_from_world[:3, :3]
            np.testing.assert_allclose(rotation, expected, atol=1e-9)
            np.testing.assert_allclose(camera.K, was.K, atol=1e-9)
    rows = [np.column_stack([m.points / k, m.point_colors]) for m, k in ((model, 3), (own, 1))]
    listed = [points[np.lexsort(np.round(points.T, 4))] for points in rows]  # in no order of theirs
    np.testing.assert_allclose(listed[0], listed[1], atol=1e-5)
    for place in ("table", "far"):
        found = json.loads((tmp_path / place / "transforms.json").read_text())["frames"]
        assert [frame["file_path"] for frame in found] == [f"images/{c.name}" for c in cameras]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "images.bin").write_bytes(b"")
    before = sorted(tmp_path.rglob("*"))
    for name in ("table/sparse/0", "a.ply", "other", "t cameras.json/model"):
        with pytest.raises(GagaError):
            export_cameras(project, tmp_path / name)
    assert sorted(tmp_path.rglob("*")) == before


def test_no_place_that_would_become_the_cameras_of_the_scene_is_written(
    project: Project, tmp_path: Path
) -> None:
    """A model in sparse/ hides the cameras.json that a scene was opened with."""
    export_cameras(project, tmp_path / "table" / "cameras.json")
    shutil.rmtree(tmp_path / "table" / "sparse")
    alone = run_stage(open_path_stage(tmp_path / "table"))
    for name in ("sparse", "sparse/0", "colmap/sparse/0", "cameras.json"):
        with pytest.raises(GagaError, match="Choose another place"):
            export_cameras(alone, tmp_path / "table" / name)
    assert find_sparse(tmp_path / "table") is None


def test_points_of_a_small_unit_keep_their_digits(project: Project, tmp_path: Path) -> None:
    export_cameras(project, tmp_path / "small", ExportOptions(scale=1e-6))
    own, small = (read_colmap(tmp_path / name) for name in ("table/sparse/0", "small"))
    listed = [np.sort(points, axis=0) for points in (own.points, small.points * 1e6)]
    np.testing.assert_allclose(listed[0], listed[1], rtol=1e-6, atol=1e-6)


def test_a_lone_file_has_no_cameras(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lone = next(table.glob("*.ply")).rename(tmp_path / "lone.ply")
    assert main(["export", str(lone), "--out", str(tmp_path / "a.json"), "--what", "cameras"]) == 1
    assert "scene folder" in capsys.readouterr().err
    assert not (tmp_path / "a.json").exists()


def test_the_ground_of_a_turned_scene_is_below_it(project: Project, tmp_path: Path) -> None:
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


def test_a_model_exported_from_another_scene_stays(project: Project, tmp_path: Path) -> None:
    """A COLMAP model as text of another scene was overwritten; one of a moved scene was not."""
    other = tmp_path / "other"
    shutil.copytree(tmp_path / "table", other)
    model = read_colmap(other / "sparse" / "0")
    turned = tuple(
        replace(camera, cam_from_world=camera.cam_from_world[[1, 0, 2, 3]] * [[1], [-1], [1], [1]])
        for camera in model.cameras
    )
    write_colmap(other / "sparse" / "0", turned, model.points, model.point_colors)
    before = {path: path.read_bytes() for path in (other / "sparse" / "0").iterdir()}
    with pytest.raises(GagaError, match="Choose another place"):
        export_cameras(project, other / "sparse" / "0")
    assert {path: path.read_bytes() for path in before} == before
    for scale in (1.0, 2.0):  # its own export is written again
        export_cameras(project, tmp_path / "model", ExportOptions(scale=scale))
    with pytest.raises(GagaError, match="Choose another place"):
        export_cameras(run_stage(open_path_stage(other)), tmp_path / "model")
    moved = (tmp_path / "table").rename(tmp_path / "moved")
    export_cameras(run_stage(open_path_stage(moved)), tmp_path / "model")
    write_colmap(moved / "sparse" / "0", turned, model.points, model.point_colors)
    export_cameras(run_stage(open_path_stage(moved)), tmp_path / "model")  # placed once more


def test_cameras_are_not_written_over_a_scene_or_a_project(project: Project) -> None:
    assert project.folder is not None
    saved, split = save_project(project), project.folder.root / "split.json"
    split.write_text("{}")
    for file in (saved / "project.json", split):
        before = file.read_bytes()
        with pytest.raises(GagaError, match="Choose another"):
            export_cameras(project, file)
        assert file.read_bytes() == before


@pytest.mark.parametrize("name", ["cameras.json", "transforms.json", "model"])
def test_the_size_of_exported_cameras_is_about_what_was_estimated(
    project: Project, tmp_path: Path, name: str
) -> None:
    """Points of a COLMAP model were not counted."""
    assert project.folder is not None
    out = tmp_path / "out" / name
    out.parent.mkdir()
    export_cameras(project, out)
    files = [out] if out.is_file() else list(out.iterdir())
    n_bytes = sum(file.stat().st_size for file in files)
    estimated = estimated_camera_bytes(project.folder, camera_form_of(out))
    assert 0.75 < estimated / n_bytes < 1.35
    if out.is_dir():
        assert count_points(out) == len(read_colmap(out).points) > 0
        sparse = find_sparse(tmp_path / "table")
        assert sparse is not None
        assert count_points(sparse) == count_points(out)
