"""What surrounds the scene: walls, floors, shrubs, the sky.

Photos of objects look at them from around: things of interest are seen whole in most views. What
lies outside of the ring of cameras and is cut by the borders of the pictures, or is seen in few
views, is background. Where views look outwards or along a way, nothing is.
"""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.hierarchy.surfels import Surfels

_AROUND = 0.15  # most sine between the views' axes and the way to their focus; half are less
_IN_FRONT = 0.3  # least way to the focus, of the distance of the cameras
_OUTSIDE, _AT_EDGE = 1.0, 0.7  # distances from the focus, of that of the cameras
_CUT, _ALWAYS_CUT = 0.5, 0.75  # shares of the views of a cluster that cut it
_RARE = 0.3  # share of all views
_MARGIN = 0.03  # of the longer side of a view: its border
_AT_BORDER = 0.03  # share of the samples in a view that must lie at its border
_SHOWN = 3  # samples of a cluster that a view must show


def is_background(surfels: Surfels, views: Sequence[Camera], cluster: LongArray) -> BoolArray:
    """Which clusters (n,) of samples (S,) are background."""
    n = int(cluster.max()) + 1
    focus, radius = _focus(views)
    if radius == 0:
        return np.zeros(n, np.bool_)
    distance = np.linalg.norm(surfels.points - focus, axis=1) / radius
    order = np.lexsort((distance, cluster))
    count = np.bincount(cluster, minlength=n)
    start = np.cumsum(count) - count
    away = distance[order[start + count // 2]]
    cut, seen = _cut_views(surfels, views, cluster, n)
    rare = seen < _RARE * len(views)
    far = (away > _OUTSIDE) & ((cut > _CUT) | rare)
    result: BoolArray = far | ((away > _AT_EDGE) & (rare | (cut > _ALWAYS_CUT)))
    return result


def _focus(views: Sequence[Camera]) -> tuple[DoubleArray, float]:
    """The point (3,) that the views look at from around and their median distance from it, 0 when
    there is none."""
    positions = np.array([camera.position for camera in views])
    axes = np.array([camera.forward for camera in views])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    focus = np.linalg.lstsq(
        across.sum(axis=0), np.einsum("vij,vj->i", across, positions), rcond=None
    )[0]
    way = focus - positions
    distance = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    radius = float(np.median(distance))
    missed = np.median(np.linalg.norm(np.cross(axes, way), axis=1) / distance)
    in_front = np.median((way * axes).sum(axis=1))
    looks_around = missed <= _AROUND and in_front >= _IN_FRONT * radius
    return focus, radius if looks_around else 0.0


def _cut_views(
    surfels: Surfels, views: Sequence[Camera], cluster: LongArray, n: int
) -> tuple[DoubleArray, DoubleArray]:
    """Share (n,) of the views that cut each cluster among those that show it, and their number."""
    cut, seen = np.zeros(n), np.zeros(n)
    for v, camera in enumerate(views):
        rows = np.flatnonzero(surfels.regions[:, v])
        pixels = camera.project(surfels.points[rows])[0]
        size = np.array([camera.width, camera.height])
        margin = _MARGIN * size.max()
        outer = ((pixels < margin) | (pixels > size - margin)).any(axis=1)
        count = np.bincount(cluster[rows], minlength=n)
        at_border = np.bincount(cluster[rows[outer]], minlength=n)
        shown = count >= _SHOWN
        seen += shown
        cut += shown & (at_border >= np.maximum(1, _AT_BORDER * count))
    return cut / np.maximum(seen, 1), seen
