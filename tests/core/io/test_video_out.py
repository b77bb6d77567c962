"""Videos that are written: the right pictures, whole or not at all."""

import json
import os
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import zstandard
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.ply import write_ply
from gaga_core.io.video import VideoConfig, ffmpeg_program, write_video_stage
from gaga_core.pipeline.film import (
    FilmConfig,
    LeftSide,
    Split,
    depth_span,
    film_stage,
    joined,
    painter_stage,
    picture_stage,
)
from gaga_core.progress import Progress, run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.scene import edits
from gaga_core.scene.camera_path import CameraPath, Keyframe, save_path, turntable
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from tests.core.scene.shots import shot_towards

SMALL = VideoConfig(96, 64, fps=10, quality=90)
UP = np.array([0.0, 0.0, 1.0])


def _read(path: Path, size: tuple[int, int]) -> UInt8Array:
    """Every picture (F, H, W, 3) of a video."""
    command = [ffmpeg_program(), "-v", "error", "-i", str(path), "-f", "rawvideo"]
    command += ["-pix_fmt", "rgb24", "-"]
    data = subprocess.run(command, capture_output=True, check=True).stdout
    return np.frombuffer(data, np.uint8).reshape(-1, size[1], size[0], 3)


def _flat(colors: list[tuple[int, int, int]], config: VideoConfig) -> Callable[[int], UInt8Array]:
    width, height = config.size
    return lambda i: np.full((height, width, 3), colors[i], np.uint8)


def test_a_compressed_ffmpeg_is_unpacked_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    binaries = tmp_path / "package" / "binaries"
    binaries.mkdir(parents=True)
    (binaries / "ffmpeg-v9.exe.zst").write_bytes(zstandard.compress(b"a program"))
    monkeypatch.setattr(imageio_ffmpeg, "__file__", str(binaries.parent / "__init__.py"))
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(variable, str(tmp_path / "cache"))
    program = Path(ffmpeg_program())
    assert (program.name, program.read_bytes()) == ("ffmpeg-v9.exe", b"a program")
    assert os.access(program, os.X_OK)
    program.write_bytes(b"is there")
    assert Path(ffmpeg_program()).read_bytes() == b"is there"


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_what_is_written_is_read_back(tmp_path: Path, suffix: str) -> None:
    colors = [(200, 30, 40), (30, 200, 60), (50, 60, 210), (128, 128, 128), (250, 250, 250)]
    target = tmp_path / f"film{suffix}"
    steps: list[Progress] = []
    stage = write_video_stage(target, 5, _flat(colors, SMALL), SMALL)
    assert run_stage(stage, steps.append) == target
    pictures = _read(target, SMALL.size)
    assert len(pictures) == 5
    for picture, color in zip(pictures, colors, strict=True):
        assert np.abs(picture.astype(int).mean(axis=(0, 1)) - color).max() < 6
    assert [step.done for step in steps] == [0, 1, 2, 3, 4, 5]
    assert {step.total for step in steps} == {5}
    assert [p.name for p in tmp_path.iterdir()] == [target.name]


def test_odd_sizes_lose_a_line() -> None:
    assert VideoConfig(97, 65).size == (96, 64)


def test_a_cancelled_film_leaves_nothing_and_keeps_the_former_one(tmp_path: Path) -> None:
    target = tmp_path / "film.mp4"
    target.write_bytes(b"former")
    stage = write_video_stage(target, 50, _flat([(9, 9, 9)] * 50, SMALL), SMALL)
    for _ in range(10):
        next(stage)
    stage.close()
    assert target.read_bytes() == b"former"
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_a_frame_that_fails_ends_ffmpeg_and_leaves_nothing(tmp_path: Path) -> None:
    def frame(index: int) -> UInt8Array:
        if index == 3:
            raise GagaError("no light")
        return np.zeros((64, 96, 3), np.uint8)

    with pytest.raises(GagaError, match="no light"):
        run_stage(write_video_stage(tmp_path / "film.mp4", 9, frame, SMALL))
    with pytest.raises(ValueError, match="expected"):
        run_stage(
            write_video_stage(
                tmp_path / "film.mp4", 1, lambda _: np.zeros((2, 2, 3), np.uint8), SMALL
            )
        )
    assert list(tmp_path.iterdir()) == []


def test_bad_wishes_get_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(GagaError, match=r"\.mp4"):
        run_stage(write_video_stage(tmp_path / "film.avi", 1, _flat([(0, 0, 0)], SMALL), SMALL))
    for bad in ({"width": 4}, {"height": 10_000}, {"fps": 0.0}, {"quality": 0}):
        with pytest.raises(GagaError):
            VideoConfig(**bad)
    shot = shot_towards(np.array([0.0, -3, 0]), np.zeros(3), UP, 1.0)
    with pytest.raises(GagaError, match="two keyframes"):
        film_stage(_scene(), CameraPath((Keyframe(shot),)), tmp_path / "a.mp4", FilmConfig())
    with pytest.raises(GagaError, match=r"JPEG"):
        picture_stage(
            _scene(), shot.camera(8, 8), tmp_path / "a.jpg", FilmConfig(), transparent=True
        )


def _scene() -> Scene:
    """A red ball on the left and a green one on the right, group 1 and 2."""
    rng = np.random.default_rng(0)
    n = 300
    centre = np.repeat([[-0.6, 0, 0], [0.6, 0, 0]], n, axis=0)
    means = (centre + rng.normal(size=(2 * n, 3)) * 0.08).astype(np.float32)
    color = np.repeat([[0.9, 0.1, 0.1], [0.1, 0.9, 0.1]], n, axis=0)
    gaussians = Gaussians(
        means,
        np.tile(np.array([1, 0, 0, 0], np.float32), (2 * n, 1)),
        np.full((2 * n, 3), np.log(0.06), np.float32),
        np.full(2 * n, 2.0, np.float32),
        ((color - 0.5) / 0.28209479)[:, None].astype(np.float32),
    )
    return Scene.of(gaussians, np.repeat([1, 2], n).astype(np.int32))


_FRONT = shot_towards(np.array([0.0, -3, 0]), np.zeros(3), UP, 0.9)


def _picture(scene: Scene, config: FilmConfig, *, transparent: bool = False) -> UInt8Array:
    camera = _FRONT.camera(96, 64)
    stage = painter_stage(scene, [camera], config, CpuRasterizer(), transparent=transparent)
    return run_stage(stage)(camera)


def test_a_film_goes_round_the_scene(tmp_path: Path) -> None:
    target = tmp_path / "round.mp4"
    path = turntable(_FRONT, UP, 2.0)
    stage = film_stage(_scene(), path, target, FilmConfig(video=SMALL), rasterizer=CpuRasterizer())
    assert run_stage(stage) == target
    pictures = _read(target, SMALL.size)
    assert len(pictures) == 20
    first, half = pictures[0].astype(int), pictures[10].astype(int)
    assert first[32, :48, 0].max() > 150  # red is left, and after half a turn right
    assert first[32, :48, 1].max() < 100
    assert half[32, 48:, 0].max() > 150
    assert half[32, :48, 1].max() > 150


def test_color_groups_and_depth_of_what_is_visible() -> None:
    scene = _scene()
    color = _picture(scene, FilmConfig())
    assert color[32, 20:40, 0].max() > 200
    groups = _picture(scene, FilmConfig("groups"))
    assert not np.array_equal(groups, color)
    depth = _picture(scene, FilmConfig("depth"))
    assert depth[32].max() > 80
    History(scene).do(edits.hide(scene, np.flatnonzero(scene.labels == 1).astype(np.int32), ""))
    hidden = _picture(scene, FilmConfig(background=(0.0, 0.0, 1.0)))
    assert hidden[32, 20:40].tolist() == [[0, 0, 255]] * 20
    assert hidden[32, 56:76, 1].max() > 200


def test_depth_keeps_its_colors_through_a_film() -> None:
    scene = _scene()
    cameras = [shot.camera(64, 64) for shot in (_FRONT, _FRONT)]
    near, far = depth_span(scene.gaussians, cameras)
    assert np.exp(near) == pytest.approx(2.8, abs=0.1)
    assert np.exp(far) == pytest.approx(3.2, abs=0.1)


def test_transparency_over_a_color_is_the_picture_over_that_color() -> None:
    scene, behind = _scene(), np.array([0.2, 0.5, 0.8])
    clear = _picture(scene, FilmConfig(), transparent=True).astype(float) / 255
    over = clear[..., :3] * clear[..., 3:] + (1 - clear[..., 3:]) * behind
    direct = _picture(scene, FilmConfig(background=(0.2, 0.5, 0.8))) / 255
    assert np.abs(over - direct).max() < 2.5 / 255
    assert clear[0, 0, 3] == 0


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_pictures_are_written_at_their_size(tmp_path: Path, name: str) -> None:
    camera = _FRONT.camera(321, 123)
    stage = picture_stage(
        _scene(), camera, tmp_path / name, FilmConfig(), rasterizer=CpuRasterizer()
    )
    run_stage(stage)
    with Image.open(tmp_path / name) as picture:
        assert picture.size == (321, 123)
        assert picture.mode == "RGB"
    assert len(list(tmp_path.iterdir())) == 1


def test_the_command_films_a_splat_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    splats, path, target = tmp_path / "a.ply", tmp_path / "p.json", tmp_path / "a.webm"
    write_ply(splats, _scene().gaussians)
    save_path(turntable(_FRONT, UP, 1.0), path)
    words = ["render", str(splats), "--path", str(path), "--video", str(target)]
    words += ["--size", "64", "48", "--fps", "6", "--backend", "cpu", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["pictures"] == 6
    assert len(_read(target, (64, 48))) == 6
    assert main(["render", str(splats), "--video", str(target)]) == 1
    assert "no camera path" in capsys.readouterr().err
    assert main(["render", str(splats)]) == 1
    assert "--out" in capsys.readouterr().err
    split = tmp_path / "split.mp4"
    words = ["render", str(splats), "--path", str(path), "--video", str(split), "--fps", "5"]
    words += ["--size", "64", "48", "--what", "depth", "--split", "rgb", "--split-at", "1.0"]
    assert main(words) == 0
    whole = tmp_path / "whole.mp4"
    words = ["render", str(splats), "--path", str(path), "--video", str(whole), "--fps", "5"]
    assert main([*words, "--size", "64", "48"]) == 0
    assert np.array_equal(_read(split, (64, 48)), _read(whole, (64, 48)))  # all left of the line
    assert main([*words, "--split", "rgb", "--split-at", "2"]) == 1


def test_an_orthographic_shot_is_drawn_alike_near_and_far() -> None:
    """Two balls of one size, one behind the other: their pictures are as large."""
    scene = _scene()
    means = scene.gaussians.means.copy()
    means[scene.labels == 2, 1] += 2.0
    scene.gaussians = replace(scene.gaussians, means=means)
    far = replace(_FRONT, eye=(0.0, -900.0, 0.0), distance=900.0, fov_x=0.003, fov_y=0.003)
    for shot, alike in ((_FRONT, False), (replace(far, is_orthographic=True), True)):
        camera = shot.camera(240, 160)
        picture = run_stage(painter_stage(scene, [camera], FilmConfig(), CpuRasterizer()))(camera)
        red, green = ((picture[..., c] > 60).sum() for c in (0, 1))
        assert bool(0.93 < green / red < 1.07) is alike


def test_a_split_film_has_another_picture_left_of_its_line(tmp_path: Path) -> None:
    scene, target = _scene(), tmp_path / "split.mp4"
    path = CameraPath((Keyframe(_FRONT), Keyframe(_FRONT)))
    color, groups = _picture(scene, FilmConfig()), _picture(scene, FilmConfig("groups"))
    for share in (0.0, 0.25, 1.0):
        both = joined(color, groups, share)
        at = round(share * 96)
        assert np.array_equal(both[:, : max(at - 1, 0)], color[:, : max(at - 1, 0)])
        assert np.array_equal(both[:, at + 1 :], groups[:, at + 1 :])
    empty = Scene.of(scene.gaussians.take(np.zeros(1, np.int32)))
    config = FilmConfig("groups", split=Split("rgb", sweeps=True), video=SMALL)
    stage = film_stage(
        scene, path, target, config, left=LeftSide(empty), rasterizer=CpuRasterizer()
    )
    run_stage(stage)
    pictures = _read(target, SMALL.size).astype(int)
    first, middle = pictures[0], pictures[len(pictures) // 2]
    assert first[32].max() > 150  # the line is at the left edge: all of the right picture
    assert middle[32].max() < first[32].max() - 60  # all of the other scene
    assert Split(sweeps=True).share(0) == Split(sweeps=True).share(1) == 0
    assert Split(sweeps=True).share(0.5) == 1
    for wrong in ({"left": "photo"}, {"at": 1.5}):
        with pytest.raises(GagaError):
            Split(**wrong)
