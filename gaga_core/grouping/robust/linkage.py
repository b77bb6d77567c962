"""Clusters of points by average linkage over the views that show them in one mask.

Time and memory grow with the pairs of points that some view shows in one mask, not with the square
of the points: points of things far apart are never looked at together.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import (
    BoolArray,
    DoubleArray,
    IntArray,
    LongArray,
    UInt16Array,
    UInt32Array,
)
from gaga_core.grouping.robust import linkage_kernels as kernels
from gaga_core.kernels import run_chunks
from gaga_core.progress import Progress, Stage

_ROWS = 256  # points in one piece of work
_SLICE = 8192  # points between two chances to cancel
_MERGES = 256  # merges between two chances to cancel
MOST_POINTS = (1 << 17) - 1


@dataclass(frozen=True)
class LinkageRules:
    """When two clusters join."""

    agreement: float  # share of views, above 1/2: pairs that are never together stay apart
    min_views: float  # least views that see both, mean over their pairs
    doubt: float  # weight of the prior 1/2, in views

    def array(self) -> DoubleArray:
        """For the kernels (3,)."""
        return np.array([self.agreement, self.min_views, self.doubt])


def linkage_stage(
    mask_of: IntArray,  # (S, V) mask that each point shows in each view, 0 = unknown
    rules: LinkageRules,
    title: str,  # of the progress
) -> Stage[IntArray]:
    """Clusters (S,) 1.. of points, in the order of their first points.

    The two clusters that agree most join, as long as their agreement is above the threshold: the
    mean over all pairs of their points of the views that show both in one mask, over those that
    see both. Raises ``ValueError`` for more than `MOST_POINTS` points.
    """
    n = len(mask_of)
    if n > MOST_POINTS:
        raise ValueError(f"mask_of: at most {MOST_POINTS} points, got {n}")
    start, length, other, together = yield from _pairs(mask_of, title)
    # A merged list is no longer than both that it replaces: packed, all fit into the first part.
    room, end = len(other) + len(other) // 4 + n, np.array([len(other)])
    other = np.append(other, np.zeros(room - len(other), np.int32))
    together = np.append(together, np.zeros(room - len(together)))
    seen, size = _counts(mask_of > 0), np.ones(n)
    partner, score = np.full(n, -1, np.int32), np.full(n, -1.0)
    parent, numbers = np.arange(n, dtype=np.int32), rules.array()
    state = (start, length, other, together)

    def find(first: int, last: int) -> None:
        kernels.find_partners(first, last, *state, parent, seen, size, numbers, partner, score)

    run_chunks(find, n, _ROWS)
    tree = _maxima(score)
    n_merges = _MERGES
    while n_merges == _MERGES:
        left = int((size > 0).sum())
        yield Progress(title, 2 * n - left, 2 * n, f"{left} clusters")
        n_merges = kernels.merge_clusters(
            *state, end, parent, seen, size, numbers, partner, score, tree, _MERGES
        )
    return renumbered(_roots(parent))


def renumbered(cluster: IntArray) -> IntArray:
    """The same clusters (S,) as 1, 2, ... in the order of their first points."""
    _, first, inverse = np.unique(cluster, return_index=True, return_inverse=True)
    order = np.empty(len(first), np.int32)
    order[np.argsort(first)] = np.arange(1, len(first) + 1)
    result: IntArray = order[inverse]
    return result


def _pairs(
    mask_of: IntArray, title: str
) -> Stage[tuple[LongArray, LongArray, IntArray, DoubleArray]]:
    """Start (S,) and length (S,) of each point's list of pairs, the other points (P,) of these
    lists, and in how many views each pair is together (P,)."""
    n = len(mask_of)
    masks = mask_of.max(axis=0, initial=0).astype(np.int64) + 1
    first_row = np.cumsum(masks) - masks
    point, view = np.nonzero(mask_of)
    row = first_row[view] + mask_of[point, view]
    members = point[np.argsort(row, kind="stable")].astype(np.int32)
    row_start = np.append(0, np.cumsum(np.bincount(row, minlength=int(masks.sum()))))
    degree, pair_start = np.zeros(n, np.int64), np.zeros(n + 1, np.int64)
    other, together = np.zeros(0, np.int32), np.zeros(0)

    def work(begin: int, stop: int) -> None:
        kernels.list_pairs(
            mask_of,
            first_row,
            row_start,
            members,
            first + begin,
            first + stop,
            pair_start,
            degree,
            other,
            together,
        )

    for is_written in (False, True):
        if is_written:
            pair_start[1:] = np.cumsum(degree)
            other, together = np.empty(pair_start[-1], np.int32), np.empty(pair_start[-1])
            if len(other) == 0:
                break
        for first in range(0, n, _SLICE):
            yield Progress(title, (first + is_written * n) // 2, 2 * n, f"{n} points")
            run_chunks(work, min(_SLICE, n - first), _ROWS)
    return pair_start[:-1].copy(), degree, other, together


def _counts(seen: BoolArray) -> UInt16Array | UInt32Array:
    """``seen`` (S, V) as numbers whose sums over points fit."""
    few = int(seen.sum(axis=0).max(initial=0)) < 1 << 16
    return seen.astype(np.uint16) if few else seen.astype(np.uint32)


def _maxima(score: DoubleArray) -> DoubleArray:
    """The tree (2 L,) of maxima whose leaves are the scores (S,); entry 1 is its root."""
    leaves = 1 << max(0, len(score) - 1).bit_length()
    levels = [np.append(score, np.full(leaves - len(score), -1.0))]
    while len(levels[-1]) > 1:
        levels.append(levels[-1].reshape(-1, 2).max(axis=1))
    return np.concatenate([[-1.0], *reversed(levels)])


def _roots(parent: IntArray) -> IntArray:
    """The surviving cluster (S,) of each point."""
    root = parent
    while (root[root] != root).any():
        root = root[root]
    return root
