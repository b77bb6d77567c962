"""The CPU rasterizer's gradients are those of float64 autograd, and they train."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import AnyArray, frozen
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster import base
from gaga_core.raster.base import Gradients
from gaga_core.raster.cpu import backward_kernels
from gaga_core.raster.cpu.backward_kernels import backward_splats
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.reference import project
from gaga_core.training.losses import photometric, psnr
from tests import torch_reference
from tests.core.raster.autograd import BACKGROUND, autograd
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CPU: base.TrainableRasterizer = CpuRasterizer()


def assert_matches(gaussians: Gaussians, camera: Camera) -> tuple[base.Gradients, AnyArray]:
    """Compare every parameter kind under random gradients of image and alpha."""
    rng = np.random.default_rng(7)
    by_image = rng.normal(size=(camera.height, camera.width, 3)).astype(np.float32)
    by_alpha = rng.normal(size=(camera.height, camera.width)).astype(np.float32)
    got = CPU.backward(gaussians, camera, by_image, alpha_gradient=by_alpha, background=BACKGROUND)
    want = autograd(gaussians, camera, by_image, by_alpha)
    for name in torch_reference.NAMES:
        ours = np.zeros_like(want[name])
        ours[got.indices] = getattr(got, name)
        size = np.linalg.norm(want[name])
        assert size > 0
        assert np.linalg.norm(ours - want[name]) <= 1e-3 * size, name
        assert (ours * want[name]).sum() > 0.9999 * size * np.linalg.norm(ours), name
    in_half_pictures = want["shift"] * [camera.width / 2, camera.height / 2]
    screen = np.linalg.norm(in_half_pictures, axis=1)
    np.testing.assert_allclose(got.screen, screen[got.indices], atol=1e-3 * screen.max())
    return got, screen


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3, 4])
def test_every_degree_of_color(sh_degree: int) -> None:
    """Sizes that are no multiples of a tile; splats that cross the border of the picture."""
    gaussians = random_gaussians(150, seed=sh_degree, sh_degree=sh_degree)
    camera = orbit_cameras(5, width=61, height=45)[sh_degree]
    assert_matches(gaussians, camera)


@pytest.mark.parametrize(("width", "height"), [(33, 64), (16, 16), (7, 5)])
def test_every_size_of_picture(width: int, height: int) -> None:
    gaussians = random_gaussians(120, seed=width, sh_degree=1)
    assert_matches(gaussians, orbit_cameras(3, width=width, height=height)[1])


def test_opaque_splats_behind_each_other() -> None:
    """Alpha at its limit, pixels that are done, splats that nobody sees."""
    scene = objects_scene(4, 40, sh_degree=1)
    camera = scene.cameras[1].resized(41, 30)
    gaussians, n = scene.gaussians, len(scene.gaussians)
    means, log_scales = gaussians.means.copy(), gaussians.log_scales.copy()
    # The first thirty become a curtain before the left of the picture.
    beside = camera.position + camera.forward - 0.3 * camera.cam_from_world[0, :3]
    means[:30] = beside + 0.02 * means[:30]
    log_scales[:30] = np.log(0.4)
    logits = np.full(n, 6, np.float32)
    curtain = replace(gaussians, means=means, log_scales=log_scales, logit_opacities=logits)
    got, screen = assert_matches(curtain, camera)
    is_hidden = screen[got.indices] == 0
    assert 20 < is_hidden.sum() < 0.9 * len(is_hidden)
    for name in torch_reference.NAMES:
        assert not getattr(got, name)[is_hidden].any()


def test_splats_beyond_the_border_have_a_clamped_jacobian() -> None:
    """Large splats outside the view that reach into it, past 1.3 times the half field."""
    gaussians = random_gaussians(80, seed=5)
    camera = orbit_cameras(3, width=50, height=40, radius=1.4)[0]
    log_scales = (gaussians.log_scales + 1.2).astype(np.float32)
    gaussians = replace(gaussians, log_scales=log_scales)
    got, screen = assert_matches(gaussians, camera)
    means = gaussians.means[got.indices[screen[got.indices] > 0]].astype(np.float64)
    pixels, _ = camera.project(means)
    slope = np.abs(pixels - camera.K[:2, 2]) / [camera.width / 2, camera.height / 2]
    assert (slope > 1.3).any(axis=0).all()


def test_long_needles_around_the_camera() -> None:
    gaussians = random_gaussians(120, seed=1, sh_degree=2)
    log_scales = gaussians.log_scales.copy()
    log_scales[:, 0] += 2.5
    log_scales[:, 1] -= 2.5
    needles = replace(gaussians, log_scales=log_scales)
    assert_matches(needles, orbit_cameras(3, width=60, height=50, radius=0.9)[0])


@pytest.mark.parametrize("smaller", [0.0, 2.0])
def test_the_antialiased_mode(smaller: float) -> None:
    """Sizes about a pixel and far below, where the opacity falls with the projected area."""
    gaussians = random_gaussians(200, seed=6, sh_degree=1)
    log_scales = (gaussians.log_scales - np.float32(smaller)).astype(np.float32)
    log_scales[:50, 0] += 2  # needles
    mip = replace(gaussians, log_scales=log_scales).with_antialiasing(True)
    camera = orbit_cameras(5, width=61, height=45)[2]
    got, _ = assert_matches(mip, camera)
    plain = CPU.backward(mip.with_antialiasing(False), camera, np.ones((45, 61, 3), np.float32))
    assert len(got.indices) <= len(plain.indices)


def test_quaternions_need_not_be_of_unit_length() -> None:
    """A quaternion twice as long turns half as fast; along itself it changes nothing."""
    gaussians = random_gaussians(60, seed=3)
    camera = orbit_cameras(3, width=48, height=40)[1]
    by_image = np.random.default_rng(0).normal(size=(40, 48, 3)).astype(np.float32)
    once = CPU.backward(gaussians, camera, by_image)
    doubled = replace(gaussians, quats=2 * gaussians.quats)
    twice = CPU.backward(doubled, camera, by_image)
    np.testing.assert_allclose(2 * twice.quats, once.quats, rtol=1e-5, atol=1e-9)
    along = (once.quats * gaussians.quats[once.indices]).sum(axis=1)
    assert np.abs(along).max() < 1e-5 * np.abs(once.quats).max()


def test_rows_name_their_splats() -> None:
    """Ascending indices of what is drawn; radii are those of the projected covariances."""
    gaussians = random_gaussians(300, seed=9)
    camera = orbit_cameras(3, width=64, height=48, radius=0.8)[0]
    got = CPU.backward(gaussians, camera, np.ones((48, 64, 3), np.float32))
    assert (np.diff(got.indices) > 0).all()
    index, _, _, covariances = project(gaussians, camera)
    radii = np.zeros(300)
    radii[index] = 3 * np.sqrt(np.linalg.eigvalsh(covariances)[:, 1])
    np.testing.assert_allclose(got.radii, radii[got.indices], rtol=1e-4)
    # Everything else, moved or not, leaves the picture as it is.
    seen = CPU.render(gaussians.take(got.indices), camera).image
    np.testing.assert_array_equal(seen, CPU.render(gaussians, camera).image)


def test_nothing_in_view_and_broken_splats() -> None:
    camera = orbit_cameras(3, width=48, height=40)[1]
    ones = np.ones((40, 48, 3), np.float32)
    assert len(CPU.backward(random_gaussians(0), camera, ones).indices) == 0
    gaussians = random_gaussians(90, seed=4, sh_degree=1)
    want = CPU.backward(gaussians.take(np.arange(90)[np.arange(90) % 3 > 0]), camera, ones)
    means, sh = gaussians.means.copy(), gaussians.sh.copy()
    means[::3] = np.nan
    got = CPU.backward(replace(gaussians, means=means), camera, ones)
    for name in torch_reference.NAMES:
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name))
    sh[::3] = np.nan
    got = CPU.backward(replace(gaussians, sh=sh), camera, ones)
    for name in torch_reference.NAMES:
        assert np.isfinite(getattr(got, name)).all(), name


def test_the_number_of_threads_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = objects_scene(8, 900, sh_degree=1)
    camera = scene.cameras[0]
    target = np.random.default_rng(0).random((120, 160, 3)).astype(np.float32)
    results = []
    for n in ("1", "2", "5"):
        monkeypatch.setenv("GAGA_THREADS", n)
        results.append(CPU.train_step(scene.gaussians, camera, target, photometric))
    for other in results[1:]:
        assert other.value == results[0].value
        np.testing.assert_array_equal(other.image, results[0].image)
        for name in ("indices", *torch_reference.NAMES, "screen", "radii"):
            got, want = getattr(other.gradients, name), getattr(results[0].gradients, name)
            np.testing.assert_array_equal(got, want)


def test_a_step_is_render_loss_and_backward() -> None:
    gaussians = random_gaussians(200, seed=2, sh_degree=2)
    camera = orbit_cameras(3, width=70, height=50)[1]
    target = np.random.default_rng(0).random((50, 70, 3)).astype(np.float32)
    step = CPU.train_step(gaussians, camera, target, photometric, background=BACKGROUND)
    image = CPU.render(gaussians, camera, background=BACKGROUND).image
    np.testing.assert_allclose(step.image, image, atol=2e-6)
    value, by_image = photometric(step.image, target)
    assert step.value == value
    want = CPU.backward(gaussians, camera, by_image, background=BACKGROUND)
    for name in torch_reference.NAMES:
        np.testing.assert_array_equal(getattr(step.gradients, name), getattr(want, name))


def test_a_sink_takes_the_same_gradients_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole rows, each once, whatever the threads; nothing is left for the result."""
    scene = objects_scene(8, 900, sh_degree=1)
    camera = scene.cameras[0]
    target = np.random.default_rng(0).random((120, 160, 3)).astype(np.float32)
    names = ("indices", *torch_reference.NAMES, "screen", "radii")
    want = CPU.train_step(scene.gaussians, camera, target, photometric)
    for n in ("1", "3"):
        monkeypatch.setenv("GAGA_THREADS", n)
        pieces: list[dict[str, AnyArray]] = []

        def sink(piece: Gradients, pieces: list[dict[str, AnyArray]] = pieces) -> None:
            pieces.append({name: getattr(piece, name).copy() for name in names})

        step = CPU.train_step(scene.gaussians, camera, target, photometric, sink=sink)
        assert step.value == want.value
        assert len(step.gradients.indices) == 0
        assert len(pieces) > 1
        pieces.sort(key=lambda piece: int(piece["indices"][0]))
        for name in names:
            got = np.concatenate([piece[name] for piece in pieces])
            np.testing.assert_array_equal(got, getattr(want.gradients, name), err_msg=name)


def test_steps_down_the_gradient_find_the_picture() -> None:
    """100 steps of Adam on all parameters from a disturbed start, three views in turn."""
    rng = np.random.default_rng(0)
    truth = objects_scene(4, 120, sh_degree=1).gaussians
    cameras = [c.resized(64, 48) for c in objects_scene(4, 120).cameras[:3]]
    targets = [CPU.render(truth, c).image for c in cameras]
    state: dict[str, AnyArray] = {
        "means": truth.means + rng.normal(0, 0.03, truth.means.shape),
        "quats": truth.quats + rng.normal(0, 0.3, truth.quats.shape),
        "log_scales": truth.log_scales + rng.normal(0.2, 0.3, truth.log_scales.shape),
        "logit_opacities": truth.logit_opacities - 2.5,
        "sh": truth.sh * 0.3,
    }
    rates = [2e-3, 1e-2, 2e-2, 5e-2, 3e-2]
    first = {name: np.zeros_like(column) for name, column in state.items()}
    second = {name: np.zeros_like(column) for name, column in state.items()}
    for i in range(100):
        step = CPU.train_step(_as_gaussians(state), cameras[i % 3], targets[i % 3], photometric)
        for name, rate in zip(state, rates, strict=True):
            g = np.zeros_like(state[name])
            g[step.gradients.indices] = getattr(step.gradients, name)
            first[name] = 0.9 * first[name] + 0.1 * g
            second[name] = 0.99 * second[name] + 0.01 * g**2
            unbiased = np.sqrt(second[name] / (1 - 0.99 ** (i + 1))) + 1e-15
            state[name] -= rate * first[name] / (1 - 0.9 ** (i + 1)) / unbiased
        if i == 0:
            before = psnr(step.image, targets[0])
    after = psnr(CPU.render(_as_gaussians(state), cameras[0]).image, targets[0])
    assert after > before + 6


def _as_gaussians(state: dict[str, AnyArray]) -> Gaussians:
    columns = [state[name].astype(np.float32) for name in torch_reference.NAMES]
    means, quats, log_scales, logits, sh = columns
    return Gaussians(means, quats, log_scales, logits, sh)


def test_read_only_columns_take_the_same_kernels() -> None:
    gaussians = random_gaussians(100, seed=7, sh_degree=1)
    camera = orbit_cameras(3, width=48, height=40)[1]
    by_image = np.ones((40, 48, 3), np.float32)
    want = CPU.backward(gaussians, camera, by_image)
    kernels: list[Any] = [backward_kernels.backward_tiles, backward_splats]
    n_versions = [len(k.signatures) for k in kernels]
    locked = gaussians.take(np.arange(100))
    for name in torch_reference.NAMES:
        frozen(getattr(locked, name))
    got = CPU.backward(locked, camera, frozen(by_image))
    np.testing.assert_array_equal(got.means, want.means)
    assert [len(k.signatures) for k in kernels] == n_versions


def test_wrong_calls_name_the_argument() -> None:
    gaussians = random_gaussians(10)
    camera = orbit_cameras(1, width=20, height=10)[0]
    ones = np.ones((10, 20, 3), np.float32)
    with pytest.raises(ValueError, match="image_gradient"):
        CPU.backward(gaussians, camera, ones[:, :9])
    with pytest.raises(ValueError, match="alpha_gradient"):
        CPU.backward(gaussians, camera, ones, alpha_gradient=ones)
    with pytest.raises(ValueError, match="background"):
        CPU.backward(gaussians, camera, ones, background=np.zeros(4))
    with pytest.raises(ValueError, match="target"):
        CPU.train_step(gaussians, camera, ones[1:], photometric)
