"""Few photos: where later splats draw the held-out views worse, earlier ones are the result."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.training.settings import TrainConfig
from gaga_core.training.train import Trained, train, train_stage
from gaga_core.training.views import HeldOutQuality, TrainView, TrainViews
from tests.core.training.train_scenes import CPU, Known, assert_same, followed, short, stop_at


@pytest.fixture(scope="module")
def contrary(known: Known) -> Known:
    """Held-out views show the first splats: whatever the photos teach is wrong there."""
    views = []
    for view in known.views.test:
        image = np.clip(CPU.render(known.initial, view.camera).image, 0, 1)
        views.append(TrainView(view.camera, (image * 255 + 0.5).astype(np.uint8)))
    return replace(known, views=TrainViews(known.views.train, tuple(views)))


def config(**changes: object) -> TrainConfig:
    return short(30, measure_every=0.2, snapshot_seconds=0.0, sh_degree=1, smaller=(), **changes)


def previewed(known: Known, settings: TrainConfig) -> tuple[Trained, list[Gaussians]]:
    updates, trained = followed(train_stage(known.initial, known.views, settings, CPU))
    return trained, [u.gaussians for u in updates if u.gaussians is not None]


def test_the_best_measured_splats_are_the_result(contrary: Known) -> None:
    trained, previews = previewed(contrary, config())
    kept = next(m for m in trained.measured if m.iteration == trained.kept)
    assert trained.kept < 30
    assert trained.quality is not None
    assert trained.quality.psnr == kept.psnr > trained.measured[-1].psnr
    then = previews[trained.kept - 1]
    n_sh = then.sh.shape[1]
    assert_same(replace(trained.gaussians, sh=trained.gaussians.sh[:, :n_sh].copy()), then)
    assert not trained.gaussians.sh[:, n_sh:].any()
    assert trained.gaussians.sh_degree == 1


def test_what_chooses_does_not_tell_how_good_the_choice_is(contrary: Known) -> None:
    """Every other held-out photo chooses; the report is of the rest, none where one is all."""
    chooser, teller = contrary.views.test[0], contrary.views.train[0]
    views = replace(contrary.views, test=(chooser, teller))
    trained, _ = previewed(replace(contrary, views=views), config())
    assert trained.quality is not None
    assert [view.name for view in trained.quality.views] == [teller.camera.name]
    kept = {m.iteration: m.psnr for m in trained.measured}
    assert trained.quality.psnr == kept[trained.kept] < max(kept.values())
    alone = replace(contrary.views, test=(chooser,))
    only, _ = previewed(replace(contrary, views=alone), config())
    assert (only.kept, only.quality) == (trained.kept, None)
    assert len(only.measured) == len(trained.measured)
    whole, _ = previewed(replace(contrary, views=views), config(keep_best=False))
    assert whole.quality is not None
    assert len(whole.quality.views) == 2


def test_the_last_ones_where_nothing_was_better_or_photos_are_many(contrary: Known) -> None:
    for settings in (replace(config(), measure_every=1.0), config(keep_best=False)):
        trained, previews = previewed(contrary, settings)
        assert trained.kept == 30
        assert_same(trained.gaussians, previews[-1])
    assert TrainConfig().keeps_best(49)
    assert not TrainConfig().keeps_best(50)
    nothing = TrainViews(contrary.views.train, ())
    assert train(contrary.initial, nothing, config(), CPU).kept == 30


@pytest.mark.parametrize(("fall", "kept"), [(0.02, 30), (0.2, 12), (1.0, 6)])
def test_a_difference_that_is_noise_chooses_nothing(
    contrary: Known, monkeypatch: pytest.MonkeyPatch, fall: float, kept: int
) -> None:
    """One held-out photo had kept a fifth of a training. What falls on and on does not creep away
    from the best: of five measurements, each ``fall`` dB worse, the last within 0.3 dB of it."""
    psnr = iter(20 - fall * k for k in range(9))

    def measured(
        _: object, views: Sequence[TrainView], *__: object
    ) -> Stage[HeldOutQuality | None]:
        yield Progress("Measure", 0, 1)
        return HeldOutQuality(next(psnr), 0.5, ()) if views else None

    monkeypatch.setattr("gaga_core.training.train.quality_stage", measured)
    alone = replace(contrary.views, test=contrary.views.test[:1])
    trained, _ = previewed(replace(contrary, views=alone), config())
    assert trained.kept == kept


@pytest.mark.parametrize("stopped", [6, 13])
def test_the_best_ones_survive_a_stop(contrary: Known, tmp_path: Path, stopped: int) -> None:
    settings, file = config(), tmp_path / "training.npz"
    whole = train(contrary.initial, contrary.views, settings, CPU)
    stop_at(stopped, contrary.initial, contrary.views, settings, file)
    again = train_stage(contrary.initial, contrary.views, settings, CPU, checkpoint=file)
    resumed = run_stage(again)
    assert (resumed.kept, resumed.measured) == (whole.kept, whole.measured)
    assert_same(resumed.gaussians, whole.gaussians)
