"""The camera rig: motions by their laws."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.geometry import look_at, quats_to_matrices
from gaga_core.scene.orientation import common_target, estimate_up, upright_basis
from gaga_core.scene.scene import Scene
from gaga_studio.session.camera_rig import CameraRig
from tests.scenes import orbit_cameras, random_gaussians

_W, _H = 800, 600
_BOX = (np.array([-1.0, -2.0, -0.5]), np.array([1.5, 1.0, 0.5]))


def _random_rotation(seed: int) -> DoubleArray:
    quat = np.random.default_rng(seed).normal(size=(1, 4))
    return quats_to_matrices(quat)[0]


def _rotated(camera: Camera, rotation: DoubleArray) -> Camera:
    """The camera in a world that was turned by ``rotation``."""
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    return Camera(camera.K, camera.cam_from_world @ pose, camera.width, camera.height, camera.name)


def _rig(seed: int = 0) -> CameraRig:
    rig = CameraRig()
    cameras = [_rotated(c, _random_rotation(seed)) for c in orbit_cameras(6)]
    rig.frame_scene(*_BOX, cameras)
    rig.camera(_W, _H)
    return rig


def _pixel(camera: Camera, point: DoubleArray) -> DoubleArray:
    pixels, depth = camera.project(point[None])
    assert depth[0] > 0
    return pixels[0]


@pytest.mark.parametrize("seed", range(5))
def test_go_to_stands_exactly_where_the_photo_was_taken(seed: int) -> None:
    rig = _rig(seed)
    rng = np.random.default_rng(seed)
    pose = look_at(rng.normal(size=3), rng.normal(size=3), rng.normal(size=3))  # any roll
    K = np.array([[500.0, 0, 320], [0, 480, 240], [0, 0, 1]])
    photo = Camera(K, pose, 640, 480)
    rig.go_to(photo, animated=False)
    seen = rig.camera(_W, _H)
    np.testing.assert_allclose(seen.cam_from_world, pose, atol=1e-9)
    corners = np.array([[0, 0], [640, 0], [640, 480], [0, 480]])
    for u, v in corners:
        at = _pixel(seen, photo.unproject(u, v, 2.0))
        assert -1e-6 <= at[0] <= _W + 1e-6
        assert -1e-6 <= at[1] <= _H + 1e-6


def test_first_view_is_the_first_photo_and_turns_around_what_all_photos_show() -> None:
    cameras = orbit_cameras(8)
    rig = CameraRig()
    rig.frame_scene(*_BOX, cameras)
    np.testing.assert_allclose(rig.eye, cameras[0].position, atol=1e-9)
    np.testing.assert_allclose(rig.up, [0, 0, 1])
    np.testing.assert_allclose(rig.pivot, 0, atol=1e-6)


def test_orbit_keeps_the_pivot_in_the_middle_and_its_distance() -> None:
    rig = _rig(1)
    distance, pivot = rig.pose.distance, rig.pivot
    for dx, dy in ((100, 30), (-400, 200), (17, -900)):
        rig.orbit(dx, dy)
        np.testing.assert_allclose(_pixel(rig.camera(_W, _H), pivot), [_W / 2, _H / 2], atol=1e-6)
        assert np.linalg.norm(rig.eye - pivot) == pytest.approx(distance)


def test_orbit_drags_the_scene_with_the_mouse() -> None:
    rig = CameraRig()
    rig.frame_scene(*_BOX, orbit_cameras(4))
    camera = rig.camera(_W, _H)
    nearer = camera.unproject(_W / 2, _H / 2, 0.8 * rig.pose.distance)
    rig.orbit(40, 0)
    assert _pixel(rig.camera(_W, _H), nearer)[0] > _W / 2
    rig.orbit(-40, 25)
    assert _pixel(rig.camera(_W, _H), nearer)[1] > _H / 2


def test_orbit_never_turns_the_world_upside_down() -> None:
    rig = _rig(2)
    rig.pose = rig.pose.__class__(rig.pivot, 2.0, 0.3, 0.0)
    for _ in range(50):
        rig.orbit(3, 500)
        camera = rig.camera(_W, _H)
        assert camera.cam_from_world[0, :3] @ rig.up == pytest.approx(0, abs=1e-9)
        assert -camera.cam_from_world[1, :3] @ rig.up > 0


def test_orbit_there_and_back_is_nothing() -> None:
    rig = _rig(3)
    before = rig.camera(_W, _H).cam_from_world
    rig.orbit(123, 45)
    rig.orbit(-123, -45)
    np.testing.assert_allclose(rig.camera(_W, _H).cam_from_world, before, atol=1e-9)


def test_look_keeps_the_eye() -> None:
    rig = _rig(4)
    eye = rig.eye
    rig.look(200, -90)
    np.testing.assert_allclose(rig.eye, eye, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_pan_moves_the_pivot_with_the_mouse(seed: int) -> None:
    rig = _rig(seed)
    pivot = rig.pivot
    rig.pan(60, -35)
    np.testing.assert_allclose(
        _pixel(rig.camera(_W, _H), pivot), [_W / 2 + 60, _H / 2 - 35], atol=1e-6
    )


def test_zoom_goes_nearer_and_back() -> None:
    rig = _rig()
    far = rig.pose.distance
    rig.zoom(3)
    assert rig.pose.distance < far
    rig.zoom(-3)
    assert rig.pose.distance == pytest.approx(far)
    rig.zoom(10_000)
    assert rig.pose.distance > 0


def test_flying_is_proportional_to_time_and_goes_where_it_looks() -> None:
    one, many = _rig(5), _rig(5)
    eye, forward = one.eye, one.camera(_W, _H).forward
    one.fly((0, 0, 1), 0.5)
    for _ in range(50):
        many.fly((0, 0, 1), 0.01)
    np.testing.assert_allclose(one.eye, many.eye, atol=1e-9)
    step = one.eye - eye
    assert step @ forward == pytest.approx(np.linalg.norm(step))
    assert np.linalg.norm(step) > 0


def test_jump_ends_exactly_and_does_not_depend_on_the_frame_rate() -> None:
    goal = orbit_cameras(7)[3]
    smooth, coarse = _rig(), _rig()
    for rig, dt in ((smooth, 0.01), (coarse, 0.05)):
        rig.go_to(goal)
        for _ in range(round(0.2 / dt)):
            assert rig.update(dt)
        assert rig.is_moving
    np.testing.assert_allclose(smooth.eye, coarse.eye, atol=1e-9)
    while smooth.update(0.01):
        pass
    np.testing.assert_allclose(smooth.camera(_W, _H).cam_from_world, goal.cam_from_world, atol=1e-9)
    assert not smooth.is_moving
    assert not smooth.update(0.01)


def test_a_drag_ends_a_jump() -> None:
    rig = _rig()
    rig.go_to(orbit_cameras(7)[3])
    rig.update(0.1)
    rig.orbit(5, 5)
    pose = rig.pose
    assert not rig.update(0.1)
    assert rig.pose is pose


@pytest.mark.parametrize("size", [(800, 600), (300, 900), (1600, 200)])
def test_a_lone_model_is_shown_whole(size: tuple[int, int]) -> None:
    rig = CameraRig()
    rig.frame_scene(*_BOX)
    camera = rig.camera(*size)
    lo, hi = _BOX
    middle = (lo + hi) / 2
    np.testing.assert_allclose(_pixel(camera, middle), [size[0] / 2, size[1] / 2], atol=1e-6)
    for corner in np.stack(np.meshgrid(*zip(lo, hi, strict=True)), -1).reshape(-1, 3):
        at = _pixel(camera, corner)
        assert 0 <= at[0] <= size[0]
        assert 0 <= at[1] <= size[1]
    np.testing.assert_array_equal(rig.up, [0, -1, 0])
    assert camera.position @ rig.up > middle @ rig.up  # from a little above


def test_focus_shows_the_whole_ball() -> None:
    rig = _rig(6)
    centre = np.array([0.3, -0.4, 0.2])
    rig.focus(centre, 0.25, animated=False)
    camera = rig.camera(_W, _H)
    np.testing.assert_allclose(_pixel(camera, centre), [_W / 2, _H / 2], atol=1e-6)
    rng = np.random.default_rng(0)
    for out in rng.normal(size=(50, 3)):
        at = _pixel(camera, centre + 0.25 * out / np.linalg.norm(out))
        assert 0 <= at[0] <= _W
        assert 0 <= at[1] <= _H


@pytest.mark.parametrize("axis", ["front", "back", "left", "right", "top", "bottom"])
def test_axis_views_look_at_the_pivot_along_an_axis(axis: str) -> None:
    rig = _rig(7)
    pivot = rig.pivot
    rig.look_along(axis)
    while rig.update(0.1):
        pass
    camera = rig.camera(_W, _H)
    np.testing.assert_allclose(_pixel(camera, pivot), [_W / 2, _H / 2], atol=1e-6)
    local = np.abs(upright_basis(rig.up) @ camera.forward)
    assert local.max() > 0.99999


@pytest.mark.parametrize("seed", range(6))
def test_up_turns_with_the_world(seed: int) -> None:
    rotation = _random_rotation(seed)
    half = orbit_cameras(12)[:5]  # seen from one side only
    up = estimate_up([_rotated(c, rotation) for c in half])
    assert up @ rotation @ np.array([0, 0, 1.0]) > np.cos(np.radians(3.1))


def test_up_of_cameras_that_look_the_same_way_is_the_top_of_their_pictures() -> None:
    camera = orbit_cameras(4)[0]
    up = estimate_up([camera, camera])
    assert up @ -camera.cam_from_world[1, :3] > 0.99


def test_common_target_is_where_the_axes_meet() -> None:
    target = common_target(orbit_cameras(9, target_height=0.4))
    assert target is not None
    np.testing.assert_allclose(target, [0, 0, 0.4], atol=1e-6)
    camera = orbit_cameras(2)[0]
    assert common_target([camera, camera]) is None


def test_upright_basis_is_a_rotation() -> None:
    for seed in range(5):
        up = _random_rotation(seed)[2]
        basis = upright_basis(up)
        np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(basis) == pytest.approx(1)
        np.testing.assert_allclose(basis @ up, [0, 0, 1], atol=1e-12)


def test_the_first_view_of_what_a_shell_surrounds_is_inside_of_it() -> None:
    """As of a training on few photos, whose far shell of blurred colors is closed."""
    rng = np.random.default_rng(0)
    out = rng.normal(size=(4000, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    means = np.concatenate([0.3 * out[:3000], 3 * out[3000:]]).astype(np.float32)
    sizes = np.repeat(np.log([0.02, 0.4]), [3000, 1000]).astype(np.float32)
    splats = replace(
        random_gaussians(4000),
        means=means,
        log_scales=np.repeat(sizes[:, None], 3, axis=1),
        logit_opacities=np.full(4000, 4.0, np.float32),
    )
    box, rig = (np.full(3, -3.0), np.full(3, 3.0)), CameraRig()
    rig.frame_scene(*box)
    way = rig.camera(100, 100).position
    is_before = out @ way > 0.8 * np.linalg.norm(way)
    for kept in (np.arange(4000) < 4000, (np.arange(4000) < 3000) | ~is_before):  # closed, open
        rig.frame_scene(*box)
        rig.turn_to_clearest(Scene.of(splats.take(np.flatnonzero(kept))), box)
        assert 0.5 < np.linalg.norm(rig.camera(100, 100).position) < 8
    rig.frame_scene(*box)
    rig.turn_to_clearest(Scene.of(splats.take(np.arange(3000))), box)
    np.testing.assert_allclose(rig.camera(100, 100).position, way, atol=1e-6)
