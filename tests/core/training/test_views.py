"""Photos as a training takes them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import ExifTags, Image

from gaga_core.arrays import BoolArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.images import read_rgb, write_rgb
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.training.views import (
    TrainView,
    TrainViews,
    load_views_stage,
    quality_stage,
    read_view,
    shrunk,
)
from tests.scenes import orbit_cameras, random_gaussians


def photos(
    folder: Path, size: tuple[int, int] = (80, 60)
) -> tuple[tuple[Camera, ...], dict[str, Path]]:
    cameras, paths = orbit_cameras(5, width=80, height=60), {}
    for i, camera in enumerate(cameras):
        picture = np.full((size[1], size[0], 3), 40 * i, np.uint8)
        picture[:, : size[0] // 2] += 20
        paths[camera.name] = folder / camera.name
        write_rgb(folder / camera.name, picture)
    return cameras, paths


def test_views_are_shrunk_with_their_cameras_and_parted(tmp_path: Path) -> None:
    cameras, paths = photos(tmp_path)
    views: TrainViews = run_stage(load_views_stage(cameras, paths, ["001.png"], 40))
    assert [v.camera.name for v in views.test] == ["001.png"]
    assert [v.camera.name for v in views.train] == ["000.png", "002.png", "003.png", "004.png"]
    for view in (*views.train, *views.test):
        assert (view.camera.width, view.camera.height) == (40, 30)
        assert view.camera.K[0, 0] == pytest.approx(cameras[0].K[0, 0] / 2)
    target = views.train[1].target()
    assert target.dtype == np.float32
    np.testing.assert_allclose(target[15, [5, 35], 0], [100 / 255, 80 / 255], atol=0.01)


def test_a_photo_is_not_enlarged_and_may_be_smaller_than_its_camera(tmp_path: Path) -> None:
    cameras, paths = photos(tmp_path, (20, 15))
    views = run_stage(load_views_stage(cameras, paths, [], 640))
    assert views.train[0].picture.shape == (15, 20, 3)
    assert views.train[0].camera.K[0, 2] == pytest.approx(cameras[0].K[0, 2] / 4)


def test_photos_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    cameras, paths = photos(tmp_path, (60, 80))
    with pytest.raises(GagaError, match=r"000\.png has 60 x 80 pixels, but its camera 80 x 60"):
        run_stage(load_views_stage(cameras, paths, [], 640))
    cameras, paths = photos(tmp_path)
    only = {"002.png": paths["002.png"]}
    with pytest.raises(GagaError, match="There is 1 photo to train on"):
        run_stage(load_views_stage(cameras, only, [], 640))
    paths["003.png"].write_bytes(b"no picture")
    with pytest.raises(GagaError, match=r"003\.png"):
        run_stage(load_views_stage(cameras, paths, [], 640))


@pytest.mark.parametrize("orientation", [1, 6])
@pytest.mark.parametrize("size", [(1001, 667), (1000, 1002), (640, 480), (656, 496), (158, 120)])
def test_a_large_jpeg_is_decoded_small_and_looks_the_same(
    tmp_path: Path, size: tuple[int, int], orientation: int
) -> None:
    """Photos of 12 megapixels were decoded whole for training pictures of 640 pixels."""
    rng, path = np.random.default_rng(0), tmp_path / "a.jpg"
    coarse = Image.fromarray(rng.integers(0, 255, (30, 40, 3), dtype=np.uint8)).resize(size)
    noisy = np.asarray(coarse, np.float64) + rng.normal(0, 8, (size[1], size[0], 3))
    tags = Image.Exif()
    tags[ExifTags.Base.Orientation] = orientation
    picture = Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8))
    picture.save(path, quality=92, exif=tags.tobytes())
    wide, high = size if orientation == 1 else size[::-1]
    camera = replace(orbit_cameras(1)[0], width=wide, height=high)
    found = read_view(camera, path, 80)
    whole = shrunk(read_rgb(path), found.camera.width, found.camera.height)
    assert max(found.picture.shape) == 80
    assert abs(80 * min(size) / max(size) - min(found.picture.shape[:2])) < 1
    least = read_rgb(path, shrunk_to=80)
    assert (max(least.shape) < max(size)) == (max(size) >= 4 * 80 and not any(n % 2 for n in size))
    assert max(least.shape) >= min(2 * 80, max(size))
    error = found.picture.astype(np.float64) - whole
    assert np.sqrt((error**2).mean()) < 1.5  # of 255


def test_a_view_of_one_pixel_stays_one(tmp_path: Path) -> None:
    camera = orbit_cameras(1, width=3, height=1)[0]
    view = TrainView(camera, np.zeros((1, 3, 3), np.uint8)).smaller(0.5)
    assert (view.camera.width, view.camera.height) == (2, 1)
    with pytest.raises(ValueError, match="picture"):
        TrainView(camera, np.zeros((2, 3, 3), np.uint8))


def test_a_mask_that_takes_some_of_the_backdrop_makes_no_model_worse() -> None:
    """Found masks do; what is left of a plain backdrop is no error, and a part that is missing is
    one."""
    camera, gaussians = orbit_cameras(1, width=80, height=60)[0], random_gaussians(400, extent=0.3)
    paper = np.array([0.9, 0.85, 0.8], np.float32)
    frame = choose("cpu").render(gaussians, camera, background=paper)
    noise = np.random.default_rng(0).normal(0, 0.02, frame.image.shape)
    photo = np.round(np.clip(frame.image + noise, 0, 1) * 255).astype(np.uint8)
    true = frame.alpha > 0.5
    taken = true.copy()
    taken[:, : true.any(axis=0).argmax()] = True  # the paper next to it

    def psnr(mask: BoolArray, model: Gaussians) -> float:
        view = TrainView(camera, photo, mask.astype(np.uint8) * 255)
        quality = run_stage(quality_stage(model, [view], choose("cpu"), np.zeros(3)))
        assert quality is not None
        return quality.psnr

    assert psnr(taken, gaussians) > psnr(true, gaussians) - 1
    assert psnr(taken, gaussians.take(np.arange(300))) < psnr(taken, gaussians) - 3
