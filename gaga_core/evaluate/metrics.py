"""Class-agnostic scores of group maps (supplement of the paper, Algorithm 1).

For each image one joint histogram of true and predicted labels gives every pairwise IoU at once.
IoU(i, j) is averaged over the images in which true label i is present (as the published code does;
the paper's text averages over all); Hungarian assignment maximises the sum; IoU is the mean of the
paired ones over all true labels, precision = hits / n_pred and recall = hits / n_gt with hits at
IoU > 0.5. Two countings: ``with_void`` takes label 0 as a label of both sides (the published
code), ``without_void`` leaves pixels out whose true label is 0.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.io.masks import list_label_files, read_labels
from gaga_core.masks import resize_labels

HIT = 0.5  # IoU above which a paired label counts as found


@dataclass(frozen=True)
class Score:
    """Algorithm 1 under one counting; all in 0..1."""

    iou: float
    precision: float
    recall: float
    pooled_iou: float  # the same pairing rule on counts summed over images: robust to odd views
    n_true: int
    n_predicted: int


@dataclass(frozen=True)
class Report:
    """Both countings, and what was compared."""

    with_void: Score
    without_void: Score
    images: tuple[str, ...]  # stems of the true maps
    missing: tuple[str, ...]  # stems without a prediction: scored as 0

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self)

    def table(self) -> list[list[str]]:
        """Rows of text, headings first."""
        rows = [["", "IoU", "precision", "recall", "pooled IoU", "true", "predicted"]]
        for name, score in (("void left out", self.without_void), ("with void", self.with_void)):
            values = (score.iou, score.precision, score.recall, score.pooled_iou)
            counts = [str(score.n_true), str(score.n_predicted)]
            rows.append([name, *(f"{100 * v:.1f}" for v in values), *counts])
        return rows


def evaluate(pred: Path, gt: Path, *, stems: Iterable[str] | None = None) -> Report:
    """Score the label maps of ``pred`` against those of ``gt`` (matched by stem).

    Every true map counts (or only those of ``stems``); a missing prediction is all 0, and named.
    A prediction of another size is resized (nearest). Raises ``GagaError`` without true maps.
    """
    true_files = {path.stem: path for path in list_label_files(gt)}
    if stems is not None:
        wanted = set(stems)
        unknown = sorted(wanted - set(true_files))
        if unknown:
            raise GagaError(f"{gt} has no true map for {len(unknown)} views (first: {unknown[0]}).")
        true_files = {stem: path for stem, path in true_files.items() if stem in wanted}
    if not true_files:
        raise GagaError(f"{gt} holds no label maps to compare with. Choose another folder.")
    predicted_files = {path.stem: path for path in list_label_files(pred)}
    missing = tuple(stem for stem in true_files if stem not in predicted_files)
    pairs = []
    for stem, path in true_files.items():
        true = read_labels(path)
        predicted = np.zeros_like(true)
        if stem in predicted_files:
            predicted = read_labels(predicted_files[stem])
        pairs.append((true, resize_labels(predicted, true.shape[1], true.shape[0])))
    with_void, without_void = score_pairs(pairs)
    return Report(with_void, without_void, tuple(true_files), missing)


def score_pairs(pairs: Sequence[tuple[IntArray, IntArray]]) -> tuple[Score, Score]:
    """Scores (with void, void left out) of (true, predicted) label maps of equal shape."""
    true_ids = _ids(true for true, _ in pairs)
    predicted_ids = _ids(predicted for _, predicted in pairs)
    joint = np.stack(
        [_joint_histogram(true, pred, true_ids, predicted_ids) for true, pred in pairs]
    )  # (V, T, P) pixels
    with_void = _score(joint)
    named = true_ids != 0
    # Void left out: no pixel of true label 0 counts, and predicted 0 is "no answer", not a label.
    answers = predicted_ids != 0
    areas = joint[:, named]
    without_void = _score(areas[:, :, answers], true_area=areas.sum(axis=2))
    return with_void, without_void


def _ids(maps: Iterable[IntArray]) -> LongArray:
    found = [np.unique(labels) for labels in maps]
    return np.unique(np.concatenate(found)).astype(np.int64)


def _joint_histogram(
    true: IntArray, predicted: IntArray, true_ids: LongArray, predicted_ids: LongArray
) -> LongArray:
    """Pixels (T, P) by pair of labels."""
    rows = np.searchsorted(true_ids, true.ravel())
    columns = np.searchsorted(predicted_ids, predicted.ravel())
    counts = np.bincount(
        rows * len(predicted_ids) + columns, minlength=len(true_ids) * len(predicted_ids)
    )
    return counts.reshape(len(true_ids), len(predicted_ids))


def _score(joint: LongArray, true_area: LongArray | None = None) -> Score:
    """Algorithm 1 on joint histograms (V, T, P); ``true_area`` (V, T) if columns were left out."""
    if true_area is None:
        true_area = joint.sum(axis=2)
    predicted_area = joint.sum(axis=1)  # (V, P)
    present = true_area > 0  # (V, T)
    predicted_used = predicted_area.sum(axis=0) > 0
    joint, predicted_area = joint[:, :, predicted_used], predicted_area[:, predicted_used]
    true_used = present.any(axis=0)
    joint, true_area, present = joint[:, true_used], true_area[:, true_used], present[:, true_used]
    per_image = _iou(joint, true_area, predicted_area)  # (V, T, P)
    images = np.maximum(present.sum(axis=0), 1)
    mean = (per_image * present[:, :, None]).sum(axis=0) / images[:, None]
    pooled = _iou(joint.sum(axis=0), true_area.sum(axis=0), predicted_area.sum(axis=0))
    n_true, n_predicted = mean.shape
    paired = _pair(mean)
    hits = int((paired > HIT).sum())
    return Score(
        iou=float(paired.mean()) if n_true else 0.0,
        precision=hits / n_predicted if n_predicted else 0.0,
        recall=hits / n_true if n_true else 0.0,
        pooled_iou=float(_pair(pooled).mean()) if n_true else 0.0,
        n_true=n_true,
        n_predicted=n_predicted,
    )


def _iou(joint: LongArray, true_area: LongArray, predicted_area: LongArray) -> DoubleArray:
    union = true_area[..., :, None] + predicted_area[..., None, :] - joint
    result: DoubleArray = joint / np.maximum(union, 1)
    return result


def _pair(iou: DoubleArray) -> DoubleArray:
    """IoU (T,) of each true label with its partner under the best assignment; 0 without one."""
    from scipy.optimize import linear_sum_assignment

    paired = np.zeros(len(iou))
    if iou.size:
        rows, columns = linear_sum_assignment(iou, maximize=True)
        paired[rows] = iou[rows, columns]
    return paired
