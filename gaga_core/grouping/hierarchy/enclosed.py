"""Thin things on a surface: a clock on a wall, a saucer on a tray.

The crease around them is hardly more than noise, so the mean over their border joins them to what
they lie on, or they lie so far out that they count as background. A part that one other cluster
encloses stays apart where the views show it whole as one region, with nothing else in it. A print
has mostly joined before parts are asked, as pieces of an even surface do; where nearly all views
show it whole it is such a part, as nothing tells it from a flat thing.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, identity

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.hierarchy.background import is_background
from gaga_core.grouping.hierarchy.linkage import Clusters
from gaga_core.grouping.hierarchy.pieces import Neighbourhood
from gaga_core.grouping.hierarchy.surfels import Surfels

_ENCLOSED = 0.75  # share of its outline along which one other cluster encloses a thing ...
_LARGER = 4.0  # ... that is at least so many times larger
_SEEN = 0.1  # share of the views that show a sample of it, mean
_WHOLE = 0.7  # mean IoU with the best region of each view


def is_enclosed_thing(
    surfels: Surfels, near: Neighbourhood, now: Clusters, least_size: float
) -> BoolArray:
    """Which clusters (n,) of ``least_size`` at least are enclosed things."""
    seen = _SEEN * np.bincount(now.cluster)
    found: BoolArray = now.graph.size >= np.maximum(seen, least_size)
    found &= _is_enclosed(near, now.cluster)
    if found.any():
        one_each = identity(len(found), format="csr")[found]
        found[found] = shown_whole(surfels, now.cluster, one_each) > _WHOLE
    return found


def keep_enclosed(
    surfels: Surfels, near: Neighbourhood, now: Clusters, least_size: float
) -> Clusters:
    """The same clusters, with nothing that speaks for joining an enclosed thing to another."""
    found = is_enclosed_thing(surfels, near, now, least_size)
    graph = now.graph
    evidence = np.where(found[graph.first] | found[graph.second], -np.inf, graph.evidence)
    return replace(now, graph=replace(graph, evidence=evidence))


def is_outside(
    surfels: Surfels,
    near: Neighbourhood,
    views: Sequence[Camera],
    now: Clusters,
    least_size: float,
) -> BoolArray:
    """Which clusters (n,) are background, enclosed things left out: a clock is no part of a wall,
    however far away it hangs."""
    outside = is_background(surfels, views, now.cluster)
    if outside.any():
        outside &= ~is_enclosed_thing(surfels, near, now, least_size)
    return outside


def _is_enclosed(near: Neighbourhood, cluster: LongArray) -> BoolArray:
    """Which clusters (n,) of samples (S,) have most of their outline with one that is larger."""
    size = np.bincount(cluster)
    n = len(size)
    a, b = cluster[near.first], cluster[near.second]
    one, other = np.concatenate([a, b]), np.concatenate([b, a])
    apart = one != other
    key, length = np.unique(one[apart] * n + other[apart], return_counts=True)
    outline = np.bincount(key // n, length, n)
    most = (size[key % n] >= _LARGER * size[key // n]) & (length >= _ENCLOSED * outline[key // n])
    result: BoolArray = np.bincount(key[most] // n, minlength=n) > 0
    return result


def shown_whole(surfels: Surfels, cluster: LongArray, sets: csr_matrix) -> DoubleArray:
    """Mean IoU (K,) of the samples of sets (K, n) of clusters (S,) with the region of each view
    that fits best, at any level of detail; views count by the samples that they show."""
    n_sets, n = sets.shape
    own = np.bincount(sets.indices, minlength=n)[cluster] > 0
    total, weight = np.zeros(n_sets), np.zeros(n_sets)
    for v in range(surfels.regions.shape[1]):
        best, seen = np.zeros(n_sets), np.zeros(n_sets)
        for region in surfels.maps_of(v).T:
            rows = np.flatnonzero(own & (region > 0))
            area = np.bincount(region)
            table = coo_matrix((np.ones(len(rows)), (cluster[rows], region[rows])), (n, len(area)))
            common = (sets @ table.tocsr()).tocoo()
            seen = np.asarray(common.sum(axis=1), np.float64).ravel()
            iou = common.data / (seen[common.row] + area[common.col] - common.data)
            np.maximum.at(best, common.row, iou)
        total += best * seen
        weight += seen
    result: DoubleArray = total / np.maximum(weight, 1)
    return result
