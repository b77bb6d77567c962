"""Surfaces that a thing lies across: a table top under its runner, a floor under a carpet.

Both sides of the runner never touch, so no border says that they are one. They join where they lie
on one plane and have one color, and where what fills the whole gap between them is one thing that
lies on that plane and is smaller than they are together. Open air joins nothing, and neither do two
plates on a table: the table is lower than they are, and larger.
"""

from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.grouping.hierarchy.pieces import Neighbourhood
from gaga_core.grouping.hierarchy.surfels import Surfels

_LEAST = 0.002  # share of all samples that either side has on the plane
_UNLIKE = 5.0  # difference in CIE Lab (`hue_of`) from which on they are two surfaces
_WIDTH = 1.2  # times the least gap: how far apart opposite samples are at most
_ALONG = (0.25, 0.5, 0.75)  # of the way between them that are looked at
_COVERED = 0.8  # share of the ways that the thing covers
_HEIGHT = 0.1  # spacings that it lies above the plane, mean: less is the plane itself


def spanned(
    surfels: Surfels, near: Neighbourhood, plane: IntArray, color: DoubleArray, cluster: LongArray
) -> LongArray:
    """Dense ids (n,) of the clusters (S,) after surfaces that a thing lies across have joined.

    ``plane`` (S,) is the plane that each sample lies on, 0 = none; ``color`` (S, 3) CIE Lab as of
    `hue_of`.
    """
    n, pairs = int(cluster.max()) + 1, []
    for p in range(1, int(plane.max(initial=0)) + 1):
        rows = np.flatnonzero(plane == p)
        own = cluster[rows]
        large = np.flatnonzero(np.bincount(own) >= _LEAST * len(cluster))
        for one, other in combinations([rows[own == k] for k in large], 2):
            unlike = np.median(color[one], axis=0) - np.median(color[other], axis=0)
            if np.linalg.norm(unlike) > _UNLIKE:
                continue
            if _is_spanned(surfels, near, plane, cluster, one, other):
                pairs.append((cluster[one[0]], cluster[other[0]]))
    first, second = np.array(pairs, np.int64).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(pairs)), (first, second)), (n, n))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _is_spanned(
    surfels: Surfels,
    near: Neighbourhood,
    plane: IntArray,
    cluster: LongArray,
    one: LongArray,
    other: LongArray,
) -> bool:
    """Whether one smaller cluster fills the gap between samples (A,) and (B,) of one plane (S,),
    and lies on it."""
    points, both = surfels.points, np.concatenate([one, other])
    spacing = float(np.median(near.spacing[both]))
    found = cKDTree(points[other]).query(points[one])
    apart, opposite = np.asarray(found[0]), np.asarray(found[1], np.int64)
    facing = np.flatnonzero(apart <= _WIDTH * apart.min())
    start, way = points[one[facing]], points[other[opposite[facing]]] - points[one[facing]]
    places = np.concatenate([start + share * way for share in _ALONG])
    between = np.asarray(cKDTree(points).query(places)[1], np.int64)
    thing = int(np.bincount(cluster[between]).argmax())
    covers = (cluster[between] == thing) & (plane[between] == plane[one[0]])
    height = (points[between[covers]] - points[both].mean(axis=0)) @ _normal(surfels, both)
    if covers.mean() < _COVERED or height.mean() < _HEIGHT * spacing:
        return False
    return int(((cluster == thing) & (plane == plane[one[0]])).sum()) < len(both)


def _normal(surfels: Surfels, rows: LongArray) -> DoubleArray:
    """Unit normal (3,) of the plane through samples (K,), to the side that is seen."""
    points = surfels.points[rows]
    normal: DoubleArray = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    return normal if normal @ surfels.normals[rows].sum(axis=0) > 0 else -normal
