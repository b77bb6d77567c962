"""Adam over the rows that a view shows, and the learning rates of the schedule."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients
from gaga_core.training.optimizer import COLUMNS, Rates, Splats, adam_step, camera_extent
from gaga_core.training.settings import RateConfig
from tests.scenes import random_gaussians

RATES = Rates(means=1e-3, quats=2e-3, log_scales=3e-3, logit_opacities=4e-2, sh=5e-3, sh_rest=6e-4)


def gradients_of(rows: np.ndarray[tuple[int], np.dtype[np.int32]], seed: int) -> Gradients:
    rng = np.random.default_rng(seed)
    n = len(rows)
    shapes = ((n, 3), (n, 4), (n, 3), (n,), (n, 4, 3), (n,), (n,))
    scale = 10.0 ** rng.uniform(-6, 1)
    return Gradients(rows, *(rng.normal(0, scale, shape).astype(np.float32) for shape in shapes))


def test_a_step_is_that_of_torch() -> None:
    """Five steps of all rows, gradients of very different size; SH beyond degree 0 has its rate."""
    start = random_gaussians(50, seed=2, sh_degree=1)
    splats = Splats.of(start)
    leaves = {name: torch.tensor(getattr(start, name).astype(np.float64)) for name in COLUMNS}
    leaves |= {"dc": leaves["sh"][:, :1].clone(), "rest": leaves.pop("sh")[:, 1:].clone()}
    named = {"dc": RATES.sh, "rest": RATES.sh_rest}
    groups = [
        {"params": [leaf], "lr": named.get(name) or getattr(RATES, name)}
        for name, leaf in leaves.items()
    ]
    adam = torch.optim.Adam(groups, eps=1e-15)
    for step in range(1, 6):
        gradients = gradients_of(np.arange(50, dtype=np.int32), step)
        adam_step(splats, gradients, RATES, step)
        for name, leaf in leaves.items():
            if name in named:
                rows = gradients.sh[:, :1] if name == "dc" else gradients.sh[:, 1:]
            else:
                rows = getattr(gradients, name)
            leaf.grad = torch.tensor(rows.astype(np.float64))
        adam.step()
    leaves["sh"] = torch.cat([leaves["dc"], leaves["rest"]], dim=1)
    for name in COLUMNS:
        np.testing.assert_allclose(
            getattr(splats.values, name), leaves[name].numpy(), atol=2e-6, err_msg=name
        )


def test_what_a_view_does_not_show_rests() -> None:
    start = random_gaussians(50, seed=2, sh_degree=1)
    splats, kept = Splats.of(start), start.take(np.arange(50))
    shown = np.array([3, 4, 17, 49], np.int32)
    adam_step(splats, gradients_of(shown, 1), RATES, 1)
    hidden = np.setdiff1d(np.arange(50), shown)
    for name in COLUMNS:
        before, after = getattr(start, name), getattr(splats.values, name)
        np.testing.assert_array_equal(before, getattr(kept, name))
        np.testing.assert_array_equal(after[hidden], before[hidden])
        assert (after[shown] != before[shown]).all(), name
        for part in (splats.first, splats.second):
            assert not getattr(part, name)[hidden].any()


def test_more_degrees_begin_at_zero_and_fewer_are_cut() -> None:
    splats = Splats.of(random_gaussians(9, seed=1, sh_degree=1))
    more = splats.with_degree(3)
    for part in (more.values, more.first, more.second):
        assert part.sh.shape == (9, 16, 3)
        assert not part.sh[:, 4:].any()
    np.testing.assert_array_equal(more.values.sh[:, :4], splats.values.sh)
    back: Gaussians = more.with_degree(1).values
    np.testing.assert_array_equal(back.sh, splats.values.sh)


def test_rates_fall_as_the_schedule_says() -> None:
    config = RateConfig(end=0.1, end_from=0.5)
    first, middle, last = (Rates.at(config, moment, 2.0) for moment in (0.0, 0.5, 1.0))
    assert first.means == pytest.approx(2 * config.means)
    assert last.means == pytest.approx(2 * config.means * config.means_end)
    assert first.means > middle.means > last.means
    for name in ("quats", "log_scales", "logit_opacities", "sh", "sh_rest"):
        assert getattr(middle, name) == getattr(first, name)
        assert getattr(last, name) == pytest.approx(0.1 * getattr(first, name))
    assert Rates.at(replace(config, end=1.0), 1.0, 1.0).sh == config.sh


def test_the_extent_grows_with_the_scene() -> None:
    positions = np.random.default_rng(0).normal(size=(9, 3))
    extent = camera_extent(positions)
    assert camera_extent(5 * positions + 3) == pytest.approx(5 * extent)
    assert camera_extent(np.ones((3, 3))) > 0
