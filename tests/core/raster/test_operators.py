"""Every backend draws, weighs, votes and labels as the float64 reference does."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gaga_core.arrays import AnyArray, FloatArray, IntArray, frozen
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.io.splats.ply import read_ply
from gaga_core.raster import base, choose, probe
from gaga_core.raster.cpu import blend_kernels, project_kernels, rasterizer
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.cuda import CudaRasterizer
from gaga_core.raster.reference import ReferenceRasterizer
from tests import gsplat_stand_in
from tests.scenes import Synthetic, objects_scene, orbit_cameras, random_gaussians

CPU, REFERENCE = CpuRasterizer(), ReferenceRasterizer()
Engine = base.Rasterizer


def assert_same(engine: Engine, got: AnyArray, want: AnyArray, *, peak: float = 1.0) -> None:
    """PSNR over 80 dB on the CPU: single pixels may fall either side of 1/255. gsplat: 45 dB."""
    error = got.astype(np.float64) - want
    assert (got.shape, got.dtype) == (want.shape, want.dtype)
    assert np.isfinite(got).all()
    if engine.name == "cpu":
        assert np.abs(error).mean() < 1e-5 * peak
    assert (error**2).mean() < (1e-8 if engine.name == "cpu" else 10**-4.5) * peak**2


def assert_same_frame(engine: Engine, got: base.Frame, want: base.Frame) -> None:
    assert_same(engine, got.image, want.image)
    assert_same(engine, got.alpha, want.alpha)
    assert_same(engine, got.expected_depth, want.expected_depth, peak=5)
    # A pixel with T = 1/2 to seven digits may take the next splat: depths jump there.
    differs = np.abs(got.median_depth - want.median_depth) > 1e-3
    assert differs.mean() < (2e-3 if engine.name == "cpu" else 0.01)


def small(n_objects: int = 4, per_object: int = 80, sh_degree: int = 1) -> Synthetic:
    scene = objects_scene(n_objects, per_object, sh_degree=sh_degree)
    return replace(scene, cameras=tuple(c.resized(77, 53) for c in scene.cameras))


def stretched(gaussians: Gaussians, by: float) -> Gaussians:
    log_scales = gaussians.log_scales.copy()
    log_scales[:, 0] += by
    log_scales[:, 1] -= by
    return replace(gaussians, log_scales=log_scales)


@pytest.mark.parametrize(
    ("width", "height", "sh_degree"), [(149, 97, 3), (69, 50, 0), (33, 64, 4), (7, 5, 1)]
)
def test_random_splats(engine: Engine, width: int, height: int, sh_degree: int) -> None:
    gaussians = random_gaussians(500, seed=width, sh_degree=sh_degree)
    camera = orbit_cameras(5, width=width, height=height)[2]
    background = np.array([0.2, 0.5, 0.7])
    got, want = (r.render(gaussians, camera, background=background) for r in (engine, REFERENCE))
    assert_same_frame(engine, got, want)


def test_objects_and_a_camera_among_long_needles() -> None:
    """Needles that run past the camera: huge ellipses, of which float32 conics lose everything."""
    scene = objects_scene(4, 200, sh_degree=2)
    needles = stretched(random_gaussians(300, seed=1), 3.0)
    among = orbit_cameras(3, width=90, height=70, radius=0.5)[0]
    for gaussians, camera in ((scene.gaussians, scene.cameras[3]), (needles, among)):
        got, want = (r.render(gaussians, camera) for r in (CPU, REFERENCE))
        assert_same_frame(CPU, got, want)


@pytest.mark.parametrize("n_channels", [1, 2, 5, 19, 31, 40])
def test_any_number_of_channels(engine: Engine, n_channels: int) -> None:
    scene = small(per_object=50)
    rng = np.random.default_rng(0)
    channels = rng.random((len(scene.gaussians), n_channels)).astype(np.float32)
    background = rng.random(n_channels)
    arguments = (scene.gaussians, scene.cameras[1])
    got = engine.render(*arguments, channels=channels, background=background)
    want = REFERENCE.render(*arguments, channels=channels, background=background)
    assert_same(engine, got.image, want.image)


def test_weights_of_sampled_pixels(engine: Engine) -> None:
    scene = small()
    pixels = np.random.default_rng(0).integers(0, 77 * 53, 400)  # in any order, some twice
    got, want = (r.weights(scene.gaussians, scene.cameras[0], pixels) for r in (engine, REFERENCE))
    for name in ("indptr", "indices", "weights"):
        assert getattr(got, name).dtype == getattr(want, name).dtype
    same = np.diff(got.indptr) == np.diff(want.indptr)
    assert same.mean() > 0.99
    rows = [np.repeat(same, np.diff(x.indptr)) for x in (got, want)]
    assert (got.indices[rows[0]] == want.indices[rows[1]]).mean() > 0.99
    apart = np.abs(got.weights[rows[0]] - want.weights[rows[1]])
    assert apart.mean() < (1e-6 if engine.name == "cpu" else 1e-3)
    large = engine.weights(scene.gaussians, scene.cameras[0], pixels, w_min=1 / 64)
    keep = got.weights > np.float32(1 / 64)
    np.testing.assert_array_equal(large.indices, got.indices[keep])
    np.testing.assert_array_equal(large.weights, got.weights[keep])


def test_pictures_are_linear_in_the_weights(engine: Engine) -> None:
    """F = W E: one row per pixel of sparse weights, front to back, times the channels."""
    scene = small()
    channels = np.random.default_rng(0).random((len(scene.gaussians), 6)).astype(np.float32)
    rows = engine.weights(scene.gaussians, scene.cameras[2], np.arange(77 * 53))
    owner = np.repeat(np.arange(77 * 53), np.diff(rows.indptr))
    product = np.zeros((77 * 53, 6), np.float32)
    np.add.at(product, owner, rows.weights[:, None] * channels[rows.indices])
    sums = np.bincount(owner, rows.weights, 77 * 53).reshape(53, 77)
    frame = engine.render(scene.gaussians, scene.cameras[2], channels=channels)
    off = 1e-5 if engine.name == "cpu" else 2e-3
    np.testing.assert_allclose(product.reshape(53, 77, 6), frame.image, atol=off)
    np.testing.assert_allclose(sums, frame.alpha, atol=off)
    depth = scene.cameras[2].project(scene.gaussians.means.astype(np.float64))[1][rows.indices]
    assert (np.diff(depth)[np.diff(owner) == 0] > -1e-6).all()


@pytest.mark.parametrize("batch", [1 << 23, 1000])
def test_votes_are_the_transpose_product_of_the_weights(
    engine: Engine, batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 labels; what was there stays; negative labels are ignored; batches change nothing."""
    monkeypatch.setattr(rasterizer, "_BATCH", batch)
    scene = small()
    camera, rng = scene.cameras[0], np.random.default_rng(0)
    blocks = np.repeat(np.repeat(rng.integers(-1, 40, (14, 16)), 4, 0), 5, 1)
    labels = np.ascontiguousarray(blocks[:53, :77], np.int32)
    labels[20:30] = rng.integers(-1, 40, (10, 77))
    histogram = np.ones((len(scene.gaussians), 45), np.float32)
    engine.vote(scene.gaussians, camera, labels, histogram)
    rows = engine.weights(scene.gaussians, camera, np.flatnonzero(labels.ravel() >= 0))
    owner = np.repeat(labels[labels >= 0], np.diff(rows.indptr))
    want = np.ones_like(histogram)
    np.add.at(want, (rows.indices, owner), rows.weights)
    if engine.name == "cpu":
        np.testing.assert_allclose(histogram, want, rtol=1e-4)
    assert np.abs(histogram - want).max() < 0.05
    assert np.abs(histogram - want).sum() < 0.005 * (want - 1).sum()
    assert (histogram[:, 40:] == 1).all()


def test_votes_match_the_reference() -> None:
    gaussians = random_gaussians(200, seed=2)
    camera = orbit_cameras(3, width=61, height=47)[1]
    labels = np.random.default_rng(0).integers(-1, 300, (47, 61)).astype(np.int32)
    got, want = np.zeros((2, 200, 300), np.float32)
    CPU.vote(gaussians, camera, labels, got)
    REFERENCE.vote(gaussians, camera, labels, want)
    np.testing.assert_allclose(got, want, atol=1e-5)


@pytest.mark.parametrize("n_labels", [2, 30, 700])
def test_label_splat_is_the_argmax_of_one_channel_per_label(engine: Engine, n_labels: int) -> None:
    """Ids may be huge."""
    gaussians = random_gaussians(300, seed=3)
    camera = orbit_cameras(3, width=61, height=47)[1]
    labels = np.random.default_rng(0).integers(0, n_labels, 300).astype(np.int32)
    one_hot = np.eye(n_labels, dtype=np.float32)[labels]
    image = CPU.render(gaussians, camera, channels=one_hot).image
    ids = np.concatenate([np.arange(n_labels - 1), [2**31 - 1]]).astype(np.int32)
    got = engine.label_splat(gaussians, camera, ids[labels])
    assert got.labels.dtype == np.int32
    assert_same(engine, got.confidence, image.max(axis=2))
    gap = np.diff(np.partition(image, -2, axis=2)[..., -2:], axis=2)[..., 0]
    clear = gap > (1e-5 if engine.name == "cpu" else 2e-2)
    assert clear.mean() > 0.4
    right = got.labels[clear] == ids[image.argmax(axis=2)[clear]]
    assert right.mean() >= (1 if engine.name == "cpu" else 0.995)
    assert not got.labels[image.max(axis=2) == 0].any()


def test_labels_and_outlines_of_one_pass_are_those_of_several() -> None:
    """Bit for bit; objects that nobody sees have an outline, too: it is theirs alone, or seen."""
    scene, background = small(n_objects=70, per_object=30), np.array([0.1, 0.5, 0.9])
    scene.gaussians.logit_opacities[:] += 4  # what is in front hides the rest
    n_hidden, void = 0, 0.3
    objects = np.arange(1, 71, 2, dtype=np.int32)
    for camera in scene.cameras[:3]:
        drawn = CPU.labelled(scene.gaussians, camera, scene.labels, objects, void, background)
        found = drawn.outlines
        want = CPU.render(scene.gaussians, camera, background=background)
        for name in ("image", "alpha", "median_depth"):
            np.testing.assert_array_equal(getattr(drawn, name), getattr(want, name))
        map_ = CPU.label_splat(scene.gaussians, camera, scene.labels)
        shown = np.where(map_.confidence < void, 0, map_.labels)
        np.testing.assert_array_equal(found.labels, shown)
        assert set(found.objects.tolist()) <= set(objects.tolist())
        for k, group in enumerate(found.objects.tolist()):
            rows = np.flatnonzero(scene.labels == group)
            alone = CPU.render(scene.gaussians.take(rows), camera).alpha >= 0.5
            seen = shown == group
            n_hidden += bool(alone.any() and not seen.any())
            assert (found.whole(k) != (alone | seen)).mean() < 1e-3  # at T = 1/2 to seven digits
    assert n_hidden > 0


def test_equal_weights_give_the_smaller_label(engine: Engine) -> None:
    """Opacity 1/5 before 1/4, centred on a pixel: both weigh exactly 1/5 there."""
    camera = Camera(np.array([[30, 0, 8.5], [0, 30, 8.5], [0, 0, 1.0]]), np.eye(4), 17, 17)
    pair = Gaussians(
        means=np.array([[0, 0, 1], [0, 0, 2]], np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1)),
        log_scales=np.full((2, 3), -2, np.float32),
        logit_opacities=np.log(np.array([1 / 4, 1 / 3])).astype(np.float32),
        sh=np.zeros((2, 1, 3), np.float32),
    )
    first, second = engine.weights(pair, camera, np.array([8 * 17 + 8])).weights
    assert first == pytest.approx(second, abs=0 if engine.name == "cpu" else 1e-6)
    for order in ((4, 2), (2, 4), (70, 2), (2, 70)):
        frame = engine.label_splat(pair, camera, np.array(order, np.int32))
        assert frame.labels[8, 8] == 2 or first != second


def test_labels_of_objects_show_where_they_stand() -> None:
    """The projected centre of each ball in front shows its own label."""
    scene = objects_scene()
    camera = scene.cameras[0]
    frame = CPU.label_splat(scene.gaussians, camera, scene.labels)
    centres = np.array([scene.gaussians.means[scene.labels == k].mean(0) for k in range(1, 7)])
    pixels, depth = camera.project(centres.astype(np.float64))
    nearest = int(depth.argmin())
    u, v = pixels[nearest].astype(int)
    assert frame.labels[v, u] == nearest + 1
    assert frame.confidence[v, u] > 0.9


def true_labels(folder: Path, camera: Camera) -> IntArray:
    return read_labels(folder / "gt" / "instance" / Path(camera.name).with_suffix(".png").name)


def test_true_masks_voted_into_a_real_scene_come_back(ycb_table: Path) -> None:
    """Votes of the true masks of 8 views, splatted into another view, give its true mask."""
    gaussians = read_ply(ycb_table / "point_cloud.ply")
    views = open_scene_folder(ycb_table).cameras
    histogram = np.zeros((len(gaussians), 17), np.float32)
    for camera in views[0:64:8]:
        CPU.vote(gaussians, camera, true_labels(ycb_table, camera), histogram)
    labels = histogram.argmax(axis=1).astype(np.int32)
    frame = CPU.label_splat(gaussians, views[5], labels)
    assert (frame.labels == true_labels(ycb_table, views[5])).mean() > 0.97


def test_nothing_to_draw(engine: Engine) -> None:
    camera = orbit_cameras(1, width=40, height=30)[0]
    background = np.array([0.1, 0.2, 0.3])
    behind = random_gaussians(50)
    behind = replace(behind, means=(behind.means + camera.position * 5).astype(np.float32))
    for gaussians in (random_gaussians(0), behind):
        frame = engine.render(gaussians, camera, background=background)
        np.testing.assert_allclose(frame.image, np.broadcast_to(background, (30, 40, 3)), rtol=1e-6)
        for plane in (frame.alpha, frame.expected_depth, frame.median_depth):
            assert not plane.any()
        labels = np.ones(len(gaussians), np.int32)
        assert not engine.label_splat(gaussians, camera, labels).labels.any()
        histogram = np.zeros((len(gaussians), 2), np.float32)
        engine.vote(gaussians, camera, np.ones((30, 40), np.int32), histogram)
        assert not histogram.any()
        assert len(engine.weights(gaussians, camera, np.arange(9)).indices) == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0])
@pytest.mark.parametrize("column", ["means", "quats", "log_scales", "logit_opacities"])
def test_broken_splats_are_left_out(engine: Engine, column: str, value: float) -> None:
    """As if they were not there: the picture of the others, without a warning."""
    gaussians = random_gaussians(120, seed=3)
    camera = orbit_cameras(3, width=48, height=40)[1]
    array = getattr(gaussians, column).copy()
    is_broken = (column, value) == ("quats", 0) or np.isnan(value)  # no orientation; no number
    is_broken |= np.isinf(value) and column != "logit_opacities"
    is_broken &= (column, value) != ("log_scales", -np.inf)  # of no size: flat
    array[::3] = value
    changed = replace(gaussians, **{column: array})
    rest = gaussians.take(np.flatnonzero(np.arange(120) % 3)) if is_broken else changed
    want = REFERENCE.render(rest, camera)
    for each in (engine, REFERENCE):
        assert_same(engine, each.render(changed, camera).image, want.image)


def test_a_color_that_is_no_number_is_black(engine: Engine) -> None:
    gaussians = random_gaussians(60, seed=5)
    camera = orbit_cameras(3, width=48, height=40)[1]
    sh = gaussians.sh.copy()
    sh[::2] = np.nan
    frame = engine.render(replace(gaussians, sh=sh), camera)
    sh[::2] = -10
    assert_same(engine, frame.image, engine.render(replace(gaussians, sh=sh), camera).image)


@pytest.mark.parametrize("depths", [(2, 4), (4, 2)])
def test_the_nearer_splat_hides_the_farther(depths: tuple[int, int]) -> None:
    """Two opaque walls, in either order in the file: the near one's color and depth."""
    camera = Camera(np.array([[50, 0, 20], [0, 50, 16], [0, 0, 1.0]]), np.eye(4), 40, 32)
    means = np.zeros((10, 3), np.float32)
    means[:, 2] = np.repeat(depths, 5)
    walls = Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (10, 1)),
        log_scales=np.full((10, 3), 2.0, np.float32),
        logit_opacities=np.full(10, 2.0, np.float32),
        sh=np.zeros((10, 1, 3), np.float32),
    )
    frame = CPU.render(walls, camera, channels=means[:, 2:].copy())
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


def test_wrong_calls_name_the_argument(engine: Engine) -> None:
    gaussians = random_gaussians(10)
    camera = orbit_cameras(1, width=20, height=10)[0]
    histogram: FloatArray = np.zeros((10, 2), np.float32)
    with pytest.raises(ValueError, match="channels"):
        engine.render(gaussians, camera, channels=np.zeros((9, 3), np.float32))
    with pytest.raises(ValueError, match="background"):
        engine.render(gaussians, camera, background=np.zeros(2))
    with pytest.raises(ValueError, match="pixels"):
        engine.weights(gaussians, camera, np.array([200]))
    with pytest.raises(ValueError, match="labels"):
        engine.vote(gaussians, camera, np.full((10, 20), 2, np.int32), histogram)
    with pytest.raises(ValueError, match="labels"):
        engine.label_splat(gaussians, camera, np.full(10, -1, np.int32))


# --- The CUDA backend alone.


def test_the_self_test_passes(engine: Engine) -> None:
    assert probe.largest_error(engine) < probe._TOLERANCE


def test_a_card_without_memory_says_so_and_votes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
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
    results = []
    for contributors in (False, True):
        gsplat_stand_in.install(monkeypatch, contributors=contributors)
        monkeypatch.setattr("gaga_core.raster.cuda.rasterizer._ENTRIES", 100_000)
        engine = CudaRasterizer("cpu")
        rows = engine.weights(scene.gaussians, scene.cameras[0], np.arange(77 * 53))
        results.append((rows, engine.render(scene.gaussians, scene.cameras[0]).median_depth))
    (old, old_median), (new, new_median) = results
    np.testing.assert_array_equal(old.indices, new.indices)
    np.testing.assert_allclose(old.weights, new.weights, atol=1e-6)
    np.testing.assert_array_equal(old_median, new_median)
