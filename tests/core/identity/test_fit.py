"""The least-squares fit: nearer to the pictures than the vote, with the vote's labels."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.closed_form import ClosedForm, FitConfig, Fitted, code_book, fit_identity
from gaga_core.identity.linear_kernels import D, keep_labels
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import true_map
from tests.core.identity.noisy import ROWS, Views, right_pixels
from tests.scenes import Synthetic

CONFIG = FitConfig(rows=ROWS)


@pytest.fixture
def fit(
    scene: Synthetic, closed: ClosedForm, train: Views, label_map: LabelMap
) -> Callable[[FitConfig], Fitted]:
    def run(config: FitConfig) -> Fitted:
        stage = fit_identity(scene.gaussians, closed, train, label_map, choose(), config)
        return run_stage(stage)

    return run


def test_pictures_gain_and_labels_stay(scene: Synthetic, closed: ClosedForm, train: Views) -> None:
    """With true maps: what is left to gain are outlines."""

    def truth(camera: Camera) -> IntArray:
        return true_map(scene, camera)

    fitted = run_stage(fit_identity(scene.gaussians, closed, train, truth, choose(), CONFIG))
    identity = fitted.closed.identity
    assert fitted.sweeps > 0
    assert fitted.after > fitted.before
    assert np.array_equal(identity.labels, closed.identity.labels)
    assert np.array_equal(identity.field.labels(), closed.identity.labels)
    assert np.array_equal(identity.confidence, closed.identity.confidence)
    before = right_pixels(scene, closed.identity.field)
    assert right_pixels(scene, identity.field) > before
    assert fitted.n_rows > 5000


def test_who_no_row_shows_keeps_its_code(
    scene: Synthetic, closed: ClosedForm, train: Views
) -> None:
    """Every fourth splat is too faint to be drawn."""

    def truth(camera: Camera) -> IntArray:
        return true_map(scene, camera)

    logits = scene.gaussians.logit_opacities.copy()
    logits[::4] = -9
    gaussians = replace(scene.gaussians, logit_opacities=logits)
    fitted = run_stage(fit_identity(gaussians, closed, train, truth, choose(), CONFIG))
    same = fitted.closed.identity.field.encodings == closed.identity.field.encodings
    assert same[::4].all()
    assert same.all(axis=1).mean() < 0.5


def test_random_errors_are_not_fitted_and_without_sweeps_nothing_is(
    scene: Synthetic, closed: ClosedForm, fit: Callable[[FitConfig], Fitted]
) -> None:
    """Every sixth block of every map is wrong: held-out views stop the fit in time."""
    fitted = fit(CONFIG)
    assert fitted.after >= fitted.before
    before = right_pixels(scene, closed.identity.field)
    assert right_pixels(scene, fitted.closed.identity.field) >= before - 0.002
    assert fit(FitConfig(sweeps=0)).closed is closed


def test_threads_change_no_bit(
    fit: Callable[[FitConfig], Fitted], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = fit(CONFIG).closed.identity.field.encodings
    monkeypatch.setenv("GAGA_THREADS", "1")
    assert np.array_equal(one, fit(CONFIG).closed.identity.field.encodings)


def test_kept_labels_lead_and_those_that_lead_are_left_alone() -> None:
    rng = np.random.default_rng(0)
    codes = code_book(40).codes
    labels = rng.integers(0, 41, 500).astype(np.int32)
    spread = rng.choice([0.05, 0.3, 3.0], 500)[:, None]
    encodings = (codes[labels] + spread * rng.normal(size=(500, D))).astype(np.float32)
    kept = encodings.copy()
    keep_labels(kept, codes, labels, 0.05, 0, 500)

    def lead(e: np.ndarray) -> np.ndarray:
        scores = e @ codes.T
        own = scores[np.arange(500), labels].copy()
        scores[np.arange(500), labels] = -np.inf
        return np.asarray(own - scores.max(axis=1))

    assert lead(kept).min() > 0.0499
    fine = lead(encodings) >= 0.05
    assert 50 < fine.sum() < 450
    assert np.array_equal(kept[fine], encodings[fine])
    np.testing.assert_allclose(lead(kept)[~fine], 0.05, atol=1e-4)  # no further back than needed


def test_nothing_labelled_and_wrong_settings(
    scene: Synthetic, closed: ClosedForm, train: Views
) -> None:
    def blank(camera: Camera) -> IntArray:
        return np.zeros((camera.height, camera.width), np.int32)

    with pytest.raises(GagaError, match="No pixel"):
        run_stage(fit_identity(scene.gaussians, closed, train, blank, choose(), CONFIG))
    with pytest.raises(ValueError, match="margin"):
        FitConfig(margin=0)
    with pytest.raises(ValueError, match="sweeps"):
        FitConfig(sweeps=-1)
