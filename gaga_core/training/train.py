"""Training of Gaussians on posed photos: 3D Gaussian Splatting (Kerbl 2023), view by view.

Deterministic from the seed: the same views and settings give the same splats, bit for bit, on any
number of threads, and whether or not the training was stopped and taken up again in between.
"""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster.base import Rasterizer, TrainableRasterizer
from gaga_core.training.checkpoint import (
    Best,
    TrainState,
    digest_of,
    load_checkpoint,
    save_checkpoint,
)
from gaga_core.training.cpu_train import CpuEngine
from gaga_core.training.distributed import SINGLE_WORKER, Team
from gaga_core.training.engine import Engine, Setting
from gaga_core.training.optimizer import camera_extent, with_degree
from gaga_core.training.settings import TrainConfig
from gaga_core.training.views import HeldOutQuality, TrainView, TrainViews, quality_stage

# --- When a training is written to disk: often enough for a crash, rarely enough for the disk.


_MOST_TIME_SHARE = 0.02  # of the training's time may go into writing
_MOST_LOST_SHARE = 0.1  # of the time since its start a crash may cost, if more than the least


def seconds_between(least: float, elapsed: float, took: float) -> float:
    """Seconds from one checkpoint to the next.

    At least ``least``; more when the last one ``took`` long, or when the training has been running
    for long: their number grows with the logarithm of the time then. ``least`` = 0 writes after
    each iteration.
    """
    if least <= 0:
        return 0.0
    return max(least, took / _MOST_TIME_SHARE, _MOST_LOST_SHARE * elapsed)


class Keeper:
    """Writes checkpoints of one training: when they are due, and when asked, if there is anything
    new. Without a path it writes none."""

    def __init__(
        self,
        engine: Engine,
        path: Path | None,
        digest: str,
        seconds: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._engine, self._clock = engine, clock
        self._path, self._digest, self._seconds = path, digest, seconds
        self._start = self._last = self._clock()
        self._saved = 0
        self._took = 0.0

    def tick(self, state: TrainState) -> None:
        """Write ``state`` when that is due."""
        now = self._clock()
        if now - self._last >= seconds_between(self._seconds, now - self._start, self._took):
            self.save(state)

    def save(self, state: TrainState) -> None:
        """Write ``state``, unless that iteration was written."""
        if self._path is not None and state.iteration != self._saved:
            start = self._clock()
            self._engine.fetch(state)
            save_checkpoint(self._path, state, self._digest)
            self._last, self._saved = self._clock(), state.iteration
            self._took = self._last - start


_SAME = 0.3  # dB that tell nothing: another seed changes a draft of few photos by 0.2
STAGE = "Train splats"
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Measured:
    """One point of the curves: quality of the held-out views after ``iteration``."""

    iteration: int
    psnr: float  # dB
    ssim: float


@dataclass(frozen=True, eq=False)
class TrainUpdate:
    """Payload of the training's progress, for a preview."""

    iteration: int
    losses: FloatArray  # (iteration,) of the view of each iteration
    n_splats: int
    measured: tuple[Measured, ...]  # so far
    gaussians: Gaussians | None = None  # a copy, every few seconds


@dataclass(frozen=True, eq=False)
class Trained:
    """The end of a training."""

    gaussians: Gaussians
    quality: HeldOutQuality | None  # on held-out views that chose nothing; None without any
    losses: FloatArray  # (iterations,)
    measured: tuple[Measured, ...]
    kept: int  # iteration that the splats are of: the last one, or the best measured


def train_stage(
    initial: Gaussians,
    views: TrainViews,
    config: TrainConfig,
    rasterizer: Rasterizer,
    *,
    checkpoint: Path | None = None,
    team: Team = SINGLE_WORKER,
) -> Stage[Trained]:
    """Train ``initial`` on ``views.train``; measure on ``views.test``, or on the half of these that
    does not choose (`TrainConfig.choosing`).

    Each `Progress` carries a `TrainUpdate`. ``checkpoint`` is a file that is written every
    `TrainConfig.checkpoint_seconds` or less often (see `checkpoint_schedule`), when the stage is
    closed (cancelled), and at the end; each takes the place of the last one. A later call with the
    same views and settings goes on from it, to the same splats. It is not removed.
    With a ``team`` each worker runs this with equal arguments and draws its own views; all return
    the same splats. Raises ``GagaError`` when the checkpoint is damaged or cannot be written.
    """
    smaller = yield from _smaller_views(views.train, config)
    first = with_degree(initial, min(initial.sh_degree, config.sh_degree))
    state = TrainState.first(first, len(views.train), config.iterations)
    digest = ""
    if checkpoint is not None:
        digest = digest_of(initial, views, config, team.size)
        _remove_leftovers(checkpoint, team)
        sizes = {"views": len(views.train), "iterations": config.iterations}
        found = load_checkpoint(checkpoint, digest, **sizes)
        if found is not None:
            _log.info("%s: going on after iteration %d", checkpoint, found.iteration)
        state = found or state
    positions = np.array([view.camera.position for view in views.train])
    setting = Setting(views.train, smaller, config, camera_extent(positions), team)
    engine = _engine(state, setting, rasterizer)
    keeper = Keeper(
        engine, checkpoint if team.rank == 0 else None, digest, config.checkpoint_seconds
    )
    watcher = _Watcher(engine, config.snapshot_seconds)
    yield Progress(STAGE, state.iteration, config.iterations, "preparing")
    try:
        while True:
            if _is_due(state, config) and views.test:
                yield from _measure_stage(state, engine, views.test, rasterizer, setting)
            if state.iteration >= config.iterations:
                break
            engine.advance(state)
            yield watcher.progress(state)
            keeper.tick(state)
    except GeneratorExit:
        # Cancelled between two iterations. Any other end may lie within one: then what was written
        # last stays.
        keeper.save(state)
        raise
    keeper.save(state)
    engine.fetch(state)
    yield watcher.progress(state)
    best = state.best
    last = engine.copied(state) if best is None else best.gaussians
    # A copy that was brought back from a checkpoint has no comments.
    gaussians = with_degree(last, config.sh_degree).with_antialiasing(config.antialiased)
    _, reporting = _parted(views.test, setting)
    quality = yield from quality_stage(gaussians, reporting, rasterizer, setting.background)
    kept = state.iteration if best is None else best.iteration
    return Trained(gaussians, quality, state.losses, _measured(state), kept)


def train(
    initial: Gaussians, views: TrainViews, config: TrainConfig, rasterizer: Rasterizer
) -> Trained:
    """`train_stage` to its end."""
    return run_stage(train_stage(initial, views, config, rasterizer))


def _engine(state: TrainState, setting: Setting, rasterizer: Rasterizer) -> Engine:
    """The engine that trains where ``rasterizer`` draws."""
    if rasterizer.name == "cuda":
        # Loaded when CUDA was chosen: it imports torch.
        from gaga_core.training.cuda_train import CudaEngine

        return CudaEngine(state, setting)
    if not hasattr(rasterizer, "train_step"):
        raise ValueError(f"rasterizer: {rasterizer.name!r} does not train")
    return CpuEngine(state, setting, cast("TrainableRasterizer", rasterizer))


def _smaller_views(
    views: Sequence[TrainView], config: TrainConfig
) -> Stage[Mapping[float, Sequence[TrainView]]]:
    """The views at each share of their size that the schedule has a use for."""
    result = dict[float, list[TrainView]]()
    for _, share in config.smaller:
        made = result.setdefault(share, [])
        for i, view in enumerate(views):
            yield Progress("Shrink photos", i, len(views), view.camera.name)
            made.append(view.smaller(share))
    return result


def _is_due(state: TrainState, config: TrainConfig) -> bool:
    """Whether the curves get a point here (the end in any case) and have none yet."""
    i = state.iteration
    every = max(1, config.at(config.measure_every))
    if i == 0 or (i % every != 0 and i != config.iterations):
        return False
    return len(state.measured) == 0 or state.measured[-1, 0] != i


def _remove_leftovers(checkpoint: Path, team: Team) -> None:
    """Parts of checkpoints that a process was killed over."""
    if team.rank == 0:
        for part in checkpoint.parent.glob(f".{checkpoint.name}.*.part"):
            part.unlink(missing_ok=True)


def _measure_stage(
    state: TrainState,
    engine: Engine,
    views: Sequence[TrainView],
    rasterizer: Rasterizer,
    setting: Setting,
) -> Stage[None]:
    """Measure on held-out ``views``: a point of the curves, and the best splats so far.

    Only the first worker of a team measures; all keep the same splats. What chooses is no point of
    the curves, unless there is but one held-out view.
    """
    team, now, psnr = setting.team, engine.copied(state), 0.0
    if team.rank == 0:
        choosing, reporting = _parted(views, setting)
        chosen = yield from quality_stage(now, choosing, rasterizer, setting.background)
        quality = yield from quality_stage(now, reporting, rasterizer, setting.background)
        psnr, shown = 0.0 if chosen is None else chosen.psnr, quality or chosen
        assert shown is not None
        row = (state.iteration, shown.psnr, shown.ssim)
        state.measured = np.concatenate([state.measured, [row]])
    psnr = team.size * float(team.mean_values(np.array([psnr]))[0])
    if not setting.config.keeps_best(len(setting.views)):
        return
    top = psnr if state.best is None else max(psnr, state.best.psnr)
    if state.best is None or psnr >= top - _SAME:
        state.best = Best(state.iteration, top, now)


def _parted(
    views: Sequence[TrainView], setting: Setting
) -> tuple[Sequence[TrainView], Sequence[TrainView]]:
    """Held-out views that choose which splats are kept, and those that tell how good they are."""
    every = setting.config.choosing(len(setting.views))
    return (views[::every], [v for i, v in enumerate(views) if i % every]) if every else ((), views)


def _measured(state: TrainState) -> tuple[Measured, ...]:
    return tuple(Measured(int(i), float(p), float(s)) for i, p, s in state.measured)


class _Watcher:
    """Makes the progress reports, with a copy of the splats now and then."""

    def __init__(self, engine: Engine, seconds: float) -> None:
        self._engine, self._seconds = engine, seconds
        self._last = -np.inf

    def progress(self, state: TrainState) -> Progress:
        now, copy = time.monotonic(), None
        if now - self._last >= self._seconds:
            self._last, copy = now, self._engine.copied(state)
        losses = state.losses[: state.iteration]
        n, measured = self._engine.n_splats, _measured(state)
        message = f"{n:,} splats, loss {losses[-1]:.4f}"
        if measured:
            message += f", held-out {measured[-1].psnr:.1f} dB"
        update = TrainUpdate(state.iteration, losses, n, measured, copy)
        return Progress(STAGE, state.iteration, len(state.losses), message, update)


# --- The report of a training: settings, curves and held-out quality for ``report.json``.


_CURVE_POINTS = 500  # of the loss curve

Json = dict[str, "Json"] | Sequence["Json"] | str | int | float | bool | None


@dataclass(frozen=True)
class Cost:
    """Time that a training took on this machine."""

    wall_seconds: float
    cpu_seconds: float  # of all threads together


def report_of(trained: Trained, config: TrainConfig, cost: Cost) -> dict[str, Json]:
    """The content of ``report.json``: plain values only.

    ``kept_iteration`` is the one that the splats are of (`TrainConfig.keeps_best`); ``held_out``
    has PSNR in dB and SSIM of each held-out view that did not choose it and their means, null
    without any; ``loss_curve``
    at most 500 points, each the mean of the iterations since the one before.
    """
    quality = trained.quality
    held_out: Json = None
    if quality is not None:
        held_out = {
            "psnr": round(quality.psnr, 3),
            "ssim": round(quality.ssim, 4),
            "views": [
                {"name": v.name, "psnr": round(v.psnr, 3), "ssim": round(v.ssim, 4)}
                for v in quality.views
            ],
        }
    return {
        "splats": len(trained.gaussians),
        "sh_degree": trained.gaussians.sh_degree,
        "iterations": len(trained.losses),
        "kept_iteration": trained.kept,
        "held_out": held_out,
        "curve": [
            {"iteration": m.iteration, "psnr": round(m.psnr, 3), "ssim": round(m.ssim, 4)}
            for m in trained.measured
        ],
        "loss_curve": _thinned(trained.losses),
        "wall_seconds": round(cost.wall_seconds, 1),
        "cpu_seconds": round(cost.cpu_seconds, 1),
        "settings": asdict(config),
    }


def _thinned(losses: FloatArray) -> list[Json]:
    n = min(_CURVE_POINTS, len(losses))
    ends = np.linspace(0, len(losses), n + 1).astype(int)
    return [
        {"iteration": int(end), "loss": round(float(losses[start:end].mean()), 5)}
        for start, end in pairwise(ends)
    ]
