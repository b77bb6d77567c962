"""Training in the antialiased (mip) mode: what is drawn, what the result says, both engines."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gaga_core.progress import run_stage
from gaga_core.training import cuda_train
from gaga_core.training.checkpoint import TrainState
from gaga_core.training.cpu_train import CpuEngine
from gaga_core.training.distributed import SINGLE_WORKER
from gaga_core.training.engine import Engine, Setting
from gaga_core.training.train import train_stage
from gaga_core.training.views import TrainView, quality_stage
from tests.core.training import train_gsplat
from tests.core.training.train_scenes import CPU, Known, followed, short
from tests.scenes import orbit_cameras, random_gaussians

BLACK = np.zeros(3, np.float32)


def test_previews_and_the_result_say_how_they_were_trained(known: Known) -> None:
    """Measured and previewed in the mode of the training, which a viewer takes from the file."""
    for antialiased in (False, True):
        config = short(20, antialiased=antialiased, snapshot_seconds=0.0)
        stage = train_stage(known.initial, known.views, config, CPU)
        updates, trained = followed(stage)
        looks = {u.gaussians.is_antialiased for u in updates if u.gaussians is not None}
        assert trained.gaussians.is_antialiased == antialiased
        assert looks == {antialiased}
        told = known.views.test[1::2]  # the others choose what is kept
        measured = run_stage(quality_stage(trained.gaussians, told, CPU, BLACK))
        assert measured == trained.quality


def test_both_engines_draw_the_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loss of the first step is the same through gsplat's flag, and another one without."""
    train_gsplat.install(monkeypatch)
    small = random_gaussians(21, seed=3)
    views = [
        TrainView(camera, np.full((15, 20, 3), 120, np.uint8))
        for camera in orbit_cameras(2, width=20, height=15)
    ]
    losses = {}
    for antialiased in (False, True):
        config = replace(short(10), smaller=(), dropout=0.0, antialiased=antialiased)
        engines: dict[str, Callable[[TrainState, Setting], Engine]] = {
            "cpu": partial(CpuEngine, rasterizer=CPU),
            "cuda": partial(cuda_train.CudaEngine, device="cpu"),
        }
        for name, engine in engines.items():
            state = TrainState.first(small, 2, 10)
            setting = Setting(views, {}, config, 1.0, SINGLE_WORKER)
            engine(state, setting).advance(state)
            losses[name, antialiased] = float(state.losses[0])
    for antialiased in (False, True):
        assert losses["cuda", antialiased] == pytest.approx(losses["cpu", antialiased], rel=1e-3)
    assert abs(losses["cpu", True] - losses["cpu", False]) > 0.01 * losses["cpu", False]
