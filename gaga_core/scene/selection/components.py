"""Connected components of a set of splats, and isolated splats."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gaga_core.arrays import IntArray
from gaga_core.kernels import n_threads
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.neighbourhood import spacing

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
    """The splats (F,) among ``splats`` (K,) that stand alone: statistical outlier removal.

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
    chosen: IntArray = splats[rows[alone]].astype(np.int32)
    return chosen
