"""Films through the photos: what stands left and right of the line, in order, whole or not."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.cli.main import main
from gaga_core.errors import GagaError
from gaga_core.evaluate.photo_film import TRUTH, PhotoFilmConfig, Verdict, error_map, error_picture
from gaga_core.io.images import read_rgb
from gaga_core.io.video import ffmpeg_program
from tests.app.folders import write_scene
from tests.core.cli.calls import Capture, answer, refusal

SIZE = (160, 96)  # the photos have 160 x 120 pixels: the film has black edges


def _pictures(path: Path) -> UInt8Array:
    command = [ffmpeg_program(), "-v", "error", "-i", str(path), "-f", "rawvideo"]
    data = subprocess.run(
        [*command, "-pix_fmt", "rgb24", "-"], capture_output=True, check=True
    ).stdout
    return np.frombuffer(data, np.uint8).reshape(-1, SIZE[1], SIZE[0], 3)


def _film(capsys: Capture, scene: Path, target: Path, *arguments: str) -> UInt8Array:
    size = [f"{side}" for side in SIZE]
    base = ["render", str(scene), "--video", str(target), "--size", *size, "--fps", "4"]
    answer(capsys, *base, "--seconds", "1", "--quality", "100", *arguments)
    return _pictures(target)


def test_photos_truth_and_errors_go_by_in_order(tmp_path: Path, capsys: Capture) -> None:
    scene = tmp_path / "scene"
    write_scene(scene)
    assert main(["associate", str(scene), "--preset", "paper"]) == 0
    target = tmp_path / "film.mp4"
    assert "true map" in refusal(
        capsys, "render", str(scene), "--video", str(target), "--split", "truth"
    )
    assert not target.exists()
    shutil.copytree(scene / "masks" / "made", scene / TRUTH)
    views = sorted(path.name for path in (scene / "images").iterdir())[1:3]
    arguments = ["--views", *views, "--what", "groups", "--split"]
    photo = _film(capsys, scene, target, *arguments, "photo", "--split-at", "1")
    assert len(photo) == 2 * 4
    for i, name in enumerate(views):
        true = read_rgb(scene / "images" / name, 128)
        for shown in photo[4 * i : 4 * i + 4]:
            assert not shown[:, :14].any()
            assert np.abs(shown[:, 16:144].astype(int) - true).mean() < 6
    sweep = _film(capsys, scene, target, *arguments, "photo", "--sweep").astype(int)
    assert np.abs(sweep[2] - photo[2]).mean() < 3  # the line is at the right edge
    assert np.abs(sweep[0] - photo[0]).mean() > 10  # at the left one: all groups
    errors = _film(capsys, scene, target, *arguments, "errors", "--split-at", "1").astype(int)
    inside = errors[0][:, 16:144]
    assert (inside[..., 2] > inside[..., 0] + 20).mean() > 0.3  # blue: right
    assert (inside[..., 0] > inside[..., 2] + 60).mean() < 0.05


def test_wrong_pixels_are_red_and_missing_ones_yellow() -> None:
    photo = np.full((2, 3, 3), 100, np.uint8)
    truth = np.array([[1, 1, 1], [0, 1, 1]], np.int32)
    picture, right = error_picture(photo, np.array([[7, 7, 8], [8, 0, 7]], np.int32), truth)
    assert right == pytest.approx(3 / 5)
    names = {(0, 0): "right", (0, 2): "wrong", (1, 1): "missing", (1, 0): "void"}
    red, green, blue = (picture[..., c].astype(int) for c in range(3))
    for at, name in names.items():
        said = {"right": blue[at] > red[at], "wrong": red[at] > 2 * green[at]}
        said |= {"missing": green[at] > 2 * blue[at], "void": red[at] == green[at] == blue[at]}
        assert said[name], name


def test_sides_and_times_that_do_not_exist_are_refused() -> None:
    for wrong in ({"left": "rgb"}, {"seconds": 0.0}):
        with pytest.raises(GagaError):
            PhotoFilmConfig(**wrong)


# --- Pixels that are right, wrong, missing or void, whatever the ids are called.


def _maps(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    truth = np.kron(rng.integers(0, 5, (4, 6)), np.ones((8, 8), int)).astype(np.int32)
    return truth, rng.permutation(np.arange(1, 60))[:5].astype(np.int32)


@pytest.mark.parametrize("seed", range(4))
def test_truth_under_other_names_is_right_everywhere(seed: int) -> None:
    truth, names = _maps(seed)
    found = error_map(names[truth], truth)  # what is void has a group, too: that is no error
    assert np.array_equal(found.verdicts, np.where(truth > 0, Verdict.RIGHT, Verdict.VOID))
    assert found.share_right == 1.0
    assert found.group_of == {int(t): int(names[t]) for t in np.unique(truth[truth > 0])}


@pytest.mark.parametrize("seed", range(4))
def test_each_damage_is_named(seed: int) -> None:
    truth, names = _maps(seed)
    groups = names[truth]
    places = np.argwhere(truth > 0)
    missing, wrong = places[:5], places[-5:]
    groups[tuple(missing.T)] = 0
    groups[tuple(wrong.T)] = 77
    found = error_map(groups, truth)
    assert (found.verdicts[tuple(missing.T)] == Verdict.MISSING).all()
    assert (found.verdicts[tuple(wrong.T)] == Verdict.WRONG).all()
    n = (truth > 0).sum()
    assert found.share_right == pytest.approx((n - 10) / n)


def test_one_group_stands_for_one_object() -> None:
    truth = np.repeat([[1, 1, 2]], 3, axis=0).astype(np.int32)
    found = error_map(np.full_like(truth, 9), truth)
    assert found.group_of == {1: 9}
    assert found.share_right == pytest.approx(2 / 3)


def test_a_view_without_objects_has_no_errors() -> None:
    empty = np.zeros((3, 4), np.int32)
    assert error_map(empty + 3, empty).share_right == 1.0
    assert error_map(empty, empty).group_of == {}
