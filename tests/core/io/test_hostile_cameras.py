"""Cameras, points, films and data sets made to do harm: one sentence, or numbers that can be."""

import json
import os
import struct
import subprocess
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.camera import Camera, is_usable
from gaga_core.errors import GagaError
from gaga_core.io.cameras.cameras_json import read_cameras_json, write_cameras_json
from gaga_core.io.cameras.colmap import read_colmap, write_colmap
from gaga_core.io.datasets import open_dataset
from gaga_core.io.images import write_rgb
from gaga_core.io.video import VideoConfig, ffmpeg_program, video_input, write_video_stage
from gaga_core.placing import video
from gaga_core.placing.video import expected_frames, extract_frames
from gaga_core.progress import Stage, run_stage
from tests.scenes import orbit_cameras

WRONG = [float("nan"), float("inf"), 1e300, 1e25, -1e25]


@pytest.fixture(autouse=True)
def _warnings_are_errors() -> None:
    warnings.simplefilter("error", RuntimeWarning)


# --- cameras and points


@pytest.mark.parametrize("value", ["nan", "inf", "1e300", "-1e25"])
def test_points_that_cannot_be_are_left_out_and_said(
    tmp_path: Path, value: str, caplog: pytest.LogCaptureFixture
) -> None:
    import pycolmap

    write_colmap(tmp_path, orbit_cameras(2), np.ones((5, 3)), np.zeros((5, 3), np.uint8))
    pycolmap.Reconstruction(str(tmp_path)).write_binary(str(tmp_path))
    raw = bytearray((tmp_path / "points3D.bin").read_bytes())
    struct.pack_into("<d", raw, 24, float(value))  # y of the first point
    (tmp_path / "points3D.bin").write_bytes(raw)
    found = read_colmap(tmp_path)
    assert found.points.tolist() == [[1, 1, 1]] * 4
    assert len(found.point_colors) == 4
    assert "1 point with" in caplog.text


@pytest.mark.parametrize("value", ["nan", "inf", "1e300", "-50", "0", "1e12"])
@pytest.mark.parametrize("column", [4, 5, 6, 7])
def test_colmap_cameras_are_usable_or_refused(tmp_path: Path, value: str, column: int) -> None:
    write_colmap(tmp_path, orbit_cameras(1), np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    words = (tmp_path / "cameras.txt").read_text().split()
    words[column] = value
    (tmp_path / "cameras.txt").write_text(" ".join(words) + "\n")
    check_cameras(lambda: read_colmap(tmp_path).cameras)


@pytest.mark.parametrize("value", ["nan", "inf", "1e300", "0"])
def test_colmap_poses_are_usable_or_refused(tmp_path: Path, value: str) -> None:
    write_colmap(tmp_path, orbit_cameras(1), np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    words = (tmp_path / "images.txt").read_text().split()
    for column in ([1], [1, 2, 3, 4], [5], [7]):
        some = [value if i in column else word for i, word in enumerate(words)]
        (tmp_path / "images.txt").write_text(" ".join(some) + "\n\n")
        check_cameras(lambda: read_colmap(tmp_path).cameras)


@pytest.mark.parametrize("name", ["a\0b.png", "\0", "\0\0\0"])
def test_a_name_with_zero_bytes_is_refused(tmp_path: Path, name: str) -> None:
    """They end the names that the reading process passes on."""
    cameras = [replace(camera, name=name) for camera in orbit_cameras(1)]
    write_colmap(tmp_path, cameras, np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    with pytest.raises(GagaError, match="zero byte"):
        read_colmap(tmp_path)


def test_a_long_name_of_one_photo_takes_no_room_from_the_others(tmp_path: Path) -> None:
    cameras = list(orbit_cameras(200))
    cameras[0] = replace(cameras[0], name="x" * 5_000_000)  # 4 GB as an array of text
    write_colmap(tmp_path, cameras, np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    assert {c.name for c in read_colmap(tmp_path).cameras} == {c.name for c in cameras}


def check_cameras(read: Callable[[], tuple[Camera, ...]]) -> None:
    try:
        cameras = read()
    except GagaError:
        return
    assert all(is_usable(camera.K, camera.cam_from_world) for camera in cameras)


@pytest.mark.parametrize("value", [*WRONG, 0, -1, "x", None, [], [[1, 0, 0]] * 3])
@pytest.mark.parametrize("field", ["width", "height", "fx", "fy", "position", "rotation"])
def test_cameras_json_is_usable_or_refused(tmp_path: Path, field: str, value: object) -> None:
    path = tmp_path / "cameras.json"
    write_cameras_json(path, orbit_cameras(2))
    content = json.loads(path.read_text())
    for wrong in (value, [value] * 3, [[value] * 3] * 3):
        content[1][field] = wrong
        path.write_text(json.dumps(content))
        check_cameras(lambda: read_cameras_json(path))


@pytest.mark.parametrize("name", ["cameras", "images", "points3D", "frames", "rigs"])
def test_a_model_with_a_pipe_is_refused(tmp_path: Path, name: str) -> None:
    write_colmap(tmp_path, orbit_cameras(1), np.ones((1, 3)), np.zeros((1, 3), np.uint8))
    (tmp_path / f"{name}.txt").unlink(missing_ok=True)
    os.mkfifo(tmp_path / f"{name}.txt")
    with pytest.raises(GagaError):
        read_colmap(tmp_path)


# --- films


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "a.mp4"
    picture = np.zeros((64, 64, 3), np.uint8)
    run_stage(write_video_stage(path, 8, lambda i: picture + i, VideoConfig(64, 64)))
    return path


@pytest.mark.parametrize(
    "content",
    [
        "ffconcat version 1.0\nfile a.mp4\n",
        "#EXTM3U\n#EXT-X-TARGETDURATION:2\n#EXTINF:1.3,\na.mp4\n#EXT-X-ENDLIST\n",
        "<?xml version='1.0'?><MPD xmlns='urn:mpeg:dash:schema:mpd:2011'></MPD>",
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\n",
    ],
)
def test_a_playlist_called_a_film_opens_nothing(film: Path, tmp_path: Path, content: str) -> None:
    (tmp_path / "a.mp4").write_bytes(film.read_bytes())
    for name in ("b.mp4", "concat:a.mp4", "%01d.mp4"):
        (tmp_path / name).write_text(content)
        with pytest.raises(GagaError, match="cannot be read as a video"):
            run_stage(extract_frames(tmp_path / name, tmp_path / "x", fps=2, longest_side=64))


@pytest.mark.parametrize("suffix", ["avi", "mkv", "mov", "webm", "ts", "mpg", "gif"])
def test_films_of_all_kinds_are_still_read(film: Path, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    command = [ffmpeg_program(), "-v", "error", *video_input(film), str(path)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    assert run_stage(extract_frames(path, tmp_path / "x", fps=12, longest_side=64))


def test_a_pipe_is_no_film(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mp4")
    with pytest.raises(GagaError, match="no regular file"):
        expected_frames(tmp_path / "a.mp4")


@pytest.mark.parametrize("is_cancelled", [True, False])
@pytest.mark.parametrize("reader", ["look", "header"])
def test_a_film_that_stops_coming_is_told_and_its_reader_ended(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str, is_cancelled: bool
) -> None:
    stalls = tmp_path / "ffmpeg"
    stalls.write_text(f"#!/bin/sh\necho $$ >> '{tmp_path}/pid'\necho 'frame=0'\nexec sleep 100\n")
    stalls.chmod(0o700)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(stalls))
    monkeypatch.setattr(video, "_PATIENCE", 100.0 if is_cancelled else 0.1)
    stage: Stage[object] = (
        video.look_through(film, 1, 0.1, (64, 64))
        if reader == "look"
        else extract_frames(film, tmp_path / "x", fps=2, longest_side=64)
    )
    next(stage)
    if is_cancelled:
        stage.close()
    else:
        with pytest.raises(GagaError, match="no progress"):
            run_stage(stage)
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)


# --- data sets


def scannet(root: Path, focal: object, pose: object = 1) -> Path:
    for name in ("color", "pose", "intrinsic", "instance-filt"):
        (root / name).mkdir(parents=True)
    write_rgb(root / "color/0.jpg", np.zeros((48, 64, 3), np.uint8))
    matrix = f"{focal} 0 32 0 0 {focal} 24 0 0 0 1 0 0 0 0 1"
    (root / "intrinsic/intrinsic_color.txt").write_text(matrix)
    (root / "pose/0.txt").write_text(f"1 0 0 0 0 1 0 0 0 0 {pose} 0 0 0 0 1")
    return root


@pytest.mark.parametrize("value", [*WRONG, 0, -1, "x", ""])
def test_wrong_numbers_of_a_data_set_are_refused_or_left_out(tmp_path: Path, value: object) -> None:
    good = open_dataset("scannet", scannet(tmp_path / "good", 50))
    assert len(good.scenes[0].folder.cameras) == 1
    assert open_dataset("scannet", scannet(tmp_path / "focal", value)).failed
    posed = open_dataset("scannet", scannet(tmp_path / "pose", 50, value))
    assert all(not scene.folder.cameras for scene in posed.scenes)


@pytest.mark.parametrize("column", range(15))
@pytest.mark.parametrize("value", [*WRONG, 0.0])
def test_wrong_numbers_of_llff_are_refused_or_left_out(
    tmp_path: Path, column: int, value: float
) -> None:
    write_rgb(tmp_path / "images/0.jpg", np.zeros((48, 64, 3), np.uint8))
    (tmp_path / "segmentations/0").mkdir(parents=True)
    (tmp_path / "segmentations/classes.txt").write_text("a")
    write_rgb(tmp_path / "segmentations/0/a.png", np.zeros((48, 64, 3), np.uint8))
    row = np.zeros(17)
    row[[1, 5, 12]], row[[4, 9, 14]] = (-1, -1, -1), (48, 64, 50)
    row[column] = value
    np.save(tmp_path / "poses_bounds.npy", row[None])
    for scene in open_dataset("3d-ovs", tmp_path).scenes:
        for camera in scene.folder.cameras:
            assert is_usable(camera.K, camera.cam_from_world)


@pytest.mark.parametrize("name", ["pose/0.txt", "intrinsic/intrinsic_color.txt"])
def test_a_pipe_in_a_data_set_ends(tmp_path: Path, name: str) -> None:
    root = scannet(tmp_path / "scene", 50)
    (root / name).unlink()
    os.mkfifo(root / name)
    assert open_dataset("scannet", root).failed
