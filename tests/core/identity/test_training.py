"""Modes "refine" and "paper", on a scene with known groups."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.closed_form import ClosedForm
from gaga_core.identity.field import Identity, LiftFigures
from gaga_core.identity.lift import LiftConfig
from gaga_core.identity.rows import RowConfig, WholeViews, whole_views
from gaga_core.identity.train import (
    PaperConfig,
    RefineConfig,
    TimeEstimate,
    refine_identity,
    train_identity,
)
from gaga_core.pipeline.settings import IdentitySettings
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.identity.noisy import ROWS, G, Views, right_pixels
from tests.scenes import Synthetic

PAPER = PaperConfig(iterations=40, rows=ROWS, reg_samples=100, checkpoint_every=8)


def _refined(
    scene: Synthetic, closed: ClosedForm, train: Views, label_map: LabelMap, config: RefineConfig
) -> tuple[Identity, LiftFigures]:
    stage = refine_identity(scene.gaussians, closed, train, label_map, choose(), config)
    return run_stage(stage)


def test_refine_is_not_worse_than_the_vote(
    scene: Synthetic, closed: ClosedForm, train: Views, label_map: LabelMap
) -> None:
    config = RefineConfig(rows=ROWS)
    identity, figures = _refined(scene, closed, train, label_map, config)
    assert (figures.accuracy or 0) >= (figures.accuracy_before or 0) > 0
    assert 1 <= (figures.steps or 0) <= config.steps
    before = right_pixels(scene, closed.identity.field)
    assert right_pixels(scene, identity.field) >= before - 0.002
    assert np.array_equal(identity.labels, identity.field.labels())
    assert (identity.confidence >= 0).all()
    assert (identity.confidence <= 1).all()
    changed = identity.labels != closed.identity.labels
    assert np.array_equal(identity.confidence[~changed], closed.identity.confidence[~changed])


def test_refining_on_any_number_of_threads_is_the_same(
    scene: Synthetic,
    closed: ClosedForm,
    train: Views,
    label_map: LabelMap,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = RefineConfig(rows=ROWS, steps=10)
    one, of_one = _refined(scene, closed, train, label_map, config)
    monkeypatch.setenv("GAGA_THREADS", "1")
    two, of_two = _refined(scene, closed, train, label_map, config)
    assert of_one.steps == of_two.steps
    assert of_one.accuracy == of_two.accuracy
    for name in ("encodings", "weight", "bias"):
        assert np.array_equal(getattr(one.field, name), getattr(two.field, name))


def test_refine_moves_and_stops_when_it_does_not_help(
    scene: Synthetic, closed: ClosedForm, train: Views, label_map: LabelMap
) -> None:
    """Steps a thousand times too long destroy the field: the closed form must come back."""
    config = RefineConfig(rows=ROWS, patience=2, check_every=3)
    wild = replace(config, rates=replace(config.rates, encodings=2.5, layer=0.5))
    identity, figures = _refined(scene, closed, train, label_map, wild)
    assert (figures.best_step, figures.steps) == (0, 6)
    assert np.array_equal(identity.field.encodings, closed.identity.field.encodings)


def _train(
    scene: Synthetic,
    train: Views,
    label_map: LabelMap,
    config: PaperConfig,
    checkpoint: Path | None = None,
) -> tuple[Identity, LiftFigures]:
    return run_stage(
        train_identity(
            scene.gaussians, G, train, label_map, choose(), config, checkpoint=checkpoint
        )
    )


def test_training_from_zeros_learns_the_groups(
    scene: Synthetic, train: Views, label_map: LabelMap
) -> None:
    config = replace(PAPER, iterations=300)
    identity, figures = _train(scene, train, label_map, config)
    assert figures.steps == 299
    assert (figures.loss or 1) < 0.6 * (figures.loss_before or 0)
    assert (figures.accuracy or 0) > 0.75
    assert right_pixels(scene, identity.field) > 0.9
    assert np.array_equal(identity.labels, identity.field.labels())
    assert (identity.labels > 0).all()  # class 0 was never trained


def _whole(scene: Synthetic, views: Views, label_map: LabelMap, config: RowConfig) -> WholeViews:
    return run_stage(whole_views(scene.gaussians, views, label_map, choose(), config))


def test_a_step_takes_all_pixels_of_its_view_whatever_fits_into_memory(
    scene: Synthetic, train: Views, label_map: LabelMap
) -> None:
    whole = RowConfig(per_view=0, w_min=0.0, train_void=True)
    kept = _whole(scene, train, label_map, whole)
    made = _whole(scene, train, label_map, replace(whole, memory_bytes=1))
    encodings = np.random.default_rng(0).normal(size=(len(scene.gaussians), 16)).astype(np.float32)
    for i, camera in enumerate(train):
        assert np.array_equal(kept[i].labels, label_map(camera).ravel())
        drawn = choose().render(scene.gaussians, camera, channels=encodings).image
        features = made[i].rows.multiply(encodings)
        assert np.abs(features - drawn.reshape(features.shape)).max() < 1e-3
    assert len(kept.kept) == len(train)
    assert len(made.kept) == 0
    ignored = _whole(scene, train, label_map, replace(whole, train_void=False))
    assert [len(batch.labels) for batch in ignored] == [(label_map(c) > 0).sum() for c in train]
    config = replace(PAPER, rows=whole)
    tight = replace(config, rows=made.config)
    one, other = (_train(scene, train, label_map, c)[0] for c in (config, tight))
    assert np.array_equal(one.field.encodings, other.field.encodings)


def test_classes_are_the_groups_alone_where_none_is_no_class(
    scene: Synthetic, train: Views, label_map: LabelMap
) -> None:
    config = replace(PAPER, has_none=False, iterations=60)
    identity, figures = _train(scene, train, label_map, config)
    assert (identity.labels > 0).all()
    assert identity.field.probabilities(identity.field.encodings)[:, 0].max() < 1e-30
    # The loss of an even guess among the G groups is 1, in units of ln G.
    assert figures.loss_before == pytest.approx(1, abs=0.25)
    assert (figures.loss or 1) < (figures.loss_before or 0)
    bias = identity.field.bias
    assert bias[0] < -1e8
    assert np.abs(bias[1:]).max() < 1
    with pytest.raises(ValueError, match="class 0"):
        replace(config, rows=RowConfig(train_void=True))


def test_each_preset_trains_as_it_says() -> None:
    """The paper's text, its released code, and the sample of robust (docs/method.md)."""
    paper, released, robust = (LiftConfig.of(name) for name in ("paper", "released", "robust"))
    assert (paper.pseudo, released.pseudo, robust.pseudo) == ("bank", "masks", "masks")
    for config in (paper, released):
        rows, rates = config.paper.rows, config.paper.rates
        assert (rows.per_view, rows.w_min) == (0, 0.0)
        assert (rates.epsilon, rates.layer_epsilon) == (1e-15, 1e-8)
        assert config.paper.iterations == 10_000
    assert (paper.paper.has_none, paper.paper.rows.train_void) == (False, False)
    assert (released.paper.has_none, released.paper.rows.train_void) == (True, True)
    assert robust == LiftConfig() == LiftConfig.of("paper", "vote")
    assert robust.paper.rows.per_view == 16384
    sampled = IdentitySettings(pixels=16384, void="train").config("paper", "paper")
    assert sampled.paper.rows == RowConfig(train_void=True)
    assert sampled.paper.has_none
    assert sampled.pseudo == "bank"


def test_the_estimate_comes_first(scene: Synthetic, train: Views, label_map: LabelMap) -> None:
    stage = train_identity(scene.gaussians, G, train, label_map, choose(), PAPER)
    first = next(stage)
    assert isinstance(first.payload, TimeEstimate)
    assert (first.done, first.total) == (1, len(train)), "a word of the step that runs"
    assert first.payload.seconds > PAPER.iterations * first.payload.seconds_per_step > 0
    stage.close()


@pytest.mark.parametrize("stop_at", [3, 17])
def test_a_stopped_run_goes_on_as_if_it_never_stopped(
    scene: Synthetic, train: Views, label_map: LabelMap, tmp_path: Path, stop_at: int
) -> None:
    whole, of_whole = _train(scene, train, label_map, PAPER)
    path = tmp_path / "run.npz"
    stage = train_identity(scene.gaussians, G, train, label_map, choose(), PAPER, checkpoint=path)
    for progress in stage:
        if progress.stage == "Train identities" and progress.done == stop_at:
            break
    stage.close()
    assert path.is_file()
    resumed, figures = _train(scene, train, label_map, PAPER, path)
    assert (figures.resumed_at, figures.steps) == (stop_at, of_whole.steps)
    for name in ("encodings", "weight", "bias"):
        assert np.array_equal(getattr(resumed.field, name), getattr(whole.field, name))


def test_a_checkpoint_of_another_run_is_not_used(
    scene: Synthetic, train: Views, label_map: LabelMap, tmp_path: Path
) -> None:
    path = tmp_path / "run.npz"
    short = replace(PAPER, iterations=10)
    _train(scene, train, label_map, short, path)
    assert _train(scene, train, label_map, short, path)[1].resumed_at == 8
    assert _train(scene, train, label_map, replace(short, reg_factor=1.0), path)[1].resumed_at == 0
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(GagaError, match=r"run\.npz is damaged"):
        _train(scene, train, label_map, short, path)


def test_the_regulariser_spreads_labels_to_hidden_gaussians(
    train: Views, label_map: LabelMap, scene: Synthetic
) -> None:
    logits = scene.gaussians.logit_opacities.copy()
    logits[::4] = -9
    gaussians: Gaussians = replace(scene.gaussians, logit_opacities=logits)
    truth = np.where(scene.labels > 0, scene.labels, G)
    right = {}
    for every in (0, 1):
        config = replace(PAPER, iterations=200, reg_every=every, reg_samples=1000)
        identity, _ = run_stage(train_identity(gaussians, G, train, label_map, choose(), config))
        right[every] = (identity.labels == truth)[::4].mean()
    assert right[1] > right[0] + 0.2
