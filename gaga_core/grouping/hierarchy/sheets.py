"""Large planes: what other things stand on, found first so that noise does not break it to pieces.

Planes are sought from single samples outwards, not from three points of the whole scene, so shelves
and seats are found like floors.
"""

import numpy as np
from scipy.sparse.csgraph import connected_components

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.grouping.hierarchy.pieces import Neighbourhood
from gaga_core.grouping.hierarchy.surfels import Surfels

_FLAT = 0.6  # length of the mean normal around a sample that may be part of a plane
_AWAY = 1.5  # times the spacing around: distance from the plane of a sample on it
_TURNED = np.cos(np.radians(30.0))  # cosine between normals of the plane and of a sample on it
_TRIED, _PROBED = 150, 8000  # planes tried at a time, and samples counted for each
_FITTED, _FITS = 6, 4  # best ones that are fitted, and how often
_LEAST = 150  # samples of a plane
_MOST = 24  # planes
_MISSES = 3  # searches in vain that end it
_FIT_POINTS = 3000


def planes_of(surfels: Surfels, near: Neighbourhood) -> IntArray:
    """The plane (S,) that each sample lies on, ids from 1 in the order found, large ones first;
    0 = none. A plane hangs together."""
    points = surfels.points
    mean = surfels.normals + surfels.normals[near.around].mean(axis=1)
    length = np.linalg.norm(mean, axis=1)
    normals = mean / np.maximum(length, 1e-9)[:, None]
    free = length > 2 * _FLAT
    plane, n_planes, n_misses = np.zeros(len(points), np.int32), 0, 0
    rng = np.random.default_rng(0)
    while n_planes < _MOST and n_misses < _MISSES and int(free.sum()) >= _LEAST:
        rows = np.flatnonzero(free)
        best, most = np.zeros(0, np.int64), 0.0
        for seed in _promising(points, normals, near.spacing, rows, rng):
            found = _grown(points, normals, near, free, seed)
            area = float((near.spacing[found] ** 2).sum())
            if area > most:
                best, most = found, area
        if len(best) == 0:
            n_misses += 1
            continue
        n_planes += 1
        plane[best], free[best] = n_planes, False
    return plane


def _promising(
    points: DoubleArray,
    normals: DoubleArray,
    spacing: DoubleArray,
    rows: LongArray,
    rng: np.random.Generator,
) -> LongArray:
    """Samples whose tangent planes hold most others of ``rows``, best first."""
    probe = rows[rng.integers(0, len(rows), min(len(rows), _PROBED))]
    tried = rng.choice(rows, min(_TRIED, len(rows)), replace=False)
    away = points[probe] @ normals[tried].T - (points[tried] * normals[tried]).sum(axis=1)
    on = np.abs(away) < _AWAY * spacing[probe][:, None]
    on &= normals[probe] @ normals[tried].T > _TURNED
    result: LongArray = tried[np.argsort(-on.sum(axis=0), kind="stable")[:_FITTED]]
    return result


def _grown(
    points: DoubleArray, normals: DoubleArray, near: Neighbourhood, free: BoolArray, seed: int
) -> LongArray:
    """Samples of the plane through a seed after some fits; none if it is too small."""
    origin, normal = points[seed], normals[seed]
    found = np.zeros(0, np.int64)
    for _ in range(_FITS):
        on = free & (np.abs((points - origin) @ normal) < _AWAY * near.spacing)
        rows = np.flatnonzero(on & (normals @ normal > _TURNED))
        if len(rows) < _LEAST:
            return np.zeros(0, np.int64)
        part = connected_components(near.adjacency(rows), directed=False)[1]
        found = rows[part == np.bincount(part, near.spacing[rows] ** 2).argmax()]
        if len(found) < _LEAST:
            return np.zeros(0, np.int64)
        origin = points[found].mean(axis=0)
        some = points[found[:: max(1, len(found) // _FIT_POINTS)]] - origin
        fitted = np.linalg.svd(some, full_matrices=False)[2][2]
        normal = fitted if fitted @ normal > 0 else -fitted
    return found
