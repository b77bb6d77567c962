"""Objects that are two things: divided where views show both sides whole and the neck is narrow."""

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.grouping.surfaces.objects import divided
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels

_LEAST = 6.0
_VIEWS = 4


def _dumb_bell(neck: int) -> tuple[DoubleArray, LongArray]:
    """Samples one unit apart of two squares that touch along ``neck`` samples, and the square (S,)
    of each."""
    y, x = np.meshgrid(np.arange(20.0), np.arange(40.0), indexing="ij")
    kept = ((x < 19) | (x > 20) | (y < neck)).ravel()
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)[kept]
    points += np.random.default_rng(0).normal(0, 0.05, points.shape)
    return points, (points[:, 0] > 19.5).astype(np.int64)


def _divided(
    points: DoubleArray,
    part: LongArray,
    regions: LongArray,
    further: LongArray | None = None,  # regions at another level of detail
    least_size: float = _LEAST,
) -> int:
    """How many things one object of all samples is."""
    table = np.repeat(regions[:, None], _VIEWS, axis=1).astype(np.int32)
    levels = np.zeros((len(points), 0), np.int32)
    if further is not None:
        levels = np.repeat(further[:, None], _VIEWS, axis=1).astype(np.int32)
    seen = np.full(len(points), _VIEWS, np.int32)
    surfels = Surfels(points, np.zeros_like(points), table, seen, levels)
    one, near = np.zeros(len(points), np.int64), Neighbourhood.of(points)
    found = divided(surfels, near, one, [part], np.ones(len(points)), least_size)
    assert np.array_equal(np.unique(found), np.arange(found.max() + 1))
    return int(found.max()) + 1


def test_two_things_that_touch_in_a_narrow_neck_are_two() -> None:
    points, square = _dumb_bell(4)
    assert _divided(points, square, 1 + square) == 2


def test_a_part_of_many_leaves_the_others_together() -> None:
    points, square = _dumb_bell(4)
    thirds = np.where(square == 0, (points[:, 1] // 7).clip(0, 2).astype(np.int64), 3)
    assert _divided(points, thirds, 1 + square) == 2


def test_stripes_of_paint_that_meet_along_their_length_stay_one() -> None:
    points, _ = _dumb_bell(20)
    points = points[points[:, 1] < 7.5]
    stripe = (points[:, 1] > 3.5).astype(np.int64)
    assert _divided(points, stripe, 1 + stripe) == 1


@pytest.mark.parametrize("which", ["one region", "the rest in two", "both in halves"])
def test_regions_that_do_not_show_both_whole_are_no_witness(which: str) -> None:
    points, square = _dumb_bell(4)
    quarter = (points[:, 1] // 5).clip(0, 3).astype(np.int64)
    regions = {
        "one region": np.ones_like(square),
        "the rest in two": np.where(square == 0, 1, 2 + (points[:, 1] > 11.5)),
        "both in halves": 1 + 2 * square + quarter // 2,
    }[which]
    assert _divided(points, square, regions) == 1


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_what_another_level_of_detail_shows_as_one_about_as_well_stays_one(share: float) -> None:
    """Regions show one side whole and ``share`` of the other, another level that share of both."""
    points, square = _dumb_bell(4)
    far, cut = points[:, 1] > 19.5 * share, points[:, 1] > 19.5 * (1 - share)
    regions = np.where(square == 0, 1, 2 + far)
    assert _divided(points, square, regions) == 2
    assert _divided(points, square, regions, 1 + ((square == 1) & ~cut)) == 1


def test_small_sides_are_no_things() -> None:
    points, square = _dumb_bell(4)
    size = float(np.bincount(square).min())
    assert _divided(points, square, 1 + square, least_size=size) == 2
    assert _divided(points, square, 1 + square, least_size=size + 1) == 1
