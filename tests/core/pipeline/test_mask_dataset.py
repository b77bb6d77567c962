"""Masks refined by 3D, as a data set: maps, photos and documents that agree with each other."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.coco import decode_rle
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.mask_dataset import export_mask_dataset
from gaga_core.pipeline.render import export_masks
from gaga_core.progress import run_stage
from gaga_core.scene.folders import Folders
from gaga_core.scene.project import Project, open_path_stage
from tests.made import write_true_scene
from tests.scenes import objects_scene


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An associated scene of 4 views; one photo is larger than its camera, one is gone."""
    root = tmp_path_factory.mktemp("made") / "scene"
    scene = objects_scene(n_objects=3, per_object=150, n_cameras=4)
    write_true_scene(root, scene)
    rng = np.random.default_rng(0)
    for i, camera in enumerate(scene.cameras):
        size = (240, 320, 3) if i == 1 else (120, 160, 3)
        if i < 3:
            write_rgb(root / "images" / camera.name, rng.integers(0, 255, size, dtype=np.uint8))
    run_stage(associate_scene(open_scene_folder(root), config=AssociateConfig.of("paper")))
    return root


@pytest.fixture
def project(root: Path) -> Project:
    return run_stage(open_path_stage(root))


def test_a_data_set_agrees_with_itself(project: Project, tmp_path: Path) -> None:
    out = tmp_path / "set"
    seen = sorted(set(project.scene.labels.tolist()) - {0})
    project.scene.folders = Folders.of((), {seen[0]: "a/b"}, {seen[2]: 99, 99: seen[0]})
    made = run_stage(export_mask_dataset(project, out))
    assert made.views == ("000.png", "001.png", "002.png")
    assert made.without_photo == ("003.png",)
    documents = {
        name: json.loads((out / f"{name}.json").read_text())
        for name in ("instances", "panoptic", "groups")
    }
    maps = {}
    for path in sorted((out / "labels").iterdir()):
        labels = maps[path.stem] = read_labels(path)
        with Image.open(out / "images" / path.name) as photo:
            assert (photo.height, photo.width) == labels.shape
        rgb = np.asarray(Image.open(out / "panoptic" / path.name)).astype(int)
        np.testing.assert_array_equal(rgb[..., 0] + 256 * rgb[..., 1], labels)
        assert (out / "previews" / f"{path.stem}.jpg").is_file()
    assert maps["001"].shape == (240, 320)
    assert (out / "images/000.png").read_bytes() == (
        project.folder.image_paths["000.png"].read_bytes() if project.folder else b""
    )
    rows = {image["id"]: image for image in documents["instances"]["images"]}
    for annotation in documents["instances"]["annotations"]:
        labels = maps[Path(rows[annotation["image_id"]]["file_name"]).stem]
        mask = decode_rle(annotation["segmentation"]["counts"], annotation["segmentation"]["size"])
        np.testing.assert_array_equal(mask, labels == annotation["group_id"])
    assert made.n_masks == len(documents["instances"]["annotations"])
    groups = documents["groups"]["groups"]
    assert made.n_groups == len(groups) >= 3
    order = {group["id"]: (group["folder"], group["parent"]) for group in groups}
    assert order == dict.fromkeys(seen, ("", 0)) | {seen[0]: ("a/b", 0), seen[2]: ("a/b", seen[0])}
    for group in groups:
        areas = [int((labels == group["id"]).sum()) for labels in maps.values()]
        assert group["pixels"] == sum(areas)
        assert group["views"] == sum(area > 0 for area in areas)
    plain = run_stage(export_masks(project, tmp_path / "plain"))
    np.testing.assert_array_equal(read_labels(plain[0]), maps["000"])


def test_names_are_categories(project: Project, tmp_path: Path) -> None:
    group = int(np.bincount(project.scene.labels)[1:].argmax()) + 1
    project.scene.names[group] = "blue ball"
    run_stage(export_mask_dataset(project, tmp_path / "coco", "coco"))
    document = json.loads((tmp_path / "coco" / "instances.json").read_text())
    assert {"id": group, "name": "blue ball", "supercategory": "object"} in document["categories"]
    assert [image["file_name"] for image in document["images"]] == [
        "000.png",
        "001.png",
        "002.png",
        "003.png",
    ]
    assert [p.name for p in (tmp_path / "coco").iterdir()] == ["instances.json"]


def test_a_cancel_leaves_nothing(project: Project, tmp_path: Path) -> None:
    stage = export_mask_dataset(project, tmp_path / "set")
    for step in stage:
        if step.stage == "Export masks" and step.done == 2:
            break
    stage.close()
    assert not (tmp_path / "set").exists()


def test_other_folders_are_never_replaced(project: Project, root: Path, tmp_path: Path) -> None:
    before = sorted(path.name for path in (root / "images").iterdir())
    with pytest.raises(GagaError, match="holds other files"):
        run_stage(export_mask_dataset(project, root))
    assert sorted(path.name for path in (root / "images").iterdir()) == before
    (tmp_path / "mine" / "labels").mkdir(parents=True)
    with pytest.raises(GagaError, match="holds other files"):
        run_stage(export_mask_dataset(project, tmp_path / "mine"))
    run_stage(export_mask_dataset(project, tmp_path / "set"))
    run_stage(export_mask_dataset(project, tmp_path / "set"))  # its own are


def test_nothing_to_export_is_said(project: Project, tmp_path: Path) -> None:
    project.scene.labels[:] = 0
    with pytest.raises(GagaError, match="No group is visible"):
        run_stage(export_mask_dataset(project, tmp_path / "set"))


def test_the_command(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ["export", str(root), "--what", "masks", "--json"]
    assert main([*common, "--out", str(tmp_path / "set"), "--format", "dataset"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["views"] == 3
    assert answer["views_without_photo"] == ["003.png"]
    assert (tmp_path / "set" / "panoptic.json").is_file()
    assert main([*common, "--out", str(tmp_path / "coco"), "--format", "coco"]) == 0
    assert json.loads(capsys.readouterr().out)["views"] == 4
    assert main([*common, "--out", str(tmp_path / "maps")]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == 4
