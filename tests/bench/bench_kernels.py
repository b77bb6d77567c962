"""Kernels at the start of a process: warm from the disk, and compiled for the first time."""

import os
import statistics
import subprocess
import sys
import tempfile

from tests.bench.figures import Figure

_RUNS = 5
_WARM = """
import time
import numpy as np
from gaga_core.raster import choose
from gaga_core.scene.selection.by_screen import pick
from gaga_core.scene.scene import Scene
from tests.scenes import objects_scene
scene = objects_scene(4, 200)
camera, n = scene.cameras[0], len(scene.gaussians)
cpu = choose("cpu")
cpu.render(scene.gaussians, camera)
cpu.label_splat(scene.gaussians, camera, scene.labels)
cpu.vote(scene.gaussians, camera, np.zeros((120, 160), np.int32), np.zeros((n, 1), np.float32))
pick(Scene.of(scene.gaussians, scene.labels), camera, 80.5, 60.5)
print(time.process_time())
"""
_ALL = """
import time
from gaga_core.pipeline.compile_kernels import warm_up_stage
steps = sum(1 for _ in warm_up_stage())
print(time.process_time(), steps)
"""


def figures() -> list[Figure]:
    """CPU seconds of whole processes, the start of Python and all imports included."""
    with tempfile.TemporaryDirectory() as cache:
        cold, n_steps = _run(_ALL, cache)
        again = statistics.median(_run(_ALL, cache)[0] for _ in range(_RUNS))
        warm = statistics.median(_run(_WARM, cache)[0] for _ in range(_RUNS))
        python = statistics.median(
            _run("import time, numpy; print(time.process_time())", cache)[0] for _ in range(_RUNS)
        )
    return [
        Figure("kernels: warm start, render, label map, vote, pick", warm, "CPU-s", "<= 2"),
        Figure("kernels: the same to a start of Python and numpy", warm / python, "x"),
        Figure("kernels: load all of the association, too", again, "CPU-s", "<= 2"),
        Figure("kernels: compile all, once", cold, "CPU-s", "<= 40"),
        Figure("kernels: steps of progress of that", n_steps, "steps", ">= 5"),
    ]


def _run(code: str, cache: str) -> tuple[float, ...]:
    """The numbers that ``code`` prints in a process whose kernels are cached in ``cache``."""
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
        check=True,
        capture_output=True,
        text=True,
    )
    return tuple(float(word) for word in run.stdout.split())
