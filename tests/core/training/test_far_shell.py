"""The far shell: behind everything, in the directions of a background, in its colors."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.color import rgb_from_dc
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.progress import run_stage
from gaga_core.training.start import (
    CameraBall,
    even_directions,
    far_shell,
    first_splats_stage,
    round_gaussians,
)
from gaga_core.training.views import TrainView
from tests.core.training.train_scenes import CPU, short

_MIDDLE = np.array([3.0, -1.0, 0.5])
_BALL = CameraBall(_MIDDLE + np.eye(3), _MIDDLE, 1.0)


def _wall(directions: DoubleArray, rgb: DoubleArray, distance: float = 2.5) -> Gaussians:
    n = len(directions)
    means = _MIDDLE + distance * directions
    return round_gaussians(means, np.full(n, 0.1), rgb.astype(np.float32), 0.1)


def _towards(direction: DoubleArray, eye: DoubleArray = _MIDDLE, size: int = 32) -> Camera:
    up = np.array([0.0, 0, 1]) if abs(direction[2]) < 0.9 else np.array([1.0, 0, 0])
    K = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1.0]])
    return Camera(K, look_at(eye, eye + direction, up), size, size)


def test_it_is_closed_and_behind_all_cameras_and_splats() -> None:
    wall = _wall(even_directions(300), np.full((300, 3), 0.4))
    shell = far_shell(wall, _BALL, 2000)
    assert len(shell) == 2000
    distances = np.linalg.norm(shell.means - _MIDDLE, axis=1)
    assert distances.min() > 1.1 * 2.5
    for eye in (_MIDDLE, _MIDDLE + np.array([0.0, 1.0, 0.0])):
        for direction in even_directions(8):
            frame = CPU.render(shell, _towards(direction, eye))
            assert frame.alpha.min() > 0.8
            np.testing.assert_allclose(frame.image / frame.alpha[..., None], 0.4, atol=0.01)


def test_it_is_only_where_there_is_a_background_next_to_it() -> None:
    half = even_directions(400)
    half = half[half[:, 0] > 0.2]
    shell = far_shell(_wall(half, np.full((len(half), 3), 0.4)), _BALL, 2000)
    directions = (shell.means - _MIDDLE) / np.linalg.norm(shell.means - _MIDDLE, axis=1)[:, None]
    angles = np.degrees(np.arccos(np.clip(directions @ half.T, -1, 1))).min(axis=1)
    assert angles.max() < 31
    assert (directions[:, 0] < 0).any()
    assert directions[:, 0].min() > -0.45
    near = _wall(half, np.full((len(half), 3), 0.4), distance=1.0)
    assert len(far_shell(near, _BALL, 2000)) == 0
    assert len(far_shell(_wall(half, np.full((len(half), 3), 0.4)), _BALL, 0)) == 0


def test_its_colors_are_those_of_the_background_next_to_it() -> None:
    """A slow change of color goes on in the shell; splats near the middle have no say."""
    directions = even_directions(600)
    rgb = 0.5 + 0.3 * directions
    near = _wall(directions, np.zeros((600, 3)), distance=0.8)
    wall = _wall(directions, rgb)
    both = round_gaussians(
        np.concatenate([near.means, wall.means]).astype(np.float64),
        np.full(1200, 0.1),
        np.concatenate([np.zeros((600, 3)), rgb]).astype(np.float32),
        0.1,
    )
    shell = far_shell(both, _BALL, 1000)
    away = shell.means - _MIDDLE
    expected = 0.5 + 0.3 * away / np.linalg.norm(away, axis=1)[:, None]
    np.testing.assert_allclose(rgb_from_dc(shell.sh[:, 0]), expected, atol=0.06)


@pytest.fixture(scope="module")
def room() -> tuple[DoubleArray, list[TrainView]]:
    """A few points in the middle of a plain room, and photos from around, far apart."""
    rng = np.random.default_rng(0)
    points = _MIDDLE + rng.normal(0, 0.1, (200, 3))
    views = []
    for angle in np.arange(5) * 2 * np.pi / 5:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        camera = _towards(-out, _MIDDLE + out, 64)
        views.append(TrainView(camera, np.full((64, 64, 3), 90, np.uint8)))
    return points, views


@pytest.mark.parametrize("shell", [0, 2000])
def test_a_new_view_between_few_photos_has_no_holes(
    room: tuple[DoubleArray, list[TrainView]], shell: int
) -> None:
    points, views = room
    colors = np.full((len(points), 3), 90, np.uint8)
    config = short(5, cover=3000, shell=shell).with_cap(40_000)
    first = run_stage(first_splats_stage(points, colors, views, config, CPU))
    opaque = replace(first, logit_opacities=np.full(len(first), 3, np.float32))
    out = np.array([np.cos(0.63), np.sin(0.63), 0.0])
    camera = _towards(-out, _MIDDLE + out, 64)
    image: FloatArray = CPU.render(opaque, camera).image
    holes = float((image < 60 / 255).mean())
    assert holes < 0.01 if shell else holes > 0.05


def test_lone_points_do_not_become_fog(room: tuple[DoubleArray, list[TrainView]]) -> None:
    """A point far from all others is no larger than 5 % of its distance to the nearest camera.

    Many photos know better: there it starts as published.
    """
    points, views = room
    lone = np.concatenate([points, _MIDDLE + np.array([[0.6, 0.6, 0.4]])])
    colors = np.full((len(lone), 3), 90, np.uint8)
    first = run_stage(first_splats_stage(lone, colors, views, short(5, cover=3000), CPU))
    positions = np.array([view.camera.position for view in views])
    for i in range(len(lone)):
        nearest = np.linalg.norm(positions - first.means[i], axis=1).min()
        assert first.scales[i].max() <= 0.0501 * nearest
    many = first_splats_stage(lone, colors, 10 * views, short(5, cover=3000), CPU)
    last = len(lone) - 1
    assert run_stage(many).scales[last].max() > 2 * first.scales[last].max()


def test_where_the_background_is_left_out_none_is_made() -> None:
    """An object on black, as masks of the object leave it: all splats are near the object."""
    rng = np.random.default_rng(0)
    points = _MIDDLE + rng.normal(0, 0.03, (200, 3))
    picture = np.zeros((64, 64, 3), np.uint8)
    picture[24:40, 24:40] = 90
    views = []
    for angle in np.arange(5) * 2 * np.pi / 5:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        views.append(TrainView(_towards(-out, _MIDDLE + out, 64), picture))
    colors = np.full((len(points), 3), 90, np.uint8)
    config = short(5, cover=3000, shell=2000).with_cap(40_000)
    first = run_stage(first_splats_stage(points, colors, views, config, CPU))
    assert len(first) > len(points)
    assert np.linalg.norm(first.means - _MIDDLE, axis=1).max() < 1
    lit = replace(config, background=(0.2, 0.2, 0.2))
    around = run_stage(first_splats_stage(points, colors, views, lit, CPU))
    assert np.linalg.norm(around.means - _MIDDLE, axis=1).max() > 2


def test_many_photos_need_none(room: tuple[DoubleArray, list[TrainView]]) -> None:
    points, views = room
    colors = np.full((len(points), 3), 90, np.uint8)

    def n_first(n_copies: int, shell: int) -> int:
        config = short(5, cover=1500, shell=shell).with_cap(40_000)
        stage = first_splats_stage(points, colors, n_copies * views, config, CPU)
        return len(run_stage(stage))

    assert n_first(1, 2000) > n_first(1, 0)
    assert n_first(10, 2000) == n_first(10, 0)
