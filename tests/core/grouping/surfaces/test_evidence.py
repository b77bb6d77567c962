"""What the levels are made from: normals of depth maps, planes, small pieces, the background."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.geometry import look_at
from gaga_core.grouping.surfaces.borders import (
    Agreement,
    Clusters,
    SignedGraph,
    coarse_graph,
    in_one_plane,
    is_background,
    is_calm,
    noise_of,
)
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels, planes_of, small_pieces
from gaga_core.grouping.surfaces.surfels_kernels import normals_at
from tests.scenes import orbit_cameras

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


def test_floor_and_shelf_are_planes_of_their_own() -> None:
    floor, shelf = _sheet(0.0, 40, 1.0), _sheet(0.5, 20, 0.4)
    ball = np.random.default_rng(0).normal(size=(600, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    points = np.concatenate([floor, shelf, 0.2 * ball + [3, 0, 0]])
    up = np.tile([0, 0, 1.0], (len(floor) + len(shelf), 1))
    plane = planes_of(_surfels(points, np.concatenate([up, ball])), Neighbourhood.of(points))
    assert set(plane[: len(floor)]) == {1}
    assert set(plane[len(floor) : len(up)]) == {2}
    assert not plane[len(up) :].any()


def test_a_crease_parts_what_stands_from_what_it_stands_on_and_convex_edges_join() -> None:
    surfels, is_box = _box_on_a_floor()
    near = Neighbourhood.of(surfels.points)
    # The views show floor and box in two regions, and each side of the box in one of its own.
    side = np.where(is_box, 2 + 4 * np.abs(surfels.normals[:, 0]) + surfels.normals[:, 2], 1)
    regions = np.repeat(side[:, None], 4, axis=1).astype(np.int32)
    surfels = replace(surfels, regions=regions)
    piece = small_pieces(surfels, near)
    both = np.unique(np.stack([piece, is_box.astype(np.int64)]), axis=1)
    assert both.shape[1] == piece.max() + 1  # no piece lies on both
    each = np.arange(len(piece))
    cluster = np.unique(side, return_inverse=True)[1].astype(np.int64)
    views, plane = Agreement.of(surfels, near, each), planes_of(surfels, near)
    graph = coarse_graph(surfels, near, plane, each, views, cluster)
    evidence = dict(zip(zip(graph.first, graph.second, strict=True), graph.evidence, strict=True))
    with_floor = [e for (a, _), e in evidence.items() if a == 0]
    in_box = [e for (a, _), e in evidence.items() if a > 0]
    assert max(with_floor) < min(in_box)


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

    def share(*cluster: LongArray) -> float:
        """Of the views that show both of two pieces across the border, that show them as one."""
        found = Agreement.of(surfels, near, piece, *cluster)
        across = sides[found.first] != sides[found.second]
        return float((found.same[across] / found.voice[across]).mean())

    assert share() > 0.9
    assert share(right.astype(np.int64)) < 0.6


def test_what_lies_outside_and_is_cut_is_background() -> None:
    views = orbit_cameras(12)
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 3000)
    wall = np.stack([7 * np.cos(angle), 7 * np.sin(angle), rng.uniform(-4, 5, 3000)], axis=1)
    thing = rng.normal(0, 0.2, (300, 3))
    points = np.concatenate([thing, wall])
    regions = np.zeros((len(points), len(views)), np.int32)
    for v, camera in enumerate(views):
        pixels, z = camera.project(points)
        size = (camera.width, camera.height)
        regions[:, v] = (z > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)
    n_views = (regions > 0).sum(axis=1).astype(np.int32)
    further = np.zeros((len(points), 0), np.int32)
    surfels = Surfels(points, np.zeros_like(points), regions, n_views, further)
    cluster = np.repeat([0, 1], [300, 3000])
    assert is_background(surfels, views, cluster).tolist() == [False, True]
    outwards = [
        replace(c, cam_from_world=look_at(c.position, 2 * c.position, np.array([0, 0, 1.0])))
        for c in views
    ]
    assert not is_background(surfels, outwards, cluster).any()


def test_creases_that_noise_makes_are_taken_off() -> None:
    """Two halves of a plane whose normals are noisy, and a wall; views part all."""
    rng = np.random.default_rng(0)
    floor = _sheet(0.0, 40, 1.0)
    wall = floor[:, [2, 1, 0]] + np.array([1.03, 0, 1.03])
    points = np.concatenate([floor, wall]) + rng.normal(0, 0.02, (2 * len(floor), 3))
    normals = np.repeat([[0, 0, 1.0], [-1.0, 0, 0]], len(floor), axis=0)
    normals += rng.normal(0, 1.0, normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surfels, near = _surfels(points, normals), Neighbourhood.of(points)
    plane = np.repeat([1, 2], len(floor)).astype(np.int32)
    cluster = np.repeat([0, 2], len(floor)) + (np.arange(len(points)) % len(floor) % 40 > 20)
    each = np.arange(len(points))
    surfels = replace(surfels, regions=(cluster + 1)[:, None].repeat(4, axis=1).astype(np.int32))
    views = Agreement.of(surfels, near, each, cluster)
    noise = noise_of(surfels, near, plane, cluster)
    assert (noise > 0.16).all()

    def evidence(known: DoubleArray | None) -> dict[tuple[int, int], float]:
        graph = coarse_graph(surfels, near, plane * 0, each, views, cluster, known)
        pairs = zip(graph.first.tolist(), graph.second.tolist(), strict=True)
        return dict(zip(pairs, graph.evidence.tolist(), strict=True))

    before, after = evidence(None), evidence(noise)
    assert after[0, 1] > before[0, 1]
    assert after[1, 2] < after[0, 1]
    flat = _surfels(floor, np.tile([0, 0, 1.0], (len(floor), 1)))
    quiet = noise_of(flat, Neighbourhood.of(floor), plane[: len(floor)], cluster[: len(floor)])
    assert (quiet < 0.05).all()
    assert is_calm(quiet)
    assert not is_calm(noise)


def test_a_patch_of_a_plane_keeps_to_it_and_what_stands_on_it_does_not() -> None:
    """Of 40 samples each: a floor, a patch that noise has lifted for the most part, a box, and a
    heap on no plane at all."""
    cluster = np.repeat(np.arange(4), 40)
    plane = np.zeros(160, np.int32)
    plane[:40], plane[40:48], plane[80:84] = 1, 1, 1
    first, second = np.array([0, 0, 0, 2]), np.array([1, 2, 3, 3])
    graph = SignedGraph(np.full(4, 40.0), first, second, np.ones(4), np.zeros(4))
    assert in_one_plane(plane, Clusters(cluster, graph)).tolist() == [True, False, False, False]
