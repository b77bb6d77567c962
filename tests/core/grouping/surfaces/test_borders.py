"""What objects are made from: normals of depth maps, small pieces, features of their borders."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.grouping.surfaces.borders import (
    FEATURES,
    Agreement,
    Moments,
    Seen,
    Shown,
    borders_of,
)
from gaga_core.grouping.surfaces.surfels import (
    N_LEVELS,
    Neighbourhood,
    Surfels,
    apart,
    small_pieces,
)
from gaga_core.grouping.surfaces.surfels_kernels import normals_at

_LENS = np.array([100.0, 110.0, 30.0, 20.0])
_SHARES = np.array([0.06, 0.03, 0.015])


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, 0.2, -0.8), (-0.1, 0.6, -0.7)])
def test_the_normal_of_a_plane_is_exact_also_next_to_a_step(
    normal: tuple[float, float, float],
) -> None:
    wanted = np.array(normal, np.float64) / np.linalg.norm(normal)
    rows, columns = np.mgrid[:40, :60]
    ray = np.stack([(columns + 0.5 - 30) / 100, (rows + 0.5 - 20) / 110, np.ones((40, 60))], axis=2)
    depth = (-2.0 / (ray @ wanted)).astype(np.float32)
    depth[:, 40:] *= 2  # another surface behind
    found = np.zeros((2, 3))
    normals_at(depth, np.array([20, 10]), np.array([25, 38]), _LENS, 5, 1, _SHARES, found)
    np.testing.assert_allclose(found, np.stack([wanted, wanted]), atol=1e-3)


def test_where_nothing_is_there_is_no_normal() -> None:
    found = np.ones((1, 3))
    nothing = np.zeros((40, 60), np.float32)
    normals_at(nothing, np.array([20]), np.array([25]), _LENS, 5, 1, _SHARES, found)
    assert not found.any()


def _sheet(height: float, n: int, side: float) -> DoubleArray:
    x, y = np.meshgrid(np.linspace(-side, side, n), np.linspace(-side, side, n))
    return np.stack([x.ravel(), y.ravel(), np.full(n * n, height)], axis=1)


def _surfels(points: DoubleArray, normals: DoubleArray, n_views: int = 4) -> Surfels:
    regions = np.ones((len(points), n_views), np.int32)
    n_seen = np.full(len(points), n_views, np.int32)
    return Surfels(points, normals, regions, n_seen, np.zeros((len(points), 0), np.int32))


def _box_on_a_floor() -> tuple[Surfels, DoubleArray]:
    """Samples of a floor and of the five sides of a box on it that are seen; which is which."""
    floor = _sheet(0.0, 40, 1.0)
    floor = floor[(np.abs(floor[:, :2]) > 0.3).any(axis=1)]
    top = _sheet(0.6, 13, 0.3)
    sides, facing = [], []
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        along, up = np.meshgrid(np.linspace(-0.3, 0.3, 13), np.linspace(0.05, 0.6, 12))
        side = np.zeros((along.size, 3))
        side[:, axis], side[:, 1 - axis], side[:, 2] = sign * 0.3, along.ravel(), up.ravel()
        sides.append(side)
        facing.append(np.tile(sign * np.eye(3)[axis], (len(side), 1)))
    up_ = np.tile([0, 0, 1.0], (len(floor) + len(top), 1))
    points, normals = np.concatenate([floor, top, *sides]), np.concatenate([up_, *facing])
    is_box = np.arange(len(points)) >= len(floor)
    return _surfels(points, normals), is_box.astype(np.float64)


def _seen(surfels: Surfels, piece: LongArray | None = None) -> Seen:
    near = Neighbourhood.of(surfels.points)
    color = np.zeros((len(surfels.points), 3))
    own = small_pieces(surfels, near) if piece is None else piece
    return Seen.of(surfels, near, color, own, surfels.regions.shape[1])


def test_pieces_end_at_creases_and_outlines() -> None:
    surfels, is_box = _box_on_a_floor()
    # The views show floor and box in two regions, and each side of the box in one of its own.
    side = np.where(is_box, 2 + 4 * np.abs(surfels.normals[:, 0]) + surfels.normals[:, 2], 1)
    regions = np.repeat(side[:, None], 4, axis=1).astype(np.int32)
    piece = _seen(replace(surfels, regions=regions)).piece
    both = np.unique(np.stack([piece, is_box.astype(np.int64)]), axis=1)
    assert both.shape[1] == piece.max() + 1  # no piece lies on both


def test_the_features_of_a_border_are_what_their_names_say() -> None:
    """A box on a floor: a crease around its foot, bulging edges above, all views part both."""
    surfels, is_box = _box_on_a_floor()
    regions = np.repeat(1 + is_box[:, None], 4, axis=1).astype(np.int32)
    top = np.where(is_box > 0, 1 + (surfels.points[:, 2] > 0.59), 0).astype(np.int64)
    each = np.arange(len(top))
    borders = borders_of(_seen(replace(surfels, regions=regions), each), top)
    assert list(zip(borders.first, borders.second, strict=True)) == [(0, 1), (1, 2)]
    foot, edge = ({name: borders.column(name)[k] for name in FEATURES} for k in (0, 1))
    assert foot["crease"] > 0.3 > foot["bulge"]
    assert edge["bulge"] > 0.3 > edge["crease"]
    assert foot["views, level 0"] < -0.5 < 0.5 < edge["views, level 0"]
    assert foot["share of the smaller"] < 1 == edge["share of the smaller"]
    assert foot["height over the larger"] > 0  # the box is on the side from which the floor is seen
    assert foot["flatness of the larger"] < foot["flatness of the smaller"]
    assert edge["size of the smaller"] < edge["size of the larger"]


def test_neither_place_nor_scale_nor_order_change_the_features() -> None:
    surfels, is_box = _box_on_a_floor()
    regions = np.repeat(1 + is_box[:, None], 4, axis=1).astype(np.int32)
    surfels = replace(surfels, regions=regions)
    cluster, each = is_box.astype(np.int64), np.arange(len(is_box))
    here = borders_of(_seen(surfels, each), cluster)
    moved = replace(surfels, points=37.0 * surfels.points + np.array([5.0, -80.0, 3.0]))
    there = borders_of(_seen(moved, each), cluster)
    np.testing.assert_allclose(there.features, here.features, atol=0.01)
    swapped = borders_of(_seen(surfels, each), 1 - cluster)
    np.testing.assert_allclose(swapped.features, here.features, atol=1e-9)


def test_regions_of_four_levels_have_features_of_their_own() -> None:
    """Only the maps of the last level part box and floor."""
    surfels, is_box = _box_on_a_floor()
    one, two = np.ones((len(is_box), 1), np.int32), (1 + is_box[:, None]).astype(np.int32)
    further = np.tile(np.concatenate([one, one, two], axis=1), (1, 4))
    seen = _seen(replace(surfels, further=further), np.arange(len(is_box)))
    borders = borders_of(seen, is_box.astype(np.int64))
    views = [float(borders.column(f"views, level {k}")[0]) for k in range(N_LEVELS)]
    assert min(views[:3]) > 0.5
    assert views[3] < -0.5


def test_a_piece_that_regions_miss_is_judged_with_its_cluster() -> None:
    """Regions part two sheets but for a strip on either side of the border."""
    points = _sheet(0.0, 40, 1.0)
    right = points[:, 0] > 0
    surfels = _surfels(points, np.tile([0, 0, 1.0], (len(points), 1)))
    regions = np.where(np.abs(points[:, 0]) < 0.12, 1, 2 + right)[:, None].repeat(4, axis=1)
    surfels, near = replace(surfels, regions=regions.astype(np.int32)), Neighbourhood.of(points)
    column = np.floor((points[:, :2] + 1) / 0.1).astype(np.int64) @ np.array([21, 1])
    piece = np.unique(column, return_inverse=True)[1].astype(np.int64)
    sides = np.zeros(piece.max() + 1, np.bool_)
    sides[piece] = right

    def share(cluster: LongArray) -> float:
        """Of the views that show both of two pieces across the border, that show them as one."""
        found = Agreement.of(Shown.of(surfels, piece), near, piece, cluster)
        across = sides[found.first] != sides[found.second]
        return float((found.same[across] / found.voice[across]).mean())

    assert share(piece) > 0.9
    assert share(right.astype(np.int64)) < 0.6


@pytest.mark.parametrize("seed", range(3))
def test_moments_of_a_set_are_those_of_its_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surfels = _surfels(rng.normal(size=(200, 3)), rng.normal(size=(200, 3)))
    seen, cluster = _seen(surfels, np.arange(200)), rng.integers(0, 10, 200)
    parts = Moments.of(seen, cluster)
    sets = csr_matrix(np.array([[1.0] * 5 + [0] * 5, [0, 0, 1, 0, 0, 0, 0, 0, 1, 0]]))
    found = parts.of_sets(sets)
    for k, rows in enumerate((cluster < 5, np.isin(cluster, [2, 8]))):
        np.testing.assert_allclose(found.centre[k], seen.points[rows].mean(axis=0), atol=1e-9)
        wanted = np.sqrt(np.linalg.eigvalsh(np.cov(seen.points[rows].T, bias=True)))
        np.testing.assert_allclose(found.axes()[0][k], wanted, rtol=1e-6)
    pair = parts.taken(np.array([2])).plus(parts.taken(np.array([8])))
    np.testing.assert_allclose(pair.covariance()[0], found.covariance()[1], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_samples_stay_that_none_before_them_is_near(seed: int) -> None:
    """Against all pairs; reaches of seven octaves, more than there are grids for fifteen."""
    rng = np.random.default_rng(seed)
    points, reach = rng.normal(size=(600, 3)), 2.0 ** rng.uniform(-8, (-1, 7, 0)[seed], 600)
    near = np.linalg.norm(points[:, None] - points, axis=2) < reach[:, None]
    wanted = np.zeros(600, np.bool_)
    for i in np.argsort(reach, kind="stable"):
        wanted[i] = not near[i, wanted].any()
    np.testing.assert_array_equal(apart(points, reach), wanted)
    assert 0 < wanted.sum() < 600
