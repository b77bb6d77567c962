"""Labels by vote: the argmax of summed blending weights, in blocks of any size."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import Votes, VoteSums, associated_labels, vote_labels
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.scenes import orbit_cameras, random_gaussians

_N_GROUPS = 7


@pytest.fixture(scope="module")
def scene() -> tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]]:
    gaussians = random_gaussians(400, seed=3)
    cameras = orbit_cameras(3, width=48, height=40)
    rng = np.random.default_rng(0)
    maps = {
        camera.name: rng.integers(0, _N_GROUPS + 1, (5, 6)).repeat(8, 0).repeat(8, 1)
        for camera in cameras
    }
    return gaussians, cameras, lambda camera: maps[camera.name].astype(np.int32)


def _vote(
    scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]], **options: int
) -> Votes:
    gaussians, cameras, label_map = scene
    return run_stage(vote_labels(gaussians, cameras, label_map, _N_GROUPS, choose(), **options))


def _table(
    scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]],
) -> FloatArray:
    """Summed weights (N, G + 1) from the sparse weights of every pixel."""
    gaussians, cameras, label_map = scene
    table = np.zeros((len(gaussians), _N_GROUPS + 1))
    for camera in cameras:
        pixels = np.arange(camera.width * camera.height)
        rows = choose().weights(gaussians, camera, pixels)
        labels = label_map(camera).ravel().repeat(np.diff(rows.indptr))
        np.add.at(table, (rows.indices, labels), rows.weights)
    return table.astype(np.float32)


def test_vote_is_the_argmax_of_summed_weights(
    scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]],
) -> None:
    votes, table = _vote(scene), _table(scene)[:, 1:]
    top = np.sort(table, axis=1)
    clear = top[:, -1] > top[:, -2] + 1e-4
    assert clear.sum() > 100
    assert (votes.labels[clear] == table[clear].argmax(axis=1) + 1).all()
    np.testing.assert_allclose(votes.weight, table.sum(axis=1), rtol=1e-4, atol=1e-4)
    seen = table.sum(axis=1) > 1e-3
    share = table.max(axis=1)[seen] / table.sum(axis=1)[seen]
    np.testing.assert_allclose(votes.confidence[seen], share, atol=1e-3)


@pytest.mark.parametrize("histogram_bytes", [1 << 20, 1])
def test_pixels_that_vote_later_add_to_the_same_sums(
    histogram_bytes: int,
    scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]],
) -> None:
    """Merged masks vote when the labels of the others are known: as if all had voted at once."""
    gaussians, cameras, label_map = scene

    def some(camera: Camera, wanted: int) -> IntArray:
        labels = label_map(camera)
        return np.where(labels % 2 == wanted, labels, 0).astype(np.int32)

    sums = VoteSums.empty(len(gaussians), _N_GROUPS, histogram_bytes)
    for wanted in (0, 1):
        stage = sums.add_stage(gaussians, cameras, partial(some, wanted=wanted), choose())
        run_stage(stage)
    both, once = sums.votes(), _vote(scene)
    assert (both.labels == once.labels).all()
    np.testing.assert_allclose(both.weight, once.weight, rtol=1e-5)
    np.testing.assert_allclose(both.confidence, once.confidence, rtol=1e-5)


def test_unseen_gaussians_have_no_label_and_no_confidence(
    scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]],
) -> None:
    gaussians, cameras, label_map = scene
    lone = gaussians.take(np.array([0, 0, 1]))
    lone.means[0] = [0, 0, 50]  # above every camera's picture
    votes = run_stage(vote_labels(lone, cameras, label_map, _N_GROUPS, choose()))
    assert votes.labels[0] == 0
    assert votes.confidence[0] == 0


@pytest.mark.parametrize("columns", [1, 2, 3])
def test_blocks_of_groups_change_nothing(
    columns: int, scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]]
) -> None:
    whole = _vote(scene)
    blocks = _vote(scene, histogram_bytes=columns * 4 * len(scene[0]))
    assert (blocks.labels == whole.labels).all()
    np.testing.assert_allclose(blocks.confidence, whole.confidence, atol=1e-6)


def test_pseudo_labels_map_mask_ids_to_groups() -> None:
    labels = np.array([[0, 4, 300], [4, 9, 1000]], np.int32)
    group_of_mask = np.zeros(301, np.int32)
    group_of_mask[[4, 300]] = [512, 7]
    assert associated_labels(labels, group_of_mask).tolist() == [[0, 512, 7], [512, 0, 0]]


@pytest.mark.parametrize("histogram_bytes", [1, 1 << 20])
def test_sums_go_on_from_the_votes_of_one_label(
    scene: tuple[Gaussians, tuple[Camera, ...], Callable[[Camera], IntArray]],
    histogram_bytes: int,
) -> None:
    """As when these votes are added in the same table, or in the same slots."""
    gaussians, cameras, label_map = scene
    rng = np.random.default_rng(0)
    before = rng.integers(0, _N_GROUPS + 1, len(gaussians)).astype(np.int32)
    weights = rng.uniform(0, 30, len(gaussians)).astype(np.float32)
    found = VoteSums.started(before, weights, _N_GROUPS, histogram_bytes)
    run_stage(found.add_stage(gaussians, cameras, label_map, choose("cpu")))
    table = np.zeros((len(gaussians), _N_GROUPS), np.float32)
    rows = np.flatnonzero(before)
    table[rows, before[rows] - 1] = weights[rows]
    both = VoteSums(_N_GROUPS, table)
    run_stage(both.add_stage(gaussians, cameras, label_map, choose("cpu")))
    votes, expected = found.votes(), both.votes()
    assert np.array_equal(votes.labels, expected.labels)
    assert np.allclose(votes.weight, expected.weight, rtol=1e-5)
    stays = (votes.labels == before)[before > 0]
    assert 0.05 < stays.mean() < 0.95, "some of the votes before decide, some do not"
