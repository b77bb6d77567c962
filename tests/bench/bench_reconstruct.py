"""Training of Gaussians on real scenes: held-out quality and CPU time of an iteration.

The short figures take a minute. ``GAGA_BENCH_LONG=1`` adds the schedules that the bars are about:
a quarter of an hour of one processor. One thread: set ``GAGA_THREADS=1``, or times are of all.
"""

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.io.cameras.colmap import read_colmap
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.settings import TrainConfig
from gaga_core.training.start import first_splats_stage
from gaga_core.training.train import TrainUpdate, train_stage
from gaga_core.training.views import TrainViews, load_views_stage
from tests.bench.figures import Figure

_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def figures() -> list[Figure]:
    """Figures of the scenes that are on this machine; none where there is no such data."""
    found = []
    if _folder("ycb_table").is_dir():
        found += _figures("ycb_table", 320, 500, 60_000, psnr="")
        if _is_long():
            found += _figures("ycb_table", 320, 3000, 60_000, psnr=">= 33", cpu="<= 55")
    if _folder("garden").is_dir() and _is_long():
        found += _figures("garden", 307, 5000, 80_000, psnr=">= 26")
    return found


def _is_long() -> bool:
    return os.environ.get("GAGA_BENCH_LONG", "") not in ("", "0")


def _folder(name: str) -> Path:
    return Path(os.environ.get("GAGA_TEST_DATA", _DATA)) / name


def _figures(
    name: str, longest_side: int, iterations: int, max_splats: int, *, psnr: str, cpu: str = ""
) -> list[Figure]:
    """A draft of one scene; the time is without that of measuring."""
    config = replace(TrainConfig.of("draft"), iterations=iterations, longest_side=longest_side)
    config = replace(config.with_cap(max_splats), measure_every=1.0)
    folder = open_scene_folder(_folder(name))
    model = read_colmap(_folder(name) / "sparse" / "0")
    views: TrainViews = run_stage(
        load_views_stage(folder.cameras, folder.image_paths, folder.test, longest_side)
    )
    cpu_raster = CpuRasterizer()
    initial = run_stage(
        first_splats_stage(model.points, model.point_colors, views.train, config, cpu_raster)
    )
    ends: list[float] = []
    stage = train_stage(initial, views, config, cpu_raster)
    start = time.process_time()
    trained = run_stage(
        stage,
        lambda p: (
            ends.append(time.process_time() - start) if isinstance(p.payload, TrainUpdate) else None
        ),
    )
    took = 1e3 * ends[iterations - 1] / iterations
    last = 1e3 * float(np.median(np.diff(ends[: iterations - 1])[-100:]))
    assert trained.quality is not None
    title = f"train: {name}, {iterations:,} its"
    return [
        Figure(f"{title}, held-out PSNR", trained.quality.psnr, "dB", psnr),
        Figure(f"{title}, held-out SSIM", trained.quality.ssim, ""),
        Figure(f"{title}, splats", len(trained.gaussians), ""),
        Figure(f"{title}, an iteration, mean", took, "CPU-ms", cpu),
        Figure(f"{title}, an iteration at the end", last, "CPU-ms", cpu),
    ]
