"""Loss of measured depth: the depth that splats draw against what a phone measured.

The depth is drawn as a color, with the coverage as another, so that the gradients are those of the
rasterizer. It is compared where both are known, relative to the median of the view, so that units
do not matter (as Deng 2022 and Kerbl 2024 have it, from other sources of depth).
"""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.camera import Camera
from gaga_core.color import SH_C0, dc_from_rgb
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients, TrainableRasterizer
from gaga_core.training.views import TrainView

_SIDE = 128  # pixels of the longest side: phones measure 256, smoothed over several
_LEAST_COVERAGE = 0.05  # of a pixel whose depth is compared
_COLUMNS = ("means", "quats", "log_scales", "logit_opacities")


@dataclass(frozen=True, eq=False)
class DepthGradients:
    """Gradients of the loss by the raw parameters of all N splats; 0 where a view shows none."""

    means: FloatArray  # (N, 3)
    quats: FloatArray  # (N, 4)
    log_scales: FloatArray  # (N, 3)
    logit_opacities: FloatArray  # (N,)

    def add_to(self, gradients: Gradients) -> None:
        """Add them to the rows of ``gradients``, in place."""
        for name in _COLUMNS:
            getattr(gradients, name)[:] += getattr(self, name)[gradients.indices]


def depth_gradients(
    splats: Gaussians, view: TrainView, rasterizer: TrainableRasterizer, weight: float
) -> DepthGradients | None:
    """Gradients of ``weight`` x the mean relative error of depth in a view; None where it has no
    depth."""
    if view.depth is None or weight <= 0 or not (view.depth > 0).any():
        return None
    camera, measured = _sampled(view.camera, view.depth)
    known = measured > 0
    unit, forward = float(np.median(measured[known])), camera.cam_from_world[2]
    by_place = (forward / unit).astype(np.float32)
    far = splats.means @ by_place[:3] + by_place[3]
    colors = np.stack([far, np.ones_like(far), np.zeros_like(far)], axis=1)
    shown = replace(splats, sh=dc_from_rgb(colors)[:, None])
    share = np.float32(weight / known.sum())

    def loss(image: FloatArray, target: FloatArray) -> tuple[float, FloatArray]:
        covered = np.maximum(image[..., 1], _LEAST_COVERAGE)
        off = image[..., 0] / covered - target[..., 0]
        side = np.sign(off) * (known & (image[..., 1] > _LEAST_COVERAGE)) * share
        gradient = np.zeros_like(image)
        gradient[..., 0] = side / covered
        gradient[..., 1] = -side * image[..., 0] / covered**2
        return float(np.abs(off * side).sum()), gradient

    wanted = np.repeat((measured / np.float32(unit))[..., None], 3, axis=2)
    step = rasterizer.train_step(shown, camera, wanted, loss, background=np.zeros(3, np.float32))
    found, rows = step.gradients, step.gradients.indices
    # By the color: a splat that is farther has a larger one.
    found.means[:] += found.sh[:, :1, 0] * np.float32(1 / SH_C0) * by_place[:3]
    columns = {name: np.zeros_like(getattr(splats, name)) for name in _COLUMNS}
    for name, column in columns.items():
        column[rows] = getattr(found, name)
    return DepthGradients(**columns)


def _sampled(camera: Camera, depth: FloatArray) -> tuple[Camera, FloatArray]:
    """Every n-th pixel of a depth map, and the camera whose pixels these are."""
    height, width = depth.shape
    step = -(-max(height, width) // _SIDE)
    first = step // 2
    sampled = np.ascontiguousarray(depth[first::step, first::step])
    whole = camera.resized(width, height)
    to_sampled = np.array([[1, 0, -first - 0.5], [0, 1, -first - 0.5], [0, 0, step]]) / step
    to_sampled[:2, 2] += 0.5
    K = to_sampled @ whole.K
    return replace(whole, K=K, width=sampled.shape[1], height=sampled.shape[0]), sampled
