"""Two threads that render, splat labels and vote at once: how many results differ from those alone.

And whether a second thread pays: CPU time of all threads against that of one.
"""

import threading

import numpy as np

from gaga_core.arrays import AnyArray
from gaga_core.camera import Camera
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.bench.bench_raster import surfaces
from tests.bench.figures import Figure, cpu_median, one_thread
from tests.scenes import Synthetic, objects_scene, orbit_cameras

_ROUNDS = 200


def figures() -> list[Figure]:
    """Rounds whose arrays are not equal bit by bit, and what splitting the work costs."""
    cpu = CpuRasterizer()
    gaussians = surfaces(100_000)
    camera = orbit_cameras(1, width=480, height=270, radius=2.0)[0]
    together = cpu_median(lambda: cpu.render(gaussians, camera))
    with one_thread():
        alone = cpu_median(lambda: cpu.render(gaussians, camera))
    return [
        Figure(f"threads: of two, {_ROUNDS} rounds each, wrong", _wrong_rounds(), "", "<= 0"),
        Figure("threads: CPU of all threads to that of one, 100k", together / alone, "x", "<= 1.5"),
    ]


def _wrong_rounds() -> int:
    """Two threads, a scene each; results are kept as copies, as shared memory would show."""
    scenes = [objects_scene(6, 700, sh_degree=degree, seed=degree) for degree in (0, 2)]
    want = [[array.copy() for array in _everything(scene, scene.cameras[0])] for scene in scenes]
    done, wrong = [0, 0], [0, 0]
    start = threading.Barrier(2)

    def work(which: int) -> None:
        start.wait()
        for _ in range(_ROUNDS):
            got = _everything(scenes[which], scenes[which].cameras[0])
            same = all(np.array_equal(a, b) for a, b in zip(got, want[which], strict=True))
            wrong[which] += not same
            done[which] += 1

    threads = [threading.Thread(target=work, args=(k,)) for k in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(wrong) + 2 * _ROUNDS - sum(done)


def _everything(scene: Synthetic, camera: Camera) -> list[AnyArray]:
    cpu, n = CpuRasterizer(), len(scene.gaussians)
    frame = cpu.render(scene.gaussians, camera)
    labels = cpu.label_splat(scene.gaussians, camera, scene.labels)
    histogram = np.zeros((n, 3), np.float32)
    halves = np.full((camera.height, camera.width), 1, np.int32)
    cpu.vote(scene.gaussians, camera, halves, histogram)
    return [
        frame.image,
        frame.alpha,
        frame.expected_depth,
        frame.median_depth,
        labels.labels,
        labels.confidence,
        histogram,
    ]
