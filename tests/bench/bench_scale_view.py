"""Editing at scale: sorting, picking, sending and undoing, with millions of splats.

CPU figures are of the threads that do the work. Waits depend on what else the machine does
and stand beside them.
"""

import threading
import time
from collections.abc import Callable
from typing import Any

import moderngl
import numpy as np

from gaga_core.gaussians import Gaussians
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.by_screen import pick
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.context import is_software
from gaga_studio.gpu.sorter import SortColumns, SortJob
from gaga_studio.gpu.viewport import Pacing, Viewport
from gaga_studio.session.view import ViewState
from tests.bench.figures import Figure, cpu_median
from tests.scenes import orbit_cameras

_CAMERAS = orbit_cameras(16, width=1280, height=720, radius=2.2)


def room(n: int, *, sh_degree: int = 0, seed: int = 0) -> Scene:
    """``n`` flat splats on six walls (groups 1 to 6) and 40 balls (groups 7 to 46), shuffled."""
    rng = np.random.default_rng(seed)
    group = rng.integers(1, 47, n).astype(np.int32)
    at = rng.uniform(-3, 3, (n, 3)).astype(np.float32)
    for axis in range(3):
        for side in range(2):
            at[group == 2 * axis + side + 1, axis] = 6 * side - 3
    ball = group > 6
    way = rng.normal(size=(int(ball.sum()), 3)).astype(np.float32)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    centres = rng.uniform(-1.6, 1.6, (47, 3)).astype(np.float32)
    at[ball] = centres[group[ball]] + np.float32(0.25) * way
    logs = rng.normal(0, 0.4, (n, 3)) + np.log(4.0 / np.sqrt(n))
    logs[:, 2] -= 2.0
    n_sh = (sh_degree + 1) ** 2
    sh = rng.normal(0, 0.1, (n, n_sh, 3)).astype(np.float32)
    return Scene.of(
        Gaussians(
            means=at,
            quats=rng.normal(size=(n, 4)).astype(np.float32),
            log_scales=logs.astype(np.float32),
            logit_opacities=np.where(rng.random(n) < 0.5, 3.0, -1.0).astype(np.float32),
            sh=sh,
        ),
        group,
    )


def figures() -> list[Figure]:
    """Every bar of drawing and editing at scale."""
    found = [*_sorting(), *_picking(), *_history()]
    options: dict[str, Any] = {"backend": "egl"}
    try:
        ctx = moderngl.create_context(require=330, standalone=True, **options)
    except (moderngl.Error, OSError, ValueError, RuntimeError):
        return found
    found += [*_sending(ctx), *_duplicating(ctx), *_drawing(ctx), *_beside_sorting(ctx)]
    ctx.release()
    return found


def _job(scene: Scene, ticket: int = 1, budget: int = 0) -> SortJob:
    columns = (scene.gaussians, scene.state, scene.placement, scene.placements)
    return SortJob(ticket, *columns, _CAMERAS[0], budget)


def _sorting() -> list[Figure]:
    scene = room(3_000_000)
    columns = SortColumns()
    whole = thread_median(lambda: columns.sort(_job(scene)))
    few = thread_median(lambda: columns.sort(_job(scene, budget=500_000)))
    return [
        Figure("3M: depth sort with cull, one thread", whole, "CPU-ms", "<= 40"),
        Figure("3M: the same, 500k most important", few, "CPU-ms"),
    ]


def _picking() -> list[Figure]:
    scene = room(4_000_000)
    spots = [(200.5 + 70 * k, 100.5 + 37 * k) for k in range(12)]
    for u, v in spots[:2]:
        pick(scene, _CAMERAS[0], u, v)
    walls, cpu = [], []
    for u, v in spots:
        start, began = time.perf_counter(), time.process_time()
        pick(scene, _CAMERAS[0], u, v)
        walls.append(1e3 * (time.perf_counter() - start))
        cpu.append(1e3 * (time.process_time() - began))
    return [
        # On one thread alone the wait is no longer than this.
        Figure("4M: click, CPU of all threads", float(np.median(cpu)), "CPU-ms", "<= 50"),
        Figure("4M: click, shortest wait", min(walls), "ms"),
        Figure("4M: click, median wait", float(np.median(walls)), "ms"),
    ]


def _history() -> list[Figure]:
    scene = room(1_500_000)
    rows = np.random.default_rng(1).permutation(len(scene))[:1_000_000]
    chosen = np.zeros(len(scene), np.bool_)
    chosen[rows] = True
    history = History(scene)
    before = scene.state.copy()
    times = []
    for _ in range(5):
        start = time.thread_time()
        history.do(edits.delete(scene, chosen))
        history.undo()
        times.append(1e3 * (time.thread_time() - start))
        assert np.array_equal(before, scene.state)
    edit = edits.delete(scene, chosen)
    assert edit is not None
    return [
        Figure("1M splats deleted and undone", float(np.median(times)), "CPU-ms", "<= 50"),
        Figure("1M splats deleted: undo entry", edit.nbytes / 1e6, "bytes a splat", "<= 1"),
    ]


def _sending(ctx: moderngl.Context) -> list[Figure]:
    """Upload of a change of an object of 100k splats among 1M, as a drawn frame asks for it."""
    scene = room(1_000_000)
    scene.labels = np.where(np.arange(1_000_000) % 10 == 3, 50, scene.labels).astype(np.int32)
    rows = np.flatnonzero(scene.labels == 50)
    buffers, history = SceneBuffers(ctx), History(scene)
    buffers.sync(scene)
    red = np.c_[np.eye(3) * 0.5, [0.4, 0, 0]]
    step = np.c_[np.eye(3), [0.1, 0, 0]]
    steps: tuple[tuple[str, Callable[[], Edit | None]], ...] = (
        ("recolor", lambda: edits.recolor(scene, rows, red)),
        ("move", lambda: edits.transform(scene, rows, step)),
        ("hide", lambda: edits.hide(scene, rows)),
    )
    found = []
    for name, build in steps:
        sends: list[float] = []
        for _ in range(7):
            history.do(build())
            sends.append(_sync_ms(ctx, buffers, scene))
            history.undo()
            sends.append(_sync_ms(ctx, buffers, scene))
        found.append(
            Figure(f"1M: send {name} of 100k, or its undo", float(np.median(sends)), "ms", "<= 1")
        )
    buffers.release()
    return found


def _duplicating(ctx: moderngl.Context) -> list[Figure]:
    """What a copy of 20k splats among 1M of degree 3 sends; the first one makes room, too."""
    scene = room(1_000_000, sh_degree=3)
    rows = np.flatnonzero(scene.labels == 10)
    buffers, history = SceneBuffers(ctx), History(scene)
    whole = _sync_ms(ctx, buffers, scene)
    history.do(edits.duplicate(scene, rows))
    first = _sync_ms(ctx, buffers, scene)
    history.do(edits.duplicate(scene, rows))
    second = _sync_ms(ctx, buffers, scene)
    history.undo()
    undone = _sync_ms(ctx, buffers, scene)
    buffers.release()
    return [
        Figure("1M, SH 3: send all", whole, "CPU-ms"),
        Figure("1M: send a first duplicate of 20k, to that", first / whole, "ratio", "<= 0.6"),
        Figure("1M: send the next one, to that", second / whole, "ratio", "<= 0.1"),
        Figure("1M: send its undo, to that", undone / whole, "ratio", "<= 0.02"),
    ]


def _sync_ms(ctx: moderngl.Context, buffers: SceneBuffers, scene: Scene) -> float:
    start = time.thread_time()
    buffers.sync(scene)
    return 1e3 * (time.thread_time() - start)


def _drawing(ctx: moderngl.Context) -> list[Figure]:
    """Full frames, frames of a motion under the controller, and bytes on the graphics card."""
    scene = room(200_000, sh_degree=3)
    viewport = Viewport(ctx)
    turns = iter(_CAMERAS * 10)

    def full() -> None:
        viewport.draw(scene, next(turns), ViewState(), wait=True)
        viewport.read_pixels()

    cpu = cpu_median(full, 5)
    walls, cpus = _moving(ctx, viewport, scene)
    per_splat = viewport.nbytes / len(scene)
    viewport.release()
    return [
        Figure("200k, 1280x720: CPU of a full frame", cpu, "CPU-ms", "<= 700"),
        Figure("200k: CPU of a frame while moving", float(np.median(cpus)), "CPU-ms", "<= 250"),
        Figure("200k: frames a second while moving", 1e3 / float(np.median(walls)), "1/s", ">= 4"),
        Figure("SH 3: on the graphics card", per_splat, "bytes a splat", "<= 120"),
    ]


def _moving(
    ctx: moderngl.Context, viewport: Viewport, scene: Scene
) -> tuple[list[float], list[float]]:
    """Wall and CPU milliseconds of each frame of a turn, as the window draws it."""
    pacing = Pacing(is_software=is_software(ctx))
    walls, cpus = [], []
    for k in range(30):
        camera = _CAMERAS[k % len(_CAMERAS)]
        start, began = time.perf_counter(), time.process_time()
        view = pacing.view_for(ViewState(), k, len(scene))
        viewport.draw(scene, camera, view)
        ctx.finish()
        walls.append(1e3 * (time.perf_counter() - start))
        cpus.append(1e3 * (time.process_time() - began))
        pacing.drew(walls[-1])
    return walls[5:], cpus[5:]


def _beside_sorting(ctx: moderngl.Context) -> list[Figure]:
    """What drawing loses to a sort of 3M that runs all the time in its thread."""
    scene, many = room(100_000), room(3_000_000)
    viewport, columns, job = Viewport(ctx), SortColumns(), _job(many)
    columns.sort(job)
    sorts, ended = threading.Event(), threading.Event()

    def sort() -> None:
        while not ended.is_set():
            if sorts.wait(0.01):
                columns.sort(job)

    cameras = [camera.resized(480, 270) for camera in _CAMERAS]

    def frame(k: int) -> tuple[float, float]:
        start, began = time.perf_counter(), time.thread_time()
        viewport.draw(scene, cameras[k % len(cameras)], ViewState())
        ctx.finish()
        return time.perf_counter() - start, time.thread_time() - began

    worker = threading.Thread(target=sort)
    worker.start()
    alone, beside = [], []
    for _ in range(8):  # in turns: other programs come and go
        sorts.clear()
        time.sleep(0.05)
        alone += [frame(k) for k in range(8)]
        sorts.set()
        beside += [frame(k) for k in range(8)]
    ended.set()
    sorts.set()
    worker.join()
    viewport.release()
    wall, cpu = (np.median(beside, axis=0) / np.median(alone, axis=0) - 1) * 100
    return [
        Figure("sort of 3M beside: drawing thread's CPU, more", float(cpu), "%", "<= 20"),
        Figure("sort of 3M beside: frame, more (drawn on these cores)", float(wall), "%"),
    ]


def thread_median(work: Callable[[], object], runs: int = 5) -> float:
    """Median CPU milliseconds of the calling thread for one call."""
    work()
    times = []
    for _ in range(runs):
        start = time.thread_time()
        work()
        times.append(1e3 * (time.thread_time() - start))
    return float(np.median(times))
