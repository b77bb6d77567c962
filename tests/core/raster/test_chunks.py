"""Leaving out what a view cannot show changes no bit of what it shows."""

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.grouping.gate import ViewMasks, gaussians_of_masks, open_bounds
from gaga_core.raster import base, for_many_views
from gaga_core.raster.base import SpatialChunks
from gaga_core.raster.cpu.prepare import prepare
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.raster.vote_slots import VoteSlots

_N, _WIDTH, _HEIGHT = 6000, 64, 48


def _wide_scene() -> Gaussians:
    """Splats all over a hall of 40 x 40 x 4; some large, some long, some not finite."""
    rng = np.random.default_rng(3)
    means = (rng.uniform(-1, 1, (_N, 3)) * (20, 20, 2)).astype(np.float32)
    log_scales = rng.normal(-3, 0.7, (_N, 3)).astype(np.float32)
    log_scales[::97] += 3
    log_scales[5::500] = 200  # infinite as float32
    means[7::300, 1] = np.nan
    means[9::300, 0] = np.inf
    log_scales[11::300, 2] = np.nan
    return Gaussians(
        means,
        rng.normal(size=(_N, 4)).astype(np.float32),
        log_scales,
        rng.normal(1, 2, _N).astype(np.float32),
        rng.uniform(-1, 1, (_N, 4, 3)).astype(np.float32),
    )


def _cameras() -> list[Camera]:
    """In the hall, looking anywhere; narrow and wide, the middle of the lens off the picture."""
    rng = np.random.default_rng(4)
    found = []
    for k in range(24):
        eye = rng.uniform(-1, 1, 3) * (22, 22, 3)
        K = np.array([[40.0 + 12 * k, 0, 32 + 3 * k], [0, 50.0 + 9 * k, 24 - k], [0, 0, 1]])
        pose = look_at(eye, eye + rng.normal(size=3) * (1, 1, 0.2), np.array([0, 0, 1.0]))
        found.append(Camera(K, pose, _WIDTH, _HEIGHT, f"{k}.png"))
    return found


@pytest.fixture
def divided(monkeypatch: pytest.MonkeyPatch) -> SpatialChunks:
    monkeypatch.setattr(base, "_SIZE", 64)
    found = SpatialChunks.of(_wide_scene())
    assert found is not None
    return found


def test_every_finite_splat_is_in_one_chunk(divided: SpatialChunks) -> None:
    means = divided.gaussians.means
    finite = np.flatnonzero(np.isfinite(means).all(axis=1))
    assert np.array_equal(np.sort(divided.rows), finite)
    sizes = np.diff(divided.offsets)
    assert sizes.min() > 0
    assert sizes.max() <= 64
    away = np.abs(means[divided.rows] - np.repeat(divided.centers, sizes, axis=0))
    assert (away <= np.repeat(divided.halves, sizes, axis=0) + 1e-5).all()


def test_a_chunk_is_seen_as_soon_as_one_of_its_splats_is_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Chunks of one splat each: those in view are all that projection keeps, and hardly more."""
    monkeypatch.setattr(base, "_SIZE", 1)
    monkeypatch.setattr(base, "_MOST", 1.0)
    rng = np.random.default_rng(6)
    cameras = _cameras()
    n = 4000
    eyes = np.stack([cameras[k].position for k in rng.integers(0, len(cameras), n)])
    round_splats = Gaussians(
        (eyes + rng.normal(size=(n, 3)) * rng.uniform(0.02, 3, (n, 1))).astype(np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.repeat(rng.normal(-2, 1.5, (n, 1)), 3, axis=1).astype(np.float32),
        np.full(n, 9, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    found = SpatialChunks.of(round_splats)
    assert found is not None
    n_drawn = n_chosen = 0
    for camera in cameras:
        rows, drawn = found.in_view(camera), prepare(round_splats, camera).order
        assert rows is not None
        assert np.isin(drawn, rows).all()
        n_drawn, n_chosen = n_drawn + len(drawn), n_chosen + len(rows)
    assert n_drawn > 5000
    assert n_chosen < 1.6 * n_drawn


def test_operators_give_the_same_bits_with_chunks(divided: SpatialChunks) -> None:
    gaussians = divided.gaussians
    plain, few = CpuRasterizer(), for_many_views(CpuRasterizer(), divided)
    rng = np.random.default_rng(5)
    of_splat = rng.integers(0, 9, _N).astype(np.int32)
    n_chosen = 0
    for camera in _cameras():
        rows = divided.in_view(camera)
        n_chosen += rows is not None
        assert rows is None or (len(rows) < 0.3 * _N and (np.diff(rows) > 0).all())
        want, got = plain.render(gaussians, camera), few.render(gaussians, camera)
        assert np.array_equal(want.image, got.image)
        assert np.array_equal(want.median_depth, got.median_depth)
        shown = plain.label_splat(gaussians, camera, of_splat)
        assert np.array_equal(shown.labels, few.label_splat(gaussians, camera, of_splat).labels)
        sums = np.zeros((2, _N, 9), np.float32)
        slots = VoteSlots.empty(_N), VoteSlots.empty(_N)
        for k, rasterizer in enumerate((plain, few)):
            rasterizer.vote(gaussians, camera, shown.labels, sums[k])
            rasterizer.vote(gaussians, camera, shown.labels, slots[k])
        assert np.array_equal(sums[0], sums[1])
        assert np.array_equal(slots[0].weights, slots[1].weights)
        pixels = np.arange(0, _WIDTH * _HEIGHT, 5)
        rows_of = [r.weights(gaussians, camera, pixels).indices for r in (plain, few)]
        assert np.array_equal(rows_of[0], rows_of[1])
    assert 8 <= n_chosen < 24


def test_centres_behind_masks_are_the_same_with_chunks(divided: SpatialChunks) -> None:
    means = divided.gaussians.means
    labels = np.arange(_WIDTH * _HEIGHT, dtype=np.int32).reshape(_HEIGHT, _WIDTH) % 7
    masks = ViewMasks.of(labels)
    for camera in _cameras():
        behind = gaussians_of_masks(means, camera, masks, open_bounds(masks))
        rows = divided.in_view(camera)
        again = gaussians_of_masks(means, camera, masks, open_bounds(masks), rows)
        assert np.array_equal(behind, again)


def test_another_scene_is_drawn_whole(divided: SpatialChunks) -> None:
    """The chunks say nothing about Gaussians that they were not made of."""
    few = for_many_views(CpuRasterizer(), divided)
    camera = _cameras()[0]
    few.render(divided.gaussians, camera)
    other = divided.gaussians.take(np.arange(_N)[::-1])
    want, got = CpuRasterizer().render(other, camera), few.render(other, camera)
    assert np.array_equal(want.image, got.image)
