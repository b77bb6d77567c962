"""Place a capture as a person would, and say how far off the cameras are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.pipeline.reconstruct import reconstruct_scene
from gaga_core.pipeline.settings import ReconstructConfig
from gaga_core.progress import run_stage


@dataclass(frozen=True)
class Placed:
    """What came out."""

    sfm: Mapping[str, Any]  # entry of the report
    notes: str
    cameras: tuple[Camera, ...]

    @property
    def share(self) -> float:
        """Of the photos that were placed."""
        return float(self.sfm["registered"]) / float(self.sfm["photos"])

    def off(self, true: Sequence[Camera]) -> float:
        """Worst distance of a camera from its true place, as a share of the cameras' extent."""
        place = {Path(camera.name).stem: camera.position for camera in true}
        mine = np.array([camera.position for camera in self.cameras])
        theirs = np.array([place[Path(camera.name).stem] for camera in self.cameras])
        return off_after_alignment(mine, theirs)


def placed(photos: Path, scene: Path, config: ReconstructConfig | None = None) -> Placed:
    """Place ``photos``, with default options if nothing else is said."""
    config = config or ReconstructConfig(only="sfm")
    made = run_stage(reconstruct_scene(photos, scene, config))
    sfm = made.report["sfm"]
    assert isinstance(sfm, dict)
    return Placed(sfm, " ".join(made.notes), open_scene_folder(scene).cameras)


def off_after_alignment(mine: DoubleArray, true: DoubleArray) -> float:
    """Worst distance after the best similarity (Umeyama 1991), over the extent of ``true``."""
    a, b = mine - mine.mean(axis=0), true - true.mean(axis=0)
    u, sizes, vt = np.linalg.svd(b.T @ a)
    flip = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (sizes * np.diag(flip)).sum() / (a**2).sum()
    aligned = scale * a @ (u @ flip @ vt).T
    worst = np.linalg.norm(aligned - b, axis=1).max()
    return float(worst / np.linalg.norm(b, axis=1).max())
