"""A free place next to objects, on what they stand on: where their copies go."""

from collections.abc import Iterator

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means
from gaga_core.scene.selection.bounds import robust_box

Box = tuple[DoubleArray, DoubleArray]  # lo, hi (3,): sideways, across and up

_SHARE = 0.98  # of the splats along each axis, as in `object_box`
_NEAR = 0.1  # of a box's diagonal: what is so near its lower side is what it stands on
_CELLS = 3  # along each side of a footprint; over more than half of them there is support


def step_to_free_place(
    scene: Scene, splats: IntArray, sideways: DoubleArray, up: DoubleArray
) -> DoubleArray | None:
    """The shortest step (3,), world, of splats (K,) by their own extent to a place that is free.

    Along ``sideways`` (3,) or horizontally across it, there or back, with the same thing below as
    now. None when there is no such place.
    """
    right = sideways - (sideways @ up) * up
    if len(splats) == 0 or np.linalg.norm(right) < 0.5:  # a picture that lies on its side
        return None
    right = right / np.linalg.norm(right)
    axes = np.column_stack([right, np.cross(up, right), up])
    own = robust_box(world_means(scene, splats) @ axes, _SHARE)
    is_other = scene.visible.copy()
    is_other[splats] = False
    rows = np.flatnonzero(is_other).astype(np.int32)
    if len(rows) == 0:
        return None
    points, labels = (world_means(scene, rows) @ axes).astype(np.float32), scene.labels[rows]
    diagonal = max(float(np.linalg.norm(own[1] - own[0])), 1e-12)
    heights = (points[:, 2] - own[0][2]) / (_NEAR * diagonal)
    support = _support(points, labels, heights, own)
    carrying = points[(np.abs(heights) <= 1) & (labels == support)][:, :2]
    mine = {*np.unique(scene.labels[splats]).tolist(), support, 0}
    others = [box for group, box in _boxes(points, labels) if group not in mine]
    size = own[1] - own[0]
    for axis, sign in sorted(
        ((i, s) for i in (0, 1) for s in (1, -1)), key=lambda way: size[way[0]]
    ):
        by = np.zeros(3)
        by[axis] = sign * size[axis]
        moved = own[0] + by, own[1] + by
        is_free = not any(_overlap(moved, box) for box in others)
        if is_free and (support is None or _is_carried(carrying, moved)):
            step: DoubleArray = axes @ by
            return step
    return None


def _support(points: FloatArray, labels: IntArray, heights: FloatArray, box: Box) -> int | None:
    """Group of most points (N, 3) under the box and around it; None when there is none.

    ``heights`` (N,) over its lower side: within 1 is at it. Around it too: photos do not see what
    is below an object. What stands there as well has more points above than there.
    """
    lo, hi = box[0][:2], box[1][:2]
    around = (hi - lo) / 2
    is_near = ((points[:, :2] >= lo - around) & (points[:, :2] <= hi + around)).all(axis=1)
    n_groups = int(labels.max(initial=0)) + 1
    n_at = np.bincount(labels[is_near & (np.abs(heights) <= 1)], minlength=n_groups)
    n_above = np.bincount(labels[is_near & (heights > 1)], minlength=n_groups)
    n_at[n_at <= n_above] = 0
    return int(n_at.argmax()) if n_at.any() else None


def _is_carried(carrying: FloatArray, box: Box) -> bool:
    """Whether points (M, 2) lie under more than half of the box's lower side."""
    lo, hi = box[0][:2], box[1][:2]
    cells = np.floor((carrying - lo) / np.maximum(hi - lo, 1e-12) * _CELLS)
    inside = cells[((cells >= 0) & (cells < _CELLS)).all(axis=1)]
    return 2 * len(np.unique(inside, axis=0)) > _CELLS**2


def _boxes(points: FloatArray, labels: IntArray) -> Iterator[tuple[int, Box]]:
    order = np.argsort(labels, kind="stable")
    groups, starts = np.unique(labels[order], return_index=True)
    for group, rows in zip(groups.tolist(), np.split(order, starts[1:]), strict=True):
        yield group, robust_box(points[rows], _SHARE)


def _overlap(a: Box, b: Box) -> bool:
    return bool((np.minimum(a[1], b[1]) > np.maximum(a[0], b[0])).all())
