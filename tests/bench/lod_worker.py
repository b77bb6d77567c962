"""A process of its own that opens a large scene, builds its tree, draws and picks.

``python -m tests.bench.lod_worker FOLDER N_SPLATS [BUDGET]`` writes a scene of that many splats
into FOLDER; called again it measures and prints one line of JSON. Times are processor time of all
threads, the software renderer's too; the peak of memory is that of the whole process, textures of
the software renderer included.
"""

import json
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.io.splats.ply import write_ply
from gaga_core.pipeline.level_of_detail import build_project_lod_stage, open_project_lod
from gaga_core.progress import run_stage
from gaga_core.scene.lod.edited import PickBoxes
from gaga_core.scene.project import open_path_stage
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState

BUDGET = 500_000
_N_FRAMES = 8
_MOST_WHOLE = 3_000_000  # splats of a scene that is drawn whole, too
_SIDE = 8.0  # of the hall at 3M splats, scene units
_SIZE = (960, 540)


@dataclass(frozen=True)
class Cost:
    """What one run took, in CPU-seconds unless the name says otherwise."""

    n: int
    open_s: float
    build_s: float
    build_mib: float  # peak while it was built, more than after opening
    opened_mib: float  # peak of memory when the scene was open
    first_s: float  # to the first settled picture
    frame_ms: float  # of a settled frame of an orbit: cut, sort and picture
    drawn: int  # splats in the cut of the last frame
    whole_ms: float  # of such a frame of all splats; 0 where it was not drawn
    pick_ms: float
    whole_pick_ms: float  # among all splats
    pop: float  # most that nodes on their way change in one frame, in 1/255, after half a turn
    peak_mib: float
    tree_mib: float  # files of the tree


def write_hall(path: Path, n: int) -> None:
    """A landscape of ``n`` splats, always equally dense: more splats are more ground."""
    rng = np.random.default_rng(0)
    side = _SIDE * np.sqrt(n / 3e6)
    means = np.empty((n, 3), np.float32)
    for axis in range(2):
        means[:, axis] = rng.random(n, np.float32) * np.float32(side) - np.float32(side / 2)
    x, y = means[:, 0], means[:, 1]
    means[:, 2] = 0.3 * np.sin(2.1 * x) * np.cos(1.7 * y) + 0.08 * np.sin(9 * x + 4 * y)
    means[:, 2] += rng.normal(0, 0.01, n).astype(np.float32)
    log_scales = np.log(np.float32(0.006)) + rng.normal(0, 0.5, (n, 3)).astype(np.float32)
    sh = np.empty((n, 1, 3), np.float32)
    for channel in range(3):
        sh[:, 0, channel] = np.sin((3 + 2 * channel) * x + channel) * np.cos(4 * y)
    sh += rng.normal(0, 0.1, (n, 1, 1)).astype(np.float32)
    quats = rng.normal(size=(n, 4)).astype(np.float32)
    opacities = rng.normal(1.5, 1.0, n).astype(np.float32)
    write_ply(path, Gaussians(means, quats, log_scales, opacities, sh))


def _cameras(n: int) -> list[Camera]:
    """Frames of an orbit near the ground, which shows both what is near and all that is far."""
    focal = 0.9 * _SIZE[0]
    K = np.array([[focal, 0, _SIZE[0] / 2], [0, focal, _SIZE[1] / 2], [0, 0, 1.0]])
    found = []
    for i in range(n):
        angle = 0.02 * i
        eye = np.array([2.5 * np.cos(angle), 2.5 * np.sin(angle), 1.2])
        found.append(Camera(K, look_at(eye, np.zeros(3), np.array([0, 0, 1.0])), *_SIZE, f"{i}"))
    return found


def _turned() -> Camera:
    """What was behind the cameras of the orbit: another cut, all of a sudden."""
    first = _cameras(1)[0]
    eye = np.array([2.5, 0.0, 1.2])
    return replace(first, cam_from_world=look_at(eye, 2 * eye, np.array([0, 0, 1.0])))


def _pop(viewport: Viewport, scene: Scene, camera: Camera, view: ViewState) -> float:
    """Mean difference, in 1/255, of two frames of a resting camera: the greatest on the way."""
    viewport.draw(scene, camera, view)
    former, worst = None, 0.0
    while former is None or not viewport.settled:
        viewport.finish_order()
        viewport.draw(scene, camera, view)
        now = viewport.read_pixels().astype(np.float32)
        if former is not None:
            worst = max(worst, float(np.abs(now - former).mean()))
        former = now
    return worst


def _cpu(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def _peak_mib() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def measure(folder: Path, n: int, budget: int, ctx: Any) -> Cost:
    """Open, build, draw and pick once; the files stay."""
    path = folder / f"hall-{n}.ply"
    if not path.exists():
        raise FileNotFoundError(path)
    held: list[Any] = []
    open_s = _cpu(lambda: held.append(run_stage(open_path_stage(path))))
    project = held[0]
    opened_mib = _peak_mib()
    build_s = 0.0
    if open_project_lod(project) is None:
        build_s = _cpu(lambda: run_stage(build_project_lod_stage(project)))
    build_mib = _peak_mib() - opened_mib
    tree = open_project_lod(project)
    assert tree is not None
    viewport, view, cameras = Viewport(ctx), ViewState(lod_budget=budget), _cameras(_N_FRAMES)
    viewport.use_tree(tree)
    scene = project.scene

    def settled(camera: Camera) -> None:
        viewport.draw(scene, camera, view, wait=True)
        viewport.read_pixels()

    first_s = _cpu(lambda: settled(cameras[0]))
    frames = [_cpu(partial(settled, camera)) for camera in cameras[1:]]
    drawn = viewport.n_in_cut
    whole_ms = 0.0
    if n <= _MOST_WHOLE:
        viewport.use_tree(None)
        settled(cameras[0])
        whole_ms = 1e3 * _cpu(lambda: settled(cameras[1]))
        viewport.use_tree(tree)
        settled(cameras[-1])
    boxes = PickBoxes(tree, scene)

    def click(v: float) -> None:
        rows = boxes.rows_at(cameras[0], 480.5, v, n)
        pick(scene, cameras[0], 480.5, v, rows=rows)

    picks = [_cpu(partial(click, v)) for v in (200.5, 300.5, 400.5, 350.5, 250.5)]
    whole_pick = _cpu(lambda: pick(scene, cameras[0], 480.5, 300.5))
    pop = max(_pop(viewport, scene, camera, view) for camera in (_turned(), cameras[-1]))
    viewport.release()
    return Cost(
        n=n,
        open_s=open_s,
        build_s=build_s,
        build_mib=build_mib,
        opened_mib=opened_mib,
        first_s=first_s,
        frame_ms=1e3 * float(np.median(frames)),
        drawn=drawn,
        whole_ms=whole_ms,
        pick_ms=1e3 * float(np.median(picks)),
        whole_pick_ms=1e3 * whole_pick,
        pop=pop,
        peak_mib=_peak_mib(),
        tree_mib=tree.file_bytes / (1 << 20),
    )


def main(arguments: list[str]) -> None:
    """Write the scene, or measure it when it is there."""
    import moderngl

    folder, n = Path(arguments[0]), int(arguments[1])
    if not (folder / f"hall-{n}.ply").exists():
        write_hall(folder / f"hall-{n}.ply", n)
        return
    options: dict[str, Any] = {"backend": "egl"}
    ctx = moderngl.create_context(require=330, standalone=True, **options)
    budget = int(arguments[2]) if len(arguments) > 2 else BUDGET
    sys.stdout.write(json.dumps(asdict(measure(folder, n, budget, ctx))) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
