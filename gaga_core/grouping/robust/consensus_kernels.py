"""Kernels of the view consensus: counts over pairs of points, and average linkage on them.

Exact arithmetic in a fixed order: the same points give the same groups on every machine.
"""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.kernels import exact_kernel


@exact_kernel
def count_pairs(
    mask_of: IntArray,  # (S, V) mask that each point shows in each view, 0 = unknown
    start: int,
    stop: int,
    together: FloatArray,  # (S, S) views in which both show in one mask; symmetric
    both: FloatArray,  # (S, S) views in which both show in some mask
) -> None:
    """Fill rows [start, stop) left of the diagonal, and the columns that mirror them."""
    n_views = mask_of.shape[1]
    for i in range(start, stop):
        for j in range(i):
            same, known = np.int32(0), np.int32(0)
            for v in range(n_views):
                a, b = mask_of[i, v], mask_of[j, v]
                seen = np.int32((a > 0) & (b > 0))
                known += seen
                same += seen & np.int32(a == b)
            together[i, j] = together[j, i] = same
            both[i, j] = both[j, i] = known


@exact_kernel
def agreement(
    together: FloatArray, both: FloatArray, size: DoubleArray, i: int, j: int, rules: DoubleArray
) -> float:
    """Mean share of views that show members of clusters i and j in one mask; -1 = not known.

    ``rules``: (3,) threshold, least number of views a pair, weight of the prior 1/2 in views.
    """
    pairs = size[i] * size[j]
    known = both[i, j] / pairs
    if known < rules[1]:
        return -1.0
    return float((together[i, j] / pairs + 0.5 * rules[2]) / (known + rules[2]))


@exact_kernel
def best_partner(
    together: FloatArray,  # (S, S) sums over pairs of members, like ``both``
    both: FloatArray,
    size: DoubleArray,  # (S,) members of each cluster, 0 = merged into another
    rules: DoubleArray,  # (3,)
    k: int,
    partner: IntArray,  # (S,) written at k
    score: DoubleArray,  # (S,) written at k
) -> None:
    """The cluster that k agrees with most, the first one on a tie."""
    partner[k], score[k] = -1, -1.0
    for other in range(len(size)):
        if size[other] > 0 and other != k:
            value = agreement(together, both, size, k, other, rules)
            if value > score[k]:
                partner[k], score[k] = other, value


@exact_kernel
def find_partners(
    together: FloatArray,
    both: FloatArray,
    size: DoubleArray,
    rules: DoubleArray,
    start: int,
    stop: int,
    partner: IntArray,
    score: DoubleArray,
) -> None:
    """`best_partner` of clusters [start, stop)."""
    for k in range(start, stop):
        best_partner(together, both, size, rules, k, partner, score)


@exact_kernel
def merge_clusters(
    together: FloatArray,  # (S, S) changed in place, like all that follow
    both: FloatArray,
    size: DoubleArray,  # (S,)
    rules: DoubleArray,  # (3,) only read
    partner: IntArray,  # (S,)
    score: DoubleArray,  # (S,)
    parent: IntArray,  # (S,) the cluster that each one was merged into, or itself
    max_merges: int,
) -> int:
    """Merge the two clusters that agree most, again and again; returns how many times.

    Fewer than ``max_merges`` means that no pair is above the threshold any more. Sums over pairs
    of members add up when clusters merge, so the agreement stays a mean weighted by evidence.
    """
    n = len(size)
    for done in range(max_merges):
        i, top = -1, rules[0]
        for k in range(n):
            if size[k] > 0 and score[k] > top:
                i, top = k, score[k]
        if i < 0:
            return done
        j = partner[i]
        i, j = min(i, j), max(i, j)
        for k in range(n):
            together[i, k] += together[j, k]
            together[k, i] = together[i, k]
            both[i, k] += both[j, k]
            both[k, i] = both[i, k]
        size[i] += size[j]
        size[j], score[j], parent[j] = 0.0, -1.0, i
        for k in range(n):
            if size[k] == 0:
                continue
            if k == i or partner[k] == i or partner[k] == j:
                best_partner(together, both, size, rules, k, partner, score)
            else:
                value = agreement(together, both, size, k, i, rules)
                if value > score[k]:
                    partner[k], score[k] = i, value
    return max_merges
