"""Things whose parts nothing holds up but one another: leaves, blossoms, the back of a chair.

What lies or stands on a plane touches it all around its foot. A part that does not, and that only
touches others of the kind, cannot be a thing of its own where all of them together are held by a
border that is short for their size. Fruit in a bowl or a box on a box have longer borders. A part
that hardly a view shows may well stand on something: it holds together with others of that kind
only, as the pot of a plant does, but not with the leaves over it.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.grouping.hierarchy.pieces import Neighbourhood, outlines

_SUPPORT_AREA = 0.01  # share of the area of all samples of a plane to stand on
_IN_PLANE = 0.3  # share of its samples that makes a cluster a part of such a plane
_FOOT = 0.25  # share of its outline that a thing has in common at least with what it stands on
_HELD = 1.5  # ... that parts have in common with what holds them, below which they are one thing
_SEEN = 0.12  # share of the views that show a sample, mean: less says nothing of the foot
_MOST = 0.05  # share of all samples: larger ones are the ground or the subject, not a hanging part


def held_together(
    near: Neighbourhood, plane: IntArray, cluster: LongArray, shown: DoubleArray
) -> LongArray:
    """Dense ids (n,) of the clusters (S,) after parts that hold each other up have joined.

    ``plane`` (S,) is the plane that each sample lies on, 0 = none; ``shown`` (S,) the share of the
    views that see it.
    """
    n = int(cluster.max()) + 1
    apart = cluster[near.first] != cluster[near.second]
    a, b = near.first[apart], near.second[apart]
    one, other = cluster[a], cluster[b]
    stands = _standing(near, plane, cluster, a, b)
    rare = np.bincount(cluster, shown) < _SEEN * np.bincount(cluster)
    links = ~stands[one] & ~stands[other] & (rare[one] == rare[other])
    ones = np.ones(int(links.sum()), np.int8)
    graph = coo_matrix((ones, (one[links], other[links])), shape=(n, n))
    part = connected_components(graph, directed=False)[1].astype(np.int64)
    outer = part[one] != part[other]
    size = np.bincount(part[cluster], minlength=n)
    held = np.bincount(part[np.concatenate([one[outer], other[outer]])], minlength=n)
    joins = (held > 0) & (held < _HELD * outlines(size))
    joins &= size < _MOST * len(cluster)
    ids = np.where(joins[part], part, n + np.arange(n))
    return np.unique(ids, return_inverse=True)[1].astype(np.int64)


def _standing(
    near: Neighbourhood, plane: IntArray, cluster: LongArray, a: LongArray, b: LongArray
) -> BoolArray:
    """Which clusters (n,) are a part of a large plane, or touch one at edges (B,) along a foot."""
    n = int(cluster.max()) + 1
    area = np.bincount(plane, near.spacing**2)
    large = area > _SUPPORT_AREA * area.sum()
    large[0] = False
    foot = np.zeros(n)
    for thing, below in ((a, b), (b, a)):
        on = large[plane[below]] & (plane[thing] != plane[below])
        foot += np.bincount(cluster[thing[on]], minlength=n)
    size = np.bincount(cluster, minlength=n)
    flat = np.bincount(cluster, large[plane], n) > _IN_PLANE * size
    result: BoolArray = flat | (foot >= _FOOT * outlines(size))
    return result
