"""Photos as a training takes them."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import BoolArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.images import write_rgb
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from gaga_core.training.views import TrainView, TrainViews, load_views_stage, quality_stage
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
