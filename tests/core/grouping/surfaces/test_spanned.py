"""Both sides of a surface are one where a thing lies across it, and nowhere else."""

import numpy as np
import pytest

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.grouping.surfaces.objects import spanned
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels

_WOOD, _CLOTH = (60.0, 20.0, 30.0), (30.0, -40.0, 10.0)
_ONE, _OTHER, _THING = range(3)


def _table() -> tuple[DoubleArray, BoolArray]:
    """Samples one unit apart and which (S,) lie under a runner across the middle."""
    x, y = np.meshgrid(np.arange(-20.0, 21), np.arange(-12.0, 13))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points += np.random.default_rng(0).normal(0, 0.03, points.shape)
    return points, np.abs(points[:, 0]) < 5


def _groups(
    points: DoubleArray,
    thing: BoolArray,
    *,
    side: BoolArray | None = None,
    kept: BoolArray | None = None,
    height: float = 0.4,
    other: tuple[float, float, float] = _WOOD,
) -> list[int]:
    """Ids of both sides and of the thing between, which lies higher by ``height``."""
    side = points[:, 0] > 0 if side is None else side
    cluster = np.where(thing, _THING, np.where(side, _OTHER, _ONE)).astype(np.int64)
    points = points + np.outer(thing, [0, 0, height])
    color = np.array([_WOOD, other, _CLOTH])[cluster]
    if kept is not None:
        points, cluster, color = points[kept], cluster[kept], color[kept]
    n = len(points)
    none = np.zeros((n, 0), np.int32)
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    surfels = Surfels(points, up, np.ones((n, 1), np.int32), np.ones(n, np.int32), none)
    plane = (points[:, 2] < 1.5).astype(np.int32)
    ids = spanned(surfels, Neighbourhood.of(points), plane, color, cluster)
    return [int(k) for k in ids]


def test_a_table_is_one_on_both_sides_of_its_runner() -> None:
    one, other, runner = _groups(*_table())
    assert one == other != runner


def test_open_air_joins_nothing() -> None:
    points, runner = _table()
    assert len(set(_groups(points, runner, kept=~runner))) == 2
    rail = np.abs(points[:, 0]) < 1.5  # of a gap of eighteen
    assert len(set(_groups(points, rail, kept=rail | (np.abs(points[:, 0]) > 9)))) == 3
    plank = runner & (np.abs(points[:, 1]) < 3)  # from one table to the other
    assert len(set(_groups(points, plank, kept=~runner | plank))) == 3


@pytest.mark.parametrize(
    ("height", "other"),
    [(0.0, _WOOD), (-0.4, _WOOD), (2.0, _WOOD), (0.4, (60.0, 20.0, 22.0))],
    ids=["level", "lower", "not on it", "another color"],
)
def test_what_does_not_lie_on_both_sides_of_one_color_joins_nothing(
    height: float, other: tuple[float, float, float]
) -> None:
    assert len(set(_groups(*_table(), height=height, other=other))) == 3


def test_a_thing_that_is_larger_is_the_surface() -> None:
    points, _ = _table()
    places = [np.hypot(points[:, 0] - x, points[:, 1]) < 5 for x in (-8, 8)]
    assert len(set(_groups(points, ~(places[0] | places[1])))) == 3


def test_a_crumb_of_the_plane_is_no_side() -> None:
    points, runner = _table()
    crumb = (points[:, 0] > 4.5) & (points[:, 0] < 5.5) & (np.abs(points[:, 1]) < 0.5)
    assert len(set(_groups(points, runner, kept=(points[:, 0] < 4.5) | crumb))) == 3
