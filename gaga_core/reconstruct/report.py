"""What a training leaves to read: settings, curves and held-out quality for ``report.json``."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.reconstruct.settings import TrainConfig
from gaga_core.reconstruct.train import Trained

_POINTS = 500  # of the loss curve

Json = dict[str, "Json"] | Sequence["Json"] | str | int | float | bool | None


@dataclass(frozen=True)
class Cost:
    """What a training took on this machine."""

    wall_seconds: float
    cpu_seconds: float  # of all threads together


def report_of(trained: Trained, config: TrainConfig, cost: Cost) -> dict[str, Json]:
    """The content of ``report.json``: plain values only.

    ``kept_iteration`` is the one that the splats are of (`TrainConfig.keeps_best`); ``held_out``
    has PSNR in dB and SSIM of each held-out view and their means, null without any; ``loss_curve``
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
    n = min(_POINTS, len(losses))
    ends = np.linspace(0, len(losses), n + 1).astype(int)
    return [
        {"iteration": int(end), "loss": round(float(losses[start:end].mean()), 5)}
        for start, end in pairwise(ends)
    ]
