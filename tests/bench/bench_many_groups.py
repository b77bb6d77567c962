"""The window with 5,000 groups: what a frame costs the main thread, next to 50 groups.

Work of the drawing threads of software OpenGL is not in it. Each window is a process of its own:
``python -m tests.bench.bench_many_groups GROUPS`` prints milliseconds a frame as JSON.
"""

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np

from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import save_bank
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.io.cameras.colmap import write_colmap
from gaga_core.io.images import write_rgb
from gaga_core.io.splats.ply import write_ply
from gaga_core.scene.objects import group_indices
from gaga_studio.features.find.search import SearchState
from tests.app.window.driver import Driver, drive
from tests.bench.figures import Figure
from tests.bench.workers import Costs, run_worker
from tests.display import xvfb
from tests.scenes import orbit_cameras

_FEW, _MANY = 50, 5000
_SPLATS = 100_000
_VIEWS = 20  # that show every object
_FRAMES = 30


def figures() -> list[Figure]:
    """Milliseconds of processor time a frame; a bar of 60 frames a second."""
    few, many = (_run(n) for n in (_FEW, _MANY))
    found = []
    for name, value in many.items():
        bar = "<= 16" if name in ("at rest", "memory bank") else ""
        found.append(Figure(f"window, {_MANY} groups: {name}", value, "CPU-ms", bar))
        found.append(Figure(f"window, {_FEW} groups: {name}", few[name], "CPU-ms"))
    return found


def _run(n_groups: int) -> Costs:
    with tempfile.TemporaryDirectory() as home, xvfb(), patch.dict(os.environ, GAGA_HOME=home):
        return run_worker("tests.bench.bench_many_groups", [str(n_groups)])


def write_scene(root: Path, n_groups: int, n_splats: int = _SPLATS) -> None:
    """A scene folder with so many groups on a square, seen by `_VIEWS` views each."""
    rng = np.random.default_rng(0)
    labels = np.arange(n_splats, dtype=np.int32) * n_groups // n_splats + 1
    side = int(np.ceil(np.sqrt(n_groups)))
    place = np.stack(np.divmod(np.arange(n_groups), side), axis=1) * (2.4 / side) - 1.2
    means = np.zeros((n_splats, 3), np.float32)
    means[:, :2] = place[labels - 1] + rng.uniform(0, 1.6 / side, (n_splats, 2))
    means[:, 2] = rng.uniform(0, 0.05, n_splats)
    gaussians = Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n_splats, 1)),
        log_scales=np.full((n_splats, 3), -5, np.float32),
        logit_opacities=np.full(n_splats, 2, np.float32),
        sh=rng.normal(0, 1, (n_splats, 1, 3)).astype(np.float32),
    )
    cameras = orbit_cameras(_VIEWS, width=160, height=120, radius=2.2)
    (root / "sparse" / "0").mkdir(parents=True)
    (root / "images").mkdir()
    (root / "gaga").mkdir()
    for camera in cameras:
        write_rgb(root / "images" / camera.name, np.zeros((120, 160, 3), np.float32))
    write_colmap(
        root / "sparse" / "0",
        cameras,
        means[::50].astype(float),
        np.zeros((n_splats // 50, 3), np.uint8),
    )
    write_ply(root / "point_cloud.ply", gaussians)
    log = [
        Decision(camera.name, g, g, i == 0, 0.9, 0, 0.0, 20)
        for i, camera in enumerate(cameras)
        for g in range(1, n_groups + 1)
    ]
    save_bank(root / "gaga" / "bank.npz", MemoryBank(labels, n_groups, tuple(log), preset="robust"))
    confidence = np.ones(n_splats, np.float32)
    np.savez_compressed(root / "gaga" / "labels.npz", labels=labels, confidence=confidence)


def measure(root: Path) -> dict[str, float]:
    """Open the window and go through the panels; milliseconds a frame by what is done."""
    costs: dict[str, float] = {}

    def walk(d: Driver) -> None:
        document = d.session.need()
        d.until(
            lambda: document.feature(SearchState).described is not None, "objects are described"
        )
        d.settle()
        scene = document.scene
        several = [group_indices(scene, g) for g in (3, 11, 29)]

        def each(name: str, act: Callable[[int], object]) -> None:
            act(0)
            d.frames(3)
            start = d.on_main(time.thread_time)
            for i in range(_FRAMES):
                act(i + 1)
                d.frames(1)
            costs[name] = 1e3 * (d.on_main(time.thread_time) - start) / _FRAMES

        each("at rest", lambda i: None)
        d.engine.mouse_move("//Objects/**/object 3/##row")
        each("scrolling", lambda i: d.engine.mouse_wheel_y(-3.0 if i % 2 else 3.0))
        each("another selection", lambda i: d.on_main(lambda: document.select(several[i % 3])))
        d.focus("Memory bank")
        each("memory bank", lambda i: None)

    drive(walk, path=root, size=(1280, 720), patience_s=300, fills_window=True)
    return costs


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        write_scene(Path(name) / "scene", int(sys.argv[1]))
        sys.stdout.write(json.dumps(measure(Path(name) / "scene")) + "\n")
