"""A scene of a million splats with all view-dependent color: opened, drawn, at rest, edited.

Times are ratios to reading the same file with ``numpy.fromfile``, so that they mean the same on
another machine; drawing itself is shown apart, because software OpenGL draws on the processor.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import psutil

from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.scene.scene import Scene, State
from gaga_studio.gpu.context import is_software
from gaga_studio.gpu.sorter import Sorter, SortJob
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState
from tests.bench.figures import Figure, cpu_median
from tests.scenes import orbit_cameras, random_gaussians

_N = 1_000_000
_CAMERAS = orbit_cameras(8, width=1280, height=720)
_VIEW = ViewState()


def figures() -> list[Figure]:
    """Opening and frames of 1M splats; empty where there is no OpenGL without a display."""
    options: dict[str, Any] = {"backend": "egl"}
    try:
        ctx = moderngl.create_context(require=330, standalone=True, **options)
    except (moderngl.Error, OSError, ValueError, RuntimeError):
        return []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "million.ply"
        gaussians = random_gaussians(_N, sh_degree=3)
        small = gaussians.log_scales - np.float32(2.5)  # as large as a million splats are
        write_ply(path, replace(gaussians, log_scales=small))
        found = _figures(ctx, path)
    ctx.release()
    return found


def _figures(ctx: moderngl.Context, path: Path) -> list[Figure]:
    _warm_up(ctx)
    read_ms = _wall(lambda: np.fromfile(path, np.uint8))
    memory = psutil.Process().memory_info().rss
    start = time.perf_counter()
    scene = Scene.of(read_ply(path))
    opened = time.perf_counter()
    viewport = Viewport(ctx)
    viewport.buffers.sync(scene)
    ctx.finish()
    uploaded = time.perf_counter()
    viewport.draw(scene, _CAMERAS[0], _VIEW, wait=True)
    viewport.read_pixels()
    shown = time.perf_counter()
    used = psutil.Process().memory_info().rss - memory
    where = "on the processor" if is_software(ctx) else "on the graphics card"
    ratio = [1e3 * (end - start) / read_ms for end in (opened, uploaded, shown)]
    rows = [
        Figure("1M splats, SH 3: plain numpy read of the file", read_ms, "ms"),
        Figure("1M: opened, as plain reads", ratio[0], "reads"),
        Figure("1M: opened and on the card, as plain reads", ratio[1], "reads", "<= 60"),
        Figure(f"1M: first picture (1280x720, drawn {where})", ratio[2], "reads"),
        Figure("1M: memory, textures included, per byte of the file", used / _size(path), "ratio"),
    ]
    rows += _frames(viewport, scene, read_ms)
    viewport.release()
    return rows


def _frames(viewport: Viewport, scene: Scene, read_ms: float) -> list[Figure]:
    """CPU of all threads for one frame of each kind, as a share of a plain read."""
    still = _CAMERAS[0]
    viewport.draw(scene, still, _VIEW, wait=True)

    def rest() -> None:
        for _ in range(100):
            viewport.draw(scene, still, _VIEW)

    def hide() -> None:
        state = scene.state.copy()
        state[::7] ^= np.uint8(State.HIDDEN)
        scene.state = state
        scene.revision.state += 1
        viewport.buffers.sync(scene)

    turns = iter(_CAMERAS * 10)

    def turn() -> None:
        viewport.draw(scene, next(turns), _VIEW, wait=True)
        viewport.read_pixels()

    sorter = Sorter()
    tickets = iter(range(1, 100))

    def sort() -> None:
        ticket = next(tickets)
        columns = (scene.gaussians, scene.state, scene.placement, scene.placements)
        sorter.submit(SortJob(ticket, *columns, still))
        sorter.wait(ticket)

    found = [
        Figure("1M: CPU of a frame at rest", cpu_median(rest) / 100 / read_ms, "reads", "<= 0.001"),
        Figure("1M: CPU of a depth sort", cpu_median(sort) / read_ms, "reads", "<= 1"),
        Figure("1M: CPU to send changed states", cpu_median(hide) / read_ms, "reads", "<= 0.2"),
        Figure("1M: CPU of a frame with a new camera", cpu_median(turn, 3) / read_ms, "reads"),
    ]
    sorter.release()
    return found


def _warm_up(ctx: moderngl.Context) -> None:
    """Compile kernels and shaders: the figures are those of a second launch."""
    viewport = Viewport(ctx)
    tiny = Scene.of(random_gaussians(10, sh_degree=3))
    viewport.draw(tiny, _CAMERAS[0], _VIEW, wait=True)
    viewport.read_pixels()
    viewport.release()


def _wall(work: Callable[[], object]) -> float:
    """Median wall milliseconds of five calls."""
    times = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))


def _size(path: Path) -> int:
    return path.stat().st_size
