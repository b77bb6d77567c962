"""The CPU rasterizer draws what the float64 reference draws."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import AnyArray, FloatArray, frozen
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster import base, choose
from gaga_core.raster.cpu import blend_kernels, project_kernels
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.reference import ReferenceRasterizer
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CPU, REFERENCE = CpuRasterizer(), ReferenceRasterizer()


def assert_same(got: AnyArray, want: AnyArray, *, peak: float = 1.0) -> None:
    """Mean error under 1e-5 and PSNR over 80 dB: single pixels may fall either side of 1/255."""
    error = got.astype(np.float64) - want
    assert got.shape == want.shape
    assert np.isfinite(got).all()
    assert np.abs(error).mean() < 1e-5 * peak
    assert (error**2).mean() < 1e-8 * peak**2


def assert_same_frame(got: base.Frame, want: base.Frame) -> None:
    assert_same(got.image, want.image)
    assert_same(got.alpha, want.alpha)
    assert_same(got.expected_depth, want.expected_depth, peak=5)
    # A pixel with T = 1/2 to seven digits may take the next splat: depths jump there.
    differs = np.abs(got.median_depth - want.median_depth) > 1e-4
    assert differs.mean() < 2e-3


@pytest.mark.parametrize(
    ("width", "height", "sh_degree"), [(160, 120, 0), (149, 97, 3), (33, 64, 4), (7, 5, 1)]
)
def test_random_splats_match_the_reference(width: int, height: int, sh_degree: int) -> None:
    gaussians = random_gaussians(500, seed=width, sh_degree=sh_degree)
    camera = orbit_cameras(5, width=width, height=height)[2]
    background = np.array([0.2, 0.5, 0.7])
    assert_same_frame(
        CPU.render(gaussians, camera, background=background),
        REFERENCE.render(gaussians, camera, background=background),
    )


def test_objects_match_the_reference() -> None:
    scene = objects_scene(4, 200, sh_degree=2)
    camera = scene.cameras[3]
    assert_same_frame(
        CPU.render(scene.gaussians, camera), REFERENCE.render(scene.gaussians, camera)
    )


def test_camera_among_long_needles_matches_the_reference() -> None:
    """Needles that run past the camera: huge ellipses, of which float32 conics lose everything."""
    gaussians = random_gaussians(300, seed=1)
    log_scales = gaussians.log_scales.copy()
    log_scales[:, 0] += 3
    log_scales[:, 1] -= 3
    needles = replace(gaussians, log_scales=log_scales)
    camera = orbit_cameras(3, width=90, height=70, radius=0.5)[0]
    assert_same_frame(CPU.render(needles, camera), REFERENCE.render(needles, camera))


@pytest.mark.parametrize("n_channels", [1, 2, 3, 5, 19, 37])
def test_any_number_of_channels(n_channels: int) -> None:
    gaussians = random_gaussians(200, seed=2)
    camera = orbit_cameras(3, width=50, height=41)[1]
    rng = np.random.default_rng(0)
    channels = rng.random((200, n_channels)).astype(np.float32)
    background = rng.random(n_channels)
    got = CPU.render(gaussians, camera, channels=channels, background=background)
    want = REFERENCE.render(gaussians, camera, channels=channels, background=background)
    assert_same(got.image, want.image)


def test_channels_are_linear_in_the_weights() -> None:
    """F = W E: one row per pixel of sparse weights times the channels is the picture."""
    scene = objects_scene(3, 150)
    camera = scene.cameras[1].resized(67, 50)
    channels = np.random.default_rng(0).random((len(scene.gaussians), 6)).astype(np.float32)
    rows = CPU.weights(scene.gaussians, camera, np.arange(67 * 50))
    owner = np.repeat(np.arange(67 * 50), np.diff(rows.indptr))
    product = np.zeros((67 * 50, 6), np.float32)
    np.add.at(product, owner, rows.weights[:, None] * channels[rows.indices])
    image = CPU.render(scene.gaussians, camera, channels=channels).image
    np.testing.assert_allclose(product.reshape(50, 67, 6), image, atol=1e-5)


def test_nothing_to_draw() -> None:
    camera = orbit_cameras(1, width=40, height=30)[0]
    background = np.array([0.1, 0.2, 0.3])
    for gaussians in (random_gaussians(0), _moved(random_gaussians(50), camera.position * 5)):
        frame = CPU.render(gaussians, camera, background=background)
        np.testing.assert_allclose(frame.image, np.broadcast_to(background, (30, 40, 3)), rtol=1e-6)
        assert not frame.alpha.any()
        assert not frame.expected_depth.any()
        assert not frame.median_depth.any()
        labels = np.zeros(len(gaussians), np.int32)
        assert not CPU.label_splat(gaussians, camera, labels).confidence.any()
        assert len(CPU.weights(gaussians, camera, np.arange(9)).indices) == 0


def _moved(gaussians: Gaussians, offset: AnyArray) -> Gaussians:
    return replace(gaussians, means=(gaussians.means + offset).astype(np.float32))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", ["means", "quats", "log_scales"])
def test_broken_splats_are_left_out(column: str, value: float) -> None:
    """As if they were not there: the picture of the others, without a warning."""
    if column == "log_scales" and value == -np.inf:
        value = np.nan  # a scale of 0 is a flat splat, not a broken one
    gaussians = random_gaussians(120, seed=3)
    camera = orbit_cameras(3, width=48, height=40)[1]
    array = getattr(gaussians, column).copy()
    array[::3, 1] = value
    rest = gaussians.take(np.flatnonzero(np.arange(120) % 3))
    want = CPU.render(rest, camera)
    for rasterizer in (CPU, REFERENCE):
        got = rasterizer.render(replace(gaussians, **{column: array}), camera)
        assert_same(got.image, want.image)


def test_splats_without_orientation_or_opacity_are_left_out() -> None:
    gaussians = random_gaussians(90, seed=4)
    camera = orbit_cameras(3, width=48, height=40)[1]
    quats, logits = gaussians.quats.copy(), gaussians.logit_opacities.copy()
    quats[::3] = 0
    logits[1::3] = np.nan
    broken = replace(gaussians, quats=quats, logit_opacities=logits)
    want = CPU.render(gaussians.take(np.arange(2, 90, 3)), camera)
    for rasterizer in (CPU, REFERENCE):
        assert_same(rasterizer.render(broken, camera).image, want.image)


def test_a_color_that_is_no_number_is_black() -> None:
    gaussians = random_gaussians(60, seed=5)
    camera = orbit_cameras(3, width=48, height=40)[1]
    sh = gaussians.sh.copy()
    sh[::2] = np.nan
    frame = CPU.render(replace(gaussians, sh=sh), camera)
    sh[::2] = -10
    assert_same(frame.image, CPU.render(replace(gaussians, sh=sh), camera).image)


def test_full_opacity_stored_as_infinity_is_drawn() -> None:
    gaussians = random_gaussians(60, seed=6)
    camera = orbit_cameras(3, width=48, height=40)[1]
    logits = np.full(60, np.inf, np.float32)
    frame = CPU.render(replace(gaussians, logit_opacities=logits), camera)
    assert_same(
        frame.alpha, REFERENCE.render(replace(gaussians, logit_opacities=logits), camera).alpha
    )
    assert frame.alpha.max() > 0.98


def test_the_nearer_splat_hides_the_farther() -> None:
    """Two opaque walls, in either order in the file: the near one's color and depth."""
    camera = Camera(np.array([[50, 0, 20], [0, 50, 16], [0, 0, 1.0]]), np.eye(4), 40, 32)
    for near_first in (True, False):
        depths = np.array([2, 4] if near_first else [4, 2], np.float32)
        means = np.zeros((10, 3), np.float32)
        means[:, 2] = np.repeat(depths, 5)
        channels = means[:, 2:].copy()
        walls = Gaussians(
            means=means,
            quats=np.tile(np.array([1, 0, 0, 0], np.float32), (10, 1)),
            log_scales=np.full((10, 3), 2.0, np.float32),
            logit_opacities=np.full(10, 2.0, np.float32),
            sh=np.zeros((10, 1, 3), np.float32),
        )
        frame = CPU.render(walls, camera, channels=channels)
        np.testing.assert_allclose(frame.image[..., 0], 2, atol=1e-3)
        np.testing.assert_allclose(frame.median_depth, 2)


def test_read_only_columns_are_drawn_alike() -> None:
    """Frozen and memory-mapped arrays take the same kernels: no second compile, no copy."""
    gaussians = random_gaussians(100, seed=7, sh_degree=1)
    camera = orbit_cameras(3, width=48, height=40)[1]
    want = CPU.render(gaussians, camera).image
    kernels: list[Any] = [project_kernels.project, project_kernels.sh_colors]
    n_versions = [len(k.signatures) for k in kernels]
    locked = gaussians.take(np.arange(100))
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        frozen(getattr(locked, name))
    assert np.array_equal(CPU.render(locked, camera).image, want)
    assert [len(k.signatures) for k in kernels] == n_versions


def test_the_exponential_of_the_kernels_is_one() -> None:
    x = np.linspace(-5.7, 0, 2001, dtype=np.float32)
    got = np.array([blend_kernels._exp(value) for value in x], np.float64)
    np.testing.assert_allclose(got, np.exp(x.astype(np.float64)), rtol=3e-6)
    assert blend_kernels._exp(np.float32(0)) == 1


def test_kernels_share_the_image_model_of_the_protocol() -> None:
    """Kernels repeat the constants: a cached kernel does not notice a change of another file."""
    want = [base.ALPHA_MIN, base.ALPHA_MAX, base.T_MIN]
    got = [blend_kernels._ALPHA_MIN, blend_kernels._ALPHA_MAX, blend_kernels._T_MIN]
    assert got == [np.float32(x) for x in want]


def test_choose_names_the_backends() -> None:
    assert choose().name == "cpu"
    assert choose("reference").name == "reference"
    for name in ("cuda", "quantum"):
        with pytest.raises(GagaError, match="cpu"):
            choose(name)


def test_wrong_calls_name_the_argument() -> None:
    gaussians = random_gaussians(10)
    camera = orbit_cameras(1, width=20, height=10)[0]
    histogram: FloatArray = np.zeros((10, 2), np.float32)
    with pytest.raises(ValueError, match="channels"):
        CPU.render(gaussians, camera, channels=np.zeros((9, 3), np.float32))
    with pytest.raises(ValueError, match="background"):
        CPU.render(gaussians, camera, background=np.zeros(2))
    with pytest.raises(ValueError, match="pixels"):
        CPU.weights(gaussians, camera, np.array([200]))
    with pytest.raises(ValueError, match="labels"):
        CPU.vote(gaussians, camera, np.full((10, 20), 2, np.int32), histogram)
    with pytest.raises(ValueError, match="labels"):
        CPU.label_splat(gaussians, camera, np.full(10, -1, np.int32))
