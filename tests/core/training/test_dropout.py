"""Splats left out of a step: as many as asked, fairly made up for, with true gradients."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import FloatArray
from gaga_core.training.checkpoint import TrainState
from gaga_core.training.cpu_train import CpuEngine
from gaga_core.training.distributed import SINGLE_WORKER
from gaga_core.training.engine import HIGHEST_OPACITY, Setting, thinned, turns_of
from gaga_core.training.losses import photometric
from gaga_core.training.optimizer import COLUMNS, adam_step
from gaga_core.training.settings import TrainConfig
from tests.core.training.train_scenes import CPU, Known, short
from tests.scenes import orbit_cameras, random_gaussians


def test_what_is_left_covers_as_much_on_average() -> None:
    gaussians = random_gaussians(400, seed=0)
    assert thinned(gaussians, 0.0, np.random.default_rng(0)).gaussians is gaussians
    gaussians = replace(gaussians, logit_opacities=np.linspace(-5, 1, 400).astype(np.float32))
    rng = np.random.default_rng(1)
    draws = np.array([thinned(gaussians, 0.25, rng).gaussians.opacities for _ in range(400)])
    is_out = draws < 1e-6
    assert is_out.mean() == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(draws.mean(axis=0), gaussians.opacities, rtol=0.2)
    np.testing.assert_allclose(draws.mean(), gaussians.opacities.mean(), rtol=0.01)


def test_opacities_stay_below_one() -> None:
    gaussians = random_gaussians(3, seed=0)
    gaussians = replace(gaussians, logit_opacities=np.array([1.0, 4.0, 9.0], np.float32))
    kept = thinned(gaussians, 1e-9, np.random.default_rng(0)).gaussians.opacities
    np.testing.assert_allclose(kept, gaussians.opacities, rtol=1e-5)
    raised = thinned(gaussians, 0.3, np.random.default_rng(0)).gaussians.opacities
    assert raised.max() <= max(HIGHEST_OPACITY, float(gaussians.opacities.max())) + 1e-6


def test_the_gradient_is_that_of_the_logits_that_are_stored() -> None:
    gaussians = random_gaussians(12, seed=2)
    logits = np.linspace(-2, 0.5, 12).astype(np.float32)
    gaussians = replace(gaussians, logit_opacities=logits)
    gaussians.log_scales[:] += 1
    camera = orbit_cameras(3, width=32, height=24)[0]
    target = np.zeros((24, 32, 3), np.float32)

    def loss(image: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
        return float((image.astype(np.float64) ** 2).sum()), 2 * (image - target)

    def value(logits: FloatArray) -> float:
        some = replace(gaussians, logit_opacities=logits.astype(np.float32))
        drawn = thinned(some, 0.3, np.random.default_rng(3)).gaussians
        return CPU.train_step(drawn, camera, target, loss).value

    way = thinned(gaussians, 0.3, np.random.default_rng(3))
    gradients = CPU.train_step(way.gaussians, camera, target, loss).gradients
    way.walk_back(gradients)
    found = np.zeros(12)
    found[gradients.indices] = gradients.logit_opacities
    step = 0.02 * np.eye(12)
    numeric = [(value(logits + d) - value(logits - d)) / 0.04 for d in step]
    is_out = way.gaussians.opacities < 1e-6
    assert 0 < is_out.sum() < 12
    assert not found[is_out].any()
    np.testing.assert_allclose(found, numeric, rtol=0.02, atol=0.01 * np.abs(numeric).max())


def test_a_training_moves_splats_by_the_gradients_of_the_logits_that_are_stored(
    known: Known,
) -> None:
    """An iteration of the engine, whose gradients come in pieces, against its single steps."""
    config = replace(short(30), dropout=0.3, smaller=())
    setting = Setting(known.views.train, {}, config, 1.0, SINGLE_WORKER)
    n_views = len(known.views.train)
    states = [TrainState.first(known.initial, n_views, 30) for _ in range(2)]
    got, want = states
    for state in states:
        state.iteration = 20
        # without a past, Adam's step does not depend on a gradient's size
        state.splats.second.logit_opacities[:] = 1e-6
    want.splats = want.splats.with_degree(config.degree_at(21 / 30))
    view = setting.view(turns_of(20, setting)[0].view, 21 / 30)
    way = thinned(want.splats.values, config.dropout_at(21 / 30, n_views), setting.random(3, 21))
    step = CPU.train_step(
        way.gaussians, view.camera, view.target(), photometric, background=setting.background
    )
    way.walk_back(step.gradients)
    adam_step(want.splats, step.gradients, setting.rates(21 / 30), 21)
    CpuEngine(got, setting, CPU).advance(got)
    for name in COLUMNS:
        values = getattr(got.splats.values, name)
        assert np.array_equal(values, getattr(want.splats.values, name)), name


def test_the_share_grows_from_nothing_and_is_small_where_photos_are_many() -> None:
    config = replace(TrainConfig(), dropout=0.2)
    assert config.dropout_at(0.0, 12) == 0
    assert config.dropout_at(1.0, 12) == pytest.approx(0.2)
    assert config.dropout_at(0.5, 25) == pytest.approx(0.1)
    assert config.dropout_at(1.0, 40) == pytest.approx(0.08)
    assert config.dropout_at(1.0, 50) == config.dropout_at(1.0, 300) == 0
    assert TrainConfig.of("full").dropout_at(1.0, 12) == 0
    with pytest.raises(ValueError, match="dropout"):
        replace(config, dropout=1.0)
