"""How well Gaussians draw views that they were not trained on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.reconstruct.losses import psnr, ssim
from gaga_core.reconstruct.views import TrainView

STAGE = "Measure on held-out views"


@dataclass(frozen=True)
class HeldOutView:
    """One view: the picture against the photo."""

    name: str
    psnr: float  # dB
    ssim: float


@dataclass(frozen=True)
class HeldOutQuality:
    """Means over the views, and each of them."""

    psnr: float  # dB, mean over views
    ssim: float
    views: tuple[HeldOutView, ...]


def quality_stage(
    gaussians: Gaussians,
    views: Sequence[TrainView],
    rasterizer: Rasterizer,
    background: DoubleArray | FloatArray,
) -> Stage[HeldOutQuality | None]:
    """PSNR and SSIM of ``views``, colors clipped to 0..1; None when there are none."""
    found = []
    for i, view in enumerate(views):
        yield Progress(STAGE, i, len(views), view.camera.name)
        image = rasterizer.render(gaussians, view.camera, background=background).image
        image = np.clip(image, 0, 1)
        target = view.target()
        found.append(HeldOutView(view.camera.name, psnr(image, target), ssim(image, target)))
    if not found:
        return None
    return HeldOutQuality(
        float(np.mean([v.psnr for v in found])),
        float(np.mean([v.ssim for v in found])),
        tuple(found),
    )
