"""A scene with known splats to train on, and trainings of it that are stopped or watched."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.raster.base import Rasterizer
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.optimizer import COLUMNS
from gaga_core.training.settings import TrainConfig
from gaga_core.training.start import initial_gaussians
from gaga_core.training.train import Trained, TrainUpdate, train_stage
from gaga_core.training.views import TrainView, TrainViews
from tests.scenes import objects_scene

CPU = CpuRasterizer()


@dataclass(frozen=True)
class Known:
    """A scene with pictures of all its views, and points as structure from motion finds them."""

    truth: Gaussians
    views: TrainViews
    points: DoubleArray
    colors: UInt8Array

    @property
    def initial(self) -> Gaussians:
        return initial_gaussians(self.points, self.colors)


def known_scene() -> Known:
    """Four balls on a floor, 18 views to train on and 2 to measure on, 64 x 48 pixels."""
    scene = objects_scene(4, 90, n_cameras=20)
    views = []
    for camera in scene.cameras:
        small = replace(camera.resized(64, 48), name=camera.name)
        image = np.clip(CPU.render(scene.gaussians, small).image, 0, 1)
        views.append(TrainView(small, (image * 255 + 0.5).astype(np.uint8)))
    rng = np.random.default_rng(0)
    some = scene.gaussians.take(rng.permutation(len(scene.gaussians))[:400])
    points = some.means + rng.normal(0, 0.02, (400, 3))
    colors = np.clip((0.5 + 0.282 * some.sh[:, 0]) * 255, 0, 255).astype(np.uint8)
    return Known(scene.gaussians, TrainViews(tuple(views[2:]), tuple(views[:2])), points, colors)


def short(iterations: int = 150, **changes: object) -> TrainConfig:
    """The draft settings for that scene."""
    # These pictures are too small for stereo, and behind the scene there is nothing.
    config = replace(TrainConfig.of("draft"), stereo=0, shell=0)
    density = replace(config.density, max_splats=700, every=20)
    return replace(config, iterations=iterations, density=density, **changes)  # type: ignore[arg-type]


def assert_same(a: Gaussians, b: Gaussians) -> None:
    """Bit for bit."""
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def followed(stage: Stage[Trained]) -> tuple[list[TrainUpdate], Trained]:
    """A training to its end, with all that it showed."""
    updates: list[TrainUpdate] = []

    def look(progress: Progress) -> None:
        if isinstance(progress.payload, TrainUpdate):
            updates.append(progress.payload)

    return updates, run_stage(stage, look)


def stop_at(
    iteration: int,
    initial: Gaussians,
    views: TrainViews,
    config: TrainConfig,
    checkpoint: Path,
    rasterizer: Rasterizer = CPU,
) -> None:
    """Train so far and close the stage there, as Cancel does."""
    stage = train_stage(initial, views, config, rasterizer, checkpoint=checkpoint)
    for progress in stage:
        update = progress.payload
        if isinstance(update, TrainUpdate) and update.iteration == iteration:
            stage.close()
            return
    raise AssertionError("the training ended before")
