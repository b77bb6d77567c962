"""Selections that grow and shrink: by distance, and by likeness of identity."""

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, FloatArray, IntArray, check_shape
from gaga_core.kernels import n_threads
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import selectable, world_means

_SAMPLE = 2000  # splats whose spacing is measured
_STEP = 6  # neighbours that one step reaches


def spacing(scene: Scene, splats: IntArray) -> float:
    """How far a step of growing or shrinking these splats (K,) goes, world units.

    The median distance to the sixth neighbour among a sample; 0 for fewer than two places.
    """
    points = world_means(scene, splats)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 2:
        return 0.0
    asked = points[:: max(len(points) // _SAMPLE, 1)]
    k = min(_STEP + 1, len(points))
    distances, _ = cKDTree(points).query(asked, k=[k], workers=n_threads())
    return float(np.median(distances))


def grown(scene: Scene, splats: IntArray, reach: float) -> IntArray:
    """``splats`` (K,) and every splat that can be selected at most ``reach`` from one of them."""
    chosen = _mask(scene, splats)
    near = _near(scene, selectable(scene) & ~chosen, splats, reach)
    return np.union1d(splats, near).astype(np.int32)


def shrunk(scene: Scene, splats: IntArray, reach: float) -> IntArray:
    """``splats`` (K,) without those at most ``reach`` from a splat that is not among them.

    Only splats that are drawn count as outside: what lies at the border of the scene stays.
    """
    chosen = _mask(scene, splats)
    outside = np.flatnonzero(~chosen & ~scene.has(State.HIDDEN | State.DELETED)).astype(np.int32)
    edge = _near(scene, chosen, outside, reach)
    return np.setdiff1d(splats, edge).astype(np.int32)


def grown_by_identity(
    scene: Scene,
    splats: IntArray,
    encodings: FloatArray,  # (N, D)
    likeness: float,
    reach: float | None = None,
) -> IntArray:
    """``splats`` and those whose identity encoding is like theirs: cosine >= ``likeness``.

    Likeness to the mean direction of the selection's encodings; with ``reach`` only of splats that
    near. Encodings of no length are like nothing.
    """
    check_shape("encodings", encodings, (len(scene), "D"))
    close = _likeness(encodings, splats) >= likeness
    candidates = selectable(scene) & ~_mask(scene, splats) & close
    more = np.flatnonzero(candidates).astype(np.int32)
    if reach is not None:
        more = _near(scene, candidates, splats, reach)
    return np.union1d(splats, more).astype(np.int32)


def _likeness(encodings: FloatArray, splats: IntArray) -> FloatArray:
    """Cosine (N,) of each encoding to the mean direction of those of ``splats``."""
    length = np.linalg.norm(encodings, axis=1)
    own = encodings[splats] / np.maximum(length[splats], 1e-12)[:, None]
    mean = own.sum(axis=0)
    size = float(np.linalg.norm(mean))
    if size == 0:
        return np.full(len(encodings), -1, np.float32)
    cosine: FloatArray = encodings @ (mean / size) / np.maximum(length, 1e-12)
    cosine[length == 0] = -1
    return cosine


def _near(scene: Scene, asking: BoolArray, splats: IntArray, reach: float) -> IntArray:
    """The asking splats at most ``reach`` from one of ``splats``."""
    points = world_means(scene)
    own = points[splats]
    own = own[np.isfinite(own).all(axis=1)]
    if len(own) == 0 or reach <= 0:
        return np.zeros(0, np.int32)
    lo, hi = own.min(axis=0) - reach, own.max(axis=0) + reach
    asking = asking.copy()
    for axis in range(3):
        asking &= (points[:, axis] >= lo[axis]) & (points[:, axis] <= hi[axis])
    rows = np.flatnonzero(asking)
    tree = cKDTree(own, balanced_tree=False, compact_nodes=False)
    distance, _ = tree.query(points[rows], distance_upper_bound=reach * 1.0001, workers=n_threads())
    return rows[distance <= reach].astype(np.int32)


def _mask(scene: Scene, splats: IntArray) -> BoolArray:
    mask = np.zeros(len(scene), np.bool_)
    mask[splats] = True
    return mask
