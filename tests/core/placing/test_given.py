import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.cameras.transforms_json import write_transforms_json
from gaga_core.io.depth_maps import read_scene_depth
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import read_rgb
from gaga_core.pipeline.place import place_photos, placement_of, read_entry
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing.poses import moved_by, pairs_by_pose, similarity_between
from gaga_core.progress import run_stage
from tests.core.placing.photo_scenes import FOCAL, write_photos

N = 6


def _noisy(cameras: tuple[Camera, ...], degrees: float, way: float) -> tuple[Camera, ...]:
    """Cameras turned and moved at random by so much."""
    rng = np.random.default_rng(5)
    found = []
    for camera in cameras:
        x, y, z = axis = rng.normal(size=3)
        x, y, z = np.radians(degrees) * axis / np.linalg.norm(axis)
        turn, _, vt = np.linalg.svd(np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
        pose = np.eye(4)
        pose[:3, :3] = turn @ vt @ camera.cam_from_world[:3, :3]
        place = camera.position + way * (direction := rng.normal(size=3)) / np.linalg.norm(
            direction
        )
        pose[:3, 3] = -pose[:3, :3] @ place
        found.append(replace(camera, cam_from_world=pose))
    return tuple(found)


def _poses(cameras: tuple[Camera, ...]) -> DoubleArray:
    return np.array([camera.cam_from_world[:3] for camera in sorted(cameras, key=lambda c: c.name)])


Placed = Callable[..., tuple[DoubleArray, DoubleArray, dict[str, Any], Path]]


@pytest.fixture
def placed(tmp_path: Path) -> Placed:
    """Place photos of the room by poses that are off: true poses, found ones, report, scene."""

    def place(
        mode: str,
        degrees: float,
        way: float,
        change: Callable[..., object] = lambda _: None,
        has_lens: bool = True,
    ) -> tuple[DoubleArray, DoubleArray, dict[str, Any], Path]:
        truth = write_photos(tmp_path / "shots" / "images", N)
        images = {camera.name: tmp_path / "shots" / "images" / camera.name for camera in truth}
        noisy = _noisy(truth, degrees, way)
        file = tmp_path / "shots" / "transforms.json"
        write_transforms_json(file, [c for c in noisy if change(c) is None], images)
        if not has_lens:
            words = re.sub(r'"fl_[xy]": [\d.]+,', "", file.read_text())
            file.write_text(words)
        config = ReconstructConfig(quality="draft", poses=mode, threads=1)  # type: ignore[arg-type]
        run_stage(place_photos(tmp_path / "shots" / "images", tmp_path / "scene", config))
        folder = open_scene_folder(tmp_path / "scene")
        entry = read_entry(tmp_path / "scene")["sfm"]
        assert isinstance(entry, dict)
        kept = {camera.name for camera in folder.cameras}
        want = tuple(camera for camera in truth if camera.name in kept)
        return _poses(want), _poses(folder.cameras), entry, tmp_path / "scene"

    return place


def test_refined_poses_are_nearer_to_the_truth_and_stay_in_their_world(placed: Placed) -> None:
    truth, found, entry, _ = placed("refine", 1.0, 0.05)
    way, turn = moved_by(truth, found)
    assert np.median(turn) < 0.7  # the world is as right as the mean of the noise
    assert np.median(way) < 0.05
    fit = similarity_between(found, truth)
    assert abs(np.cbrt(np.linalg.det(fit[:3, :3])) - 1) < 0.03
    way, turn = moved_by(np.array([_carried(pose, fit) for pose in found]), truth)
    assert way.max() < 0.02
    assert turn.max() < 0.2
    given = entry["given"]
    assert given["is_refined"]
    assert given["refined"] < 0.3 * given["given"]
    assert "Cameras moved by" in " ".join(entry["notes"])


def test_poses_that_are_kept_are_those_of_the_file(placed: Placed) -> None:
    truth, found, entry, _ = placed("keep", 0.0, 0.0)
    assert np.abs(truth - found).max() < 1e-6
    assert entry["registered"] == N
    assert not entry["given"]["is_refined"]


def test_right_poses_are_not_made_worse(placed: Placed) -> None:
    truth, found, entry, _ = placed("refine", 0.0, 0.0)
    way, turn = moved_by(truth, found)
    assert way.max() < 0.02
    assert turn.max() < 0.2
    given = entry["given"]
    assert not given["is_refined"] or given["refined"] < given["given"]


def test_scale_only_places_anew_in_the_given_world(placed: Placed) -> None:
    truth, found, entry, _ = placed("scale", 3.0, 0.1)
    fit = similarity_between(found, truth)
    assert abs(np.cbrt(np.linalg.det(fit[:3, :3])) - 1) < 0.05
    way, _ = moved_by(truth, found)
    assert np.median(way) < 0.2
    assert entry["given"]["mode"] == "scale"


def test_poses_of_others_are_found_out_and_the_photos_placed_without(placed: Placed) -> None:
    truth, found, entry, _ = placed("refine", 180.0, 30.0)
    assert entry["registered"] == N
    assert "contradict" in " ".join(entry["notes"])
    fit = similarity_between(found, truth)
    carried = np.array([_carried(pose, fit) for pose in found])
    way, turn = moved_by(carried, truth)
    assert way.max() < 0.1
    assert turn.max() < 1.0


def test_a_photo_without_a_pose_is_told(placed: Placed) -> None:
    _, found, entry, _ = placed("refine", 0.5, 0.02, lambda c: c.name == "005.jpg" or None)
    assert len(found) == N - 1
    report = placement_of({"sfm": entry})
    assert report is not None
    assert report.left_out == {"005.jpg": "no pose is given"}


def test_poses_without_a_lens_are_refined_with_one_and_not_kept(placed: Placed) -> None:
    with pytest.raises(GagaError, match="nothing of the lens"):
        placed("keep", 0.0, 0.0, has_lens=False)
    truth, found, entry, _ = placed("refine", 0.0, 0.0, has_lens=False)
    assert entry["focal"] == pytest.approx(FOCAL, rel=0.02)
    assert moved_by(truth, found)[0].max() < 0.1


def test_kept_poses_that_photos_contradict_are_refused(placed: Placed, tmp_path: Path) -> None:
    with pytest.raises(GagaError):
        placed("keep", 60.0, 3.0)
    assert not (tmp_path / "scene" / "sparse").exists()


def _carried(pose: DoubleArray, world: DoubleArray) -> DoubleArray:
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    turn = pose[:, :3] @ (world[:3, :3] / scale).T
    place = world[:3, :3] @ (-pose[:, :3].T @ pose[:, 3]) + world[:3, 3]
    return np.c_[turn, -turn @ place]


def test_a_similarity_is_found_from_cameras_on_one_line_and_in_spite_of_some_wrong_ones() -> None:
    rng = np.random.default_rng(0)
    world = np.eye(4)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    world[:3, :3], world[:3, 3] = 2.5 * turn * np.linalg.det(turn), (1, 2, 3)
    source = np.zeros((20, 3, 4))
    for i in range(20):
        q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        q *= np.linalg.det(q)
        source[i] = np.c_[q, -q @ np.array([0.3 * i, 0, 0])]
    target = np.array([_carried(pose, world) for pose in source])
    assert np.allclose(similarity_between(source, target), world, atol=1e-9)
    target[:3, :, 3] += 5
    assert np.abs(similarity_between(source, target) - world).max() < 0.02


def test_pairs_are_those_that_look_the_same_way_from_near() -> None:
    poses = np.zeros((8, 3, 4))
    poses[:, :, :3] = np.eye(3)
    poses[4:, :, :3] = np.diag([-1.0, 1, -1])  # the other way
    poses[:, 0, 3] = [*range(4), *range(4)]
    pairs = pairs_by_pose(poses, 2)
    assert (0, 1) in pairs
    assert all((i < 4) == (j < 4) for i, j in pairs)


def test_given_masks_and_depth_come_into_the_scene_as_its_pictures_lie(tmp_path: Path) -> None:
    """Depth that is a plane for the rays of the bent lens is that plane for the scene's cameras."""
    shots, size = tmp_path / "shots", (64, 48)
    truth = write_photos(shots / "images", N)
    lens = pycolmap.Camera(
        model="OPENCV", width=320, height=240, params=[FOCAL, FOCAL, 160, 120, -0.2, 0, 0, 0]
    )
    v, u = np.mgrid[0 : size[1], 0 : size[0]].reshape(2, -1) + 0.5
    rays = np.asarray(lens.cam_from_img(np.c_[u, v] * 5))
    plane = (3 + rays[:, 0] - 0.5 * rays[:, 1]).reshape(size[::-1])
    mask = np.zeros((240, 320), np.uint8)
    mask[:, 100:] = 255
    for name in ("depth", "masks"):
        (shots / name).mkdir()
    file = shots / "transforms.json"
    images = {camera.name: shots / "images" / camera.name for camera in truth}
    write_transforms_json(file, truth, images)
    whole = json.loads(file.read_text()) | {"camera_model": "OPENCV", "k1": -0.2}
    for i, frame in enumerate(whole["frames"]):
        frame["depth_file_path"] = f"depth/{i}.png"
        Image.fromarray(np.round(plane * 1000).astype(np.uint16)).save(shots / f"depth/{i}.png")
        if i > 0:
            frame["mask_path"] = f"masks/{i}.png"
            Image.fromarray(mask).save(shots / f"masks/{i}.png")
    file.write_text(json.dumps(whole))
    config = ReconstructConfig(quality="draft", poses="keep", threads=1, accept_wrong=True)
    run_stage(place_photos(shots / "images", tmp_path / "scene", config))
    folder = open_scene_folder(tmp_path / "scene")
    entry = read_entry(tmp_path / "scene")["sfm"]
    assert isinstance(entry, dict)
    assert f"{N - 1} masks and {N} depth maps" in entry["notes"][0]
    assert set(folder.depth) == {camera.name for camera in folder.cameras} == set(folder.foreground)
    for camera in folder.cameras:
        found = read_scene_depth(folder.depth[camera.name])
        small = camera.resized(found.shape[1], found.shape[0])
        v, u = np.nonzero(found)
        assert len(v) > 0.8 * found.size
        x, y = ((np.c_[u, v] + 0.5 - small.K[:2, 2]) / np.diag(small.K)[:2]).T
        assert np.abs(found[v, u] - (3 + x - 0.5 * y)).max() < 0.016  # half a pixel is 0.012
        inside = read_rgb(folder.foreground[camera.name])[..., 0] > 127
        assert inside[:, 110:].all()
        assert inside[:, :80].all() == (camera.name == truth[0].name)
    report = placement_of(read_entry(tmp_path / "scene"), folder)
    assert report is not None
    assert report.cut_out is not None
    photo, its_mask = report.cut_out
    assert folder.foreground[photo.name] == its_mask  # one picture shows what is left out
    without = placement_of(read_entry(tmp_path / "scene"))
    assert without is not None
    assert without.cut_out is None
