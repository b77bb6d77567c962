"""Files of four million splats: opening and exporting against plain numpy, and memory at the peak.

Each figure is a ratio to what numpy and the disk take for the same bytes. Reading is CPU time, each
in a process of its own for the peak of memory. Writing waits for the disk: time on the clock, the
medians of two ways that take turns in one process, or the system's pages would decide.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.bench.figures import Figure

N = 4_000_000

_MAKE = """
import numpy as np
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.ply import write_ply
rng, n = np.random.default_rng(0), {n}
write_ply(Path({path!r}), Gaussians(
    means=rng.normal(size=(n, 3)).astype(np.float32),
    quats=rng.normal(size=(n, 4)).astype(np.float32),
    log_scales=rng.normal(-4, 1, (n, 3)).astype(np.float32),
    logit_opacities=rng.normal(size=n).astype(np.float32),
    sh=rng.random((n, 16, 3), np.float32) - np.float32(0.5),
))
"""
_NUMPY = """
import numpy as np, plyfile
rows = plyfile.PlyData.read({path!r}, mmap="r")["vertex"].data
dtype, offset = rows.dtype, rows.offset
del rows
start = time.process_time(), time.perf_counter()
rows = np.fromfile({path!r}, dtype, offset=offset)
columns = [np.ascontiguousarray(rows[name]) for name in dtype.names]
"""
_OURS = """
from gaga_core.io.splats.splat_files import read_splats
start = time.process_time(), time.perf_counter()
splats = read_splats(Path({path!r}))
"""
_WRITE = """
import numpy as np
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.progress import run_stage
from gaga_core.export.export import export_scene_stage
from gaga_core.scene.scene import Scene
data, out = Path({path!r}).read_bytes(), Path({path!r} + ".out")
scene = Scene.of(read_splats(Path({path!r})))
for _ in range(6):  # the first round loads the kernel
    for write in (
        lambda: out.write_bytes(data),
        lambda: run_stage(export_scene_stage(scene, out, form=SplatFormat.PLY)),
    ):
        start = time.process_time(), time.perf_counter()
        write()
        found.append(time.perf_counter() - start[1])
        out.unlink()
"""
_FRAME = """
import json, resource, time
from pathlib import Path
from gaga_core.io.splats.splat_files import SplatFormat
start = time.process_time(), time.perf_counter()
found = []
{work}
spent = time.process_time() - start[0], time.perf_counter() - start[1]
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(json.dumps([*spent, peak, *found]))
"""


def figures() -> list[Figure]:
    """Open and export a .ply of four million splats with SH of degree 3 (990 MB)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.ply"
        _run(_MAKE, path)
        size = path.stat().st_size
        numpy_s, ours = min(_run(_NUMPY, path)[0] for _ in range(2)), _best(_OURS, path)
        seconds = np.reshape(_run(_WRITE, path)[3:], (-1, 2))[1:]
        bytes_s, export_s = np.median(seconds, axis=0)
    return [
        Figure("open 4M against numpy's columns", ours[0] / numpy_s, "times", "<= 1.5"),
        Figure("open 4M, peak memory", ours[1] / size, "times the file", "<= 1.3"),
        Figure("export 4M against its bytes", float(export_s / bytes_s), "times", "<= 2"),
    ]


def _best(work: str, path: Path) -> tuple[float, float]:
    """Seconds of the faster of two runs, and bytes at the peak."""
    runs = [_run(work, path) for _ in range(2)]
    return min(run[0] for run in runs), max(run[2] for run in runs)


def _run(work: str, path: Path) -> list[float]:
    """CPU seconds, wall seconds and bytes at the peak of ``work`` in a process of its own.

    What ``work`` adds to the list ``found`` comes behind them.
    """
    code = _FRAME.format(work=work.format(path=str(path), n=N))
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return [float(value) for value in json.loads(done.stdout)]
