"""Objects that are two things: an orange and the half of a drill that it touches.

Evidence is a mean over a border, and the small pieces of two things that touch may straddle it, so
that each later join looks right. The object that comes out does not: views show a part of it and
the rest as one region each, and both together as none, and the two meet in a narrow neck. A neck is
asked for because regions part stripes of paint as well, which meet along their whole length.
"""

import numpy as np
from scipy.sparse import csr_matrix, vstack

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.grouping.hierarchy.enclosed import shown_whole
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, outlines
from gaga_core.grouping.hierarchy.surfels import Surfels

_WHOLE = 0.62  # mean IoU of both sides with the best region of each view ...
_BETTER = 0.05  # ... by which they are better than together
_NECK = 2.0  # outlines of the smaller side along which both touch, at most


def divided(
    surfels: Surfels,
    near: Neighbourhood,
    cluster: LongArray,
    parts: list[LongArray],
    shown: DoubleArray,
    least_size: float,
) -> LongArray:
    """Dense ids (S,) of the clusters (S,) after those that are two things have been divided, each
    once.

    ``parts`` are levels (S,) that refine the clusters, fine to coarse, ``shown`` (S,) is how much
    each sample counts for the size of a thing, which is ``least_size`` at least.
    """
    leaf, levels, n = parts[0], [cluster, *parts], int(cluster.max()) + 1
    members = vstack([_members(level, leaf) for level in levels], format="csr")
    inside = np.concatenate([_coarser_of(level, cluster) for level in levels])
    whole = shown_whole(surfels, leaf, members)  # of the clusters, then of all parts
    count, size = members @ np.bincount(leaf), members @ np.bincount(leaf, shown)
    outline = outlines(np.minimum(count, count[inside] - count))
    neck = np.concatenate([_necks(near, cluster, level) for level in levels])
    asked = (whole > _WHOLE) & (whole > whole[inside] + _BETTER) & (neck < _NECK * outline)
    found = np.flatnonzero(asked & (np.minimum(size, size[inside] - size) >= least_size))
    if len(found) == 0:
        return cluster
    rests = members[inside[found]] - members[found]
    rests.eliminate_zeros()
    least = np.minimum(whole[found], shown_whole(surfels, leaf, rests))
    better = least - whole[inside[found]]
    side = cluster.copy()
    for k in np.argsort(better):  # the best of each cluster last
        if least[k] > _WHOLE and better[k] > _BETTER:
            own = inside[found[k]]
            side[cluster == own] = own
            side[np.isin(leaf, members[found[k]].indices)] = n + own
    return np.unique(side, return_inverse=True)[1].astype(np.int64)


def _coarser_of(level: LongArray, coarser: LongArray) -> LongArray:
    """The cluster (n,) at a ``coarser`` level (S,) of each one at a ``level`` (S,)."""
    result = np.zeros(int(level.max()) + 1, np.int64)
    result[level] = coarser
    return result


def _members(level: LongArray, leaf: LongArray) -> csr_matrix:
    """Which leaves (n, m) each cluster of a level (S,) consists of."""
    of_leaf = _coarser_of(leaf, level)
    return csr_matrix((np.ones(len(of_leaf)), (of_leaf, np.arange(len(of_leaf)))))


def _necks(near: Neighbourhood, cluster: LongArray, part: LongArray) -> LongArray:
    """Edges (n,) from each part (S,) to others in its cluster (S,)."""
    a, b = near.first, near.second
    across = (part[a] != part[b]) & (cluster[a] == cluster[b])
    ends = np.concatenate([part[a[across]], part[b[across]]])
    return np.bincount(ends, minlength=int(part.max()) + 1).astype(np.int64)
