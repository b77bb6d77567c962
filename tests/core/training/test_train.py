"""Training on a scene with known splats: it learns, stops, goes on, and always the same way."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.progress import run_stage
from gaga_core.raster.base import Gradients
from gaga_core.training.densification import ScreenSums
from gaga_core.training.optimizer import Splats
from gaga_core.training.settings import QUALITIES, TrainConfig
from gaga_core.training.start import first_splats_stage, initial_gaussians
from gaga_core.training.train import Cost, TrainUpdate, report_of, train, train_stage
from gaga_core.training.views import TrainView, TrainViews, quality_stage
from tests.core.training.train_scenes import CPU, Known, assert_same, followed, short, stop_at

BLACK = np.zeros(3, np.float32)


def quality_of(gaussians: Gaussians, known: Known) -> float:
    quality = run_stage(quality_stage(gaussians, known.views.test, CPU, BLACK))
    assert quality is not None
    return quality.psnr


@pytest.mark.parametrize("strategy", ["gradient", "mcmc"])
def test_a_short_training_learns_the_scene(known: Known, strategy: str) -> None:
    """Held-out views get better by decibels, and the loss falls."""
    config = short(sh_degree=1, smaller=())  # losses of one size of picture
    if strategy == "mcmc":
        config = config.with_mcmc()
    trained = train(known.initial, known.views, config, CPU)
    assert trained.quality is not None
    assert trained.quality.psnr > quality_of(known.initial, known) + 2.5
    assert trained.losses[-20:].mean() < 0.65 * trained.losses[:3].mean()
    assert len(trained.gaussians) > len(known.points)
    assert trained.gaussians.sh_degree == 1
    assert len(trained.gaussians) <= config.density.max_splats
    last = trained.measured[-1]
    assert last.iteration == config.iterations
    assert last.psnr == pytest.approx(trained.quality.psnr)


def test_a_background_that_is_left_out_stays_empty(known: Known) -> None:
    """Two of four balls are the object: nothing is left of the rest, in held-out views too."""
    half = known.truth.means[:, 0] > np.median(known.truth.means[:, 0])
    ball = known.truth.take(half & (known.truth.means[:, 2] > 0.05))

    def masked(view: TrainView) -> TrainView:
        alpha = CPU.render(ball, view.camera).alpha
        return replace(view, alpha=np.where(alpha > 0.5, 255, 0).astype(np.uint8))

    train_views, test_views = (
        tuple(masked(view) for view in views) for views in (known.views.train, known.views.test)
    )
    views, config = TrainViews(train_views, test_views), short(300)
    stage = first_splats_stage(known.points, known.colors, views.train, config, CPU)
    trained = train(run_stage(stage), views, config, CPU).gaussians
    for view in test_views:
        assert view.alpha is not None
        drawn = CPU.render(trained, view.camera).alpha
        away = ~binary_dilation(view.alpha > 0, iterations=2)
        assert drawn[away].mean() < 0.05
        assert drawn[view.alpha > 0].mean() > 0.8


def test_the_same_seed_gives_the_same_splats(known: Known, monkeypatch: pytest.MonkeyPatch) -> None:
    """On any number of threads; another seed gives others."""
    monkeypatch.setenv("GAGA_THREADS", "1")
    one = train(known.initial, known.views, short(50), CPU)
    monkeypatch.setenv("GAGA_THREADS", "4")
    again = train(known.initial, known.views, short(50), CPU)
    assert_same(one.gaussians, again.gaussians)
    other = train(known.initial, known.views, short(50, seed=1), CPU)
    assert not np.array_equal(one.losses, other.losses)


@pytest.mark.parametrize("strategy", ["gradient", "mcmc"])
@pytest.mark.parametrize("stopped", [7, 40, 63])
def test_a_stopped_training_goes_on_as_if_nothing_had_been(
    known: Known, tmp_path: Path, strategy: str, stopped: int
) -> None:
    """Stopped before, at and after density control: bit for bit the uninterrupted result."""
    config = short(70, exposure=True)
    config = replace(config, density=replace(config.density, strategy=strategy))  # type: ignore[arg-type]
    whole = train(known.initial, known.views, config, CPU)
    file = tmp_path / "training.npz"
    stop_at(stopped, known.initial, known.views, config, file)
    stage = train_stage(known.initial, known.views, config, CPU, checkpoint=file)
    seen, resumed = followed(stage)
    assert seen[0].iteration == stopped + 1
    assert_same(whole.gaussians, resumed.gaussians)
    np.testing.assert_array_equal(whole.losses, resumed.losses)
    assert whole.measured == resumed.measured
    assert [p.name for p in tmp_path.iterdir()] == ["training.npz"]


def test_a_checkpoint_of_another_training_is_not_taken(known: Known, tmp_path: Path) -> None:
    file = tmp_path / "training.npz"
    stop_at(20, known.initial, known.views, short(30), file)
    for config in (short(31), short(30, seed=5)):
        stage = train_stage(known.initial, known.views, config, CPU, checkpoint=file)
        first = next(p.payload for p in stage if isinstance(p.payload, TrainUpdate))
        assert first.iteration == 1
        stage.close()


def test_a_damaged_checkpoint_is_named(known: Known, tmp_path: Path) -> None:
    file = tmp_path / "training.npz"
    stop_at(20, known.initial, known.views, short(30), file)
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(GagaError, match=r"training\.npz is damaged"):
        run_stage(train_stage(known.initial, known.views, short(30), CPU, checkpoint=file))


def test_a_failure_leaves_the_last_good_checkpoint(
    known: Known, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Memory that ends within an iteration, after splats were moved: what was written is whole."""
    config, file = short(30, checkpoint_seconds=0.0), tmp_path / "training.npz"
    whole = train(known.initial, known.views, config, CPU)
    add, n_added = ScreenSums.add, 0

    def failing(self: ScreenSums, gradients: Gradients) -> None:
        nonlocal n_added
        n_added += 1
        if n_added == 9:
            raise MemoryError
        add(self, gradients)

    with monkeypatch.context() as patch:
        patch.setattr(ScreenSums, "add", failing)
        with pytest.raises(MemoryError):
            run_stage(train_stage(known.initial, known.views, config, CPU, checkpoint=file))
    assert 1 <= int(np.load(file)["iteration"]) <= 8
    resumed = run_stage(train_stage(known.initial, known.views, config, CPU, checkpoint=file))
    assert_same(whole.gaussians, resumed.gaussians)


def test_observers_get_copies_that_stay(known: Known) -> None:
    config = short(30, snapshot_seconds=0.0)
    copies: list[tuple[Gaussians, Gaussians]] = []
    for progress in train_stage(known.initial, known.views, config, CPU):
        if isinstance(progress.payload, TrainUpdate):
            assert progress.done == progress.payload.iteration
            gaussians = progress.payload.gaussians
            assert gaussians is not None
            copies.append((gaussians, gaussians.take(np.arange(len(gaussians)))))
    assert len(copies) >= 30
    for given, then in copies:
        assert_same(given, then)


def test_exposure_is_found_and_kept_out_of_the_splats(known: Known, tmp_path: Path) -> None:
    """Photos of other brightness are met better, their gains are found, and none is left over."""
    rng = np.random.default_rng(3)
    gains = rng.uniform(0.5, 1.0, len(known.views.train))
    gains /= gains.max()
    dim = tuple(
        TrainView(view.camera, (view.picture * gain).astype(np.uint8))
        for view, gain in zip(known.views.train, gains, strict=True)
    )

    def last_loss(exposure: bool) -> float:
        config = short(400, exposure=exposure, exposure_rate=2e-2)
        file = tmp_path / f"{exposure}.npz"
        views = TrainViews(dim, known.views.test)
        stage = train_stage(known.initial, views, config, CPU, checkpoint=file)
        return float(run_stage(stage).losses[-36:].mean())

    assert last_loss(True) < 0.92 * last_loss(False)
    found = np.load(tmp_path / "True.npz")["exposures_values"]
    assert np.corrcoef(found[:, 0].mean(axis=1), gains)[0, 1] > 0.9
    np.testing.assert_allclose(found.mean(axis=0), [[1] * 3, [0] * 3], atol=1e-9)


def test_too_few_photos_and_points_are_named(known: Known) -> None:
    with pytest.raises(GagaError, match="There is 1 photo to train on"):
        TrainViews(known.views.train[:1], known.views.test)
    with pytest.raises(GagaError, match="0 points"):
        initial_gaussians(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
    nan = np.full((9, 3), np.nan)
    with pytest.raises(GagaError, match="0 points"):
        initial_gaussians(nan, np.zeros((9, 3), np.uint8))


def test_the_published_schedule_resets_opacities_and_recovers(known: Known) -> None:
    config = replace(TrainConfig.of("full").with_cap(700), iterations=100, snapshot_seconds=0.0)
    updates, _ = followed(train_stage(known.initial, known.views, config, CPU))
    highest = {u.iteration: float(u.gaussians.opacities.max()) for u in updates if u.gaussians}
    cut = {i for i in range(2, 101) if highest[i] < 0.9 * highest[i - 1]}
    assert cut == {11, 21, 31, 41}
    assert max(highest[i] for i in cut) < 0.011
    assert highest[100] > 0.3


def test_what_is_measured_is_not_cut_before(known: Known) -> None:
    """Both are due every tenth of the published schedule: a curve of held-out views shows training
    alone."""
    config = replace(TrainConfig.of("full").with_cap(700), iterations=100)
    density = replace(config.density, stop=0.2, start=0.2)
    trained = train(known.initial, known.views, replace(config, density=density), CPU)
    never = replace(density, reset_every=0.0)
    plain = train(known.initial, known.views, replace(config, density=never), CPU)
    assert trained.measured[0] == plain.measured[0]
    assert trained.measured[1] != plain.measured[1]


def test_decay_thins_and_shrinks(known: Known) -> None:
    plain = train(known.initial, known.views, short(60), CPU).gaussians
    thin = train(known.initial, known.views, short(60, opacity_decay=1.0), CPU).gaussians
    small = train(known.initial, known.views, short(60, scale_decay=5.0), CPU).gaussians
    assert thin.opacities.mean() < 0.8 * plain.opacities.mean()
    assert small.scales.mean() < 0.9 * plain.scales.mean()


@pytest.mark.parametrize("quality", QUALITIES)
def test_settings_have_a_name_and_scale(quality: str) -> None:
    config = TrainConfig.of(quality)
    assert config.quality == quality
    assert config.with_cap(5).density.max_splats == 5
    assert replace(config, iterations=10).at(0.5) == 5
    assert config.cpu_seconds(100_000) < config.cpu_seconds(400_000)
    assert TrainConfig.of("draft").cpu_seconds(94_000) < config.cpu_seconds(94_000) + 1
    with pytest.raises(ValueError, match="quality"):
        TrainConfig.of("best")
    with pytest.raises(ValueError, match="sh_degree"):
        replace(config, sh_degree=4)


def test_the_report_is_plain_json_and_says_what_came_out(known: Known) -> None:
    config = short(30)
    trained = train(known.initial, known.views, config, CPU)
    report = json.loads(json.dumps(report_of(trained, config, Cost(12.34, 56.78))))
    assert trained.quality is not None
    assert report["held_out"]["psnr"] == pytest.approx(trained.quality.psnr, abs=1e-3)
    assert [v["name"] for v in report["held_out"]["views"]] == ["001.png"]  # the other one chose
    assert report["splats"] == len(trained.gaussians)
    assert report["settings"]["density"]["max_splats"] == 700
    assert [p["iteration"] for p in report["loss_curve"]] == list(range(1, 31))
    assert report["loss_curve"][3]["loss"] == pytest.approx(trained.losses[3], abs=1e-5)
    assert report["curve"][-1]["iteration"] == 30
    alone = train(known.initial, TrainViews(known.views.train, ()), short(4), CPU)
    assert (alone.quality, alone.measured) == (None, ())
    assert report_of(alone, short(4), Cost(1, 1))["held_out"] is None


def test_what_has_no_points_is_covered_first(known: Known) -> None:
    """Photos of a floor that has no points: splats of its color, about there, and a better end."""
    on_balls = known.points[:, 2] > -0.2
    config = short(60, cover=500)
    bare = initial_gaussians(
        known.points[on_balls], known.colors[on_balls], opacity=config.initial_opacity
    )

    def covered(most: int) -> Gaussians:
        return run_stage(
            first_splats_stage(
                known.points[on_balls],
                known.colors[on_balls],
                known.views.train,
                replace(config, cover=most),
                CPU,
            )
        )

    first = covered(500)
    assert_same(covered(0), bare)
    assert len(bare) + 50 < len(first) <= len(bare) + 500
    assert len(covered(20)) == len(bare) + 20
    np.testing.assert_array_equal(first.means[: len(bare)], bare.means)
    with_cover = train(first, known.views, config, CPU).quality
    without = train(bare, known.views, config, CPU).quality
    assert with_cover is not None
    assert without is not None
    assert with_cover.psnr > without.psnr + 0.3


def test_no_more_points_are_taken_than_the_cap_allows(known: Known) -> None:
    def first(most: int) -> Gaussians:
        config = short(5).with_cap(most)
        args = (known.points, known.colors, known.views.train, config, CPU)
        return run_stage(first_splats_stage(*args))

    def n_points(most: int) -> int:
        found = {tuple(row) for row in first(most).means}
        return len(found & {tuple(row) for row in known.points.astype(np.float32)})

    assert len(first(100)) <= 100
    assert n_points(100) == 75  # the rest is for what covers holes
    assert_same(first(100), first(100))
    assert n_points(2 * len(known.points)) == len(known.points)
    trained = train(first(100), known.views, short(30).with_cap(100), CPU)
    assert len(trained.gaussians) <= 100


def test_a_view_that_shows_nothing_does_no_harm(known: Known) -> None:
    """A camera that looks away, a splat that is no number: the rest is trained."""
    away = known.views.train[0]
    turned = away.camera.cam_from_world.copy()
    turned[[0, 2]] *= -1
    views = TrainViews(
        (*known.views.train, TrainView(replace(away.camera, cam_from_world=turned), away.picture)),
        known.views.test,
    )
    broken = Splats.of(known.initial).values
    broken.means[3] = np.nan
    broken.logit_opacities[5] = np.nan
    trained = train(broken, views, short(60), CPU)
    assert trained.quality is not None
    assert trained.quality.psnr > quality_of(known.initial, known)
    assert np.isfinite(trained.losses).all()


def test_what_covers_holes_is_in_front_of_no_other_camera() -> None:
    """Points near a camera that looks away: others put what they see next to them far behind it."""
    rng = np.random.default_rng(0)
    points = np.array([1.5, 0, 0]) + rng.normal(0, 0.05, (40, 3))
    up, size = np.array([0, 0, 1.0]), 64
    K = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1.0]])
    views = []
    for eye, target in (([-2, 0, 0], 0), ([-2, 0.3, 0], 0), ([2, 0, 0], 5)):
        pose = look_at(np.array(eye, np.float64), np.array([target, 0, 0.0]), up)
        camera = Camera(K, pose, size, size)
        views.append(TrainView(camera, np.full((size, size, 3), 99, np.uint8)))
    colors = np.full((40, 3), 200, np.uint8)
    first = run_stage(first_splats_stage(points, colors, views, short(5, cover=500), CPU))
    covers = first.means[len(points) :]
    assert len(covers) > 100
    assert np.linalg.norm(covers - [2, 0, 0], axis=1).min() > 1.5
