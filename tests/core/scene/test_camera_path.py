"""The camera's path: through its keyframes, smoothly, at the speed that was asked for."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.scene.camera_path import (
    Bookmark,
    CameraPath,
    Keyframe,
    Shot,
    bookmarks_entry,
    bookmarks_of,
    load_path,
    path_entry,
    path_of,
    save_path,
    turntable,
)
from tests.core.scene.shots import shot_towards

UP = np.array([0.0, 0.0, 1.0])


def _walk(n: int, seed: int, *, is_closed: bool = False, even_speed: bool = False) -> CameraPath:
    """Keyframes at random places that look at random targets, after unequal times."""
    rng = np.random.default_rng(seed)
    keys = []
    for _ in range(n):
        eye, target = rng.normal(size=3) * 3, rng.normal(size=3)
        shot = shot_towards(eye, target, UP, float(rng.uniform(0.4, 1.5)))
        keys.append(Keyframe(shot, float(rng.uniform(0.3, 4))))
    return CameraPath(tuple(keys), is_closed, even_speed)


def _state(path: CameraPath, t: float) -> DoubleArray:
    """Eye, rotation matrix and fields of view at a moment: no signs to mind."""
    shot = path.shot(t)
    turn = quats_to_matrices(np.array([shot.quat]))[0].ravel()
    return np.concatenate([shot.eye, turn, [shot.fov_x, shot.fov_y]])


@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize("even_speed", [False, True])
def test_it_passes_through_every_keyframe(is_closed: bool, even_speed: bool) -> None:
    path = _walk(5, 1, is_closed=is_closed, even_speed=even_speed)
    assert len(path.times()) == 5
    for key, t in zip(path.keyframes, path.times(), strict=True):
        still = CameraPath((key,))
        np.testing.assert_allclose(_state(path, t), _state(still, 0), atol=1e-6)
    assert path.shot(-1) == path.shot(0)
    if is_closed:
        np.testing.assert_allclose(_state(path, path.seconds), _state(path, 0), atol=1e-9)
    else:
        np.testing.assert_allclose(_state(path, 99), _state(path, path.seconds), atol=1e-9)


@pytest.mark.parametrize("even_speed", [False, True])
def test_two_keyframes_are_a_straight_line(even_speed: bool) -> None:
    path = _walk(2, 4, even_speed=even_speed)
    (start, stop), t = path.times(), np.linspace(0, 1, 9)
    eyes = np.array([path.shot(start + float(x) * (stop - start)).eye for x in t])
    np.testing.assert_allclose(eyes, eyes[0] + t[:, None] * (eyes[-1] - eyes[0]), atol=1e-6)


@pytest.mark.parametrize("is_closed", [False, True])
def test_its_speed_has_no_jumps(is_closed: bool) -> None:
    path = _walk(6, 2, is_closed=is_closed)
    h = 1e-5
    joints = [t for t in path.times() if h < t < path.seconds - h]
    assert len(joints) >= 4
    for t in joints:
        before = (_state(path, t) - _state(path, t - h)) / h
        after = (_state(path, t + h) - _state(path, t)) / h
        np.testing.assert_allclose(before, after, atol=2e-3 * (1 + np.abs(before).max()))
    if is_closed:
        out = (_state(path, h) - _state(path, 0)) / h
        back = (_state(path, path.seconds) - _state(path, path.seconds - h)) / h
        np.testing.assert_allclose(out, back, atol=2e-3 * (1 + np.abs(out).max()))


def test_even_speed_is_even_and_takes_as_long() -> None:
    path = _walk(5, 3, even_speed=True)
    assert path.seconds == pytest.approx(replace(path, even_speed=False).seconds)
    times = np.linspace(0, path.seconds, 400)
    eyes = np.array([path.shot(float(t)).eye for t in times])
    steps = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    assert steps.std() / steps.mean() < 0.02
    uneven = np.array([replace(path, even_speed=False).shot(float(t)).eye for t in times])
    steps = np.linalg.norm(np.diff(uneven, axis=0), axis=1)
    assert steps.std() / steps.mean() > 0.2


def test_even_speed_keeps_the_time_of_a_turn_on_the_spot() -> None:
    eye = np.zeros(3)
    shots = [
        shot_towards(eye, np.array([1.0, 0, 0]), UP, 1.0),
        shot_towards(eye, np.array([0, 1.0, 0]), UP, 1.0),
    ]
    path = CameraPath(tuple(Keyframe(shot, 3.0) for shot in shots), even_speed=True)
    assert path.times() == (0.0, 3.0)
    forward = quats_to_matrices(np.array([path.shot(1.5).quat]))[0][2]
    np.testing.assert_allclose(forward, [math.sqrt(0.5), math.sqrt(0.5), 0], atol=1e-6)


def test_a_turntable_keeps_its_distance_and_looks_at_its_middle() -> None:
    pivot, up = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, 1.0])
    axis = up / np.linalg.norm(up)
    shot = shot_towards(np.array([4.0, 0.0, 3.0]), pivot, axis, 0.9)
    path = turntable(shot, up, 8.0)
    assert path.seconds == pytest.approx(8.0)
    height = (np.array(shot.eye) - pivot) @ axis
    angles = []
    for t in np.linspace(0, 8, 97)[:-1]:
        now = path.shot(float(t))
        camera = now.camera(640, 480)
        assert np.linalg.norm(np.array(now.eye) - pivot) == pytest.approx(shot.distance, rel=1e-3)
        assert (np.array(now.eye) - pivot) @ axis == pytest.approx(height, abs=1e-9)
        pixels, _ = camera.project(pivot[None])
        assert np.abs(pixels[0] - [320, 240]).max() < 1.0
        flat = np.array(now.eye) - pivot - height * axis
        angles.append(flat / np.linalg.norm(flat))
    turns = np.cross(angles, np.roll(angles, -1, axis=0)) @ axis
    np.testing.assert_allclose(turns, math.sin(2 * math.pi / 96), rtol=0.05)
    assert (np.cross(*np.array([path.shot(t).eye - pivot for t in (0, 1)])) @ axis) > 0


@pytest.mark.parametrize(
    ("eye", "pivot", "begins_here"),
    [
        ((0.2, -0.9, 1.5), (0.0, 0.2, 0.8), True),  # from between the photos
        ((0.1, 1.2, 1.2), (0.0, 1.8, 1.0), True),  # nearer to a wall than any photo
        ((7.0, -9.0, 7.5), (0.0, 0.2, 0.8), False),  # from far behind all photos
        ((-2.4, 0.1, 1.5), (0.3, 0.2, 0.8), False),  # from behind a wall
        ((0.1, 3.0, 1.2), (0.0, 1.6, 1.0), False),  # from behind the wall that it looks at
    ],
)
def test_a_turntable_stays_between_the_photos(
    eye: tuple[float, float, float], pivot: tuple[float, float, float], begins_here: bool
) -> None:
    """Walls stand at 2 from the middle of the photos, which were taken to 1 from it."""
    places = np.random.default_rng(5).uniform((-1, -1, 1), (1, 1, 2), (60, 3))
    shot = shot_towards(np.array(eye), np.array(pivot), UP, 0.9)
    path = turntable(shot, UP, 8.0, seen_from=places)
    eyes = np.array([path.shot(t).eye for t in np.linspace(0, 8, 97)])
    assert np.abs(eyes[:, :2]).max() < 1.3
    assert eyes[:, 2].max() < 2.3
    first = path.keyframes[0].shot
    assert (np.linalg.norm(np.array(first.eye) - eye) < 1e-9) == begins_here
    assert np.ptp(eyes, axis=0).max() > 0.5, "it goes around"
    for key in path.keyframes:
        pixels, depth = key.shot.camera(640, 480).project(np.array(pivot)[None])
        assert np.abs(pixels[0] - [320, 240]).max() < 1
        assert depth[0] > 0


@pytest.mark.parametrize("heading", np.radians([0, 20, 45, 110, 225, 300]))
def test_a_turntable_stays_on_the_side_of_a_wall_that_photos_saw(heading: float) -> None:
    """It went behind walls that lie across to the axes of the scene."""
    angles = heading + np.radians(np.linspace(-60, 60, 13))
    places = np.stack([3 * np.cos(angles), 3 * np.sin(angles), np.full(13, 1.5)], axis=1)
    front = np.array([np.cos(heading), np.sin(heading), 0])
    for eye in (places[3], 1.5 * places[9]):
        path = turntable(shot_towards(eye, np.zeros(3), UP, 0.9), UP, 8.0, seen_from=places)
        eyes = np.array([path.shot(t).eye for t in np.linspace(0, 8, 97)])
        assert (eyes @ front).min() > 1
        assert np.ptp(eyes, axis=0).max() > 0.5, "it goes from side to side"


def test_frames_of_a_film() -> None:
    path = _walk(3, 4)
    times = path.frame_times(24)
    assert len(times) == round(path.seconds * 24) + 1
    assert times[0] == 0
    assert times[-1] == pytest.approx(path.seconds, abs=0.5 / 24)
    # A closed one is played round and round: its first picture comes once.
    ring = turntable(path.keyframes[0].shot, UP, 2.0)
    assert len(ring.frame_times(25)) == 50
    assert len(CameraPath(path.keyframes[:1]).frame_times(30)) == 1


def test_a_shot_is_the_camera_that_it_was_made_of() -> None:
    shot = _walk(1, 5).keyframes[0].shot
    camera = shot.camera(800, 600)
    again = Shot.of_camera(camera, shot.distance).camera(800, 600)
    np.testing.assert_allclose(again.cam_from_world, camera.cam_from_world, atol=1e-12)
    np.testing.assert_allclose(again.K, camera.K, rtol=1e-12)


def test_json_round_trips(tmp_path: Path) -> None:
    path = _walk(4, 6, is_closed=True, even_speed=True)
    assert path_of(json.loads(json.dumps(path_entry(path)))) == path
    assert load_path(save_path(path, tmp_path / "p.json")) == path
    marks = (
        Bookmark("door", path.keyframes[0].shot, 3),
        Bookmark("Fenster", replace(path.keyframes[1].shot, is_orthographic=True)),
    )
    assert bookmarks_of(json.loads(json.dumps(bookmarks_entry(marks)))) == marks


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", '{"kind": "x"}', '{"kind": "gaga camera path", "format": 2, "keyframes": []}'],
)
def test_what_is_no_path_gets_one_sentence(tmp_path: Path, text: str) -> None:
    file = tmp_path / "p.json"
    file.write_text(text)
    with pytest.raises(GagaError, match=r"p.json is .*Camera, Save path"):
        load_path(file)
    with pytest.raises(GagaError, match="does not exist"):
        load_path(tmp_path / "none.json")


@pytest.mark.parametrize(
    "spoil",
    [
        {"eye": [0, 0]},
        {"eye": [0, 0, "x"]},
        {"eye": [0, 0, float("nan")]},
        {"fov": [0, 1]},
        {"distance": -1},
        {"quat": [0, 0, 0, 0]},
        {"seconds": 0},
        {"seconds": None},
    ],
)
def test_damaged_keyframes_are_refused_and_damaged_bookmarks_left_out(
    spoil: dict[str, object],
) -> None:
    entry = path_entry(_walk(2, 7))
    keys = entry["keyframes"]
    assert isinstance(keys, list)
    keys[1].update(spoil)
    with pytest.raises(ValueError, match=r"."):
        path_of(entry)
    if "seconds" not in spoil:
        good = bookmarks_entry((Bookmark("a", _walk(1, 8).keyframes[0].shot),))
        assert [b.name for b in bookmarks_of([{**good[0], **spoil}, *good, 7])] == ["a"]


def test_a_thrown_ball_stays_on_its_parabola_whatever_the_times() -> None:
    spans = (0.5, 2.0, 0.7, 1.3)
    knots = np.concatenate([[0.0], np.cumsum(spans)])

    def ball(t: float) -> DoubleArray:
        return np.array([1.0 + t, -2.0 * t, 3 * t - 0.7 * t * t])

    base = shot_towards(np.zeros(3), np.array([0.0, 5, 0]), UP, 1.0)
    shots = [replace(base, eye=tuple(ball(float(t)).tolist())) for t in knots]
    keys = [Keyframe(shot, span) for shot, span in zip(shots, (1.0, *spans), strict=True)]
    path = CameraPath(tuple(keys))
    for t in np.linspace(0, path.seconds, 50):
        np.testing.assert_allclose(path.shot(float(t)).eye, ball(float(t)), atol=1e-9)


def test_moments_that_vanish_in_a_sum_are_refused() -> None:
    path = turntable(shot_towards(np.array([0.0, -3.0, 0.0]), np.zeros(3), UP, 1.0), UP)
    content = json.loads(json.dumps(path_entry(path)))
    content["keyframes"][0]["seconds"] = 1e-300
    with pytest.raises(ValueError, match="seconds"):
        path_of(content)
