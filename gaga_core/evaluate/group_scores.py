"""Class-agnostic scores of group maps (supplement of the paper, Algorithm 1).

For each image one joint histogram of true and predicted labels gives every pairwise IoU at once.
IoU(i, j) is averaged over the images in which true label i is present (as the published code does;
the paper's text averages over all); Hungarian assignment maximises the sum; IoU is the mean of the
paired ones over all true labels, precision = hits / n_pred and recall = hits / n_gt with hits at
IoU > 0.5. Two countings: ``with_void`` takes label 0 as a label of both sides and counts every
predicted label, as the published code does; ``without_void`` leaves pixels out whose true label is
0. There a predicted label that found nothing counts only where it says something about the objects:
not when more than half of its pixels lie on void (the rule of panoptic quality, Kirillov et al.,
CVPR 2019), nor when it is smaller in every image than any mask (`SMALLEST`). Else each label of
a wall or of a blended outline that covers one pixel of an object would cost as much precision as a
wrong object, and the score would say how labels were decoded instead of how they were associated.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.io.masks.label_maps import label_files, label_files_of, read_labels, view_key
from gaga_core.masks import resize_labels
from gaga_core.progress import Progress, Stage, run_stage

HIT = 0.5  # IoU above which a paired label counts as found
SMALLEST = 0.0002  # share of a picture of the smallest mask that model providers keep (`min_area`)
VOID_LEFT_OUT = (
    "Counted with void left out: an id that found nothing, and lies mostly on void or is smaller "
    f"than {100 * SMALLEST:g} % of every picture, is no prediction."
)
UNANSWERED = -1  # predicted "label" of a whole missing map: pairs with nothing, not even void
_LARGEST_TABLE = 1 << 22  # ids up to here are counted by table


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
    images: tuple[str, ...]  # of the true maps: path without suffix
    missing: tuple[str, ...]  # images without a prediction: scored as 0

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


def evaluate(pred: Path, gt: Path, *, views: Iterable[str] | None = None) -> Report:
    """Score the label maps of ``pred`` against those of ``gt``, matched by their path in there.

    Suffixes do not matter. Every true map counts (or only those of ``views``, photos by name); next
    to maps in ``gt`` itself, its subfolders count where ``pred`` has them too. A missing prediction
    is IoU 0 for all that the image shows (void too), and named. A prediction of another size is
    resized (nearest). Raises ``GagaError`` without true maps.
    """
    predicted_files = label_files(pred)
    if views is None:
        true_files = _true_files(gt, predicted_files)
    else:
        names = sorted(set(views))
        found = label_files_of(gt, names)
        unknown = [name for name in names if name not in found]
        if unknown:
            raise GagaError(f"{gt} has no true map for {len(unknown)} views (first: {unknown[0]}).")
        true_files = {view_key(name): path for name, path in found.items()}
        predicted = label_files_of(pred, names)
        predicted_files = {view_key(name): path for name, path in predicted.items()}
    if not true_files:
        raise GagaError(f"{gt} holds no label maps to compare with. Choose another folder.")
    missing = tuple(stem for stem in true_files if stem not in predicted_files)
    pairs = (_read_pair(path, predicted_files.get(stem)) for stem, path in true_files.items())
    with_void, without_void = score_pairs(pairs)
    return Report(with_void, without_void, tuple(true_files), missing)


def score_pairs(pairs: Iterable[tuple[IntArray, IntArray]]) -> tuple[Score, Score]:
    """Scores (with void, void left out) of (true, predicted) label maps of equal shape.

    A predicted `UNANSWERED` is no label in either counting. The maps are read once, one pair at a
    time.
    """
    return run_stage(score_stage(pairs, 0))


def score_stage(
    pairs: Iterable[tuple[IntArray, IntArray]], n_pairs: int
) -> Stage[tuple[Score, Score]]:
    """`score_pairs` with a step of progress a pair."""
    counts = []
    for true, predicted in pairs:
        counts.append(_count(true, predicted))
        yield Progress("Score", len(counts), n_pairs)
    return _score(counts), _score([_without_void(image) for image in counts])


@dataclass(frozen=True, eq=False)
class _Counts:
    """One image: how many pixels have each pair of labels."""

    true_ids: LongArray  # (T,) labels in this image, increasing
    predicted_ids: LongArray  # (P,)
    joint: LongArray  # (T, P) pixels
    true_area: LongArray  # (T,) pixels, those without an answer included
    outside: LongArray  # (P,) pixels on void, where void is left out; else 0
    n_pixels: int  # of the image
    counts_all: bool  # every predicted label is a prediction, whatever it covers


def _true_files(gt: Path, predicted: Mapping[str, Path]) -> dict[str, Path]:
    """The true maps that count when no views are named, by their path without suffix."""
    files = label_files(gt)
    if all("/" in key for key in files):
        return files
    folders = {key.rpartition("/")[0] for key in predicted} | {""}
    return {key: path for key, path in files.items() if key.rpartition("/")[0] in folders}


def _read_pair(true_file: Path, predicted_file: Path | None) -> tuple[IntArray, IntArray]:
    true = read_labels(true_file)
    if predicted_file is None:
        return true, np.full_like(true, UNANSWERED)
    return true, resize_labels(read_labels(predicted_file), true.shape[1], true.shape[0])


def _count(true: IntArray, predicted: IntArray) -> _Counts:
    """The joint histogram of one image."""
    true_ids, rows = _compact(true)
    predicted_ids, columns = _compact(predicted)
    n_true, n_predicted = len(true_ids), len(predicted_ids)
    joint = np.bincount(rows * n_predicted + columns, minlength=n_true * n_predicted)
    joint = joint.reshape(n_true, n_predicted)
    answers = predicted_ids != UNANSWERED
    return _Counts(
        true_ids=true_ids,
        predicted_ids=predicted_ids[answers],
        joint=joint[:, answers],
        true_area=joint.sum(axis=1),
        outside=np.zeros(int(answers.sum()), np.int64),
        n_pixels=true.size,
        counts_all=True,
    )


def _compact(labels: IntArray) -> tuple[LongArray, LongArray]:
    """The distinct labels, increasing, and for each pixel its place among them."""
    shifted = labels.ravel().astype(np.int64) - UNANSWERED
    if shifted.max(initial=0) > _LARGEST_TABLE:
        ids, places = np.unique(shifted, return_inverse=True)
        return ids + UNANSWERED, places
    ids = np.flatnonzero(np.bincount(shifted))  # a table lookup: far quicker than sorting
    table = np.zeros(int(shifted.max(initial=0)) + 1, np.int64)
    table[ids] = np.arange(len(ids))
    return ids + UNANSWERED, table[shifted]


def _without_void(image: _Counts) -> _Counts:
    """Pixels of true label 0 do not count, and a predicted 0 is "no answer", not a label."""
    named = image.true_ids != 0
    answers = image.predicted_ids != 0
    return _Counts(
        true_ids=image.true_ids[named],
        predicted_ids=image.predicted_ids[answers],
        joint=image.joint[named][:, answers],
        true_area=image.true_area[named],
        outside=image.joint[~named][:, answers].sum(axis=0),
        n_pixels=image.n_pixels,
        counts_all=False,
    )


def _score(images: Sequence[_Counts]) -> Score:
    """Algorithm 1."""
    true_ids = _union([image.true_ids for image in images])
    predicted_ids = _union([image.predicted_ids for image in images])
    n_true, n_predicted = len(true_ids), len(predicted_ids)
    iou_sum = np.zeros((n_true, n_predicted))
    joint = np.zeros((n_true, n_predicted), np.int64)
    n_images = np.zeros(n_true, np.int64)  # that show true label i
    true_area, predicted_area = np.zeros(n_true, np.int64), np.zeros(n_predicted, np.int64)
    outside, largest = np.zeros(n_predicted, np.int64), np.zeros(n_predicted)
    for image in images:
        rows = np.searchsorted(true_ids, image.true_ids)
        columns = np.searchsorted(predicted_ids, image.predicted_ids)
        area = image.joint.sum(axis=0)
        iou_sum[np.ix_(rows, columns)] += _iou(image.joint, image.true_area, area)
        joint[np.ix_(rows, columns)] += image.joint
        n_images[rows] += 1
        true_area[rows] += image.true_area
        predicted_area[columns] += area
        outside[columns] += image.outside
        share = (area + image.outside) / max(image.n_pixels, 1)
        largest[columns] = np.maximum(largest[columns], share)
    paired, partners = _pair(iou_sum / np.maximum(n_images, 1)[:, None])
    pooled, _ = _pair(_iou(joint, true_area, predicted_area))
    hits = partners[paired > HIT]
    counted = (outside <= predicted_area) & (largest >= SMALLEST) & (predicted_area > 0)
    counted |= all(image.counts_all for image in images)
    counted[hits] = True
    n_counted = int(counted.sum())
    return Score(
        iou=float(paired.mean()) if n_true else 0.0,
        precision=len(hits) / n_counted if n_counted else 0.0,
        recall=len(hits) / n_true if n_true else 0.0,
        pooled_iou=float(pooled.mean()) if n_true else 0.0,
        n_true=n_true,
        n_predicted=n_counted,
    )


def _union(ids: Sequence[LongArray]) -> LongArray:
    return np.unique(np.concatenate([np.zeros(0, np.int64), *ids]))


def _iou(joint: LongArray, true_area: LongArray, predicted_area: LongArray) -> DoubleArray:
    """IoU (T, P) of every pair."""
    union = true_area[:, None] + predicted_area[None, :] - joint
    return joint / np.maximum(union, 1)


def _pair(iou: DoubleArray) -> tuple[DoubleArray, LongArray]:
    """IoU (T,) of each true label with its partner under the best assignment, and the partner's
    column (T,); without one 0 and -1."""
    paired, partners = np.zeros(len(iou)), np.full(len(iou), -1, np.int64)
    if iou.size:
        rows, columns = linear_sum_assignment(iou, maximize=True)
        paired[rows], partners[rows] = iou[rows, columns], columns
    return paired, partners
