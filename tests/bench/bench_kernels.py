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
import sys
import time
from gaga_core.pipeline.compile_kernels import warm_up_stage
steps = [time.process_time() for _ in warm_up_stage(*sys.argv[1:])]
print(time.process_time(), len(steps), steps[min(3, len(steps) - 1)])
"""


def figures() -> list[Figure]:
    """CPU seconds of whole processes, the start of Python and all imports included."""
    with tempfile.TemporaryDirectory() as cache:
        window, _, first = _run(_ALL, cache, "window")
        rest, _, _ = _run(_ALL, cache, "grouping", "training", "export", "lod")
        again = statistics.median(_run(_ALL, cache, "window", "grouping")[0] for _ in range(_RUNS))
        warm = statistics.median(_run(_WARM, cache)[0] for _ in range(_RUNS))
        python = statistics.median(
            _run("import time, numpy; print(time.process_time())", cache)[0] for _ in range(_RUNS)
        )
    return [
        Figure("kernels: warm start, render, label map, vote, pick", warm, "CPU-s", "<= 2"),
        Figure("kernels: the same to a start of Python and numpy", warm / python, "x"),
        Figure("kernels: load all of the association, too", again, "CPU-s", "<= 2"),
        Figure("kernels: compile for clicks, object list, thumbnails, names", first, "CPU-s"),
        Figure("kernels: compile for viewing, picking, editing", window, "CPU-s", "<= 60"),
        Figure("kernels: compile all else, when first needed", rest, "CPU-s"),
    ]


def _run(code: str, cache: str, *arguments: str) -> tuple[float, ...]:
    """The numbers that ``code`` prints in a process whose kernels are cached in ``cache``."""
    run = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | {"NUMBA_CACHE_DIR": cache},
        check=True,
        capture_output=True,
        text=True,
    )
    return tuple(float(word) for word in run.stdout.split())
