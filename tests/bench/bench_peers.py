"""Next to programs of others, on the same files, photos and poses: conversions and trainings.

splat-transform (`make peers`, MIT) converts a million generated splats of degree 3; both read the
same .ply. OpenSplat (AGPL-3.0; nothing of it is part of this project) trains on its own rasterizer
for the CPU, 300 steps with its own options, but for pictures of full size from the start: they take
several times as long as a draft of 2,000 steps here (``GAGA_BENCH_LONG=1``: 2,000 steps, hours).
`make bench-peers` builds it where there is a compiler, with OpenCV and what else it needs from the
system; ``GAGA_OPENSPLAT`` names another program. What is missing is left out with a sentence.
Processor time of the whole process, of ours that of the call; memory is the peak of the process. dB
of the same held-out photos, both drawn by our rasterizer.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from gaga_core.gaussians import Gaussians
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.progress import run_stage
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from gaga_core.training.settings import TrainConfig
from gaga_core.training.start import first_splats_stage
from gaga_core.training.train import train
from gaga_core.training.views import TrainViews, quality_stage
from tests.bench.figures import Figure, data_folder, is_long
from tests.bench.posed_subsets import Subset, draw_subset, draw_whole
from tests.peer_tools import node_tool

_FORMATS = {"compressed .ply": "compressed.ply", ".spz": "spz", ".sog": "sog", ".glb": "glb"}
_MILLION = 1_000_000
_MOST_S = 300  # CPU seconds until another program is stopped: its time is more than that
_MOST_TRAINING_S = 36_000
_STEPS = 300
_OPENSPLAT = Path(__file__).resolve().parents[2] / ".peers" / "OpenSplat" / "build" / "opensplat"
_BLACK = np.zeros(3)
_CONVERT = """
import json, re, sys, time
from pathlib import Path
from gaga_core.io.splats.ply import read_ply
from gaga_core.io.splats.splat_files import write_splats
start = time.process_time()
write_splats(Path(sys.argv[2]), read_ply(Path(sys.argv[1])))
took, status = time.process_time() - start, Path("/proc/self/status").read_text()
print(json.dumps([took, int(re.search(r"VmHWM:\\s+(\\d+)", status)[1]) / 1024]))
"""
_RUN = """
import json, resource, subprocess, sys
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[1]), int(sys.argv[1])))
done = subprocess.run(sys.argv[2:], stdout=sys.stderr)
if done.returncode > 0:
    sys.exit(done.returncode)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))
"""


def figures() -> list[Figure]:
    """Processor time of both, memory of ours, and dB."""
    with tempfile.TemporaryDirectory() as scratch:
        return [*_conversions(Path(scratch)), *_trainings(Path(scratch))]


def _say(what: str) -> None:
    print(f"peers: {what}")  # noqa: T201  a benchmark says what it skips


def _measured(code: str, *args: str) -> tuple[float, float]:
    """CPU seconds and MB at the peak, as ``code`` prints them in a process of its own."""
    command = [sys.executable, "-c", code, *args]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    seconds, peak = json.loads(done.stdout)
    return seconds, peak


# --- Conversions.


def _conversions(scratch: Path) -> list[Figure]:
    transform = node_tool("@playcanvas/splat-transform/bin/cli.mjs")
    if transform is None:
        _say("splat-transform is left out: it is not installed (make peers)")
    source = scratch / "million.ply"
    write_ply(source, _generated(_MILLION))
    found = []
    for name, ending in _FORMATS.items():
        warm, ours = scratch / "warm.ply", scratch / f"ours.{ending}"
        write_ply(warm, _generated(1000))  # kernels are compiled once, not by each program
        _measured(_CONVERT, str(warm), str(scratch / f"warm.{ending}"))
        seconds, peak = _measured(_CONVERT, str(source), str(ours))
        title = f"peers: 1M splats to {name}"
        found += [
            Figure(f"{title}, ours", seconds, "CPU-s"),
            Figure(f"{title}, peak of ours", peak, "MiB", "<= 500"),
        ]
        if transform is not None:
            theirs = scratch / f"theirs.{ending}"
            command = (*transform, "-w", "-g", "cpu", str(source), str(theirs))
            other, _ = _measured(_RUN, str(_MOST_S), *command)
            found += [
                Figure(f"{title}, splat-transform", other, "CPU-s"),
                Figure(f"{title}, ours to theirs", seconds / other, "x", "<= 0.5"),
            ]
            if theirs.is_file():
                size = ours.stat().st_size / theirs.stat().st_size
                found.append(Figure(f"{title}, size to theirs", size, "x"))
            else:
                _say(f"splat-transform was stopped after {_MOST_S} CPU-s, {name} not written")
    return found


def _generated(n: int) -> Gaussians:
    """Splats on waves of surfaces, colored smoothly with noise, as captured ones are."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-1, 1, (n, 3))
    means[:, 2] = 0.2 * np.sin(4 * means[:, 0]) + rng.choice([0.0, 0.5], n)
    sh = rng.normal(0, 0.05, (n, 16, 3))
    sh[:, 0] = np.sin(3 * means) + rng.normal(0, 0.1, (n, 3))
    return Gaussians(
        means=means.astype(np.float32),
        quats=rng.normal(size=(n, 4)).astype(np.float32),
        log_scales=rng.normal(-5, 0.5, (n, 3)).astype(np.float32),
        logit_opacities=rng.normal(1, 2, n).astype(np.float32),
        sh=sh.astype(np.float32),
    )


# --- Trainings.


def _trainings(scratch: Path) -> list[Figure]:
    program = os.environ.get("GAGA_OPENSPLAT") or str(_OPENSPLAT)
    if shutil.which(program) is None:
        _say("OpenSplat is left out: it is not built (make bench-peers)")
        return []
    config, found = TrainConfig.of("draft"), []
    steps = config.iterations if is_long() else _STEPS
    for name in ("fox", "garden"):
        if not data_folder(name).is_dir():
            continue
        side = config.longest_side
        drawn = draw_whole(name, side) if name == "fox" else draw_subset(name, 25, 0, side)
        seconds, ours = _ours(drawn, config)
        folder = _written(drawn, scratch / name)
        out = folder / "theirs.ply"
        command = (program, str(folder), "-n", str(steps), "-o", str(out))
        options = ("--num-downscales", "0", "--keep-crs")
        other, _ = _measured(_RUN, str(_MOST_TRAINING_S), *command, *options)
        title = f"peers: {name}, OpenSplat, {steps:,} steps"
        found += [
            Figure(f"peers: {name}, ours, a draft", seconds, "CPU-s"),
            Figure(title, other, "CPU-s"),
            Figure(f"{title}, ours to theirs", seconds / other, "x"),
            Figure(f"peers: {name}, ours, a draft, held-out", ours, "dB"),
            Figure(f"{title}, held-out", _psnr(read_ply(out), drawn.views), "dB"),
        ]
    return found


def _ours(drawn: Subset, config: TrainConfig) -> tuple[float, float]:
    """CPU seconds of the start and of the training, and held-out dB."""
    config, engine = replace(config, keep_best=False), CpuRasterizer()
    for timed in (replace(config, iterations=20), config):  # kernels first
        start = time.process_time()
        stage = first_splats_stage(drawn.points, drawn.colors, drawn.views.train, timed, engine)
        made = train(run_stage(stage), TrainViews(drawn.views.train, ()), timed, engine)
        seconds = time.process_time() - start
    return seconds, _psnr(made.gaussians, drawn.views)


def _psnr(gaussians: Gaussians, views: TrainViews) -> float:
    found = run_stage(quality_stage(gaussians, views.test, CpuRasterizer(), _BLACK))
    assert found is not None
    return found.psnr


def _written(drawn: Subset, folder: Path) -> Path:
    """The photos to train on, their poses and points, as COLMAP has them: binary."""
    (folder / "images").mkdir(parents=True)
    (folder / "text").mkdir()
    (folder / "sparse" / "0").mkdir(parents=True)
    cameras = []
    for view in drawn.views.train:
        camera = replace(view.camera, name=f"{Path(view.camera.name).stem}.png")
        Image.fromarray(view.picture).save(folder / "images" / camera.name)
        cameras.append(camera)
    write_colmap(folder / "text", cameras, drawn.points, drawn.colors)
    pycolmap.Reconstruction(str(folder / "text")).write_binary(str(folder / "sparse" / "0"))
    return folder
