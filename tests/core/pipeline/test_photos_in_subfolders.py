"""Photos of equal names in subfolders (l/0.png, r/0.png): every stage keeps their files apart."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.evaluate.group_scores import evaluate
from gaga_core.io.cameras.cameras_json import read_cameras_json, write_cameras_json
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder, select_views
from gaga_core.io.images import read_rgb, write_rgb
from gaga_core.io.masks.label_maps import (
    mask_folder,
    read_labels,
    view_key,
    view_keys,
    write_labels,
)
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.import_masks import import_masks, match_views
from gaga_core.pipeline.mask_dataset import export_mask_dataset
from gaga_core.pipeline.render import export_masks, render_views
from gaga_core.pipeline.run import missing_stages
from gaga_core.pipeline.segment import segment_scene
from gaga_core.progress import run_stage
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene
from tests.core.grouping.true_masks import permuted, true_map
from tests.core.segmentation.fake_provider import Quarters
from tests.made import write_true_scene
from tests.scenes import objects_scene

SCENE = objects_scene(n_objects=4, per_object=150, n_cameras=6)
NAMES = tuple(f"{side}/{i}.png" for side in "lr" for i in range(3))
CAMERAS = tuple(
    replace(camera, name=name) for camera, name in zip(SCENE.cameras, NAMES, strict=True)
)


def truth_of(camera: Camera) -> IntArray:
    return true_map(SCENE, camera)


@pytest.fixture
def folder(tmp_path: Path) -> SceneFolder:
    """Six views in two folders of photos with the same three names, all for training."""
    root = tmp_path / "scene"
    write_true_scene(root, SCENE, cameras=CAMERAS)
    for i, camera in enumerate(CAMERAS):
        write_rgb(root / "images" / camera.name, np.full((120, 160, 3), 40 * i, np.uint8))
    return open_scene_folder(root)


def files(root: Path) -> list[str]:
    return sorted(p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file())


def test_each_photo_has_masks_of_its_own(folder: SceneFolder) -> None:
    masks = mask_folder(folder.mask_folders["sim"], NAMES)
    for i, camera in enumerate(CAMERAS):
        assert np.array_equal(masks.load(camera.name, 160, 120), permuted(truth_of(camera), i))


def test_made_masks_are_kept_apart_and_are_not_made_twice(folder: SceneFolder) -> None:
    report = run_stage(segment_scene(folder, Quarters()))
    assert files(report.folder) == sorted((*NAMES, "provider.json"))
    assert "quarters" in open_scene_folder(folder.root).mask_folders
    again = run_stage(segment_scene(folder, Quarters()))
    assert again.kept == NAMES
    (report.folder / "provider.json").unlink()
    with pytest.raises(GagaError, match="not made here"):
        run_stage(segment_scene(folder, Quarters()))


def test_association_renders_and_scores_keep_views_apart(folder: SceneFolder) -> None:
    run_stage(associate_scene(folder, "sim"))
    assert files(folder.work / "masks") == list(NAMES)
    written = run_stage(render_views(folder, views="all"))
    assert [p.relative_to(folder.work / "renders" / "groups").as_posix() for p in written] == list(
        NAMES
    )
    report = evaluate(folder.work / "masks", folder.root / "gt" / "instance")
    assert report.images == tuple(view_key(name) for name in NAMES)
    assert report.missing == ()
    assert report.without_void.iou > 0.95
    (folder.work / "masks" / "r" / "1.png").unlink()
    assert evaluate(folder.work / "masks", folder.root / "gt" / "instance").missing == ("r/1",)
    part = evaluate(folder.work / "masks", folder.root / "gt" / "instance", views=["l/1.png"])
    assert part.images == ("l/1",)


def test_a_rerun_finds_the_renders_of_all_views(folder: SceneFolder) -> None:
    run_stage(associate_scene(folder, "sim"))
    run_stage(render_views(folder, views="all"))
    for path in (folder.work / "renders").rglob("*.png"):
        os.utime(path)
    assert "render" not in missing_stages(folder)
    (folder.work / "renders" / "groups" / "r" / "2.png").unlink()
    assert "render" in missing_stages(folder)


def test_exports_hold_a_file_of_every_view(folder: SceneFolder, tmp_path: Path) -> None:
    scene = Scene.of(SCENE.gaussians, SCENE.labels)
    project = Project(scene, folder.root / "point_cloud.ply", folder)
    written = run_stage(export_masks(project, tmp_path / "png"))
    assert files(tmp_path / "png") == list(NAMES)
    assert written == tuple(tmp_path / "png" / name for name in NAMES)
    out = tmp_path / "set"
    run_stage(export_mask_dataset(project, out))
    for part in ("images", "labels", "panoptic"):
        assert files(out / part) == list(NAMES)
    for i, name in enumerate(NAMES):
        assert read_rgb(out / "images" / name)[0, 0, 0] == 40 * i
    listed = json.loads((out / "instances.json").read_text())["images"]
    assert [image["file_name"] for image in listed] == list(NAMES)
    report = run_stage(import_masks(folder, out / "instances.json", "back"))
    assert report.views == NAMES
    for name in NAMES:
        back = read_labels(folder.root / "masks" / "back" / name)
        assert np.array_equal(back > 0, read_labels(out / "labels" / name) > 0)


def test_maps_in_folders_of_the_photos_are_imported(folder: SceneFolder, tmp_path: Path) -> None:
    shutil.copytree(folder.root / "masks" / "sim", tmp_path / "theirs")
    report = run_stage(import_masks(folder, tmp_path / "theirs", "theirs"))
    assert report.views == NAMES
    assert report.unmatched == ()
    for i, camera in enumerate(CAMERAS):
        made = read_labels(folder.root / "masks" / "theirs" / camera.name)
        assert np.array_equal(made, permuted(truth_of(camera), i))


def test_a_flat_map_belongs_to_no_photo_or_to_the_only_one(folder: SceneFolder) -> None:
    flat = folder.root / "masks" / "flat"
    write_labels(flat / "1.png", truth_of(CAMERAS[1]))
    write_labels(flat / "9.png", truth_of(CAMERAS[1]))
    assert mask_folder(flat, [*NAMES, "r/9.png"]).names == ("r/9.png",)
    assert mask_folder(flat, ["l/1.png"], among=NAMES).names == ()
    assert match_views(NAMES, ["1"])[0] == {}
    assert match_views(["l/1.png", "r/2.png"], ["1", "2"])[0] == {"l/1.png": "1", "r/2.png": "2"}
    assert match_views(["1.png"], ["images/1"])[0] == {"1.png": "images/1"}
    assert match_views(["1.png"], ["a/1", "b/1"])[0] == {}
    assert match_views(NAMES, ["images/l/1", "images/r/1"])[0] == {
        "l/1.png": "images/l/1",
        "r/1.png": "images/r/1",
    }


def test_a_view_is_named_with_its_folder_where_its_name_is_not_unique(folder: SceneFolder) -> None:
    assert [c.name for c in select_views(folder, ["l/1", "r/1.png"])] == ["l/1.png", "r/1.png"]
    for name in ("1", "1.png"):
        with pytest.raises(GagaError, match=r"2 views are called .*l/1\.png, r/1\.png"):
            select_views(folder, [name])


def test_photos_that_differ_in_their_suffix_alone_are_refused() -> None:
    assert view_keys(["a.b.jpg", "l/a.jpg", "a.jpg"]) == {
        "a.b.jpg": "a.b", "l/a.jpg": "l/a", "a.jpg": "a"
    }  # fmt: skip
    with pytest.raises(GagaError, match=r"l/a\.jpg and l/a\.png differ only in their suffix"):
        view_keys(["l/a.jpg", "r/a.png", "l/a.png"])


@pytest.mark.parametrize("name", ["../../a.png", "/etc/a.png", "./x/../a.png", "..", "", "/"])
def test_names_of_a_camera_file_never_lead_out_of_a_folder(tmp_path: Path, name: str) -> None:
    path = (tmp_path / f"{view_key(name)}.png").resolve()
    assert path.is_relative_to(tmp_path)


def test_cameras_keep_their_folder_in_cameras_json(tmp_path: Path) -> None:
    write_cameras_json(tmp_path / "cameras.json", CAMERAS)
    read = read_cameras_json(tmp_path / "cameras.json")
    assert [camera.name for camera in read] == [view_key(name) for name in NAMES]
