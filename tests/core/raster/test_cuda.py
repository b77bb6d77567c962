"""What the CUDA backend draws is what the CPU draws.

With gsplat where a CUDA device is (marked cuda, else skipped), and everywhere with a stand-in of
gsplat in plain torch: all of the backend but gsplat itself.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import AnyArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.raster import base, probe
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.cuda import CudaRasterizer
from tests import gsplat_stand_in
from tests.scenes import Synthetic, objects_scene, orbit_cameras, random_gaussians

CPU = CpuRasterizer()


@pytest.fixture(params=["stand-in", pytest.param("gsplat", marks=pytest.mark.cuda)])
def cuda(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> base.Rasterizer:
    if request.param == "stand-in":
        return stand_in(monkeypatch)
    found = probe.verdict(may_compile=True)
    if not found.usable:
        pytest.skip(f"CUDA cannot draw here: {found.reason}")
    return CudaRasterizer()


def stand_in(monkeypatch: pytest.MonkeyPatch, *, contributors: bool = False) -> CudaRasterizer:
    """The backend on the processor, with several bands of pixels and pieces of Gaussians."""
    gsplat_stand_in.install(monkeypatch, contributors=contributors)
    monkeypatch.setattr("gaga_core.raster.cuda.rasterizer._ENTRIES", 100_000)
    monkeypatch.setattr("gaga_core.raster.cuda.view._ROWS", 300)
    return CudaRasterizer("cpu")


def small(n_objects: int = 4, per_object: int = 80, sh_degree: int = 1) -> Synthetic:
    scene = objects_scene(n_objects, per_object, sh_degree=sh_degree)
    return replace(scene, cameras=tuple(c.resized(77, 53) for c in scene.cameras))


def psnr(got: AnyArray, want: AnyArray) -> float:
    assert got.shape == want.shape
    assert got.dtype == want.dtype
    assert np.isfinite(got).all()
    return float(-10 * np.log10(((got.astype(np.float64) - want) ** 2).mean() + 1e-20))


def test_the_self_test_passes(cuda: base.Rasterizer) -> None:
    assert probe.largest_error(cuda) < probe._TOLERANCE


@pytest.mark.parametrize("sh_degree", [0, 1, 3, 4])
def test_pictures_match_the_cpu(cuda: base.Rasterizer, sh_degree: int) -> None:
    gaussians = random_gaussians(350, seed=sh_degree, sh_degree=sh_degree)
    camera = orbit_cameras(5, width=69, height=50)[2]
    background = np.array([0.2, 0.5, 0.7])
    got = cuda.render(gaussians, camera, background=background)
    want = CPU.render(gaussians, camera, background=background)
    assert psnr(got.image, want.image) >= 45
    assert psnr(got.alpha, want.alpha) >= 45
    assert psnr(got.expected_depth / 5, want.expected_depth / 5) >= 45
    differs = np.abs(got.median_depth - want.median_depth) > 1e-3
    assert differs.mean() < 0.01


@pytest.mark.parametrize("n_channels", [1, 3, 6, 31, 40])
def test_any_number_of_channels(cuda: base.Rasterizer, n_channels: int) -> None:
    scene = small()
    rng = np.random.default_rng(0)
    channels = rng.random((len(scene.gaussians), n_channels)).astype(np.float32)
    background = rng.random(n_channels)
    arguments = (scene.gaussians, scene.cameras[1])
    got = cuda.render(*arguments, channels=channels, background=background)
    want = CPU.render(*arguments, channels=channels, background=background)
    assert psnr(got.image, want.image) >= 45


@pytest.mark.parametrize("w_min", [0.0, 1 / 64])
def test_weights_of_sampled_pixels_match_the_cpu(cuda: base.Rasterizer, w_min: float) -> None:
    scene = small()
    pixels = np.random.default_rng(0).integers(0, 77 * 53, 500)  # in any order, some twice
    got = cuda.weights(scene.gaussians, scene.cameras[0], pixels, w_min=w_min)
    want = CPU.weights(scene.gaussians, scene.cameras[0], pixels, w_min=w_min)
    assert (got.indptr.dtype, got.indices.dtype, got.weights.dtype) == (
        want.indptr.dtype,
        want.indices.dtype,
        want.weights.dtype,
    )
    same = np.diff(got.indptr) == np.diff(want.indptr)
    assert same.mean() > 0.99
    rows = [np.repeat(same, np.diff(x.indptr)) for x in (got, want)]
    assert (got.indices[rows[0]] == want.indices[rows[1]]).mean() > 0.99
    assert np.abs(got.weights[rows[0]] - want.weights[rows[1]]).mean() < 1e-3
    assert (got.weights > np.float32(w_min)).all()


def test_rows_of_weights_give_the_picture(cuda: base.Rasterizer) -> None:
    scene = small()
    rows = cuda.weights(scene.gaussians, scene.cameras[2], np.arange(77 * 53))
    owner = np.repeat(np.arange(77 * 53), np.diff(rows.indptr))
    sums = np.bincount(owner, rows.weights, 77 * 53).reshape(53, 77)
    alpha = cuda.render(scene.gaussians, scene.cameras[2]).alpha
    np.testing.assert_allclose(sums, alpha, atol=2e-3)


def test_votes_match_the_cpu_and_add_up(cuda: base.Rasterizer) -> None:
    """40 labels: two chunks; negative ones are ignored; what was there stays."""
    scene = small()
    labels = np.random.default_rng(0).integers(-1, 40, (53, 77)).astype(np.int32)
    got, want = (np.ones((len(scene.gaussians), 45), np.float32) for _ in range(2))
    cuda.vote(scene.gaussians, scene.cameras[0], labels, got)
    CPU.vote(scene.gaussians, scene.cameras[0], labels, want)
    assert np.abs(got - want).max() < 0.05
    assert np.abs(got - want).sum() < 0.005 * (want - 1).sum()
    assert (got[:, 40:] == 1).all()


@pytest.mark.parametrize("n_labels", [5, 90])
def test_label_maps_match_the_cpu(cuda: base.Rasterizer, n_labels: int) -> None:
    scene = small()
    labels = np.random.default_rng(0).integers(0, n_labels, len(scene.gaussians)).astype(np.int32)
    labels[labels == 3] = 2**31 - 1
    for mine in (labels, scene.labels):
        got = cuda.label_splat(scene.gaussians, scene.cameras[0], mine)
        want = CPU.label_splat(scene.gaussians, scene.cameras[0], mine)
        assert got.labels.dtype == np.int32
        assert (got.labels == want.labels).mean() >= 0.99
        assert psnr(got.confidence, want.confidence) >= 45


def test_nothing_to_draw(cuda: base.Rasterizer) -> None:
    camera = orbit_cameras(1, width=40, height=30)[0]
    behind = random_gaussians(50)
    behind = replace(behind, means=(behind.means + camera.position * 5).astype(np.float32))
    for gaussians in (random_gaussians(0), behind):
        frame = cuda.render(gaussians, camera, background=np.array([0.1, 0.2, 0.3]))
        np.testing.assert_allclose(frame.image[3, 4], [0.1, 0.2, 0.3], rtol=1e-6)
        assert frame.image.shape == (30, 40, 3)
        for plane in (frame.alpha, frame.expected_depth, frame.median_depth):
            assert not plane.any()
        labels = np.ones(len(gaussians), np.int32)
        assert not cuda.label_splat(gaussians, camera, labels).labels.any()
        histogram = np.zeros((len(gaussians), 2), np.float32)
        cuda.vote(gaussians, camera, np.ones((30, 40), np.int32), histogram)
        assert not histogram.any()
        assert len(cuda.weights(gaussians, camera, np.arange(9)).indices) == 0


@pytest.mark.parametrize("column", ["means", "quats", "log_scales", "logit_opacities", "sh"])
def test_broken_splats_are_left_out(cuda: base.Rasterizer, column: str) -> None:
    gaussians = random_gaussians(120, seed=3)
    camera = orbit_cameras(3, width=48, height=40)[1]
    array = getattr(gaussians, column).copy()
    array[::3] = np.nan
    broken = replace(gaussians, **{column: array})
    assert psnr(cuda.render(broken, camera).image, CPU.render(broken, camera).image) >= 45


def test_wrong_calls_name_the_argument(cuda: base.Rasterizer) -> None:
    gaussians = random_gaussians(10)
    camera = orbit_cameras(1, width=20, height=10)[0]
    with pytest.raises(ValueError, match="channels"):
        cuda.render(gaussians, camera, channels=np.zeros((9, 3), np.float32))
    with pytest.raises(ValueError, match="background"):
        cuda.render(gaussians, camera, background=np.zeros(2))
    with pytest.raises(ValueError, match="pixels"):
        cuda.weights(gaussians, camera, np.array([200]))
    with pytest.raises(ValueError, match="labels"):
        cuda.vote(gaussians, camera, np.full((10, 20), 2, np.int32), np.zeros((10, 2), np.float32))
    with pytest.raises(ValueError, match="labels"):
        cuda.label_splat(gaussians, camera, np.full(10, -1, np.int32))


def test_a_card_without_memory_says_so_and_votes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    module = gsplat_stand_in.install(monkeypatch)
    engine = CudaRasterizer("cpu")
    drawn: list[int] = []

    def full(*arguments: object) -> object:
        drawn.append(1)
        if len(drawn) > 1:
            raise torch.OutOfMemoryError("CUDA out of memory")
        return gsplat_stand_in.rasterize_to_pixels(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "rasterize_to_pixels", full)
    scene = small()
    labels = np.arange(53 * 77, dtype=np.int32).reshape(53, 77) % 40
    histogram = np.zeros((len(scene.gaussians), 40), np.float32)
    with pytest.raises(GagaError, match="not enough free memory"):
        engine.vote(scene.gaussians, scene.cameras[0], labels, histogram)
    assert not histogram.any()


def test_newer_gsplat_lists_the_same_contributions(monkeypatch: pytest.MonkeyPatch) -> None:
    """gsplat 1.6 gives weights with its lists; for 1.5 they are computed again."""
    scene = small(3, 60)
    pixels = np.arange(77 * 53)
    results = []
    for contributors in (False, True):
        engine = stand_in(monkeypatch, contributors=contributors)
        rows = engine.weights(scene.gaussians, scene.cameras[0], pixels)
        results.append((rows, engine.render(scene.gaussians, scene.cameras[0]).median_depth))
    (old, old_median), (new, new_median) = results
    np.testing.assert_array_equal(old.indices, new.indices)
    np.testing.assert_allclose(old.weights, new.weights, atol=1e-6)
    np.testing.assert_array_equal(old_median, new_median)


def test_equal_weights_give_the_smaller_label(cuda: base.Rasterizer) -> None:
    """Opacity 1/5 before 1/4, centred on a pixel: both weigh exactly 1/5 there."""
    camera = Camera(np.array([[30, 0, 8.5], [0, 30, 8.5], [0, 0, 1.0]]), np.eye(4), 17, 17)
    pair = Gaussians(
        means=np.array([[0, 0, 1], [0, 0, 2]], np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        log_scales=np.full((2, 3), -2, np.float32),
        logit_opacities=np.log(np.array([1 / 4, 1 / 3])).astype(np.float32),
        sh=np.zeros((2, 1, 3), np.float32),
    )
    first, second = cuda.weights(pair, camera, np.array([8 * 17 + 8])).weights
    assert first == pytest.approx(second, abs=1e-6)
    for order in ((4, 2), (2, 4), (70, 2), (2, 70)):
        frame = cuda.label_splat(pair, camera, np.array(order, np.int32))
        assert frame.labels[8, 8] == 2 or first != second
