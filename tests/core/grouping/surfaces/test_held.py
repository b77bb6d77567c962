"""Parts that stand on nothing are one thing where little holds them."""

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.grouping.surfaces.objects import held_together
from gaga_core.grouping.surfaces.surfels import Neighbourhood

_FLOOR, _BELOW, _ONE, _OTHER = range(4)
Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]  # low and high of x, y, z
_STEM: Box = ((0, 2), (0, 2), (1, 20))
_LEAVES: tuple[Box, Box] = (((-12, 2), (-4, 4), (20, 21)), ((2, 14), (-4, 4), (20, 21)))


def _scene(floor: int, *boxes: Box) -> tuple[Neighbourhood, IntArray, LongArray, DoubleArray]:
    """Samples one unit apart of a square floor and of boxes over it; the plane, the cluster and the
    share of the views (S,) of each sample."""
    parts = [_samples(((-floor, floor), (-floor, floor), (0, 1))), *map(_samples, boxes)]
    points = np.concatenate(parts)
    points += np.random.default_rng(0).normal(0, 0.05, points.shape)
    cluster = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    plane = (cluster == _FLOOR).astype(np.int32)
    return Neighbourhood.of(points), plane, cluster, np.full(len(points), 0.5)


def _samples(box: Box) -> DoubleArray:
    axes = np.meshgrid(*(np.arange(low, high, dtype=float) for low, high in box), indexing="ij")
    return np.stack(axes, axis=-1).reshape(-1, 3)


def test_leaves_are_one_thing_apart_from_the_stem_that_stands() -> None:
    ids = held_together(*_scene(40, _STEM, *_LEAVES))
    assert ids[_ONE] == ids[_OTHER]
    assert sorted(np.unique(ids).tolist()) == [0, 1, 2]


def test_without_a_plane_to_stand_on_nothing_is_joined() -> None:
    near, plane, cluster, shown = _scene(40, _STEM, *_LEAVES)
    assert len(np.unique(held_together(near, np.zeros_like(plane), cluster, shown))) == 4


def test_what_hardly_a_view_shows_is_not_held_by_what_many_show() -> None:
    near, plane, cluster, shown = _scene(40, _STEM, *_LEAVES)
    shown[cluster == _OTHER] = 0.05
    assert len(np.unique(held_together(near, plane, cluster, shown))) == 4
    shown[cluster == _ONE] = 0.05
    ids = held_together(near, plane, cluster, shown)
    assert ids[_ONE] == ids[_OTHER]


def test_what_rests_on_something_wide_stays_apart() -> None:
    boxes: tuple[Box, ...] = (((0, 12), (0, 6), (1, 4)), ((0, 6), (0, 6), (4, 8)))
    ids = held_together(*_scene(40, *boxes, ((6, 12), (0, 6), (4, 8))))
    assert len(np.unique(ids)) == 4


def test_only_what_is_small_in_the_scene_is_joined() -> None:
    ids = held_together(*_scene(15, _STEM, *_LEAVES))
    assert len(np.unique(ids)) == 4
