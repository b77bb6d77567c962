"""Readers of benchmark data sets: every layout gives back the scene it was made from."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.io.datasets import DATASETS, DatasetScene, open_dataset
from tests.datasets import (
    LAYOUTS,
    N_VIEWS,
    PROMPTS,
    gaga_replica,
    lerf_mask,
    mipnerf360,
    ovs3d,
    raw_scannet,
    semantic_nerf,
    tiny,
    write_photo,
)

TEST_VIEWS = {
    "Semantic-NeRF": {1, 3, 5, 7},
    "Replica, Gaga": {1, 3, 5, 7},
    "ScanNet": {0},
    "DM-NeRF": {2, 6},
    "ScanNet, Gaga": {2, 6},
    "LERF-Mask": {2, 4, 6},
    "3D-OVS": {0, 4},
    "COLMAP": {0},
}


def only(name: str, root: Path) -> DatasetScene:
    data = open_dataset(name, root)
    assert data.failed == {}
    (scene,) = data.scenes
    return scene


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_scene_it_was_made_from(layout: str, tmp_path: Path) -> None:
    name, write = LAYOUTS[layout]
    names = write(tmp_path / "office_0")
    scene = only(name, tmp_path)
    folder = scene.folder
    assert scene.name == "office_0"
    assert scene.layout == layout.split(", ")[-1]
    views = {camera.name: camera for camera in folder.cameras}
    assert set(views) == set(names.values())
    assert set(folder.test) == {names[k] for k in TEST_VIEWS[layout]}
    assert set(folder.train) == set(names.values()) - set(folder.test)
    for k, camera_name in names.items():
        camera, true = views[camera_name], tiny().cameras[k]
        assert np.allclose(camera.K, true.K, atol=1e-6)
        assert np.allclose(camera.cam_from_world, true.cam_from_world, atol=1e-6)
        assert (camera.width, camera.height) == (true.width, true.height)
        assert folder.image_paths[camera_name].stem == Path(camera_name).stem
        if camera_name in scene.truth:
            assert np.array_equal(scene.truth.loaders[camera_name](), tiny().labels[k])
    if DATASETS[name].protocol == "instance" and name != "mipnerf360":
        assert set(folder.test) <= set(scene.truth.names)
        assert scene.missing == ()
    assert folder.model_path is not None
    assert any(m in folder.mask_folders for m in ("raw_sam_mask", "sam"))


def test_a_scene_folder_itself_and_nested_archives_are_found(tmp_path: Path) -> None:
    semantic_nerf(tmp_path / "Replica_Dataset" / "room_0")
    semantic_nerf(tmp_path / "Replica_Dataset" / "office_1")
    found = open_dataset("replica", tmp_path)
    assert [scene.name for scene in found.scenes] == ["office_1", "room_0"]
    alone = open_dataset("replica", tmp_path / "Replica_Dataset" / "room_0")
    assert [scene.name for scene in alone.scenes] == ["room_0"]
    some = open_dataset("replica", tmp_path, ["room_0", "room_9"])
    assert [scene.name for scene in some.scenes] == ["room_0"]
    assert "no scene room_9" in some.failed["room_9"]


def test_instance_maps_of_the_archive_beside_are_found(tmp_path: Path) -> None:
    data = tmp_path / "Replica_Dataset"
    semantic_nerf(data / "room_0")
    archive = tmp_path / "Replica_Instance_Segmentation" / "room_0" / "Sequence_1"
    archive.mkdir(parents=True)
    shutil.move(data / "room_0" / "Sequence_1" / "semantic_instance", archive)
    assert len(only("replica", data).truth) == N_VIEWS


def test_models_may_lie_elsewhere(tmp_path: Path) -> None:
    gaga_replica(tmp_path / "data" / "room_0")
    shutil.move(tmp_path / "data" / "room_0" / "point_cloud", tmp_path / "models" / "room_0")
    lacking = only("replica", tmp_path / "data")
    assert lacking.folder.model_path is None
    models = tmp_path / "models2" / "room_0"
    models.mkdir(parents=True)
    shutil.move(tmp_path / "models" / "room_0", models / "point_cloud")
    (found,) = open_dataset("replica", tmp_path / "data", models=tmp_path / "models2").scenes
    assert found.folder.model_path is not None
    with pytest.raises(GagaError, match="trained models"):
        open_dataset("replica", tmp_path / "data", models=tmp_path / "nowhere")


def test_the_colmap_model_wins_over_the_trajectory(tmp_path: Path) -> None:
    names = semantic_nerf(tmp_path / "room_0")
    (tmp_path / "room_0" / "Sequence_1" / "traj_w_c.txt").write_text("1 2 3")
    assert "4 x 4" in open_dataset("replica", tmp_path).failed["room_0"]
    from tests.datasets import write_sparse

    write_sparse(tmp_path / "room_0", names)
    assert len(only("replica", tmp_path).folder.cameras) == N_VIEWS


def test_frames_without_a_pose_or_a_map_are_told(tmp_path: Path) -> None:
    raw_scannet(tmp_path / "scene0000_00")
    (tmp_path / "scene0000_00" / "instance-filt" / "0.png").unlink()
    (tmp_path / "scene0000_00" / "pose" / "10.txt").unlink()
    scene = only("scannet", tmp_path)
    assert "10.jpg" not in {camera.name for camera in scene.folder.cameras}
    assert "90.jpg" not in {camera.name for camera in scene.folder.cameras}
    assert any("no true label map (first: 0.jpg)" in sentence for sentence in scene.missing)


def test_intrinsics_are_scaled_to_the_photos(tmp_path: Path) -> None:
    raw_scannet(tmp_path / "scene0000_00")
    (tmp_path / "scene0000_00" / "intrinsic" / "intrinsic_depth.txt").unlink()
    K, true = only("scannet", tmp_path).folder.cameras[0].K, tiny().cameras[0].K
    assert np.allclose(K[:2, 2], true[:2, 2])
    assert np.allclose(K[[0, 1], [0, 1]], 1.1 * true[[0, 1], [0, 1]])


def test_prompts_of_lerf_mask_count_test_views(tmp_path: Path) -> None:
    names = lerf_mask(tmp_path / "figurines")
    prompts = only("lerf-mask", tmp_path).prompts
    assert prompts is not None
    assert prompts.views == {"0": names[2], "2": names[6]}
    assert prompts.prompts == tuple(sorted(PROMPTS.values()))


def test_3d_ovs_without_colmap_takes_the_poses_of_llff(tmp_path: Path) -> None:
    names = ovs3d(tmp_path / "bed", sparse=False)
    scene = only("3d-ovs", tmp_path)
    assert len(scene.folder.cameras) == N_VIEWS
    for k, camera in enumerate(scene.folder.cameras):
        assert camera.name == names[k]
        assert np.allclose(camera.K, tiny().cameras[k].K)
        assert np.allclose(camera.cam_from_world, tiny().cameras[k].cam_from_world)


def test_photos_that_are_too_wide_are_used_in_a_smaller_folder(tmp_path: Path) -> None:
    names = mipnerf360(tmp_path / "bicycle")
    root = tmp_path / "bicycle"
    (root / "images").rename(root / "images_8")
    (root / "images").mkdir()
    for k, name in names.items():
        write_photo(
            root / "images" / name,
            np.zeros((6, 1680, 3), np.uint8) if k else np.zeros((1260, 1680, 3), np.uint8),
        )
    scene = only("mipnerf360", tmp_path)
    assert {p.parent.name for p in scene.folder.image_paths.values()} == {"images_8"}
    assert scene.folder.cameras[0].width == 80


@pytest.mark.parametrize(
    ("layout", "gone", "said"),
    [
        ("Semantic-NeRF", "Sequence_1/traj_w_c.txt", "traj_w_c.txt does not exist"),
        ("Replica, Gaga", "sparse", "no COLMAP model"),
        ("ScanNet", "pose", "no poses"),
        ("ScanNet", "intrinsic", "no intrinsic_color.txt"),
        ("DM-NeRF", "test/test_images", "no photos in test/test_images"),
        ("ScanNet, Gaga", "images", "no photos in images"),
        ("LERF-Mask", "test_mask", "no masks test_mask"),
        ("LERF-Mask", "images_train", "no photos in images_train"),
        ("3D-OVS", "segmentations/classes.txt", "no segmentations/classes.txt"),
        ("3D-OVS", "segmentations/00/red ball.png", "00/red ball.png"),
        ("3D-OVS", "sparse", "poses_bounds.npy does not exist"),
    ],
)
def test_a_partial_scene_says_in_one_sentence_what_is_missing(
    layout: str, gone: str, said: str, tmp_path: Path
) -> None:
    name, write = LAYOUTS[layout]
    write(tmp_path / "scene")
    path = tmp_path / "scene" / gone
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    data = open_dataset(name, tmp_path)
    assert data.scenes == ()
    assert said in data.failed["scene"]


@pytest.mark.parametrize("name", DATASETS)
def test_a_wrong_folder_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "holiday").mkdir()
    with pytest.raises(GagaError, match="it must have"):
        open_dataset(name, tmp_path)
    with pytest.raises(GagaError, match="not a folder"):
        open_dataset(name, tmp_path / "nowhere")


def test_damaged_instances_and_unknown_names_are_plain_sentences(tmp_path: Path) -> None:
    from tests.datasets import dm_nerf

    names = dm_nerf(tmp_path / "scene0010_00")
    (tmp_path / "scene0010_00" / "test" / "test_ins" / "14.npz").write_bytes(b"PK\x03\x04no")
    scene = only("scannet", tmp_path)
    with pytest.raises(GagaError, match=r"14\.npz is damaged"):
        scene.truth.loaders[names[2]]()
    with pytest.raises(GagaError, match="no data set"):
        open_dataset("imagenet", tmp_path)


def test_all_instances_are_the_truth_of_dm_nerf_where_they_are(tmp_path: Path) -> None:
    from tests.datasets import dm_nerf, write_map

    names = dm_nerf(tmp_path / "scene0010_00")
    assert only("scannet", tmp_path).truth_from.startswith("ins_2d_label_id")
    for part, k in (("test", 2), ("test", 6), ("train", 0)):
        path = tmp_path / "scene0010_00" / part / f"{part}_ins_full" / f"{7 * k}.png"
        write_map(path, tiny().labels[k] * 7)
    scene = only("scannet", tmp_path)
    assert scene.truth_from == "ins_full"
    assert np.array_equal(scene.truth.loaders[names[2]](), tiny().labels[2] * 7)


def test_a_quarter_of_the_size_is_used_where_it_is_there(tmp_path: Path) -> None:
    names = mipnerf360(tmp_path / "garden")
    for name in names.values():
        write_photo(tmp_path / "garden" / "images_4" / name, np.zeros((15, 20, 3), np.uint8))
    scene = only("mipnerf360", tmp_path)
    assert {p.parent.name for p in scene.folder.image_paths.values()} == {"images_4"}
    assert scene.folder.cameras[0].width == 20
