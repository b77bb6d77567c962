"""Pictures and votes do not depend on threads, nor on who else renders."""

import threading

import numpy as np
import pytest

from gaga_core.arrays import AnyArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.raster.cpu import rasterizer
from gaga_core.raster.cpu.rasterizer import CpuRasterizer
from tests.scenes import objects_scene

CPU = CpuRasterizer()


def _everything(
    gaussians: Gaussians, camera: Camera, splat_labels: AnyArray, labels: AnyArray
) -> list[AnyArray]:
    frame = CPU.render(gaussians, camera)
    label_frame = CPU.label_splat(gaussians, camera, splat_labels)
    histogram = np.zeros((len(gaussians), int(labels.max()) + 1), np.float32)
    CPU.vote(gaussians, camera, labels, histogram)
    rows = CPU.weights(gaussians, camera, np.arange(0, labels.size, 3))
    return [
        frame.image,
        frame.alpha,
        frame.expected_depth,
        frame.median_depth,
        label_frame.labels,
        label_frame.confidence,
        histogram,
        rows.indptr,
        rows.indices,
        rows.weights,
    ]


def test_the_number_of_threads_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rasterizer, "_BATCH", 20_000)  # several batches
    scene = objects_scene(8, 2500, sh_degree=1)  # several pieces of Gaussians
    camera = scene.cameras[0]
    labels = (np.indices((120, 160)).sum(axis=0) // 9 % 11 - 1).astype(np.int32)
    results = []
    for n in ("1", "2", "5"):
        monkeypatch.setenv("GAGA_THREADS", n)
        results.append(_everything(scene.gaussians, camera, scene.labels, labels))
    for other in results[1:]:
        for got, want in zip(other, results[0], strict=True):
            np.testing.assert_array_equal(got, want)


def test_two_threads_draw_the_same_for_200_rounds() -> None:
    """Each draws a scene of its own, so that nothing but the pool is shared."""
    scenes = [objects_scene(6, 700, sh_degree=degree, seed=degree) for degree in (0, 2)]
    alone = [CPU.render(scene.gaussians, scene.cameras[0]) for scene in scenes]
    want = [(frame.image.copy(), frame.alpha.copy()) for frame in alone]  # shared memory would show
    done, wrong = [0, 0], [0, 0]
    together = threading.Barrier(2)

    def work(which: int) -> None:
        together.wait()
        for _ in range(200):
            got = CPU.render(scenes[which].gaussians, scenes[which].cameras[0])
            image, alpha = want[which]
            same = np.array_equal(got.image, image) and np.array_equal(got.alpha, alpha)
            wrong[which] += not same
            done[which] += 1

    threads = [threading.Thread(target=work, args=(k,)) for k in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (done, wrong) == ([200, 200], [0, 0])


def test_two_threads_rendering_at_once_draw_the_same() -> None:
    scene = objects_scene(6, 300)
    labels = (np.indices((120, 160)).sum(axis=0) // 9 % 11 - 1).astype(np.int32)
    want = [_everything(scene.gaussians, c, scene.labels, labels) for c in scene.cameras[:2]]
    wrong: list[int] = []

    def work(which: int) -> None:
        for _ in range(24):
            got = _everything(scene.gaussians, scene.cameras[which], scene.labels, labels)
            if not all(np.array_equal(a, b) for a, b in zip(got, want[which], strict=True)):
                wrong.append(which)

    threads = [threading.Thread(target=work, args=(k,)) for k in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
