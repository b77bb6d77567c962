"""A scene of a million splats with all view-dependent color: opened, drawn, at rest, edited.

Times are ratios to reading the same file with ``numpy.fromfile``, so that they mean the same on
another machine; drawing itself is shown apart, because software OpenGL draws on the processor.
"""

import tempfile
import time
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
import psutil

from gaga_core.io.splats.ply import read_ply, write_ply
from gaga_core.scene.scene import Scene, State
from gaga_studio.gpu.context import Target, is_software
from gaga_studio.gpu.overlays import Compositor, Finish
from gaga_studio.gpu.sorter import Sorter, SortJob
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState
from tests.bench.figures import Figure, egl_context, median_ms
from tests.scenes import orbit_cameras, random_gaussians

_N = 1_000_000
_CAMERAS = orbit_cameras(8, width=1280, height=720)
_VIEW = ViewState()


def figures() -> list[Figure]:
    """Opening and frames of 1M splats; empty where there is no OpenGL without a display."""
    ctx = egl_context()
    if ctx is None:
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
    read_ms = median_ms(lambda: np.fromfile(path, np.uint8), warm_up=0, clock=time.perf_counter)
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
    per_byte = used / path.stat().st_size
    where = "on the processor" if is_software(ctx) else "on the graphics card"
    ratio = [1e3 * (end - start) / read_ms for end in (opened, uploaded, shown)]
    rows = [
        Figure("1M splats, SH 3: plain numpy read of the file", read_ms, "ms"),
        Figure("1M: opened, as plain reads", ratio[0], "reads"),
        Figure("1M: opened and on the card, as plain reads", ratio[1], "reads", "<= 60"),
        Figure(f"1M: first picture (1280x720, drawn {where})", ratio[2], "reads"),
        Figure(
            "1M: memory, textures included, per byte of the file",
            per_byte,
            "ratio",
        ),
    ]
    rows += _frames(viewport, scene, read_ms)
    rows += _outlines(ctx)
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
        Figure("1M: CPU of a frame at rest", median_ms(rest) / 100 / read_ms, "reads", "<= 0.001"),
        Figure("1M: CPU of a depth sort", median_ms(sort) / read_ms, "reads", "<= 1"),
        Figure("1M: CPU to send changed states", median_ms(hide) / read_ms, "reads", "<= 0.2"),
        Figure("1M: CPU of a frame with a new camera", median_ms(turn, 3) / read_ms, "reads"),
    ]
    sorter.release()
    return found


def _outlines(ctx: moderngl.Context) -> list[Figure]:
    """The last pass with outlines to that without, by the part of the picture that is marked."""
    size = (1280, 720)
    splats, picture = Target(ctx, [(4, "f2"), (4, "f1")], smooth=True), Target(ctx, [(4, "f1")])
    compositor = Compositor(ctx)
    for target in (splats, picture):
        target.resize(*size)
        target.begin().clear()

    def finish(with_mask: bool) -> float:
        def draw() -> None:
            compositor.draw(splats, picture, Finish((0.0, 0.0, 0.0), with_mask))
            ctx.finish()

        return median_ms(draw)

    plain = finish(False)
    nothing = finish(True) / plain
    mask = np.zeros((*size[::-1], 4), np.uint8)
    mask[260:460, 540:740] = 255  # an object of 4 % of the picture
    splats.textures[1].write(mask.tobytes())
    one = finish(True) / plain
    for owner in (compositor, splats, picture):
        owner.release()
    name = "last pass with outlines, to that without"
    return [
        Figure(f"{name}: none in sight", nothing, "ratio", "<= 4"),
        Figure(f"{name}: an object of 4 % of the picture", one, "ratio", "<= 10"),
    ]


def _warm_up(ctx: moderngl.Context) -> None:
    """Compile kernels and shaders: the figures are those of a second launch."""
    viewport = Viewport(ctx)
    tiny = Scene.of(random_gaussians(10, sh_degree=3))
    viewport.draw(tiny, _CAMERAS[0], _VIEW, wait=True)
    viewport.read_pixels()
    viewport.release()
