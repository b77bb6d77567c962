"""The depth order equals a plain sort by depth, within the resolution of its keys."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.raster.base import NEAR
from gaga_core.scene.scene import Placements, Scene, State
from gaga_studio.gpu.sort_kernels import N_KEYS
from gaga_studio.gpu.sorter import Sorter, SortJob, sort
from tests.scenes import orbit_cameras, random_gaussians

CAMERA = orbit_cameras(1)[0]


def _job(scene: Scene, ticket: int = 1, budget: int = 0) -> SortJob:
    return SortJob(
        ticket=ticket,
        gaussians=scene.gaussians,
        state=scene.state,
        placement=scene.placement,
        placements=scene.placements,
        camera=CAMERA,
        budget=budget,
    )


def _depths(scene: Scene) -> DoubleArray:
    """Camera depth (N,) of placed centres, by numpy."""
    matrix = scene.placements.matrix[scene.placement]
    means = np.einsum("nij,nj->ni", matrix[:, :, :3], scene.gaussians.means) + matrix[:, :, 3]
    return CAMERA.project(means)[1]


def _placed_scene() -> Scene:
    scene = Scene.of(random_gaussians(5000, extent=0.9))
    table = Placements.identity(3)
    table.matrix[1, :, 3] = [0.1, 0.2, -0.1]
    table.matrix[2, :, :3] = np.diag([0.5, -1.0, 0.8])
    scene.placements = table
    scene.placement = np.random.default_rng(0).integers(0, 3, 5000).astype(np.int32)
    return scene


def test_far_to_near_as_numpy_sorts() -> None:
    scene = _placed_scene()
    depths = _depths(scene)
    found = sort(_job(scene))
    expected = np.argsort(-depths[found.order], kind="stable")
    seen = depths[found.order]
    # Depths of one key differ by at most the spread of keys: one part in N_KEYS of the range of
    # float bits, of which a power of two has 2^23.
    bits = np.array([seen.min(), seen.max()], np.float32).view(np.uint32)
    step = (int(bits[1]) - int(bits[0])) / N_KEYS / 2**23
    assert np.all(seen[:-1] >= seen[1:] * (1 - 2 * step - 1e-6))
    assert np.allclose(seen, seen[expected], rtol=2 * step + 1e-6)
    assert found.near < found.far


def test_nothing_that_is_seen_is_culled() -> None:
    """Whole scene in view: exactly the splats in front of the camera that are not taken out."""
    scene = _placed_scene()
    rng = np.random.default_rng(1)
    scene.state = rng.choice(
        [0, State.SELECTED, State.LOCKED, State.HIDDEN, State.DELETED], 5000
    ).astype(np.uint8)
    wanted = np.flatnonzero(scene.visible & (_depths(scene) >= NEAR))
    assert np.array_equal(np.sort(sort(_job(scene)).order), wanted)


def test_what_is_far_outside_or_behind_is_culled() -> None:
    scene = Scene.of(random_gaussians(5000, extent=20.0))
    order = sort(_job(scene)).order
    pixels, depths = CAMERA.project(scene.gaussians.means.astype(np.float64))
    size = np.array([CAMERA.width, CAMERA.height])
    inside = (depths >= NEAR) & np.all((pixels > 0) & (pixels < size), axis=1)
    assert np.isin(np.flatnonzero(inside), order).all()
    assert len(order) < 0.5 * len(scene)


def test_splats_that_are_not_finite_or_point_nowhere_are_skipped() -> None:
    scene = Scene.of(random_gaussians(100))
    means = scene.gaussians.means.copy()
    means[:10] = np.nan
    means[10:20] = np.inf
    scene.gaussians = replace(scene.gaussians, means=means)
    scene.placement = scene.placement.copy()
    scene.placement[20:30] = 7  # a row that the table lacks
    assert np.array_equal(np.sort(sort(_job(scene)).order), np.arange(30, 100))


def test_equal_depths_keep_the_order_of_a_front_to_back_sort() -> None:
    gaussians = random_gaussians(50)
    same = replace(gaussians, means=np.zeros((50, 3), np.float32))
    assert np.array_equal(sort(_job(Scene.of(same))).order, np.arange(50)[::-1])


def test_a_budget_keeps_the_most_important() -> None:
    gaussians = random_gaussians(1000)
    scene = Scene.of(gaussians)
    order = sort(_job(scene, budget=100)).order
    logs = np.sort(gaussians.log_scales.astype(np.float64), axis=1)
    score = logs[:, 1] + logs[:, 2] + np.log(gaussians.opacities)
    assert len(order) == 100
    assert score[order].min() >= np.sort(score)[-100] - 1e-5


@pytest.mark.parametrize("n", [0, 1])
def test_tiny_scenes(n: int) -> None:
    assert len(sort(_job(Scene.of(random_gaussians(n)))).order) == n


def test_the_latest_camera_wins() -> None:
    """Jobs that pile up while one runs are forgotten, but for the last."""
    sorter = Sorter()
    scene = Scene.of(random_gaussians(20000))
    for ticket in range(1, 200):
        sorter.submit(_job(scene, ticket))
    sorter.wait(199, timeout=30)
    found = sorter.take()
    assert found is not None
    assert found.ticket == 199
    assert sorter.take() is None
    sorter.release()
    assert "gaga-sort" not in {thread.name for thread in threading.enumerate()}


def test_waiting_for_an_ended_sorter_returns() -> None:
    sorter = Sorter()
    sorter.release()
    sorter.wait(1, timeout=30)
    assert sorter.take() is None
