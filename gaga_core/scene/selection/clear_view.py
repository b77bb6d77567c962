"""Which side is open: a room without photos is looked into, not at its back, and an object that was
found is not looked at through another one."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import turned
from gaga_core.scene.frame import scale_of
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means

_SAMPLE = 50_000  # splats that are sampled
_SEEN = 0.3  # opacity from which on a splat shows a surface
_CORE = 0.6  # share of the sides of a scene's box that is its middle: no walls
_CELLS = 64  # cells across a view in which surfaces hide each other
_LARGEST = 3  # cells: radius of a splat up to which it is drawn in cells of this size
_LEVELS = 4  # sizes of cells, each twice the one before, for larger splats
_BEHIND = 0.02  # of the view's distance: what is so little behind a surface is part of it
_CLEARER = 0.05  # share of all splats that another view has to show more of in the middle
_HIDDEN = 0.5  # share of what the best view shows: the first is left where it shows less


def clearest_view(
    scene: Scene, box: tuple[DoubleArray, DoubleArray], views: Sequence[Camera]
) -> tuple[int, float]:
    """Number of the view that shows the most of the middle of the box lo, hi (3,): the first,
    unless another one shows twice as much of it, or more by a twentieth of all splats; and the
    share of the middle's splats that it shows.

    Splats are sampled; each hides what lies behind it in the cells of a view that it covers. Where
    the whole scene was moved to counts, not what was done to its parts.
    """
    gaussians, world = scene.gaussians, scene.frame.world
    opaque = np.flatnonzero(gaussians.opacities >= _SEEN)
    rows = opaque[:: max(1, len(opaque) // _SAMPLE)]
    means = turned(gaussians.means[rows].astype(np.float64), world[:3, :3]) + world[:3, 3]
    rows, means = rows[np.isfinite(means).all(axis=1)], means[np.isfinite(means).all(axis=1)]
    if len(rows) == 0:
        return 0, 1.0
    middle, half = (box[0] + box[1]) / 2, _CORE * (box[1] - box[0]) / 2
    is_core: BoolArray = np.logical_and.reduce(np.abs(means - middle) <= half, axis=1)
    sizes = scale_of(world) * _sizes(gaussians, rows, len(opaque))
    shown = [_n_shown(means, sizes, is_core, view.at_most(_CELLS)) for view in views]
    best = int(np.argmax(shown))
    is_hidden = shown[0] < _HIDDEN * shown[best]
    best = best if is_hidden or shown[best] - shown[0] > _CLEARER * len(rows) else 0
    return best, shown[best] / max(int(is_core.sum()), 1)


def clearest_view_of(scene: Scene, indices: IntArray, views: Sequence[Camera]) -> int:
    """Number of the view that shows the most of the visible splats ``indices`` (K,): the first, if
    it shows at least half as much. What is hidden or deleted hides nothing."""
    splats = scene.gaussians
    is_opaque = scene.visible & (splats.opacities >= _SEEN)
    is_of = np.zeros(len(scene), bool)
    is_of[indices] = True
    sampled, sizes = list[IntArray](), list[DoubleArray]()
    for part in (is_of, ~is_of):
        opaque = np.flatnonzero(part & is_opaque).astype(np.int32)
        rows = opaque[:: max(1, len(opaque) // _SAMPLE)]
        sampled.append(rows)
        sizes.append(_sizes(splats, rows, len(opaque)))
    rows = np.concatenate(sampled)
    means = world_means(scene, rows).astype(np.float64)
    scale = scale_of(scene.frame.world)
    wide = scale * np.concatenate(sizes)
    shown = [_n_shown(means, wide, is_of[rows], view.at_most(_CELLS)) for view in views]
    best = int(np.argmax(shown))
    return best if shown[0] < _HIDDEN * shown[best] else 0


def _sizes(splats: Gaussians, rows: IntArray | LongArray, n: int) -> DoubleArray:
    """Middle standard deviations (K,) of a sample of ``n`` splats: fewer have to be larger to be as
    dense."""
    middle = np.sort(splats.log_scales[rows], axis=1)[:, 1].astype(np.float64)
    return np.exp(middle) * np.sqrt(max(1.0, n / max(len(rows), 1)))


def _n_shown(means: DoubleArray, sizes: DoubleArray, is_core: BoolArray, view: Camera) -> int:
    """How many of the core's splats nothing hides in a view."""
    pixels, depths = view.project(means)
    inside = np.flatnonzero(view.shows(pixels, depths))
    u, v = pixels[inside].astype(np.int64).T
    depth = depths[inside]
    radius = sizes[inside] * view.K[0, 0] / depth
    nearest = np.full((view.height, view.width), np.inf)
    for level in range(_LEVELS):  # the larger a splat, the coarser the cells that it covers
        times = 2**level
        most = _LARGEST * times if level < _LEVELS - 1 else np.inf
        own = (radius <= most) & (radius > (_LARGEST * times / 2 if level else -1))
        covered = _nearest(u[own] // times, v[own] // times, depth[own], radius[own] / times, view)
        whole = covered.repeat(times, axis=0).repeat(times, axis=1)
        np.minimum(nearest, whole[: view.height, : view.width], out=nearest)
    middle = float(np.median(depth)) if len(depth) else 0.0
    return int((is_core[inside] & (depth <= nearest[v, u] + _BEHIND * middle)).sum())


def _nearest(
    u: LongArray, v: LongArray, depth: DoubleArray, radius: DoubleArray, view: Camera
) -> DoubleArray:
    """Depth (H, W) of the nearest of some splats (K,) in the cells that each covers."""
    nearest = np.full((view.height, view.width), np.inf)
    reach = np.arange(-_LARGEST, _LARGEST + 1)
    for dv in reach:
        for du in reach:
            y, x = v + dv, u + du
            on = (np.minimum(radius, _LARGEST) >= np.hypot(du, dv)) & (x >= 0) & (y >= 0)
            on &= (x < view.width) & (y < view.height)
            np.minimum.at(nearest, (y[on], x[on]), depth[on])
    return nearest
