"""Thin things that one surface encloses: apart where regions show them whole."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.grouping.surfaces.borders import (
    Clusters,
    SignedGraph,
    is_background,
    is_enclosed_thing,
    is_outside,
    keep_enclosed,
)
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels
from tests.scenes import orbit_cameras

_LEAST = 6.0
_VIEWS = 4


def _wall() -> tuple[DoubleArray, LongArray]:
    """Samples of a wall and which (S,) are a disc on it."""
    y, z = np.meshgrid(np.linspace(-3, 3, 61), np.linspace(-3, 3, 61))
    points = np.stack([np.full(y.size, 6.0), y.ravel(), z.ravel()], axis=1)
    return points, (np.linalg.norm(points[:, 1:], axis=1) < 0.8).astype(np.int64)


def _shown(points: DoubleArray, regions: LongArray, n_views: int = _VIEWS) -> Surfels:
    table = np.repeat(regions[:, None], n_views, axis=1).astype(np.int32)
    none = np.zeros((len(points), 0), np.int32)
    seen = np.full(len(points), n_views, np.int32)
    return Surfels(points, np.zeros_like(points), table, seen, none)


def _clusters(cluster: LongArray, size: DoubleArray | None = None) -> Clusters:
    size = np.bincount(cluster).astype(np.float64) if size is None else size
    n = len(size)
    first, second = np.zeros(n - 1, np.int64), np.arange(1, n)
    return Clusters(cluster, SignedGraph(size, first, second, np.ones(n - 1), np.ones(n - 1)))


def test_a_disc_that_views_show_as_one_region_stays_apart() -> None:
    points, disc = _wall()
    now, near = _clusters(disc), Neighbourhood.of(points)
    kept = keep_enclosed(_shown(points, 1 + disc), near, now, _LEAST)
    assert kept.joined(0.6).cluster.max() == 1
    assert now.joined(0.6).cluster.max() == 0


@pytest.mark.parametrize(
    "regions",
    [
        lambda points, disc: np.ones_like(disc),
        lambda points, disc: 1 + disc * (1 + (points[:, 1] > 0)),
        lambda points, disc: 1 + (np.linalg.norm(points[:, 1:], axis=1) < 1.1),
    ],
    ids=["one region", "two halves", "a larger region"],
)
def test_other_regions_are_no_witness(
    regions: Callable[[DoubleArray, LongArray], LongArray],
) -> None:
    points, disc = _wall()
    shown = _shown(points, regions(points, disc))
    assert not is_enclosed_thing(shown, Neighbourhood.of(points), _clusters(disc), _LEAST).any()


def test_what_two_others_hold_is_not_enclosed() -> None:
    points, disc = _wall()
    halves = np.where(disc > 0, 1, 2 * (points[:, 1] > 0))
    near = Neighbourhood.of(points)
    assert not is_enclosed_thing(_shown(points, 1 + disc), near, _clusters(halves), _LEAST).any()


@pytest.mark.parametrize(("share", "is_thing"), [(0.2, True), (0.05, False)])
def test_what_few_views_show_is_no_thing(share: float, is_thing: bool) -> None:
    points, disc = _wall()
    now = _clusters(disc, share * np.bincount(disc).astype(np.float64))
    found = is_enclosed_thing(_shown(points, 1 + disc), Neighbourhood.of(points), now, _LEAST)
    assert found.any() == is_thing


def test_any_level_of_detail_may_show_it() -> None:
    points, disc = _wall()
    shown = _shown(points, np.ones_like(disc))
    now, near = _clusters(disc), Neighbourhood.of(points)
    coarse, fine = shown.regions, np.repeat(1 + disc[:, None], _VIEWS, axis=1).astype(np.int32)
    levels = np.stack([coarse, fine], axis=2).reshape(len(points), -1)  # view by view
    assert is_enclosed_thing(replace(shown, further=levels), near, now, _LEAST).tolist() == [0, 1]


def test_a_thing_on_a_far_wall_is_not_background() -> None:
    points, disc = _wall()
    views = orbit_cameras(12)
    shown, near = _shown(points, 1 + disc, len(views)), Neighbourhood.of(points)
    for v, camera in enumerate(views):
        pixels, z = camera.project(points)
        size = (camera.width, camera.height)
        shown.regions[~((z > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)), v] = 0
    now = _clusters(disc)
    assert is_background(shown, views, disc).tolist() == [True, True]
    assert is_outside(shown, near, views, now, _LEAST).tolist() == [True, False]
