"""Two captures of one place come together by their photos, or are refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.geometry import fit_similarity
from gaga_core.progress import run_stage
from gaga_core.scene.captures.alignment import Alignment, By, NotAlignedError, difference, trusted
from gaga_core.scene.captures.by_photos import align_shared_stage, shared_of
from gaga_core.scene.frame import carried_cameras, inverse
from tests.core.scene.captures.scenes import any_similarity
from tests.scenes import orbit_cameras

_SIZE = np.array([640.0, 480.0])


def features(
    rng: np.random.Generator,
    views: tuple[Camera, ...],
    moves: tuple[DoubleArray, DoubleArray],  # (N, 3) points as each half of the views sees them
    wrong: float,
) -> dict[str, np.ndarray]:
    """Features of points that all views see, half a pixel off; a share of the matches is wrong."""
    n, half = len(moves[0]), len(views) // 2
    places = [
        (view.project(moves[int(i >= half)])[0] + rng.normal(0, 0.5, (n, 2))) / _SIZE
        for i, view in enumerate(views)
    ]
    pairs = [(i, j) for i in range(len(views)) for j in range(i)]
    matches = []
    for i, j in pairs:
        to = np.arange(n)
        is_wrong = (rng.random(n) < wrong) & ((i >= half) != (j >= half))
        to[is_wrong] = rng.permutation(n)[: is_wrong.sum()]
        matches.append(np.stack([i * n + np.arange(n), j * n + to], axis=1))
    return {
        "names": np.array([view.name for view in views]),
        "first": n * np.arange(len(views) + 1),
        "places": np.concatenate(places),
        "matches": np.concatenate(matches),
    }


@pytest.mark.parametrize("seed", range(2))
def test_any_similarity_is_found_among_wrong_matches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = any_similarity(rng)  # second_from_first
    cameras = [view.resized(640, 480) for view in orbit_cameras(8)]
    second = carried_cameras(cameras[4:], world)
    named = [replace(c, name=f"a/{i}.png") for i, c in enumerate(cameras[:4])]
    named += [replace(c, name=f"b/{i}.png") for i, c in enumerate(second)]
    points = rng.uniform(-0.6, 0.6, (150, 3))
    moved = points.copy()
    moved[:40, 0] += 0.4  # a thing that stands elsewhere
    there = moved @ world[:3, :3].T + world[:3, 3]
    arrays = features(rng, tuple(named), (points, there), wrong=0.3)
    shared = shared_of(arrays, {view.name: view for view in named})
    found = trusted(run_stage(align_shared_stage(shared, seed=seed)))
    turn, scale = difference(inverse(world), found.world)
    assert np.degrees(turn) < 0.5
    assert scale < 0.005
    assert found.pixels is not None
    assert found.pixels < 2
    assert turn < 5 * found.turn_error
    assert scale < 5 * found.scale_error


def test_photos_of_two_places_are_refused() -> None:
    """Every match across is wrong."""
    rng = np.random.default_rng(0)
    cameras = [view.resized(640, 480) for view in orbit_cameras(8)]
    names = [f"{'ab'[i >= 4]}/{i}.png" for i in range(8)]
    named = [replace(c, name=name) for c, name in zip(cameras, names, strict=True)]
    arrays = features(rng, tuple(named), (rng.uniform(-0.6, 0.6, (150, 3)),) * 2, wrong=1.0)
    shared = shared_of(arrays, {view.name: view for view in named})
    ways: tuple[By, ...] = ("photos", "surfaces")
    for by in ways:
        with pytest.raises(NotAlignedError) as refused:
            trusted(run_stage(align_shared_stage(shared, by=by)))
        assert ("photo" in str(refused.value)) is (by == "photos")


def test_a_similarity_is_fitted_without_a_mirror() -> None:
    rng = np.random.default_rng(0)
    world, source = any_similarity(rng), rng.normal(size=(5, 20, 3))
    target = source @ world[:3, :3].T + world[:3, 3]
    np.testing.assert_allclose(fit_similarity(source, target), np.tile(world[:3], (5, 1, 1)))
    mirrored = fit_similarity(source[0], target[0] * [1, 1, -1])
    assert np.linalg.det(mirrored[:, :3]) > 0


@pytest.mark.parametrize(
    ("degrees", "scale", "residual", "apart", "how"),
    [
        (0.0, 1.0, 4.63e-06, ("under 0.001 units", "under 1.0 mm"), "not turned, of the same size"),
        (-0.02, 1.00002, 0.5, ("0.5 units", "50.0 cm"), "not turned, of the same size"),
        (12.34, 1.2504, 7.0, ("7 units", "7.00 m"), "turned by 12.3°, 1.25 times as large"),
    ],
)
def test_how_a_capture_lies_is_told_plainly(
    degrees: float, scale: float, residual: float, apart: tuple[str, str], how: str
) -> None:
    world = np.eye(4)
    world[:3, :3] = scale * Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    error = np.radians(0.00005)
    found = Alignment(world, "surfaces", 40, 0.9, residual, None, error, 1e-7)
    for is_metric in (False, True):
        assert found.sentence(is_metric=is_metric) == (
            f"40 points of the surfaces fit, {apart[is_metric]} apart in the median; {how}, "
            "known to under 0.001° and under 0.001 %."
        )
