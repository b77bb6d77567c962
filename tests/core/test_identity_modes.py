"""The three ways to identity encodings, on scenes with known groups."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.identity.closed_form import ClosedForm, VoteConfig, Voted, vote_identity
from gaga_core.identity.field import IdentityField, decode_view
from gaga_core.identity.neighbours import majority, nearest
from gaga_core.identity.paper import PaperConfig, TimeEstimate, Trained, train_identity
from gaga_core.identity.refine import RefineConfig, Refined, refine_identity
from gaga_core.identity.rows import RowConfig, ViewRows, mixed_batches, sample_rows, view_batches
from gaga_core.identity.votes import vote_labels
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.core.test_associate import true_map
from tests.scenes import Synthetic, objects_scene

_G = 6  # five balls and the floor
_ROWS = RowConfig(per_view=1500)
_PAPER = PaperConfig(iterations=40, rows=_ROWS, reg_samples=100, checkpoint_every=8)


@pytest.fixture(scope="module")
def scene() -> Synthetic:
    return objects_scene(n_objects=_G - 1, per_object=250, n_cameras=10, seed=2)


@pytest.fixture(scope="module")
def maps(scene: Synthetic) -> dict[str, IntArray]:
    """True label maps of which 15 % of the 12 x 12 blocks have a random label, view by view."""
    result = {}
    for i, camera in enumerate(scene.cameras):
        rng = np.random.default_rng(i)
        blocks = (-(-camera.height // 12), -(-camera.width // 12))
        other = rng.integers(1, _G + 1, blocks).repeat(12, axis=0).repeat(12, axis=1)
        wrong = (rng.random(blocks) < 0.15).repeat(12, axis=0).repeat(12, axis=1)
        here = (slice(camera.height), slice(camera.width))
        truth = true_map(scene, camera)
        result[camera.name] = np.where(wrong[here] & (truth > 0), other[here], truth).astype(
            np.int32
        )
    return result


@pytest.fixture(scope="module")
def label_map(maps: dict[str, IntArray]) -> Callable[[Camera], IntArray]:
    return lambda camera: maps[camera.name]


@pytest.fixture(scope="module")
def train(scene: Synthetic) -> Sequence[Camera]:
    return [camera for i, camera in enumerate(scene.cameras) if i not in (3, 7)]


@pytest.fixture(scope="module")
def closed(
    scene: Synthetic, train: Sequence[Camera], label_map: Callable[[Camera], IntArray]
) -> ClosedForm:
    votes = run_stage(vote_labels(scene.gaussians, train, label_map, _G, choose()))
    nobody = np.full(len(scene.gaussians), -1, np.int32)
    voted = Voted(votes.labels, votes.confidence)
    return run_stage(vote_identity(scene.gaussians, voted, nobody, _G, train, choose()))


def _right_pixels(scene: Synthetic, field: IdentityField) -> float:
    """Share of right pixels on the two views left out, against the true maps."""
    right = []
    for camera in (scene.cameras[3], scene.cameras[7]):
        truth = true_map(scene, camera)
        shown = decode_view(field, scene.gaussians, camera, choose(), void_below=0.3).labels
        right.append((shown == truth)[truth > 0].mean())
    return float(np.mean(right))


# ---- vote


def test_vote_decodes_to_the_voted_labels(
    scene: Synthetic,
    closed: ClosedForm,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
) -> None:
    votes = run_stage(vote_labels(scene.gaussians, train, label_map, _G, choose()))
    voted = votes.labels > 0
    identity = closed.identity
    assert voted.mean() > 0.6
    assert np.array_equal(identity.labels[voted], votes.labels[voted])
    assert np.array_equal(identity.confidence[voted], votes.confidence[voted])
    assert np.array_equal(identity.field.labels(), identity.labels)
    assert _right_pixels(scene, identity.field) > 0.95


def test_who_no_view_shows_takes_its_neighbours_label(scene: Synthetic) -> None:
    """Every fourth splat is too faint to be drawn; the truth is voted for all others."""
    truth = np.where(scene.labels > 0, scene.labels, _G).astype(np.int32)
    logits = scene.gaussians.logit_opacities.copy()
    logits[::4] = -9
    gaussians = replace(scene.gaussians, logit_opacities=logits)
    labels, confidence = truth.copy(), np.full(len(truth), 0.8, np.float32)
    labels[::4], confidence[::4] = 0, 0
    nobody = np.zeros(len(truth), np.int32)
    result = run_stage(
        vote_identity(gaussians, Voted(labels, confidence), nobody, _G, scene.cameras, choose())
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
    result = run_stage(vote_identity(scene.gaussians, voted, nobody, _G, scene.cameras, choose()))
    floor = (scene.labels == 0) & (shown[:, 0] > 0)
    assert floor.sum() > 100
    assert (result.identity.labels[floor] == 0).all()


def test_who_got_no_vote_keeps_the_banks_group(scene: Synthetic) -> None:
    truth = np.where(scene.labels > 0, scene.labels, _G).astype(np.int32)
    labels, confidence = truth.copy(), np.ones(len(truth), np.float32)
    labels[:50], confidence[:50] = 0, 0
    bank = np.full(len(truth), -1, np.int32)
    bank[:50] = 3
    result = run_stage(
        vote_identity(scene.gaussians, Voted(labels, confidence), bank, _G, [], choose())
    )
    assert (result.identity.labels[:50] == 3).all()
    assert result.n_from_bank == 50
    assert np.array_equal(result.identity.field.labels(), result.identity.labels)


def test_positions_that_are_no_numbers_are_left_alone(scene: Synthetic) -> None:
    means = scene.gaussians.means.copy()
    means[:5] = np.nan
    gaussians = replace(scene.gaussians, means=means)
    labels = np.where(scene.labels > 0, scene.labels, _G).astype(np.int32)
    labels[:5] = 0
    voted = Voted(labels, (labels > 0).astype(np.float32))
    nobody = np.zeros(len(labels), np.int32)
    result = run_stage(vote_identity(gaussians, voted, nobody, _G, scene.cameras, choose()))
    assert (result.identity.labels[:5] == 0).all()
    assert (result.identity.confidence[:5] == 0).all()


def test_vote_without_any_group() -> None:
    scene = objects_scene(n_objects=1, per_object=30, n_cameras=2)
    none = np.zeros(len(scene.gaussians), np.int32)
    voted = Voted(none, none.astype(np.float32))
    result = run_stage(vote_identity(scene.gaussians, voted, none, 0, scene.cameras, choose()))
    assert (result.identity.labels == 0).all()


def test_vote_checks_its_labels(scene: Synthetic) -> None:
    none = np.zeros(len(scene.gaussians), np.int32)
    with pytest.raises(ValueError, match="more than 6 groups"):
        run_stage(
            vote_identity(
                scene.gaussians, Voted(none + 7, none.astype(np.float32)), none, 6, [], choose()
            )
        )
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


# ---- rows


def _rows(
    scene: Synthetic, label_map: Callable[[Camera], IntArray], config: RowConfig
) -> list[ViewRows]:
    return run_stage(sample_rows(scene.gaussians, scene.cameras, label_map, choose(), config))


def test_rows_are_labelled_pixels_spread_over_the_view(
    scene: Synthetic, label_map: Callable[[Camera], IntArray], maps: dict[str, IntArray]
) -> None:
    for view in _rows(scene, label_map, RowConfig(per_view=1000)):
        truth = maps[view.view]
        assert len(view.labels) == 1000
        assert (view.labels > 0).all()
        share = np.bincount(truth[truth > 0], minlength=_G + 1) / (truth > 0).sum()
        got = np.bincount(view.labels, minlength=_G + 1) / 1000
        assert np.abs(share - got).max() < 0.03


def test_all_pixels_when_none_are_named(
    scene: Synthetic, label_map: Callable[[Camera], IntArray], maps: dict[str, IntArray]
) -> None:
    views = _rows(scene, label_map, RowConfig(per_view=0, w_min=0, train_void=True))
    assert [len(view.labels) for view in views] == [maps[view.view].size for view in views]
    views = _rows(scene, label_map, RowConfig(per_view=0))
    assert [len(v.labels) for v in views] == [int((maps[v.view] > 0).sum()) for v in views]


def test_rows_keep_to_the_memory(scene: Synthetic, label_map: Callable[[Camera], IntArray]) -> None:
    limit = 3_000_000
    views = _rows(scene, label_map, RowConfig(per_view=0, memory_bytes=limit))
    used = sum(16 * len(view.weights.indices) for view in views)
    assert 0.4 * limit < used < 1.1 * limit


def test_batches_hold_every_row_once(
    scene: Synthetic, label_map: Callable[[Camera], IntArray]
) -> None:
    views = _rows(scene, label_map, RowConfig(per_view=333))
    whole = np.sort(np.concatenate([view.weights.weights for view in views]))
    mixed = mixed_batches(views, len(scene.gaussians))
    by_view = view_batches(views, len(scene.gaussians))
    for batches in (mixed, by_view):
        assert len(batches) == len(scene.cameras)
        got = np.concatenate([batch.rows.by_pixel.weights for batch in batches])
        assert np.array_equal(np.sort(got), whole)
    sizes = [len(batch.labels) for batch in mixed]
    assert max(sizes) - min(sizes) <= len(scene.cameras)


def test_nothing_labelled_is_told(scene: Synthetic) -> None:
    with pytest.raises(GagaError, match="No pixel"):
        _rows(scene, lambda c: np.zeros((c.height, c.width), np.int32), _ROWS)


# ---- refine


def _refined(
    scene: Synthetic,
    closed: ClosedForm,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
    config: RefineConfig,
) -> Refined:
    stage = refine_identity(scene.gaussians, closed, train, label_map, choose(), config)
    return run_stage(stage)


def test_refine_is_not_worse_than_the_vote(
    scene: Synthetic,
    closed: ClosedForm,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
) -> None:
    config = RefineConfig(rows=_ROWS)
    refined = _refined(scene, closed, train, label_map, config)
    assert refined.after.accuracy >= refined.before.accuracy
    assert 1 <= refined.steps <= config.steps
    before = _right_pixels(scene, closed.identity.field)
    assert _right_pixels(scene, refined.identity.field) >= before - 0.002
    identity = refined.identity
    assert np.array_equal(identity.labels, identity.field.labels())
    assert (identity.confidence >= 0).all()
    assert (identity.confidence <= 1).all()
    changed = identity.labels != closed.identity.labels
    assert np.array_equal(identity.confidence[~changed], closed.identity.confidence[~changed])


def test_refine_moves_and_stops_when_it_does_not_help(
    scene: Synthetic,
    closed: ClosedForm,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
) -> None:
    """Steps a thousand times too long destroy the field: the closed form must come back."""
    config = RefineConfig(rows=_ROWS, patience=2, check_every=3)
    wild = replace(config, rates=replace(config.rates, encodings=2.5, layer=0.5))
    refined = _refined(scene, closed, train, label_map, wild)
    assert refined.best_step == 0
    assert refined.steps == 6
    assert np.array_equal(refined.identity.field.encodings, closed.identity.field.encodings)


def test_refine_is_deterministic(
    scene: Synthetic,
    closed: ClosedForm,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = RefineConfig(rows=_ROWS, steps=10)
    one = _refined(scene, closed, train, label_map, config)
    monkeypatch.setenv("GAGA_THREADS", "1")
    two = _refined(scene, closed, train, label_map, config)
    assert np.array_equal(one.identity.field.encodings, two.identity.field.encodings)
    assert np.array_equal(one.identity.field.weight, two.identity.field.weight)
    assert one.after == two.after


# ---- paper


def _train(
    scene: Synthetic,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
    config: PaperConfig,
    checkpoint: Path | None = None,
) -> Trained:
    return run_stage(
        train_identity(
            scene.gaussians, _G, train, label_map, choose(), config, checkpoint=checkpoint
        )
    )


def test_training_from_zeros_learns_the_groups(
    scene: Synthetic, train: Sequence[Camera], label_map: Callable[[Camera], IntArray]
) -> None:
    config = replace(_PAPER, iterations=300)
    trained = _train(scene, train, label_map, config)
    assert trained.steps == 299
    assert trained.last_loss < 0.6 * trained.first_loss
    assert trained.accuracy > 0.75
    assert _right_pixels(scene, trained.identity.field) > 0.9
    assert np.array_equal(trained.identity.labels, trained.identity.field.labels())
    assert (trained.identity.labels > 0).all()  # class 0 was never trained


def test_the_estimate_comes_first(
    scene: Synthetic, train: Sequence[Camera], label_map: Callable[[Camera], IntArray]
) -> None:
    stage = train_identity(scene.gaussians, _G, train, label_map, choose(), _PAPER)
    first = next(stage)
    assert isinstance(first.payload, TimeEstimate)
    assert (first.done, first.total) == (0, _PAPER.iterations)
    assert first.payload.seconds > _PAPER.iterations * first.payload.seconds_per_step > 0
    stage.close()


@pytest.mark.parametrize("stop_at", [3, 8, 17, 31])
def test_a_stopped_run_goes_on_as_if_it_never_stopped(
    scene: Synthetic,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
    tmp_path: Path,
    stop_at: int,
) -> None:
    whole = _train(scene, train, label_map, _PAPER)
    path = tmp_path / "run.npz"
    stage = train_identity(scene.gaussians, _G, train, label_map, choose(), _PAPER, checkpoint=path)
    for progress in stage:
        if progress.stage == "Train identities" and progress.done == stop_at:
            break
    stage.close()
    assert path.is_file()
    resumed = _train(scene, train, label_map, _PAPER, path)
    assert resumed.resumed_at == stop_at
    assert resumed.steps == whole.steps
    for name in ("encodings", "weight", "bias"):
        ours, theirs = getattr(resumed.identity.field, name), getattr(whole.identity.field, name)
        assert np.array_equal(ours, theirs)


def test_a_checkpoint_of_another_run_is_not_used(
    scene: Synthetic,
    train: Sequence[Camera],
    label_map: Callable[[Camera], IntArray],
    tmp_path: Path,
) -> None:
    path = tmp_path / "run.npz"
    short = replace(_PAPER, iterations=10)
    _train(scene, train, label_map, short, path)
    assert _train(scene, train, label_map, short, path).resumed_at == 8
    assert _train(scene, train, label_map, replace(short, reg_factor=1.0), path).resumed_at == 0
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(GagaError, match=r"run\.npz is damaged"):
        _train(scene, train, label_map, short, path)


def test_the_regulariser_spreads_labels_to_hidden_gaussians(
    train: Sequence[Camera], label_map: Callable[[Camera], IntArray], scene: Synthetic
) -> None:
    logits = scene.gaussians.logit_opacities.copy()
    logits[::4] = -9
    gaussians: Gaussians = replace(scene.gaussians, logit_opacities=logits)
    truth = np.where(scene.labels > 0, scene.labels, _G)
    right = {}
    for every in (0, 1):
        config = replace(_PAPER, iterations=200, reg_every=every, reg_samples=1000)
        trained = run_stage(train_identity(gaussians, _G, train, label_map, choose(), config))
        right[every] = (trained.identity.labels == truth)[::4].mean()
    assert right[1] > right[0] + 0.2
