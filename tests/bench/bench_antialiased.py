"""Splats seen at other sizes than they were trained at: the classic and the antialiased mode.

Drafts of whole photo sets, trained at 160 pixels, held-out views measured at 80, 160 and 320. Takes
minutes of processor time, so only with ``GAGA_BENCH_LONG=1``. Set ``GAGA_THREADS=1``.
"""

import os
from dataclasses import replace

import numpy as np

from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.settings import TrainConfig
from gaga_core.training.start import first_splats_stage
from gaga_core.training.train import train
from gaga_core.training.views import TrainViews, quality_stage
from tests.bench.figures import Figure
from tests.bench.posed_subsets import data_folder, draw_whole

_SCENES = ("ycb_table", "fox")
_LARGE = 320  # pixels of the longest side, twice that of the training
_ITERATIONS = 600
_MOST_SPLATS = 40_000


def figures() -> list[Figure]:
    """Held-out PSNR of each scene, mode and size; none of scenes that are not on this machine."""
    if os.environ.get("GAGA_BENCH_LONG", "") in ("", "0"):
        return []
    found = []
    for name in _SCENES:
        if data_folder(name).is_dir():
            for antialiased in (False, True):
                found += _figures(name, antialiased)
    return found


def _figures(name: str, antialiased: bool) -> list[Figure]:
    whole = draw_whole(name, _LARGE)
    large, cpu = whole.views, CpuRasterizer()
    views = {2: large, 1: large.smaller(0.5), 0.5: large.smaller(0.25)}
    config = replace(TrainConfig.of("draft"), iterations=_ITERATIONS, longest_side=_LARGE // 2)
    config = replace(config.with_cap(_MOST_SPLATS), measure_every=1.0, antialiased=antialiased)
    initial = run_stage(first_splats_stage(whole.points, whole.colors, views[1].train, config, cpu))
    trained = train(initial, TrainViews(views[1].train, ()), config, cpu).gaussians
    found, mode = [], "antialiased" if antialiased else "classic"
    for times, at_size in views.items():
        quality = run_stage(quality_stage(trained, at_size.test, cpu, np.zeros(3)))
        assert quality is not None
        title = f"{name}, {mode}, at {times} x the size"
        found.append(Figure(f"{title}: held-out PSNR", quality.psnr, "dB"))
        found.append(Figure(f"{title}: held-out SSIM", quality.ssim, ""))
    return found
