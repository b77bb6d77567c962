"""Where splats are: boxes that a few stray splats do not blow up."""

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray, check_shape
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means

_SAMPLE = 200_000  # splats looked at: percentiles of more would not differ

_WHOLE, _MUCH_LARGER = 0.996, 2.0


def robust_box(points: AnyArray, share: float = 0.9) -> tuple[DoubleArray, DoubleArray]:
    """Corners lo, hi (3,) of the box that holds the middle ``share`` of points (N, 3) per axis.

    Points that are not finite do not count; a unit box around the origin when none are left.
    """
    check_shape("points", points, ("N", 3))
    step = max(1, len(points) // _SAMPLE)
    sample = np.asarray(points[::step], np.float64)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) == 0:
        return np.full(3, -0.5), np.full(3, 0.5)
    tail = (1 - share) / 2 * 100
    lo, hi = np.percentile(sample, [tail, 100 - tail], axis=0)
    return lo, hi


def splat_box(
    scene: Scene, indices: IntArray | None = None, share: float = 0.9
) -> tuple[DoubleArray, DoubleArray]:
    """The robust box of splats (K,), placements applied; of all that are visible by default."""
    rows = np.flatnonzero(scene.visible).astype(np.int32) if indices is None else indices
    step = max(1, len(rows) // _SAMPLE)
    return robust_box(world_means(scene, rows[::step]), share)


def whole_box(scene: Scene) -> tuple[DoubleArray, DoubleArray]:
    """The box lo, hi (3,) of all visible splats but a few strays; `splat_box` where it would be
    much larger than that: the far background of a scene, not the whole of a thing."""
    near, whole = splat_box(scene), splat_box(scene, share=_WHOLE)
    sizes = [float(np.linalg.norm(hi - lo)) for lo, hi in (near, whole)]
    return whole if sizes[1] <= _MUCH_LARGER * sizes[0] else near
