"""The depth order equals a plain sort by depth, within the resolution of its keys."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.arrays import DoubleArray
from gaga_core.camera import NEAR, Camera
from gaga_core.scene.scene import Placements, Scene, State
from gaga_studio.gpu import sorter
from gaga_studio.gpu.sort_kernels import N_KEYS
from gaga_studio.gpu.sorter import SortColumns, Sorter, SortJob, plain_order, sort
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


def _weights(scene: Scene) -> DoubleArray:
    """Root of opacity times the largest cross-section (N,)."""
    gaussians = scene.gaussians
    logs = np.sort(gaussians.log_scales.astype(np.float64), axis=1)
    return np.sqrt(np.exp(logs[:, 1] + logs[:, 2]) * gaussians.opacities)


def test_a_smaller_budget_is_a_part_of_a_larger_one() -> None:
    scene = Scene.of(random_gaussians(1000))
    before = set(sort(_job(scene)).order)
    for budget in (800, 300, 100, 7):
        chosen = set(sort(_job(scene, budget=budget)).order)
        assert len(chosen) == budget
        assert chosen < before
        before = chosen


def test_a_budget_takes_splats_with_the_probability_that_the_threshold_says() -> None:
    """What is large for certain; and enlarged by 1 / p they cover what all of them cover."""
    scene = Scene.of(random_gaussians(20_000))
    weights = _weights(scene)
    found = sort(_job(scene, budget=4000))
    p = np.minimum(1, weights * np.exp(-found.threshold))
    assert np.isin(np.flatnonzero(p >= 1), found.order).all()
    taken = np.zeros(len(scene), bool)
    taken[found.order] = True
    for rare in (p < 0.1, (p >= 0.1) & (p < 0.3)):
        assert taken[rare].mean() == pytest.approx(p[rare].mean(), rel=0.12)
    area = weights**2
    assert (area / p)[taken].sum() == pytest.approx(area.sum(), rel=0.03)


def test_a_budget_leaves_something_of_every_object() -> None:
    """Objects of small splats too: the largest alone would be all of the floor."""
    gaussians = random_gaussians(10_000)
    logs = gaussians.log_scales.copy()
    small = np.arange(10_000) < 5000
    logs[small] -= 3.0
    scene = Scene.of(replace(gaussians, log_scales=logs))
    order = sort(_job(scene, budget=2000)).order
    assert 40 < small[order].sum() < 500


def test_the_coarse_order_is_the_order_of_its_budget() -> None:
    scene = _placed_scene()
    both = sort(replace(_job(scene), coarse_budget=900))
    few = sort(_job(scene, budget=900))
    thinned = both.thinned()
    assert len(both.order) == len(scene)
    assert thinned.threshold == few.threshold
    assert thinned.budget == few.budget == 900
    assert set(thinned.order) == set(few.order)
    assert np.all(np.diff(_depths(scene)[thinned.order]) < 1e-4)


@pytest.mark.parametrize("n", [0, 1])
def test_tiny_scenes(n: int) -> None:
    assert len(sort(_job(Scene.of(random_gaussians(n)))).order) == n


def test_the_plain_order_is_the_order_of_all_that_is_in_front() -> None:
    scene = _placed_scene()
    scene.state = np.random.default_rng(1).choice([0, 2, 4, 8], 5000).astype(np.uint8)
    scene.gaussians.means[:10] = np.nan
    scene.placement[20:30] = 7  # a row that the table lacks
    plain, found = plain_order(_job(scene)), sort(_job(scene))
    assert np.array_equal(np.sort(plain.order), np.sort(found.order))  # all are in view
    scene.placement[20:30] = 0
    assert (np.diff(_depths(scene)[plain.order]) <= 0).all()
    np.testing.assert_allclose([plain.near, plain.far], [found.near, found.far], rtol=0.02)


def test_something_is_drawn_while_kernels_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    job = _job(_placed_scene())
    monkeypatch.setattr(sorter, "is_compiled", lambda: True)
    assert [is_last for _, is_last in SortColumns().orders(job)] == [True]
    monkeypatch.setattr(sorter, "is_compiled", lambda: False)
    columns = SortColumns()
    assert [is_last for _, is_last in columns.orders(job)] == [False, True]
    assert [is_last for _, is_last in columns.orders(job)] == [True]


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


def _seen(scene: Scene, camera: Camera, near: float, far: float) -> set[int]:
    """Splats whose centres a camera sees between two depths, by numpy."""
    pixels, depths = camera.project(scene.gaussians.means.astype(np.float64))
    is_seen = camera.shows(pixels, depths) & (depths >= near) & (depths <= far)
    return set(np.flatnonzero(is_seen).tolist())


def test_what_an_order_covers_it_has() -> None:
    """For cameras that turned, moved and zoomed by a little or much: nothing seen was culled."""
    rng = np.random.default_rng(5)
    points = random_gaussians(3000, extent=1.5)
    scene = Scene.of(replace(points, log_scales=points.log_scales - np.float32(5)))
    answers = []
    for strength in np.repeat([0.003, 0.03, 0.1, 0.2, 1.0], 60):
        old = replace(CAMERA, cam_from_world=_moved(CAMERA, rng, 0.5))
        order = sort(replace(_job(scene), camera=old))
        new = replace(old, cam_from_world=_moved(old, rng, strength))
        new = new.resized(*rng.integers(60, 400, 2).tolist()) if rng.random() < 0.2 else new
        covers = order.covers(new)
        answers.append((strength, covers))
        if covers:
            assert _seen(scene, new, order.near, order.far) <= set(order.order.tolist())
    assert all(covers for strength, covers in answers if strength < 0.01), "nothing to wait for"
    assert sum(covers for strength, covers in answers if strength > 0.5) < 6
    assert plain_order(_job(scene)).covers(new)


def _moved(camera: Camera, rng: np.random.Generator, strength: float) -> DoubleArray:
    """A pose that differs by a turn (radians) and a step of this strength."""
    axis = rng.normal(size=3)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(strength * axis / np.linalg.norm(axis)).as_matrix()
    pose[:3, 3] = strength * rng.normal(size=3)
    moved: DoubleArray = pose @ camera.cam_from_world
    return moved
