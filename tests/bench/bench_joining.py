"""Views that join later, next to all at once: what it costs and what it loses, in one process.

Halls of boxes, views of 320x240: every fourth one joins the others later. Preset robust.
``python -m tests.bench.bench_joining`` prints both as JSON.
"""

import json
import sys
import time
from dataclasses import asdict, dataclass
from functools import partial
from statistics import mean

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.grouping.add_views import FormerGroups, add_views_stage
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.masks import MaskSet
from gaga_core.progress import Stage, run_stage
from gaga_core.raster import choose
from tests.bench.figures import Figure
from tests.bench.hall import cameras, draw_masks, hall
from tests.bench.workers import run_worker

_HALLS = ((125, 60, 0), (125, 60, 5), (100, 80, 9))  # boxes, views, seed
_EVERY = 4


@dataclass(frozen=True)
class _Cost:
    """CPU seconds, and mean IoU of boxes in percent."""

    joining_s: float
    whole_s: float
    first: float  # IoU before views joined
    joined: float
    whole: float


def figures() -> list[Figure]:
    """Mean and worst of the halls."""
    cost = run_worker("tests.bench.bench_joining", [])
    name = f"joining: {len(_HALLS)} halls, a quarter of the views later"
    ratio, loss = cost["joining_s"] / cost["whole_s"], cost["joined"] - cost["whole"]
    return [
        Figure(f"{name}, time to that of all at once", ratio, "ratio", "<= 0.5"),
        Figure(f"{name}, IoU, less that of all at once", loss, "points", ">= -1"),
        Figure(f"{name}, the same, worst", cost["worst"], "points"),
        Figure(f"{name}, IoU before they joined", cost["first"], "%"),
        Figure(f"{name}, IoU then", cost["joined"], "%"),
        Figure(f"{name}, IoU of all at once", cost["whole"], "%"),
    ]


def measure() -> dict[str, float]:
    """Means over the halls, and the worst difference of IoU."""
    costs = [asdict(_cost(*sizes)) for sizes in _HALLS]
    means = {name: mean(cost[name] for cost in costs) for name in costs[0]}
    return means | {"worst": min(cost["joined"] - cost["whole"] for cost in costs)}


def _cost(n_boxes: int, n_views: int, seed: int) -> _Cost:
    """One hall."""
    scene, engine, config = hall(n_boxes, seed), choose("cpu"), AssociateConfig.of("robust")
    views = cameras(scene, n_views, (320, 240), seed + 1)
    maps = {
        camera.name: draw_masks(scene, camera, np.random.default_rng((2 + seed, i)))
        for i, camera in enumerate(views)
    }
    names = [camera.name for camera in views]

    def masks(chosen: list[str]) -> MaskSet:
        return MaskSet({name: partial(maps.__getitem__, name) for name in chosen}, "hall")

    def timed(stage: Stage[Association]) -> tuple[Association, float]:
        start = time.process_time()
        return run_stage(stage), time.process_time() - start

    early = [name for i, name in enumerate(names) if i % _EVERY]
    first, _ = timed(associate_stage(scene.gaussians, views, masks(early), engine, config))
    assert first.weight is not None
    former = FormerGroups(first.bank, first.labels, first.confidence, first.weight)
    every = masks(names)
    joined, joining_s = timed(
        add_views_stage(scene.gaussians, views, every, former, engine, config)
    )
    whole, whole_s = timed(associate_stage(scene.gaussians, views, every, engine, config))
    iou = [100 * mean_iou(found.labels, scene.labels) for found in (first, joined, whole)]
    return _Cost(joining_s, whole_s, *iou)


def mean_iou(labels: IntArray, truth: IntArray) -> float:
    """Mean over the objects 1.. of ``truth`` (N,) of the best IoU of a group with each; splats of
    no object are left out."""
    own, found = truth[truth > 0], labels[truth > 0]
    table = np.zeros((int(own.max()) + 1, int(labels.max()) + 1), np.int64)
    np.add.at(table, (own, found), 1)
    union = table.sum(axis=1)[:, None] + table.sum(axis=0) - table
    return float((table / np.maximum(union, 1))[1:, 1:].max(axis=1).mean())


if __name__ == "__main__":
    sys.stdout.write(json.dumps(measure()) + "\n")
