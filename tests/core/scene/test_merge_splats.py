"""A merged splat has the moments of the splats that it stands for."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene.merge_splats import merge_runs, merge_splats
from tests.scenes import random_gaussians


def _covariances(gaussians: Gaussians) -> DoubleArray:
    axes = quats_to_matrices(gaussians.quats) * gaussians.scales.astype(np.float64)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def _weights(gaussians: Gaussians) -> DoubleArray:
    a, b, c = gaussians.scales.astype(np.float64).T
    return gaussians.opacities * (a * b + b * c + c * a)


def test_mean_covariance_color_and_weight_are_those_of_the_mixture() -> None:
    splats = random_gaussians(600, seed=3, sh_degree=2)
    rng = np.random.default_rng(0)
    splats = replace(splats, extra=MappingProxyType({"x": rng.normal(size=600).astype(np.float32)}))
    parents = rng.integers(5, 45, 600)
    merged = merge_splats(splats, parents)
    covariances = _covariances(splats)
    for k, parent in enumerate(np.unique(parents)):
        rows = np.flatnonzero(parents == parent)
        weights = _weights(splats.take(rows))
        share = weights / weights.sum()
        mean = share @ splats.means[rows]
        apart = splats.means[rows] - mean
        covariance = np.einsum("n,nij->ij", share, covariances[rows])
        covariance += np.einsum("n,ni,nj->ij", share, apart, apart)
        one = merged.take(np.array([k]))
        assert np.allclose(one.means[0], mean, atol=1e-5)
        assert np.allclose(_covariances(one)[0], covariance, rtol=1e-4, atol=1e-6)
        assert np.allclose(one.sh[0], np.einsum("n,nsc->sc", share, splats.sh[rows]), atol=1e-5)
        assert np.allclose(one.extra["x"][0], share @ splats.extra["x"][rows], atol=1e-5)
        assert np.isclose(_weights(one)[0], weights.sum(), rtol=1e-3)


def test_splats_alone_keep_their_bits_and_runs_are_parents_in_order() -> None:
    splats = random_gaussians(50, sh_degree=1)
    order = np.random.default_rng(1).permutation(50)
    alone = merge_runs(splats, np.arange(50), order)
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh"):
        assert np.array_equal(getattr(alone, name), getattr(splats, name)[order])
    pairs = merge_runs(splats, np.arange(0, 50, 2))
    same = merge_splats(splats, np.arange(50) // 2)
    assert pairs.means.tobytes() == same.means.tobytes()
    assert len(merge_runs(splats.take(order[:0]), np.zeros(0, np.int64))) == 0
    with pytest.raises(ValueError, match="starts"):
        merge_runs(splats, np.array([3, 10]))


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_thin_splats_of_any_size_stay_thin_and_a_copy_stays_itself(size: float) -> None:
    """Two copies in one place are one, with twice the weight while that is below 1."""
    one = random_gaussians(1, seed=7)
    one = replace(
        one,
        means=np.array([[3, -2, 1]], np.float32) * np.float32(size),
        log_scales=np.log(np.array([[1, 0.5, 1e-6]]) * size).astype(np.float32),
        logit_opacities=np.full(1, -2, np.float32),
    )
    both = merge_splats(one.take(np.array([0, 0])), np.zeros(2, np.int64))
    assert np.allclose(np.sort(both.log_scales[0]), np.sort(one.log_scales[0]), atol=1e-3)
    assert np.allclose(both.opacities, 2 * one.opacities, rtol=1e-4)
    assert np.allclose(both.means, one.means, rtol=1e-6)
    assert np.allclose(
        _covariances(both) / size**2, _covariances(one) / size**2, rtol=1e-3, atol=1e-9
    )


def test_whole_numbers_are_those_of_the_splat_that_covers_most() -> None:
    splats = random_gaussians(40)
    groups = np.arange(40, dtype=np.int32)
    splats = replace(splats, extra=MappingProxyType({"group": groups}))
    merged = merge_splats(splats, np.repeat([0, 1], 20))
    weights = _weights(splats)
    assert list(merged.extra["group"]) == [weights[:20].argmax(), 20 + weights[20:].argmax()]
    assert merged.extra["group"].dtype == np.int32


def test_invisible_splats_merge_to_an_invisible_one_and_count_for_nothing_next_to_others() -> None:
    splats = random_gaussians(8, seed=2)
    logits = np.array([-np.inf] * 4 + [-np.inf, 1.0, -np.inf, -np.inf], np.float32)
    merged = merge_runs(replace(splats, logit_opacities=logits), np.array([0, 4]))
    assert np.isneginf(merged.logit_opacities[0])
    assert np.allclose(merged.means[0], splats.means[:4].mean(axis=0), atol=1e-5)
    assert np.isfinite(merged.log_scales).all()
    assert np.allclose(merged.means[1], splats.means[5], atol=1e-5)
