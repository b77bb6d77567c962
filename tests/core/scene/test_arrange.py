"""Mirror, ground and snapping by their axioms; a mirrored object is drawn as the mirror image."""

import numpy as np
import pytest

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits.history import History
from gaga_core.scene.orientation import ground_map, mirror_map, turn_between
from gaga_core.scene.scene import Scene
from tests.scenes import random_gaussians


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirror_is_its_own_inverse_and_keeps_its_plane(axis: int) -> None:
    about = np.array([0.3, -1.0, 2.0])
    m = mirror_map(axis, about)
    assert np.allclose(m[:, :3] @ about + m[:, 3], about)
    square = np.vstack([m, [0, 0, 0, 1]])
    assert np.allclose(square @ square, np.eye(4))
    assert np.linalg.det(m[:, :3]) == pytest.approx(-1)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_picture_of_a_mirrored_scene_is_the_mirror_image(axis: int) -> None:
    """In the planes through the middle of the picture of a camera that looks along z."""
    scene = Scene.of(random_gaussians(300, seed=3, sh_degree=2))
    away = np.eye(4)
    away[2, 3] = 6.0
    camera = Camera(np.array([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]]), away, 80, 60)
    plain = choose("cpu").render(scene.gaussians, camera).image
    History(scene).do(edits.transform(scene, np.arange(300), mirror_map(axis, np.zeros(3))))
    mirrored = choose("cpu").render(bake(scene), camera).image
    assert np.abs(mirrored - np.flip(plain, 1 - axis)).max() < 2e-3


def test_three_points_of_the_ground_come_to_height_0() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        points, up = rng.normal(size=(3, 3)), rng.normal(size=3)
        up /= np.linalg.norm(up)
        eye = rng.normal(size=3) * 5
        m = ground_map(points, up, eye)
        assert np.allclose(m[:, :3] @ m[:, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(m[:, :3]) == pytest.approx(1)
        laid = points @ m[:, :3].T + m[:, 3]
        assert np.abs(laid @ up).max() < 1e-9
        assert (m[:, :3] @ eye + m[:, 3]) @ up > 0


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_three_points_near_a_line_do_not_say_how_the_ground_lies(
    order: tuple[int, int, int],
) -> None:
    up, eye = np.array([0, 0, 1.0]), np.array([0, 0, 9.0])
    for height in (0.0, 0.05):  # of a triangle that is 4 long
        points = np.array([[0, 0, 0], [4, 0, 0], [1, height, 0.0]])[list(order)]
        with pytest.raises(GagaError, match="nearly on a line"):
            ground_map(points, up, eye)
    corners = np.array([[0, 0, 0], [4, 0, 0], [1, 0.2, 0.0]])[list(order)]
    assert np.allclose(ground_map(corners, up, eye)[:, :3], np.eye(3))
    with pytest.raises(GagaError, match="nearly on a line"):
        ground_map(np.ones((3, 3)), up, eye)


def test_turns_take_one_direction_to_another_even_the_opposite() -> None:
    rng = np.random.default_rng(4)
    for a in rng.normal(size=(20, 3)):
        start = a / np.linalg.norm(a)
        for b in (rng.normal(size=3), start, -start):
            stop = b / np.linalg.norm(b)
            turn = turn_between(start, stop)
            assert np.allclose(turn @ start, stop)
            assert np.allclose(turn @ turn.T, np.eye(3))
            assert np.linalg.det(turn) == pytest.approx(1)
