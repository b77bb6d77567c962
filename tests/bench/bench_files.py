"""Files of four million splats: opening and exporting against plain numpy, and memory at the peak.

Each figure is a ratio to what the disk and numpy take for the same bytes, in a process of its own:
CPU time of reading, and for writing, which waits for the disk, the time on the clock.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.bench.figures import Figure

N = 4_000_000

_MAKE = """
import numpy as np
from gaga_core.gaussians import Gaussians
from gaga_core.io.ply import write_ply
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
from gaga_core.io.splat_files import read_splats
start = time.process_time(), time.perf_counter()
splats = read_splats(Path({path!r}))
"""
_BYTES = """
data = Path({path!r}).read_bytes()
start = time.process_time(), time.perf_counter()
Path({path!r} + ".out").write_bytes(data)
"""
_EXPORT = """
import numpy as np
from gaga_core.io.splat_files import read_splats
from gaga_core.progress import run_stage
from gaga_core.scene.export import export_scene_stage
from gaga_core.scene.scene import Scene
scene = Scene.of(read_splats(Path({path!r})))
tiny = Scene.of(scene.gaussians.take(np.arange(9)))
run_stage(export_scene_stage(tiny, Path({path!r} + ".out"), form=Form.PLY))  # loads the kernel
Path({path!r} + ".out").unlink()
start = time.process_time(), time.perf_counter()
run_stage(export_scene_stage(scene, Path({path!r} + ".out"), form=Form.PLY))
"""
_FRAME = """
import json, resource, time
from pathlib import Path
from gaga_core.io.splat_files import Form
start = time.process_time(), time.perf_counter()
{work}
spent = time.process_time() - start[0], time.perf_counter() - start[1]
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(json.dumps([*spent, peak]))
"""


def figures() -> list[Figure]:
    """Open and export a .ply of four million splats with SH of degree 3 (990 MB)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.ply"
        _run(_MAKE, path)
        size = path.stat().st_size
        numpy_s, ours = min(_run(_NUMPY, path)[0] for _ in range(2)), _best(_OURS, path)
        runs = [(_written(_BYTES, path), _written(_EXPORT, path)) for _ in range(3)]
        bytes_s, export_s = (min(run[i] for run in runs) for i in (0, 1))
    return [
        Figure("open 4M against numpy's columns", ours[0] / numpy_s, "times", "<= 1.5"),
        Figure("open 4M, peak memory", ours[1] / size, "times the file", "<= 1.3"),
        Figure("export 4M against its bytes", export_s / bytes_s, "times", "<= 2"),
    ]


def _best(work: str, path: Path) -> tuple[float, float]:
    """Seconds of the faster of two runs, and bytes at the peak."""
    runs = [_run(work, path) for _ in range(2)]
    return min(s for s, _, _ in runs), max(peak for _, _, peak in runs)


def _written(work: str, path: Path) -> float:
    """Seconds on the clock of writing a file that is not there."""
    seconds = _run(work, path)[1]
    Path(f"{path}.out").unlink()
    return seconds


def _run(work: str, path: Path) -> tuple[float, float, float]:
    """CPU seconds, wall seconds, and bytes at the peak of ``work`` in a process of its own."""
    code = _FRAME.format(work=work.format(path=str(path), n=N))
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    cpu, wall, peak = json.loads(done.stdout)
    return float(cpu), float(wall), float(peak)
