"""Selections that grow and shrink: by distance, and by likeness of identity."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, FloatArray, IntArray, check_shape
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import selectable, world_means
from gaga_core.scene.selection.bounds import within
from gaga_core.threads import n_threads

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
    length = np.linalg.norm(encodings, axis=1)
    own = encodings[splats] / np.maximum(length[splats], 1e-12)[:, None]
    mean = own.sum(axis=0)
    size = float(np.linalg.norm(mean))
    cosine = encodings @ (mean / max(size, 1e-12)) / np.maximum(length, 1e-12)
    close = np.where((length == 0) | (size == 0), -1, cosine) >= likeness
    candidates = selectable(scene) & ~_mask(scene, splats) & close
    more = np.flatnonzero(candidates).astype(np.int32)
    if reach is not None:
        more = _near(scene, candidates, splats, reach)
    return np.union1d(splats, more).astype(np.int32)


def _near(scene: Scene, asking: BoolArray, splats: IntArray, reach: float) -> IntArray:
    """The asking splats at most ``reach`` from one of ``splats``."""
    points = world_means(scene)
    own = points[splats]
    own = own[np.isfinite(own).all(axis=1)]
    if len(own) == 0 or reach <= 0:
        return np.zeros(0, np.int32)
    lo, hi = own.min(axis=0) - reach, own.max(axis=0) + reach
    rows = np.flatnonzero(asking & within(points, lo, hi))
    tree = cKDTree(own, balanced_tree=False, compact_nodes=False)
    distance, _ = tree.query(points[rows], distance_upper_bound=reach * 1.0001, workers=n_threads())
    return rows[distance <= reach].astype(np.int32)


def _mask(scene: Scene, splats: IntArray) -> BoolArray:
    mask = np.zeros(len(scene), np.bool_)
    mask[splats] = True
    return mask


# --- Connected components of a set of splats, and isolated splats.


_LINK = 4.0  # splats this many spacings apart still belong together
_NEIGHBOURS = 8  # links looked at from each splat
_SIGMAS = 4.0
_EVEN = 0.1  # least deviation, so that a perfectly even grid has no floaters
_OUTLIER = 8  # neighbours whose distance says whether a splat floats


def components_of(scene: Scene, splats: IntArray, least: int = 50) -> tuple[IntArray, ...]:
    """``splats`` (K,) divided into connected components; the largest first.

    Parts of fewer than ``least`` splats go with the part that is nearest to them. Splats touch when
    they are among each other's eight nearest and at most four `spacing`s apart.
    """
    if len(splats) == 0:
        return ()
    points = world_means(scene, splats).astype(np.float64)
    points[~np.isfinite(points).all(axis=1)] = 0
    reach = _LINK * max(spacing(scene, splats), 1e-12)
    k = min(_NEIGHBOURS + 1, len(splats))
    tree = cKDTree(points)
    found = tree.query(points, k=k, workers=n_threads(), distance_upper_bound=reach)
    far, near = (np.asarray(table).reshape(len(points), k) for table in found)
    start = np.repeat(np.arange(len(points)), k)
    linked = np.isfinite(far).ravel()
    graph = coo_matrix(
        (np.ones(int(linked.sum()), np.int8), (start[linked], near.ravel()[linked])),
        shape=(len(points), len(points)),
    )
    _, part = connected_components(graph, directed=False)
    size = np.bincount(part)
    large = size >= min(least, int(size.max()))
    if not large.all():
        small = ~large[part]
        _, at = cKDTree(points[~small]).query(points[small], workers=n_threads())
        part[small] = part[~small][at]
    order = np.argsort(-np.bincount(part, minlength=len(size)), kind="stable")
    return tuple(splats[part == p] for p in order if large[p])


def floaters(scene: Scene, splats: IntArray, strength: float = 1.0) -> IntArray:
    """The splats (F,) among ``splats`` (K,) that are isolated: statistical outlier removal.

    The logarithm of their mean distance to eight neighbours lies more than ``4 / strength``
    deviations above the median of all; after Rusu et al. 2008 (Towards 3D point cloud based object
    maps), in logarithms and robust, so that far floaters do not hide near ones.
    Raises ``ValueError`` for a strength that is not positive.
    """
    if not strength > 0:
        raise ValueError(f"strength: expected a positive number, got {strength}")
    points = world_means(scene, splats)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1))
    if len(rows) <= _OUTLIER:
        return np.zeros(0, np.int32)
    points = points[rows]
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    far = np.asarray(tree.query(points, k=_OUTLIER + 1, workers=n_threads())[0])
    logs = np.log(np.maximum(far[:, 1:].mean(axis=1), 1e-12))
    middle = float(np.median(logs))
    # The spread of the nearer half, mirrored: floaters themselves do not widen it.
    spread = 1.4826 * float(np.median(middle - logs[logs <= middle]))
    alone = logs > middle + _SIGMAS / strength * max(spread, _EVEN)
    return splats[rows[alone]].astype(np.int32)
