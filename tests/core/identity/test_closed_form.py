"""Mode "vote": labels, who gets them without a vote, and their encodings."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.votes import LabelMap, vote_labels
from gaga_core.identity.closed_form import (
    ClosedForm,
    FitConfig,
    Fitted,
    VoteConfig,
    Voted,
    code_book,
    fit_identity,
    vote_identity,
)
from gaga_core.identity.linear_kernels import D, keep_labels
from gaga_core.identity.training_step import majority, nearest
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.grouping.true_masks import true_map
from tests.core.identity.noisy import ROWS, G, Views, right_pixels
from tests.scenes import Synthetic


def test_vote_decodes_to_the_voted_labels(
    scene: Synthetic, closed: ClosedForm, train: Views, label_map: LabelMap
) -> None:
    votes = run_stage(vote_labels(scene.gaussians, train, label_map, G, choose()))
    voted = votes.labels > 0
    identity = closed.identity
    assert voted.mean() > 0.6
    assert np.array_equal(identity.labels[voted], votes.labels[voted])
    assert np.array_equal(identity.confidence[voted], votes.confidence[voted])
    assert np.array_equal(identity.field.labels(), identity.labels)
    assert right_pixels(scene, identity.field) > 0.95


def test_who_no_view_shows_takes_its_neighbours_label(scene: Synthetic) -> None:
    """Every fourth splat is too faint to be drawn; the truth is voted for all others."""
    truth = np.where(scene.labels > 0, scene.labels, G).astype(np.int32)
    logits = scene.gaussians.logit_opacities.copy()
    logits[::4] = -9
    gaussians = replace(scene.gaussians, logit_opacities=logits)
    labels, confidence = truth.copy(), np.full(len(truth), 0.8, np.float32)
    labels[::4], confidence[::4] = 0, 0
    nobody = np.zeros(len(truth), np.int32)
    result = run_stage(
        vote_identity(gaussians, Voted(labels, confidence), nobody, G, scene.cameras, choose())
    )
    filled = result.identity.labels[::4]
    assert result.n_from_neighbours == len(filled)
    assert result.n_from_bank == 0
    assert (filled == truth[::4]).mean() > 0.95
    agreeing = result.identity.confidence[::4]
    assert 0 < agreeing.min() <= agreeing.max() <= np.float32(0.8) + 1e-6


def test_who_is_seen_without_a_mask_stays_without_a_group(scene: Synthetic) -> None:
    """The floor has no mask; splats of it that are seen must not join the balls beside them."""
    n = len(scene.gaussians)
    shown = np.zeros((n, 1), np.float32)
    for camera in scene.cameras:
        blank = np.zeros((camera.height, camera.width), np.int32)
        choose().vote(scene.gaussians, camera, blank, shown)
    voted = Voted(scene.labels, (scene.labels > 0).astype(np.float32))
    nobody = np.zeros(n, np.int32)
    result = run_stage(vote_identity(scene.gaussians, voted, nobody, G, scene.cameras, choose()))
    floor = (scene.labels == 0) & (shown[:, 0] > 0)
    assert floor.sum() > 100
    assert (result.identity.labels[floor] == 0).all()


def test_who_got_no_vote_keeps_the_banks_group(scene: Synthetic) -> None:
    truth = np.where(scene.labels > 0, scene.labels, G).astype(np.int32)
    labels, confidence = truth.copy(), np.ones(len(truth), np.float32)
    labels[:50], confidence[:50] = 0, 0
    bank = np.full(len(truth), -1, np.int32)
    bank[:50] = 3
    result = run_stage(
        vote_identity(scene.gaussians, Voted(labels, confidence), bank, G, [], choose())
    )
    assert (result.identity.labels[:50] == 3).all()
    assert result.n_from_bank == 50
    assert np.array_equal(result.identity.field.labels(), result.identity.labels)


def test_positions_that_are_no_numbers_are_left_alone(scene: Synthetic) -> None:
    means = scene.gaussians.means.copy()
    means[:5] = np.nan
    gaussians = replace(scene.gaussians, means=means)
    labels = np.where(scene.labels > 0, scene.labels, G).astype(np.int32)
    labels[:5] = 0
    voted = Voted(labels, (labels > 0).astype(np.float32))
    nobody = np.zeros(len(labels), np.int32)
    result = run_stage(vote_identity(gaussians, voted, nobody, G, scene.cameras, choose()))
    assert (result.identity.labels[:5] == 0).all()
    assert (result.identity.confidence[:5] == 0).all()


def test_without_groups_nobody_has_one_and_labels_are_checked(scene: Synthetic) -> None:
    none = np.zeros(len(scene.gaussians), np.int32)

    def vote(labels: IntArray) -> ClosedForm:
        voted = Voted(labels, none.astype(np.float32))
        return run_stage(vote_identity(scene.gaussians, voted, none, 0, scene.cameras, choose()))

    assert (vote(none).identity.labels == 0).all()
    with pytest.raises(ValueError, match="more than 0 groups"):
        vote(none + 1)
    with pytest.raises(ValueError, match="positive"):
        VoteConfig(scale=0)


def test_nearest_are_the_nearest() -> None:
    means = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32)
    near = run_stage(nearest(means, 4))
    distance = np.linalg.norm(means[:, None] - means[None], axis=2)
    assert np.array_equal(near[:, 0], np.arange(60))
    assert np.array_equal(np.sort(near, axis=1), np.sort(distance.argsort(axis=1)[:, :4], axis=1))
    few = run_stage(nearest(means[:2], 4))
    assert few.shape == (2, 4)
    assert set(few.ravel()) == {0, 1}


def test_majority_prefers_the_nearer_on_a_tie() -> None:
    labels = np.array([5, 7, 7, 9, 5], np.int32)
    found, share = majority(labels, np.array([[0, 1, 2, 3], [3, 1, 0, 2], [3, 0, 1, 4]]))
    assert found.tolist() == [7, 7, 5]
    assert share.tolist() == [0.5, 0.5, 0.5]
    assert majority(labels, np.array([[3, 0]]))[0].tolist() == [9]


# --- The least-squares fit: nearer to the pictures than the vote, with the vote's labels.


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
