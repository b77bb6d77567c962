"""Many scenes by a dask cluster of four worker processes, next to four processes started here.

The same small scenes by `gaga run`, in turns, the better of two runs each: what the cluster costs,
not what it gains, as all processes share one machine. Its processor time has no start of workers,
which a cluster does once; processes here start for each scene.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import psutil

from tests.app.folders import write_scene
from tests.bench.figures import Figure
from tests.cluster import WORKERS, cluster

_SCENES, _TURNS = 8, 2


def figures() -> list[Figure]:
    """Time and processor time of the cluster as ratios, and of a scene."""
    here, there = [], []
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        made = Path(name) / "made"
        for i in range(_SCENES):
            write_scene(made / f"scene-{i}", n_objects=2 + i % 4)
        address = stack.enter_context(cluster(Path(name)))
        for _ in range(1 + _TURNS):
            here.append(_run(made, "--executor", "local", "--workers", str(WORKERS)))
            there.append(_run(made, "--executor", "dask", "--address", address))
    # The first turn compiles kernels and lets the workers import.
    (here_s, here_cpu), (there_s, there_cpu) = (
        [min(column) for column in zip(*runs[1:], strict=True)] for runs in (here, there)
    )
    name = f"cluster: {_SCENES} scenes, {WORKERS} dask workers"
    return [
        Figure(f"{name}, time, to {WORKERS} processes here", there_s / here_s, "ratio"),
        Figure(f"{name}, processor time, to those", there_cpu / here_cpu, "ratio"),
        Figure(f"{name}: processor time of a scene", there_cpu / _SCENES, "CPU-s"),
        Figure("cluster: processes here: processor time of a scene", here_cpu / _SCENES, "CPU-s"),
    ]


def _run(made: Path, *switches: str) -> tuple[float, float]:
    """Seconds, and CPU seconds of all processes, for a copy of the scenes."""
    with tempfile.TemporaryDirectory() as name:
        root = shutil.copytree(made, Path(name) / "scenes")
        command = [sys.executable, "-m", "gaga_core.cli.main", "run", str(root), *switches]
        start, before = time.perf_counter(), _cpu()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.perf_counter() - start, _cpu() - before


def _cpu() -> float:
    """CPU seconds of the processes that ended, and of those that run: the cluster's."""
    import resource  # not on Windows

    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    running = [process.cpu_times() for process in psutil.Process().children(recursive=True)]
    found = ended.ru_utime + ended.ru_stime + sum(t.user + t.system for t in running)
    return float(found)
