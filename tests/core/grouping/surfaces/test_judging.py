"""What depends on the noise of the splats: when borders are judged again, and what counts then."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import LongArray
from gaga_core.grouping.surfaces.borders import Clusters, Judge, in_one_plane, is_calm
from gaga_core.grouping.surfaces.surfels import Neighbourhood, Surfels, planes_of, small_pieces

_CALM, _ROUGH = np.array([0.05, 0.1]), np.array([0.2, 0.35])
_EVIDENCE = (3.2, 2.6, 2.2)


@pytest.fixture(scope="module")
def judge() -> Judge:
    """A bumpy floor whose views show it in regions of several sizes, each view in others."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(-1, 1, 45), np.linspace(-1, 1, 45))
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    points[:, 2] = rng.normal(0, 0.008, x.size)
    normals = rng.normal(0, 0.3, points.shape) + np.array([0, 0, 1.0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    regions = np.empty((len(points), 6), np.int32)
    for v in range(6):
        cell = np.floor((points[:, :2] + rng.uniform(1, 2, 2)) / rng.uniform(0.3, 0.7))
        regions[:, v] = 1 + cell.astype(np.int32) @ [20, 1]
    seen = np.full(len(points), 6, np.int32)
    surfels = Surfels(points, normals, regions, seen, np.zeros((len(points), 0), np.int32))
    near = Neighbourhood.of(points)
    piece, plane = small_pieces(surfels, near), planes_of(surfels, near)
    assert (plane > 0).any()
    return Judge(surfels, near, plane, piece, np.ones(len(points)), _CALM)


def _once(judge: Judge, cluster: LongArray) -> list[Clusters]:
    """Levels from a single judgement."""
    now = judge.judged(cluster).joined(_EVIDENCE[0]).joined(-np.inf, 1.5)
    levels = [now]
    for evidence in _EVIDENCE[1:]:
        levels.append(levels[-1].joined(evidence))
    return levels


def _at_each(judge: Judge, cluster: LongArray) -> list[Clusters]:
    """Levels of which each has a judgement of its own."""
    levels = [judge.judged(cluster).joined(_EVIDENCE[0]).joined(-np.inf, 1.5)]
    for evidence in _EVIDENCE[1:]:
        levels.append(judge.judged(levels[-1].cluster).joined(evidence))
    return levels


def test_parts_are_judged_at_each_level_only_where_splats_are_calm(judge: Judge) -> None:
    judge = replace(judge, plane=np.zeros_like(judge.plane))  # the other rule has no say
    for noise, expected, other in ((_CALM, _at_each, _once), (_ROUGH, _once, _at_each)):
        noisy = replace(judge, noise=noise)
        assert is_calm(noise) == (noise is _CALM)
        found = noisy.parts(noisy.piece, _EVIDENCE, 1.5, np.inf)
        pairs = zip(found, expected(noisy, noisy.piece), strict=True)
        assert all(np.array_equal(level.cluster, wanted.cluster) for level, wanted in pairs)
        pairs = zip(found, other(noisy, noisy.piece), strict=True)
        assert not all(np.array_equal(level.cluster, less.cluster) for level, less in pairs)


def test_the_better_judgement_counts_within_a_plane_only_where_splats_are_rough(
    judge: Judge,
) -> None:
    for noise in (_CALM, _ROUGH):
        noisy = replace(judge, noise=noise)
        before = noisy.judged(noisy.piece).joined(3.0)
        now, again = noisy.judged(before.cluster), noisy.again(before)
        flat = in_one_plane(noisy.plane, now)
        better = flat & (before.graph.evidence > now.graph.evidence)
        assert better.any()
        expected = now.graph.evidence.copy()
        if noise is _ROUGH:
            expected[better] = before.graph.evidence[better]
        assert np.array_equal(again.graph.evidence, expected)


def test_an_enclosed_part_stays_apart(judge: Judge) -> None:
    """Evidence joins all of the floor, unless a disc on it is one region of every view."""
    disc = np.linalg.norm(judge.surfels.points[:, :2], axis=1) < 0.3
    regions = np.repeat(1 + disc[:, None], 6, axis=1).astype(np.int32)
    seen = replace(judge, surfels=replace(judge.surfels, regions=regions), noise=_ROUGH)
    cluster = disc.astype(np.int64)
    seen = replace(seen, piece=cluster)
    for least_thing, n_parts in ((6.0, 2), (np.inf, 1)):
        parts = seen.parts(cluster, (np.inf, -1000.0), 1.5, least_thing)
        assert parts[-1].cluster.max() + 1 == n_parts
