"""Recordings of phone programs, written as they do."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.cameras.poses import find_poses
from gaga_core.io.depth_maps import read_depth
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.video import VideoConfig, write_video_stage
from gaga_core.pipeline.place import place_photos
from gaga_core.pipeline.reconstruct import look_at_photos
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.placing.photos import ignored_files, list_photos
from gaga_core.placing.recordings import look_at_recording, unpack_stage
from gaga_core.progress import run_stage
from tests.core.io.pose_forms import GL, stray
from tests.core.placing.photo_scenes import FOCAL, write_photos

_DEPTH = (16, 12)  # pixels


def write_r3d(folder: Path, n: int, *, still: int = 0) -> tuple[Path, tuple[Camera, ...]]:
    """A recording of ``n`` photos of the room, each followed by ``still`` frames that hardly move;
    and the cameras of those photos."""
    lzfse = pytest.importorskip("lzfse", reason="the extra depth is not installed")
    cameras = write_photos(folder / "shots", n)
    poses: list[list[float]] = []
    path = folder / "scan.r3d"
    with zipfile.ZipFile(path, "w") as archive:
        for camera in cameras:
            photo = (folder / "shots" / camera.name).read_bytes()
            c2w = np.linalg.inv(camera.cam_from_world) @ GL
            for k in range(still + 1):
                i = len(poses)
                quat = pycolmap.Rotation3d(c2w[:3, :3]).quat.tolist()
                poses.append([*quat, *(c2w[:3, 3] + 0.001 * k)])
                depth = np.full(_DEPTH[::-1], 1 + i / 8, np.float32)
                sure = np.full(_DEPTH[::-1], 2, np.uint8)
                sure[:4] = 0
                archive.writestr(f"rgbd/{i}.jpg", photo)
                archive.writestr(f"rgbd/{i}.depth", lzfse.compress(depth.tobytes()))
                archive.writestr(f"rgbd/{i}.conf", lzfse.compress(sure.tobytes()))
        sizes = {"w": 320, "h": 240, "dw": _DEPTH[0], "dh": _DEPTH[1], "fps": 60}
        K = [FOCAL, 0, 0, 0, FOCAL, 0, 160, 120, 1]
        more = {"frameTimestamps": list(range(40_000)), "cameraType": 0}
        archive.writestr("metadata", json.dumps({"poses": poses, **more, **sizes, "K": K}))
        archive.writestr("sound.m4a", b"")
    return path, cameras


def test_a_recording_gives_photos_poses_and_depth_of_frames_that_moved(tmp_path: Path) -> None:
    path, cameras = write_r3d(tmp_path, 12, still=4)
    seen = look_at_recording(path)
    assert len(seen.frames) == pytest.approx(12, abs=6)
    assert np.diff([i // 5 for i in seen.frames]).min() >= 0
    target = tmp_path / "scene" / "input"
    run_stage(unpack_stage(path, target))
    found = find_poses(target)
    assert found is not None
    assert found.is_metric
    assert found.up == (0, 1, 0)
    assert sorted(int(Path(pose.name).stem) for pose in found.poses) == list(seen.frames)
    assert not ignored_files(target)[1:]  # the metadata only
    for pose in found.poses:
        i = int(Path(pose.name).stem)
        assert np.abs(pose.cam_from_world - cameras[i // 5].cam_from_world).max() < 0.01
        assert pose.depth is not None
        depth = read_depth(pose.depth)
        assert depth.shape == _DEPTH[::-1]
        assert not depth[:4].any()
        assert (depth[4:] == np.float32(1 + i / 8)).all()
    run_stage(unpack_stage(path, target))  # it is there
    (target / "metadata").write_text("{}")
    with pytest.raises(GagaError, match="holds other photos"):
        run_stage(unpack_stage(path, target))


def test_a_recording_is_placed_as_it_was_taken(tmp_path: Path) -> None:
    path, cameras = write_r3d(tmp_path, 12)
    found = look_at_photos(path)
    assert found is not None
    assert (found.n_photos, found.size) == (12, (320, 240))
    assert "12 of 12 frames" in found.poses
    run_stage(place_photos(path, found.scene, ReconstructConfig(poses="keep", threads=1)))
    scene = open_scene_folder(found.scene)
    assert scene.is_metric
    assert len(scene.depth) == 12
    for camera in scene.cameras:
        true = cameras[int(Path(camera.name).stem)]
        assert np.abs(camera.cam_from_world - true.cam_from_world).max() < 1e-5


def test_a_recording_that_is_cancelled_leaves_nothing(tmp_path: Path) -> None:
    path, _ = write_r3d(tmp_path, 12)
    stage = place_photos(path, tmp_path / "scene", ReconstructConfig(poses="keep", threads=1))
    while next(stage).stage != "Read frames":
        pass
    assert list((tmp_path / "scene").iterdir())
    stage.close()
    assert not (tmp_path / "scene").exists()


def test_a_damaged_recording_gets_a_sentence(tmp_path: Path) -> None:
    path, _ = write_r3d(tmp_path, 3)
    raw = path.read_bytes()
    for content in (b"", raw[: len(raw) // 2], raw.replace(b'"poses"', b'"prose"')):
        path.write_bytes(content)
        with pytest.raises(GagaError, match=r"scan\.r3d"):
            look_at_recording(path)


def write_stray(folder: Path, n: int) -> tuple[Path, tuple[Camera, ...]]:
    """A recording of ``n`` photos of the room as a film; and their cameras."""
    cameras, scan = write_photos(folder / "shots", n), folder / "71de12f9"
    for name in ("depth", "confidence"):
        (scan / name).mkdir(parents=True)
    shots = [read_rgb(folder / "shots" / camera.name) for camera in cameras]
    film = VideoConfig(320, 240, 60.0, 100)
    run_stage(write_video_stage(scan / "rgb.mp4", n, shots.__getitem__, film))
    for i in range(n):
        depth = np.full(_DEPTH[::-1], 1000 + i, np.uint16)
        Image.fromarray(depth).save(scan / "depth" / f"{i:06d}.png")
        sure = Image.fromarray(np.full(depth.shape, 2, np.uint8))
        sure.save(scan / "confidence" / f"{i:06d}.png")
    stray(scan, cameras)
    return scan, cameras


def test_a_folder_of_stray_scanner_gives_its_frames(tmp_path: Path) -> None:
    scan, cameras = write_stray(tmp_path, 12)
    found = look_at_photos(scan)
    assert found is not None
    assert (found.n_photos, found.size, found.is_video) == (12, (320, 240), False)
    assert found.scene == tmp_path / "71de12f9-scene"
    target = found.scene / "input"
    run_stage(unpack_stage(scan, target))
    assert len(list_photos(target)) == 12
    given = find_poses(target)
    assert given is not None
    for i, (pose, camera) in enumerate(zip(given.poses, cameras, strict=True)):
        assert pose.name == f"{i:06d}.jpg"
        assert np.abs(pose.cam_from_world - camera.cam_from_world).max() < 1e-6
        assert pose.depth is not None
        assert (read_depth(pose.depth) == np.float32(1 + i / 1000)).all()
        picture = read_rgb(target / pose.name).astype(float)
        shots = [read_rgb(tmp_path / "shots" / c.name) for c in cameras]
        assert np.argmin([np.abs(picture - shot).mean() for shot in shots]) == i
    lines = (scan / "odometry.csv").read_text().splitlines()
    (scan / "odometry.csv").write_text("\n".join([*lines, "1, 2, 3", ""]))
    with pytest.raises(GagaError, match=r"odometry\.csv, line 14"):
        look_at_recording(scan)
