"""Gradients of the CUDA backend are those of float64 autograd and of the CPU backend.

With gsplat where a CUDA device is (marked cuda, else skipped), and everywhere with the stand-in of
gsplat in plain torch: all of the way back but gsplat's own kernels.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster import base, probe
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.cuda import CudaRasterizer
from gaga_core.training.losses import photometric
from tests import gsplat_stand_in, torch_reference
from tests.core.raster.autograd import BACKGROUND, autograd
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CPU: base.TrainableRasterizer = CpuRasterizer()


@pytest.fixture(params=["stand-in", pytest.param("gsplat", marks=pytest.mark.cuda)])
def cuda(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> base.TrainableRasterizer:
    if request.param == "stand-in":
        gsplat_stand_in.install(monkeypatch)
        return CudaRasterizer("cpu")
    found = probe.verdict(may_compile=True)
    if not found.usable:
        pytest.skip(f"CUDA cannot draw here: {found.reason}")
    return CudaRasterizer()


def see_through(gaussians: Gaussians) -> Gaussians:
    """The same splats with alpha under 0.99: above, backends differ in their limit."""
    logits = np.minimum(gaussians.logit_opacities, 3.0).astype(np.float32)
    return replace(gaussians, logit_opacities=logits)


def assert_matches(
    engine: base.TrainableRasterizer, gaussians: Gaussians, camera: Camera
) -> base.Gradients:
    """Compare every parameter kind under random gradients of image and alpha."""
    rng = np.random.default_rng(7)
    by_image = rng.normal(size=(camera.height, camera.width, 3)).astype(np.float32)
    by_alpha = rng.normal(size=(camera.height, camera.width)).astype(np.float32)
    keywords = {"alpha_gradient": by_alpha, "background": BACKGROUND}
    got = engine.backward(gaussians, camera, by_image, **keywords)
    ours = CPU.backward(gaussians, camera, by_image, **keywords)
    # The CPU leaves splats out whose box, but not whose ellipse, touches the picture.
    mine = np.isin(got.indices, ours.indices)
    np.testing.assert_array_equal(got.indices[mine], ours.indices)
    assert (np.diff(got.indices) > 0).all()
    assert not got.screen[~mine].any()
    assert got.indices.dtype == ours.indices.dtype
    want = autograd(gaussians, camera, by_image, by_alpha)
    for name in torch_reference.NAMES:
        column = getattr(got, name)
        assert column[mine].shape == getattr(ours, name).shape
        assert column.dtype == np.float32
        full = np.zeros_like(want[name])
        full[got.indices] = column
        size = np.linalg.norm(want[name])
        assert size > 0
        assert np.linalg.norm(full - want[name]) <= 2e-3 * size, name
        assert (full * want[name]).sum() > 0.9999 * size * np.linalg.norm(full), name
    np.testing.assert_allclose(got.screen[mine], ours.screen, atol=2e-3 * ours.screen.max())
    np.testing.assert_allclose(got.radii[mine], ours.radii, rtol=1e-4)
    return got


@pytest.mark.parametrize("sh_degree", [0, 1, 3])
def test_every_degree_of_color(cuda: base.TrainableRasterizer, sh_degree: int) -> None:
    gaussians = see_through(random_gaussians(120, seed=sh_degree, sh_degree=sh_degree))
    assert_matches(cuda, gaussians, orbit_cameras(5, width=61, height=45)[sh_degree])


def test_a_clamped_jacobian(cuda: base.TrainableRasterizer) -> None:
    """Large splats beside the view that reach into it, past 1.3 times the half field."""
    gaussians = see_through(random_gaussians(80, seed=5))
    gaussians = replace(gaussians, log_scales=(gaussians.log_scales + 1.2).astype(np.float32))
    assert_matches(cuda, gaussians, orbit_cameras(3, width=50, height=40, radius=1.4)[0])


def test_opaque_splats_agree_with_the_cpu(cuda: base.TrainableRasterizer) -> None:
    """Alpha at its limit, which gsplat 1.5 sets at 0.999: the same direction of descent."""
    scene = objects_scene(4, 60, sh_degree=1)
    camera = scene.cameras[1].resized(77, 53)
    opaque = replace(scene.gaussians, logit_opacities=scene.gaussians.logit_opacities + 4)
    by_image = np.random.default_rng(0).normal(size=(53, 77, 3)).astype(np.float32)
    got, want = (engine.backward(opaque, camera, by_image) for engine in (cuda, CPU))
    for name in torch_reference.NAMES:
        a, b = getattr(got, name).ravel(), getattr(want, name).ravel()
        assert (a * b).sum() > 0.95 * np.linalg.norm(a) * np.linalg.norm(b), name


def test_a_step_is_render_loss_and_backward(cuda: base.TrainableRasterizer) -> None:
    gaussians = see_through(random_gaussians(150, seed=2, sh_degree=2))
    camera = orbit_cameras(3, width=70, height=50)[1]
    target = np.random.default_rng(0).random((50, 70, 3)).astype(np.float32)
    step = cuda.train_step(gaussians, camera, target, photometric, background=BACKGROUND)
    image = cuda.render(gaussians, camera, background=BACKGROUND).image
    np.testing.assert_allclose(step.image, image, atol=1e-5)
    value, by_image = photometric(step.image, target)
    assert step.value == value
    want = cuda.backward(gaussians, camera, by_image, background=BACKGROUND)
    for name in torch_reference.NAMES:
        size = np.abs(getattr(want, name)).max()
        np.testing.assert_allclose(
            getattr(step.gradients, name), getattr(want, name), atol=1e-5 * size
        )
    ours = CPU.train_step(gaussians, camera, target, photometric, background=BACKGROUND)
    assert step.value == pytest.approx(ours.value, rel=1e-3)


def test_nothing_in_view(cuda: base.TrainableRasterizer) -> None:
    camera = orbit_cameras(1, width=40, height=30)[0]
    behind = random_gaussians(50, sh_degree=1)
    behind = replace(behind, means=(behind.means + camera.position * 5).astype(np.float32))
    target = np.zeros((30, 40, 3), np.float32)
    for gaussians in (random_gaussians(0), behind):
        step = cuda.train_step(gaussians, camera, target, photometric, background=BACKGROUND)
        np.testing.assert_allclose(step.image[3, 4], BACKGROUND, rtol=1e-6)
        want = CPU.train_step(gaussians, camera, target, photometric, background=BACKGROUND)
        for name in ("indices", *torch_reference.NAMES, "screen", "radii"):
            got = getattr(step.gradients, name)
            assert got.shape == getattr(want.gradients, name).shape
            assert got.dtype == getattr(want.gradients, name).dtype


@pytest.mark.parametrize("column", ["means", "sh"])
def test_broken_splats_spoil_no_others(cuda: base.TrainableRasterizer, column: str) -> None:
    gaussians = see_through(random_gaussians(90, seed=4, sh_degree=1))
    camera = orbit_cameras(3, width=48, height=40)[1]
    values = getattr(gaussians, column).copy()
    values[::3] = np.nan
    broken = replace(gaussians, **{column: values})
    ones = np.ones((40, 48, 3), np.float32)
    got, want = (engine.backward(broken, camera, ones) for engine in (cuda, CPU))
    np.testing.assert_array_equal(got.indices, want.indices)
    for name in torch_reference.NAMES:
        a, b = getattr(got, name), getattr(want, name)
        assert np.isfinite(a).all(), name
        assert np.linalg.norm(a - b) < 5e-3 * np.linalg.norm(b), name


def test_wrong_calls_name_the_argument(cuda: base.TrainableRasterizer) -> None:
    gaussians = random_gaussians(10)
    camera = orbit_cameras(1, width=20, height=10)[0]
    ones = np.ones((10, 20, 3), np.float32)
    with pytest.raises(ValueError, match="image_gradient"):
        cuda.backward(gaussians, camera, ones[:, :9])
    with pytest.raises(ValueError, match="alpha_gradient"):
        cuda.backward(gaussians, camera, ones, alpha_gradient=ones)
    with pytest.raises(ValueError, match="background"):
        cuda.backward(gaussians, camera, ones, background=np.zeros(4))
    with pytest.raises(ValueError, match="target"):
        cuda.train_step(gaussians, camera, ones[1:], photometric)
