"""The CPU rasterizer and picking: accuracy, CPU time, growth with pixels and splats."""

import os
import subprocess
import sys
import tempfile
from dataclasses import replace

import numpy as np
import torch

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.cpu.prepare import prepare
from gaga_core.raster.cpu.rasterizer import CpuRasterizer, _blend, _colors
from gaga_core.raster.reference import ReferenceRasterizer
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.picking import pick
from tests.bench.figures import Figure, cpu_median, one_thread
from tests.bench.torch_tiles import torch_tile_loop
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

_PIECE = 256  # splats of a torch operation: the fastest of 64 to all
_COLD = """
import time
from gaga_core.raster import choose
from tests.scenes import objects_scene
import numpy as np
start = time.process_time()
scene = objects_scene(2, 50)
camera, n = scene.cameras[0], len(scene.gaussians)
cpu = choose("cpu")
cpu.render(scene.gaussians, camera)
cpu.label_splat(scene.gaussians, camera, scene.labels)
cpu.vote(scene.gaussians, camera, np.zeros((120, 160), np.int32), np.zeros((n, 1), np.float32))
print(time.process_time() - start)
"""


def figures() -> list[Figure]:
    """Every figure of this file; single figures in CPU milliseconds of all threads together."""
    return [*_accuracy(), *_speed(), *_large(), _cold_compile()]


def surfaces(n: int, seed: int = 0) -> Gaussians:
    """``n`` mostly opaque splats on a floor and balls, sized so that they just cover them."""
    scene = objects_scene(24, n // 27, seed=seed)
    shrink = np.log(np.sqrt(400 / (n // 27)))
    rng = np.random.default_rng(seed)
    logits = rng.normal(2.0, 2.0, len(scene.gaussians)).astype(np.float32)
    log_scales = (scene.gaussians.log_scales + shrink).astype(np.float32)
    return replace(scene.gaussians, log_scales=log_scales, logit_opacities=logits)


def _camera(width: int, height: int) -> Camera:
    return orbit_cameras(1, width=width, height=height, radius=2.0)[0]


def _accuracy() -> list[Figure]:
    gaussians = random_gaussians(3000, seed=3, sh_degree=3)
    camera = _camera(320, 180)
    got = CpuRasterizer().render(gaussians, camera).image.astype(np.float64)
    error = got - ReferenceRasterizer().render(gaussians, camera).image
    psnr = -10 * np.log10((error**2).mean())
    return [
        Figure("raster: mean error against float64", float(np.abs(error).mean()), "", "<= 1e-5"),
        Figure("raster: PSNR against float64", float(psnr), "dB", ">= 80"),
    ]


def _speed() -> list[Figure]:
    cpu = CpuRasterizer()
    gaussians = surfaces(100_000)
    small, large = _camera(480, 270), _camera(960, 540)
    times = [cpu_median(lambda c=c: cpu.render(gaussians, c)) for c in (small, large)]  # type: ignore[misc]
    return [
        Figure(
            "raster: 100k, 480x270, prepare", cpu_median(lambda: prepare(gaussians, small)), "ms"
        ),
        Figure("raster: 100k, 480x270, whole", times[0], "ms"),
        Figure("raster: 100k, 960x540, whole", times[1], "ms"),
        Figure("raster: 960x540 to 480x270", times[1] / times[0], "x", "<= 3"),
        *_torch(gaussians, small),
    ]


def _torch(gaussians: Gaussians, camera: Camera) -> list[Figure]:
    """The same lists of tiles blended by torch, one thread each."""
    view = prepare(gaussians, camera)
    colors, black = _colors(gaussians, camera, view), np.zeros(3, np.float32)
    n_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with one_thread():
            ours = cpu_median(lambda: _blend(view, camera, colors, black, 3))
            want = _blend(view, camera, colors, black, 3).image
            theirs = cpu_median(lambda: torch_tile_loop(view, camera, colors, _PIECE))
            error = np.abs(torch_tile_loop(view, camera, colors, _PIECE) - want).mean()
    finally:
        torch.set_num_threads(n_threads)
    return [
        Figure("raster: 100k, 480x270, blend, one thread", ours, "ms"),
        Figure("raster: pure-torch tile loop to that", theirs / ours, "x", ">= 20"),
        Figure("raster: mean difference of their pictures", float(error), "", "<= 1e-5"),
    ]


def _large() -> list[Figure]:
    cpu = CpuRasterizer()
    gaussians = surfaces(1_000_000)
    n = len(gaussians)
    camera = _camera(640, 480)
    labels = (np.arange(n) * 120 // n).astype(np.int32)
    pixel_labels = (np.indices((480, 640)).sum(axis=0) // 40).astype(np.int32)
    histogram = np.zeros((n, 100), np.float32)
    scene = Scene.of(gaussians, labels)
    render = cpu_median(lambda: cpu.render(gaussians, camera))
    splat = cpu_median(lambda: cpu.label_splat(gaussians, camera, labels))
    vote = cpu_median(lambda: cpu.vote(gaussians, camera, pixel_labels, histogram))
    one_pick = cpu_median(lambda: pick(scene, camera, 320.5, 300.5))
    return [
        Figure("raster: 1M, 640x480, render", render, "ms"),
        Figure("raster: 1M, 640x480, label_splat to render", splat / render, "x", "<= 2"),
        Figure("raster: 1M, 640x480, vote to render", vote / render, "x", "<= 3"),
        Figure("pick: one pixel of 1M", one_pick, "ms", "<= 50"),
        Figure("pick: to one render of 1M", one_pick / render, "x", "<= 0.2"),
    ]


def _cold_compile() -> Figure:
    """CPU seconds of the first render, vote and label map with an empty kernel cache."""
    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.run(
            [sys.executable, "-c", _COLD],
            env=os.environ | {"NUMBA_CACHE_DIR": folder},
            check=True,
            capture_output=True,
            text=True,
        )
    return Figure("raster: compile all kernels, once", float(run.stdout), "s", "<= 20")
