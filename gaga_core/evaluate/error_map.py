"""Where a view's groups agree with the true objects, pixel by pixel."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.optimize import linear_sum_assignment

from gaga_core.arrays import IntArray, UInt8Array, check_shape


class Verdict(IntEnum):
    """What is said of a pixel."""

    VOID = 0  # no true object is there
    RIGHT = 1  # the group that stands for the true object
    WRONG = 2  # another group
    MISSING = 3  # no group


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """The comparison of one view."""

    verdicts: UInt8Array  # (H, W) `Verdict`
    group_of: dict[
        int, int
    ]  # the group that stands for each true id; one that has none is left out

    @property
    def share_right(self) -> float:
        """Share of the pixels of true objects that have the right group; 1 without any."""
        counts = np.bincount(self.verdicts.ravel(), minlength=4)
        n = int(counts[1:].sum())
        return float(counts[Verdict.RIGHT] / n) if n else 1.0


def error_map(groups: IntArray, truth: IntArray) -> ErrorMap:
    """Compare group ids with true ids, both (H, W), 0 = none.

    Each true object is matched to one group, and no group to two objects, so that the sum of their
    IoU in this view is greatest (the pairing of the supplement's Algorithm 1, for a single image
    without void).
    """
    check_shape("groups", groups, ("H", "W"), np.int32)
    check_shape("truth", truth, groups.shape, np.int32)
    inside = truth > 0
    true_ids, row = np.unique(truth[inside], return_inverse=True)
    group_ids, column = np.unique(groups[inside], return_inverse=True)
    counts = np.zeros((len(true_ids), len(group_ids)), np.int64)
    np.add.at(counts, (row, column), 1)
    union = counts.sum(axis=1, keepdims=True) + counts.sum(axis=0, keepdims=True) - counts
    overlap = np.where(group_ids > 0, counts / np.maximum(union, 1), 0.0)
    pairs = zip(*linear_sum_assignment(overlap, maximize=True), strict=True)
    group_of = {int(true_ids[i]): int(group_ids[j]) for i, j in pairs if overlap[i, j] > 0}
    lookup = np.full(int(truth.max(initial=0)) + 1, -1, np.int32)
    lookup[list(group_of)] = list(group_of.values())
    verdicts = np.where(groups == lookup[np.maximum(truth, 0)], Verdict.RIGHT, Verdict.WRONG)
    verdicts = np.where(groups == 0, Verdict.MISSING, verdicts)
    return ErrorMap(np.where(inside, verdicts, Verdict.VOID).astype(np.uint8), group_of)
