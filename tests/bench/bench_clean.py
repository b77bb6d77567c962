"""Cleaning an object: time at scale, and how many planted errors are found."""

import numpy as np

from gaga_core.gaussians import Gaussians
from gaga_core.scene.cleanup import clean_object
from gaga_core.scene.scene import Scene
from tests.bench.figures import Figure, median_ms
from tests.scenes import objects_scene

_SEEDS = range(5)


def figures() -> list[Figure]:
    """CPU time of a 100k-splat object among 1M, and precision and recall before and after."""
    scene = _large()
    time = median_ms(lambda: clean_object(scene, 1), runs=5)
    scores = np.mean([_scores(seed) for seed in _SEEDS], axis=0)
    bars = ("", "", ">= 0.97", ">= 0.97", "<= 0.01")
    names = (
        "precision before",
        "recall before",
        "precision after",
        "recall after",
        "share of a true object that changes",
    )
    return [
        Figure("clean: object of 100k among 1M", time, "CPU-ms", "<= 1000"),
        *(
            Figure(f"clean: {n}", float(v), "", b)
            for n, v, b in zip(names, scores, bars, strict=True)
        ),
    ]


def _scores(seed: int) -> tuple[float, ...]:
    """Means over the balls of one scene with 15 % of all labels wrong."""
    made = objects_scene(per_object=1500, seed=seed)
    truth = np.where(made.labels > 0, made.labels, 9).astype(np.int32)
    rng = np.random.default_rng(seed)
    labels = truth.copy()
    wrong = rng.random(len(labels)) < 0.15
    labels[wrong] = rng.integers(0, 10, wrong.sum())
    rows = []
    for group in range(1, 7):
        preview = clean_object(Scene.of(made.gaussians, labels), group)
        still = clean_object(Scene.of(made.gaussians, truth), group)
        n_true = int((truth == group).sum())
        hits = [int((truth[rows_] == group).sum()) for rows_ in (preview.before, preview.after)]
        changed = (len(still.add) + len(still.remove)) / n_true
        rows.append(
            (
                hits[0] / len(preview.before),
                hits[0] / n_true,
                hits[1] / len(preview.after),
                hits[1] / n_true,
                changed,
            )
        )
    return tuple(np.mean(rows, axis=0))


def _large() -> Scene:
    """A ball of 100k splats on a table of 900k, 2 % of all labels wrong."""
    rng = np.random.default_rng(0)
    n, k = 1_000_000, 100_000
    out = rng.normal(size=(k, 3))
    ball = 0.5 * out / np.linalg.norm(out, axis=1, keepdims=True) + [0, 0, 0.5]
    table = np.c_[rng.uniform(-4, 4, (n - k, 2)), rng.normal(0, 0.01, n - k)]
    gaussians = Gaussians(
        means=np.concatenate([ball, table]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), -5, np.float32),
        logit_opacities=rng.normal(1, 2, n).astype(np.float32),
        sh=rng.normal(0, 0.3, (n, 1, 3)).astype(np.float32),
    )
    labels = np.repeat(np.array([1, 2], np.int32), [k, n - k])
    wrong = rng.random(n) < 0.02
    labels[wrong] = rng.integers(0, 4, wrong.sum())
    return Scene.of(gaussians, labels)
