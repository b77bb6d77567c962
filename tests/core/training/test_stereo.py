"""Multi-view stereo: points lie on the surfaces that photos show, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.progress import run_stage
from gaga_core.training.cpu_train import depth_gradients
from gaga_core.training.start import (
    depth_points,
    first_splats_stage,
    round_gaussians,
    with_sure_depth,
)
from gaga_core.training.stereo import stereo_points_stage
from gaga_core.training.stereo_kernels import REACH, STEP, count_agreeing, match_view, packed
from gaga_core.training.train import train
from gaga_core.training.views import TrainView, TrainViews
from tests.core.training.train_scenes import CPU, short
from tests.scenes import orbit_cameras

_RADIUS = 0.5  # of a ball at the origin; the floor is at z = -_RADIUS


def _texture(p: DoubleArray) -> DoubleArray:
    """Color (..., 3) in 0..1 of places in space: waves of many lengths."""
    rng = np.random.default_rng(4)
    waves = rng.normal(0, 12, (24, 3))
    phases, amounts = rng.uniform(0, 6, 24), rng.normal(0, 0.3, (24, 3))
    result: DoubleArray = np.clip(0.5 + np.sin(p @ waves.T + phases) @ amounts * 0.5, 0, 1)
    return result


def _photo(camera: Camera) -> TrainView:
    """A ball on a floor, cast ray by ray."""
    v, u = np.indices((camera.height, camera.width))
    K = camera.K
    rays = np.stack([(u + 0.5 - K[0, 2]) / K[0, 0], (v + 0.5 - K[1, 2]) / K[1, 1], u * 0 + 1.0], -1)
    rays = rays @ camera.world_from_cam[:3, :3].T
    eye = camera.position
    a, b = (rays**2).sum(-1), rays @ eye
    root = b**2 - a * (eye @ eye - _RADIUS**2)
    to_ball = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    with np.errstate(divide="ignore"):
        to_floor = (-_RADIUS - eye[2]) / rays[..., 2]
    depth = np.minimum(to_ball, np.where(to_floor > 0, to_floor, np.inf))
    seen = np.isfinite(depth)
    color = np.zeros((*depth.shape, 3))
    color[seen] = _texture(eye + rays[seen] * depth[seen, None])
    measured = np.where(seen, depth, 0).astype(np.float32)
    return TrainView(camera, (color * 255).astype(np.uint8), None, measured)


def _off(points: DoubleArray) -> DoubleArray:
    """Distance of points to the nearer of the two surfaces."""
    ball = np.abs(np.linalg.norm(points, axis=1) - _RADIUS)
    result: DoubleArray = np.minimum(ball, np.abs(points[:, 2] + _RADIUS))
    return result


@pytest.fixture(scope="module")
def views() -> tuple[TrainView, ...]:
    cameras = orbit_cameras(14, width=96, height=72, radius=2.0)
    return tuple(replace(_photo(camera), depth=None) for camera in cameras)


@pytest.fixture(scope="module")
def known() -> DoubleArray:
    """Some points, as structure from motion finds them."""
    rng = np.random.default_rng(1)
    on_ball = rng.normal(size=(30, 3))
    on_ball *= _RADIUS / np.linalg.norm(on_ball, axis=1, keepdims=True)
    on_floor = np.c_[rng.uniform(-1.5, 1.5, (30, 2)), np.full(30, -_RADIUS)]
    return np.concatenate([on_ball, on_floor])


def _found(
    known: DoubleArray, views: tuple[TrainView, ...], most: int = 10**6
) -> tuple[DoubleArray, UInt8Array]:
    return run_stage(stereo_points_stage(known, views, most))


def test_points_lie_on_the_surfaces_in_their_colors(
    known: DoubleArray, views: tuple[TrainView, ...]
) -> None:
    points, colors = _found(known, views)
    assert len(points) > 2000
    off = _off(points)
    assert np.median(off) < 0.005
    assert np.quantile(off, 0.98) < 0.03
    assert np.median(np.abs(colors / 255 - _texture(points))) < 0.06


def test_what_no_other_photo_confirms_is_left_out(
    known: DoubleArray, views: tuple[TrainView, ...]
) -> None:
    """Photos of noise match nothing: no point comes of them, and few of the others are lost."""
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 256, v.picture.shape).astype(np.uint8) for v in views]
    noisy = tuple(TrainView(v.camera, picture) for v, picture in zip(views, noise, strict=True))
    assert len(_found(known, noisy[:5])[0]) < 10
    one = (*views[:5], noisy[5], *views[6:8])
    points, _ = _found(known, one)
    assert len(points) > 800
    assert np.quantile(_off(points), 0.98) < 0.03


def test_a_surface_is_taken_from_the_first_photo_that_shows_it() -> None:
    """Three depth maps of one camera; the third is off by 2 % and confirms nothing."""
    shape = (5, 7)
    one = np.random.default_rng(0).uniform(0.5, 1, shape).astype(np.float32)
    one[2, 3] = 0  # no depth here
    maps = np.concatenate([one.ravel(), one.ravel(), 1.02 * one.ravel()]).astype(np.float32)
    places = np.array([[35, 7, 5], [70, 7, 5]])
    M, t = np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3))
    for is_before in (True, False):
        counts, is_new = np.zeros(shape, np.int32), np.ones(shape, np.bool_)
        before = np.array([is_before, is_before])
        count_agreeing(one, maps, places, M, t, before, 0.01, counts, is_new)
        np.testing.assert_array_equal(counts, one > 0)
        np.testing.assert_array_equal(is_new, (one == 0) | (not is_before))


def test_the_points_do_not_depend_on_threads(
    known: DoubleArray, views: tuple[TrainView, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_THREADS", "1")
    one = _found(known, views[:5], 500)
    monkeypatch.setenv("GAGA_THREADS", "3")
    three = _found(known, views[:5], 500)
    assert len(one[0]) == 500
    np.testing.assert_array_equal(one[0], three[0])
    np.testing.assert_array_equal(one[1], three[1])


def test_without_shared_points_nothing_is_found(views: tuple[TrainView, ...]) -> None:
    assert len(_found(np.zeros((0, 3)), views)[0]) == 0
    assert len(_found(np.full((9, 3), 50.0), views)[0]) == 0


def test_a_training_starts_from_them(known: DoubleArray, views: tuple[TrainView, ...]) -> None:
    """Up to as many as the settings say and the cap on splats allows."""
    colors = np.full((len(known), 3), 128, np.uint8)

    def first(stereo: int, cap: int) -> int:
        config = short(5, stereo=stereo, cover=0).with_cap(cap)
        return len(run_stage(first_splats_stage(known, colors, views[:5], config, CPU)))

    assert first(0, 1000) == len(known)
    assert first(300, 1000) == 300
    assert first(300, 200) == 200
    assert first(30, 1000) == len(known)


def test_measured_depth_takes_the_place_of_matching(
    known: DoubleArray, views: tuple[TrainView, ...]
) -> None:
    """Its points lie on the surfaces in their colors; in another unit it is not used."""
    measured = TrainViews(tuple(_photo(view.camera) for view in views), ())
    sure = with_sure_depth(measured, known).train
    points, colors = depth_points(sure, 3000, 0)
    assert len(points) == 3000
    assert _off(points).max() < 1e-5
    assert np.abs(colors / 255 - _texture(points)).max() < 0.01
    assert np.ptp(points, axis=0).min() > 0.8  # of all views, the whole ball
    coarse = [_with_depth(v, np.ascontiguousarray(_depth(v)[1::3, 1::3])) for v in sure]
    assert _off(depth_points(coarse, 500, 0)[0]).max() < 1e-5
    for factor in (0.5, 1000):
        wrong = tuple(_with_depth(v, _depth(v) * np.float32(factor)) for v in sure)
        assert len(depth_points(with_sure_depth(TrainViews(wrong, ()), known).train, 9, 0)[0]) == 0
    config = short(5, stereo=300, cover=0).with_cap(1000)
    first = first_splats_stage(known, np.full((len(known), 3), 128, np.uint8), sure, config, CPU)
    assert _off(run_stage(first).means[len(known) :].astype(np.float64)).max() < 1e-5


def _depth(view: TrainView) -> FloatArray:
    assert view.depth is not None
    return view.depth


def _with_depth(view: TrainView, depth: FloatArray) -> TrainView:
    return replace(view, depth=depth)


def test_gradients_of_depth_are_those_of_its_error(views: tuple[TrainView, ...]) -> None:
    """By differences, for every parameter that moves what is drawn; of any size of map."""
    rng = np.random.default_rng(0)
    means = rng.normal(0, 0.3, (12, 3))
    splats = round_gaussians(
        means, rng.uniform(0.1, 0.3, 12), rng.random((12, 3)).astype(np.float32), 0.6
    )
    splats = replace(splats, quats=rng.normal(size=(12, 4)).astype(np.float32))
    splats.log_scales[:] += rng.normal(0, 0.3, (12, 3)).astype(np.float32)
    small = views[0].camera.resized(48, 36)
    seen = CPU.render(splats, small).alpha > 0.2
    nearer = np.where(seen, np.float32(1.3), 0).astype(np.float32)  # than any splat
    view = replace(views[0], depth=nearer)

    def error(changed: Gaussians) -> float:
        drawn = CPU.render(changed, small).expected_depth[seen] / 1.3
        return float(np.abs(drawn - 1).mean())

    found = depth_gradients(splats, view, CPU, 1.0)
    assert found is not None
    for name in ("means", "log_scales", "logit_opacities", "quats"):
        column, gradient = getattr(splats, name), getattr(found, name)
        way = rng.normal(size=column.shape).astype(np.float32)
        if name == "quats":  # their length changes nothing
            way -= (way * column).sum(1, keepdims=True) * column / (column**2).sum(1, keepdims=True)
        ends = [
            error(replace(splats, **{name: column + np.float32(side * 2e-3) * way}))
            for side in (-1, 1)
        ]
        expected = (ends[1] - ends[0]) / 4e-3
        assert float((gradient * way).sum()) == pytest.approx(expected, rel=0.1, abs=2e-3)
    assert depth_gradients(splats, views[0], CPU, 1.0) is None
    large = replace(view, depth=nearer.repeat(7, axis=0).repeat(7, axis=1))  # every third pixel
    same = depth_gradients(splats, large, CPU, 1.0)
    assert same is not None
    assert np.abs(same.means - found.means).max() < 0.1 * np.abs(found.means).max()


def test_a_training_with_depth_has_its_surfaces_nearer(
    known: DoubleArray, views: tuple[TrainView, ...]
) -> None:
    measured = tuple(_photo(view.camera) for view in views[:6])
    colors = np.full((len(known), 3), 128, np.uint8)

    def off(weight: float) -> float:
        config = short(100, cover=0, depth=weight)
        first = run_stage(first_splats_stage(known, colors, measured, config, CPU))
        splats = train(first, TrainViews(measured, ()), config, CPU).gaussians
        found = []
        for view in measured:
            frame = CPU.render(splats, view.camera)
            both = (frame.alpha > 0.5) & (_depth(view) > 0)
            found.append(np.median(np.abs(frame.expected_depth / _depth(view) - 1)[both]))
        return float(np.mean(found))

    assert off(0.4) < 0.6 * off(0.0)


def _plain_similarity(
    grey: FloatArray,
    other: FloatArray,
    x: int,
    y: int,
    plane: DoubleArray,
    M: DoubleArray,
    t: DoubleArray,
) -> float:
    """Weighted correlation as `stereo_kernels` defines it, sample by sample."""
    height, width = grey.shape
    sums = np.zeros(6)
    for dy in range(-REACH, REACH + 1, STEP):
        for dx in range(-REACH, REACH + 1, STEP):
            depth = plane[0] + dx * plane[1] + dy * plane[2]
            q = M @ [x + dx, y + dy, 1] + depth * t
            u, v = q[:2] / q[2]
            if q[2] < 1e-9 or not (0 <= u < width - 1 and 0 <= v < height - 1):
                continue
            b = map_coordinates(other, [[v], [u]], order=1)[0]
            a = grey[min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)]
            weight = np.exp(-((a - grey[y, x]) ** 2) / (2 * 0.12**2))
            sums += weight * np.array([1, a, b, a * a, b * b, a * b])
    total, a, b, aa, bb, ab = sums
    result: float = (ab * total - a * b) / np.sqrt((aa * total - a * a) * (bb * total - b * b))
    return result


@pytest.mark.parametrize(("forwards", "slope"), [(0.1, 0.02), (1.0, 0.15)])
def test_windows_are_compared_as_their_definition_says(forwards: float, slope: float) -> None:
    """Whole ones and those that leave the other picture, which is stored in 8 bits; by a camera
    that went ``forwards``, of planes with such a slope: there some depths are several times others.
    """
    rng = np.random.default_rng(2)
    blurred = (gaussian_filter(rng.random((40, 50)), 1.0) * 2 - 0.5 for _ in range(2))
    grey, other = (np.clip(picture, 0, 1).astype(np.float32) for picture in blurred)
    M = np.eye(3) + rng.normal(0, 1e-4, (3, 3))
    sources, t = np.array([[0, 50, 40]]), np.array([[5, 3, forwards]])
    compared = 0
    for _ in range(300):
        x, y = int(rng.integers(0, 50)), int(rng.integers(0, 40))
        plane = np.array([rng.uniform(0.1, 1), *rng.normal(0, slope, 2)])
        planes, scores = np.zeros((40, 50, 3)), np.zeros((40, 50), np.float32)
        planes[y, x] = plane
        match_view(grey, packed(other), sources, M[None], t, 0.0, 2.0, 1.0, 0, 1, planes, scores)
        if scores[y, x] > -1:  # or too little of it is seen
            assert scores[y, x] == pytest.approx(
                _plain_similarity(grey, other, x, y, plane, M, t[0]), abs=0.01
            )
            compared += 1
    assert compared > 100
