"""What the window shows of splats while they are trained."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.scene.scene import Scene

if TYPE_CHECKING:
    from gaga_core.pipeline.place import PlacementReport
    from gaga_core.training.train import TrainUpdate

_POINTS = 240  # of a curve: more than its picture has pixels to show


@dataclass(frozen=True, eq=False)
class TrainingUpdate:
    """Payload of a reconstruction's progress: everything so far, since payloads may be skipped."""

    cameras: tuple[Camera, ...]  # of the placed photos, by name
    notes: tuple[str, ...] = ()  # sentences of the checks
    update: "TrainUpdate | None" = None
    gaussians: Gaussians | None = None  # the newest copy of the splats
    placement: "PlacementReport | None" = None  # of photos that were placed here


@dataclass(eq=False)
class TrainingPreview:
    """A reconstruction that runs. Main thread only."""

    name: str
    iterations: int  # of the training
    cameras: tuple[Camera, ...] = ()
    scene: Scene | None = None  # nothing in it can be edited
    update: "TrainUpdate | None" = None
    placement: "PlacementReport | None" = None
    _shown: Gaussians | None = field(default=None, repr=False)

    def take(self, live: TrainingUpdate) -> bool:
        """Show what is new; return whether the photos have just been placed."""
        is_first = not self.cameras and bool(live.cameras)
        self.cameras, self.update = live.cameras, live.update
        self.placement = live.placement
        if live.gaussians is not None and live.gaussians is not self._shown:
            self._show(live.gaussians)
        return is_first

    def _show(self, gaussians: Gaussians) -> None:
        """Replace the splats inside the same scene, so that the former depth order is kept."""
        self._shown, new = gaussians, Scene.of(gaussians)
        if self.scene is None:
            self.scene = new
            return
        scene = self.scene
        scene.gaussians, scene.labels, scene.state = new.gaussians, new.labels, new.state
        scene.placement, scene.source = new.placement, new.source
        scene.revision.splats_changed(kept=0)


def smoothed(losses: Sequence[float] | np.ndarray, n: int = _POINTS) -> list[tuple[float, float]]:
    """Return a curve of at most ``n`` points (iteration, mean loss) of the loss of every iteration.

    Each point is the mean over its share of the iterations: single views differ a lot.
    """
    values = np.asarray(losses, np.float64)
    if len(values) == 0:
        return []
    edges = np.unique(np.linspace(0, len(values), min(n, len(values)) + 1).astype(int))
    sums = np.add.reduceat(values, edges[:-1])
    means = sums / np.diff(edges)
    return [(float(x), float(y)) for x, y in zip(edges[1:], means, strict=True)]
