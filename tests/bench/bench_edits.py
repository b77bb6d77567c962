"""Edits and the object list at a million splats."""

import time

import numpy as np

from gaga_core.gaussians import Gaussians
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices, object_table
from gaga_core.scene.scene import Scene
from tests.bench.figures import Figure, median_ms

N = 1_000_000


def _scene() -> Scene:
    rng = np.random.default_rng(0)
    gaussians = Gaussians(
        means=rng.normal(size=(N, 3)).astype(np.float32),
        quats=rng.normal(size=(N, 4)).astype(np.float32),
        log_scales=np.full((N, 3), -4, np.float32),
        logit_opacities=np.zeros(N, np.float32),
        sh=np.zeros((N, 16, 3), np.float32),
    )
    return Scene.of(gaussians, rng.integers(0, 300, N).astype(np.int32))


def figures() -> list[Figure]:
    """Delete a scattered half of a million, undo it, list the objects, drag and copy one."""
    scene = _scene()
    half = np.random.default_rng(1).random(N) < 0.5
    found = [
        Figure("object list, 1M splats", median_ms(lambda: object_table(scene)), "CPU-ms", "<= 15")
    ]
    edit = edits.delete(scene, half)
    assert edit is not None
    per_splat = edit.nbytes / int(half.sum())
    found += [
        Figure("undo entry, scattered delete", per_splat, "bytes a splat", "<= 1"),
        Figure(
            "delete 500k of 1M", median_ms(lambda: edits.delete(scene, half)), "CPU-ms", "<= 50"
        ),
        Figure(
            "its do or undo", median_ms(lambda: edit.apply(scene), 6, warm_up=2), "CPU-ms", "<= 50"
        ),
    ]
    mug, history = group_indices(scene, 7), History(scene)
    steps = iter(range(1, 100))

    def drag() -> None:
        by = np.column_stack([np.eye(3), [next(steps), 0, 0]])
        history.preview_with(lambda base: edits.transform(base, mug, by))

    found.append(Figure("a frame of a drag", median_ms(drag), "CPU-ms", "<= 16"))
    history.preview(None)
    history.do(edits.duplicate(scene, mug))

    def again() -> None:
        history.undo()
        history.redo()

    found.append(
        Figure(
            "undo and redo a duplicate", median_ms(again, warm_up=0, clock=time.perf_counter), "ms"
        )
    )
    return found
