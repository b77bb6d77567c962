"""Density control: rows of the optimiser stay with their splats, the picture stays, caps hold."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import AnyArray
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import empty_gradients
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.densification import (
    ScreenSums,
    control_density,
    quota,
    relocate_and_grow,
    reset_opacities,
    shared,
    shared_opacity,
    walk,
)
from gaga_core.training.losses import psnr
from gaga_core.training.optimizer import COLUMNS, Splats, concatenate
from gaga_core.training.settings import DensityConfig, TrainConfig
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

CPU = CpuRasterizer()
EXTENT = 1.0
CONFIG = DensityConfig(max_splats=400, threshold=0.5, split_size=0.04, largest_size=0.0)


def remembering(gaussians: Gaussians) -> Splats:
    """Splats whose running means tell which row they belong to: value + 1, value + 2."""

    def plus(number: float) -> Gaussians:
        columns = (getattr(gaussians, name) + np.float32(number) for name in COLUMNS)
        means, quats, log_scales, logits, sh = columns
        return Gaussians(means, quats, log_scales, logits, sh)

    return Splats(Splats.of(gaussians).values, plus(1), plus(2))


def sums_of(gradient: AnyArray) -> ScreenSums:
    n_views = np.arange(1, len(gradient) + 1, dtype=np.int32)
    return ScreenSums((gradient * n_views).astype(np.float32), n_views)


def is_remembered(splats: Splats, rows: AnyArray, column: str) -> bool:
    value = getattr(splats.values, column)[rows]
    first, second = getattr(splats.first, column)[rows], getattr(splats.second, column)[rows]
    return bool(
        np.allclose(first, value + 1, atol=1e-5) and np.allclose(second, value + 2, atol=1e-5)
    )


def test_a_view_counts_for_the_splats_that_it_draws() -> None:
    sums = ScreenSums.empty(5)
    for rows in ([0, 3], [3, 4]):
        gradients = empty_gradients(np.array(rows, np.int32), 1)
        gradients.screen[:] = [1.0, 2.0]
        sums.add(gradients)
    assert sums.gradient.tolist() == [1, 0, 0, 3, 2]
    assert sums.n_views.tolist() == [1, 0, 0, 2, 1]


def test_rows_that_stay_keep_what_the_optimiser_knows() -> None:
    """Kept rows come first, in order, each with its own running means; new ones know nothing."""
    gaussians = random_gaussians(200, seed=1, sh_degree=1)
    gaussians.logit_opacities[::9] = -7
    rng = np.random.default_rng(0)
    need = rng.uniform(0, 1, 200)
    before = remembering(gaussians)
    after = control_density(before, sums_of(need), CONFIG, EXTENT, 1000, rng)
    size = gaussians.log_scales.max(axis=1)
    alive = gaussians.opacities > CONFIG.least_opacity
    chosen = alive & (need > CONFIG.threshold)
    is_split = chosen & (size > np.log(CONFIG.split_size))
    kept = alive & ~is_split
    n_kept = int(kept.sum())
    assert 0 < is_split.sum() < chosen.sum()
    assert (~alive).sum() > 0
    assert len(after) == n_kept + int((chosen & ~is_split).sum()) + 2 * int(is_split.sum())
    old = np.arange(n_kept)
    np.testing.assert_array_equal(after.values.means[old], gaussians.means[kept])
    for column in ("means", "quats", "log_scales", "sh"):
        assert is_remembered(after, old, column), column
    for part in (after.first, after.second):
        for column in COLUMNS:
            rows = getattr(part, column)
            assert len(rows) == len(after)
            assert not rows[n_kept:].any()


def test_no_more_are_added_than_allowed_and_the_neediest_first() -> None:
    gaussians = random_gaussians(200, seed=1)
    gaussians = replace(gaussians, logit_opacities=np.full(200, 1, np.float32))
    need = np.linspace(0, 1, 200)
    after = control_density(
        Splats.of(gaussians), sums_of(need), CONFIG, EXTENT, 7, np.random.default_rng(0)
    )
    assert len(after) == 207
    size = gaussians.log_scales.max(axis=1)
    is_split = (np.arange(200) >= 193) & (size > np.log(CONFIG.split_size))
    np.testing.assert_array_equal(
        after.values.means[: 200 - is_split.sum()], gaussians.means[~is_split]
    )
    untouched = np.flatnonzero(need < need[193])
    np.testing.assert_array_equal(
        after.values.logit_opacities[untouched], gaussians.logit_opacities[untouched]
    )


@pytest.mark.parametrize("strategy", ["gradient", "mcmc"])
def test_the_cap_holds_and_is_reached_in_time(strategy: str) -> None:
    """The room under the cap is shared among the controls that are left."""
    config = replace(CONFIG, max_splats=333, full_at=0.5, threshold=0.0)
    gaussians = random_gaussians(100, seed=4)
    splats = Splats.of(replace(gaussians, logit_opacities=np.full(100, 3, np.float32)))
    for i in range(1, 11):
        n_new = quota(config, len(splats), i / 10, 0.1)
        rng = np.random.default_rng(i)
        if strategy == "mcmc":
            splats = relocate_and_grow(splats, config, n_new, rng)
        else:
            need = np.ones(len(splats))
            splats = control_density(splats, sums_of(need), config, EXTENT, n_new, rng)
        assert len(splats) <= 333
        assert (len(splats) == 333) == (i >= 5)


def test_without_a_moment_to_be_full_growth_is_as_published() -> None:
    config = replace(CONFIG, max_splats=1000)
    assert quota(config, 400, 0.1, 0.01) == 600
    mcmc = replace(config, strategy="mcmc")
    assert quota(mcmc, 400, 0.1, 0.01) == 20
    assert quota(mcmc, 990, 0.1, 0.01) == 10
    assert quota(mcmc, 1001, 0.1, 0.01) == 0


def test_a_splat_and_its_clone_draw_what_it_drew() -> None:
    logits = np.linspace(-6, 8, 50).astype(np.float32)
    halves = 1 / (1 + np.exp(-shared_opacity(logits).astype(np.float64)))
    whole = 1 / (1 + np.exp(-logits.astype(np.float64)))
    np.testing.assert_allclose(1 - (1 - halves) ** 2, whole, rtol=1e-4)


@pytest.mark.parametrize("strategy", ["clone", "split", "mcmc"])
def test_adding_splats_keeps_the_picture(strategy: str) -> None:
    """Against the damage that plain copies do."""
    scene = objects_scene(4, 150)
    camera = orbit_cameras(5, width=96, height=72)[1]
    gaussians = replace(scene.gaussians, logit_opacities=np.full(len(scene.labels), 0, np.float32))
    before = CPU.render(gaussians, camera).image
    rng = np.random.default_rng(0)
    if strategy == "mcmc":
        after = relocate_and_grow(Splats.of(gaussians), CONFIG, len(gaussians), rng)
    else:
        config = replace(CONFIG, split_size=1e-6 if strategy == "split" else 10.0)
        need = np.ones(len(gaussians))
        after = control_density(
            Splats.of(gaussians), sums_of(need), config, EXTENT, len(gaussians), rng
        )
    assert len(after) == 2 * len(gaussians)
    now = psnr(CPU.render(after.values, camera).image, before)
    plain = psnr(CPU.render(concatenate(gaussians, gaussians), camera).image, before)
    assert now > plain + (1 if strategy == "split" else 10)


def test_copies_share_opacity_and_width_as_published() -> None:
    """One copy of itself is the splat itself; N cover together as much as one (equation 9)."""
    opacity = np.array([0.05, 0.5, 0.9])
    same, factor = shared(opacity, np.ones(3, np.int64))
    np.testing.assert_allclose(same, opacity)
    np.testing.assert_allclose(factor, 1)
    for n in (2, 5, 30):
        each, factor = shared(opacity, np.full(3, n))
        np.testing.assert_allclose(1 - (1 - each) ** n, opacity)
        # The line integral through the middle of n copies over one another, by quadrature.
        x = np.linspace(-12, 12, 20001)[:, None]
        bells = each * np.exp(-0.5 * (x / factor) ** 2)
        together = np.trapezoid(1 - (1 - bells) ** n, x[:, 0], axis=0)
        np.testing.assert_allclose(together, opacity * np.sqrt(2 * np.pi), rtol=1e-3)


def test_faded_splats_move_to_living_ones() -> None:
    gaussians = random_gaussians(100, seed=2)
    logits = np.where(np.arange(100) < 30, -9, 1).astype(np.float32)
    splats = remembering(replace(gaussians, logit_opacities=logits))
    after = relocate_and_grow(splats, CONFIG, 0, np.random.default_rng(0))
    assert len(after) == 100
    living = {tuple(m) for m in gaussians.means[30:]}
    assert all(tuple(m) in living for m in after.values.means[:30])
    assert (after.values.opacities > CONFIG.least_opacity).all()
    untouched = np.flatnonzero(after.first.means.any(axis=1))
    assert 30 < len(untouched) < 70
    sources = np.setdiff1d(np.arange(30, 100), untouched)
    assert (after.values.log_scales[sources] < gaussians.log_scales[sources]).all()
    assert is_remembered(after, untouched, "means")


def test_only_faint_splats_walk_and_in_their_own_size() -> None:
    gaussians = random_gaussians(400, seed=3)
    logits = np.where(np.arange(400) < 200, -7, 2).astype(np.float32)
    splats = Splats.of(replace(gaussians, logit_opacities=logits))
    walk(splats, CONFIG, 1.0, EXTENT, np.random.default_rng(0))
    moved = np.linalg.norm(splats.values.means - gaussians.means, axis=1)
    assert (moved[:200] > 0).all()
    assert not moved[200:].any()
    size = gaussians.scales.max(axis=1)
    assert np.corrcoef(np.log(moved[:200]), np.log(size[:200]))[0, 1] > 0.4


def test_a_reset_cuts_opacities_only() -> None:
    splats = remembering(random_gaussians(50, seed=3))
    before = splats.values.logit_opacities.copy()
    reset_opacities(splats, 0.01)
    logit = np.log(0.01 / 0.99)
    np.testing.assert_allclose(splats.values.logit_opacities, np.minimum(before, logit), rtol=1e-6)
    assert not splats.first.logit_opacities.any()
    assert is_remembered(splats, np.arange(50), "means")


@pytest.mark.parametrize("quality", ["draft", "standard"])
@pytest.mark.parametrize("n_pixels", [100_000, 400_000])
def test_the_time_of_steps_follows_the_splats_that_there_are(quality: str, n_pixels: int) -> None:
    """Splats were thought to grow from none: early steps were told at half of their cost."""
    config = TrainConfig.of(quality)
    density, n = config.density, config.stereo
    cost = []
    for i in range(config.iterations):
        moment, step = i / config.iterations, density.every / config.iterations
        if i % density.every == 0 and density.start <= moment <= density.stop:
            n += quota(density, n, moment, step)
        cost.append(0.21 * n_pixels * config.size_at(moment) ** 2 + 0.67 * n)
    assert n == density.max_splats
    spent = np.cumsum(cost) / np.sum(cost)
    for i in range(49, config.iterations, 50):
        told = config.spent(n_pixels, (i + 1) / config.iterations)
        assert told == pytest.approx(spent[i], rel=0.1)
    assert config.cpu_seconds(n_pixels) == pytest.approx(1e-6 * np.sum(cost), rel=0.02)
