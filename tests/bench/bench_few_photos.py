"""Training on few photos: held-out quality of drafts on subsets that a seed draws.

Every scene has a subset of the size that `_SCENES` says; all other photos, or 16 of them spread
evenly, are the truth. ``GAGA_BENCH_LONG=1`` takes three seeds instead of one, and trains on the
whole sets too. Set ``GAGA_THREADS=1``.
"""

import os
import time
from dataclasses import replace

import numpy as np

from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.settings import TrainConfig
from gaga_core.training.start import first_splats_stage
from gaga_core.training.train import train
from tests.bench.figures import Figure
from tests.bench.posed_subsets import Subset, data_folder, draw_subset, draw_whole

_SCENES = {"garden": 25, "ycb_table": 12, "fox": 12, "sceaux": 8}  # photos to train on
_BARS = {"garden": 21.3, "ycb_table": 23.5, "fox": 25.4, "sceaux": 18.4}  # dB with seed 0
_WHOLE = ("garden", "ycb_table", "fox")
_SIDE = 160  # pixels, longest side of the photos
_ITERATIONS = 600
_MOST_SPLATS = 40_000


def figures() -> list[Figure]:
    """Mean, worst view and CPU time of each scene; none of scenes that are not on this machine."""
    is_long = os.environ.get("GAGA_BENCH_LONG", "") not in ("", "0")
    found = []
    for name, n_train in _SCENES.items():
        if data_folder(name).is_dir():
            seeds = range(3 if is_long else 1)
            subsets = [draw_subset(name, n_train, seed, _SIDE) for seed in seeds]
            bar = "" if is_long else f">= {_BARS[name]}"
            found += _figures(f"{name}, {n_train} photos", subsets, bar)
    for name in _WHOLE if is_long else ():
        if data_folder(name).is_dir():
            found += _figures(f"{name}, all photos", [draw_whole(name, _SIDE)], "")
    return found


def _figures(title: str, subsets: list[Subset], bar: str) -> list[Figure]:
    """The mean over ``subsets``, and how far they are apart."""
    config = replace(TrainConfig.of("draft"), iterations=_ITERATIONS, longest_side=_SIDE)
    config = replace(config.with_cap(_MOST_SPLATS), measure_every=1.0)
    rows = []
    for subset in subsets:
        start, cpu = time.process_time(), CpuRasterizer()
        initial = run_stage(
            first_splats_stage(subset.points, subset.colors, subset.views.train, config, cpu)
        )
        quality = train(initial, subset.views, config, cpu).quality
        assert quality is not None
        worst = min(view.psnr for view in quality.views)
        rows.append((quality.psnr, worst, quality.ssim, time.process_time() - start))
    psnr, worst, ssim, seconds = (float(column) for column in np.mean(rows, axis=0))
    found = [
        Figure(f"{title}: held-out PSNR", psnr, "dB", bar),
        Figure(f"{title}: worst view", worst, "dB"),
        Figure(f"{title}: held-out SSIM", ssim, ""),
        Figure(f"{title}: CPU time", seconds, "s"),
    ]
    if len(rows) > 1:
        spread = float(np.std([row[0] for row in rows], ddof=1))
        found.append(Figure(f"{title}: spread of held-out PSNR", spread, "dB"))
    return found
