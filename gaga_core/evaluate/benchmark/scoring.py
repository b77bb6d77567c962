"""The scores of a scene's predictions: Algorithm 1, or masks of text prompts."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.evaluate.benchmark_tables import InstanceScores, PromptScores
from gaga_core.evaluate.lerf_mask import lerf_mask_stage
from gaga_core.evaluate.metrics import UNANSWERED, score_stage
from gaga_core.io.datasets.base import DatasetScene
from gaga_core.io.masks import label_files_of, read_labels
from gaga_core.masks import resize_labels
from gaga_core.progress import Stage


@dataclass(frozen=True)
class Scored:
    """The scores of a scene."""

    scores: InstanceScores | PromptScores
    missing: tuple[str, ...]  # predictions that were not there
    notes: tuple[str, ...] = ()


def score_scene(scene: DatasetScene, predictions: Path) -> Stage[Scored]:
    """The scores of the predictions in a folder; those that are missing count as 0."""
    if scene.prompts is None:
        return (yield from _score_maps(scene, predictions))
    prompts = scene.prompts
    with TemporaryDirectory() as nothing:
        folder = predictions if predictions.is_dir() else Path(nothing)
        report = yield from lerf_mask_stage(folder, prompts.folder, views=prompts.views)
    by_prompt = {p.prompt: (p.iou, p.boundary_iou) for p in report.prompts}
    scores = PromptScores(report.miou, report.mean_boundary_iou, by_prompt)
    n, notes = len(report.unused), []
    if n:
        notes.append(f"{n} predictions answer no prompt of the data set ({report.unused[0]}, ...).")
    return Scored(scores, report.missing, tuple(notes))


def _score_maps(scene: DatasetScene, predictions: Path) -> Stage[Scored]:
    """Algorithm 1 over the group maps ``<stem>.png`` of the test views that have a true map."""
    truth = scene.truth
    names = [name for name in scene.folder.test if name in truth]
    files: Mapping[str, Path] = {}
    if predictions.is_dir():
        files = label_files_of(predictions, names, [c.name for c in scene.folder.cameras])

    def pair(name: str) -> tuple[IntArray, IntArray]:
        true = truth.loaders[name]()
        file = files.get(name)
        if file is None:
            return true, np.full_like(true, UNANSWERED)
        return true, resize_labels(read_labels(file), true.shape[1], true.shape[0])

    with_void, without_void = yield from score_stage((pair(name) for name in names), len(names))
    missing = tuple(name for name in names if name not in files)
    return Scored(InstanceScores(with_void, without_void), missing)
