"""Pictures drawn in parts: the same to the bit, whole before they are shown, never in the way."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.scene.scene import Scene
from gaga_studio.gpu.viewport import Slices, Viewport
from gaga_studio.session.view import Mode, ViewState
from tests.scenes import objects_scene, orbit_cameras

pytestmark = pytest.mark.gl
CAMERA, OTHER_CAMERA = orbit_cameras(2)
VIEW = ViewState()
FRAME_S = 1e-9  # one part a call


@pytest.fixture
def scene() -> Scene:
    made = objects_scene(n_objects=6, per_object=1000)
    return Scene.of(made.gaussians, made.labels)


def _finish(viewport: Viewport, scene: Scene, view: ViewState = VIEW) -> int:
    """Calls until the picture is whole."""
    for n in range(1, 1000):
        viewport.draw(scene, CAMERA, view, wait=True, frame_s=FRAME_S)
        if viewport.settled:
            return n
    raise AssertionError("the picture never becomes whole")


@pytest.mark.parametrize("mode", [Mode.COLOR, Mode.GROUPS, Mode.DEPTH, Mode.RINGS])
def test_parts_make_the_same_picture_to_the_bit(
    viewport: Viewport, scene: Scene, mode: Mode
) -> None:
    view = replace(VIEW, mode=mode)
    viewport.draw(scene, CAMERA, view, wait=True)
    at_once = viewport.read_pixels()
    viewport.draw(scene, OTHER_CAMERA, view, wait=True)
    assert not np.array_equal(viewport.read_pixels(), at_once)
    assert _finish(viewport, scene, view) > 3
    assert np.array_equal(viewport.read_pixels(), at_once)


def test_the_last_picture_stays_until_the_next_is_whole(viewport: Viewport, scene: Scene) -> None:
    viewport.draw(scene, OTHER_CAMERA, VIEW, wait=True)
    before, n = viewport.read_pixels(), viewport.n_draws
    viewport.draw(scene, CAMERA, VIEW, wait=True, frame_s=FRAME_S)
    assert not viewport.settled
    assert viewport.n_draws == n
    assert np.array_equal(viewport.read_pixels(), before)
    _finish(viewport, scene)
    assert viewport.n_draws == n + 1


def test_an_empty_picture_is_none_that_was_drawn(viewport: Viewport) -> None:
    """What it takes says nothing of what pictures of splats take."""
    n = viewport.n_draws
    viewport.draw(None, OTHER_CAMERA, VIEW, frame_s=FRAME_S)
    assert viewport.settled
    assert viewport.n_draws == n


def test_a_draft_is_finished_although_the_camera_goes_on(viewport: Viewport, scene: Scene) -> None:
    viewport.draw(scene, OTHER_CAMERA, VIEW, wait=True)
    n = viewport.n_draws
    for i in range(400):  # every frame another camera: only drafts can ever be whole
        K = CAMERA.K + np.array([[0, 0, 0.01 * i], [0, 0, 0], [0, 0, 0]])
        moved = replace(CAMERA, K=K)
        viewport.draw(scene, moved, VIEW, wait=True, frame_s=FRAME_S, is_draft=True)
    assert viewport.n_draws > n
    assert _finish(viewport, scene) > 1
    whole = viewport.read_pixels()
    viewport.draw(scene, OTHER_CAMERA, VIEW, wait=True)
    viewport.draw(scene, CAMERA, VIEW, wait=True)
    assert np.array_equal(viewport.read_pixels(), whole)


def test_a_draft_has_all_its_splats_whatever_order_comes_meanwhile(
    viewport: Viewport, scene: Scene
) -> None:
    """A shorter one came, and what is nearest was missing: the front half of a room."""
    viewport.draw(scene, CAMERA, VIEW, wait=True)
    whole = viewport.read_pixels()
    viewport.draw(scene, OTHER_CAMERA, VIEW, wait=True)
    viewport.draw(scene, CAMERA, VIEW, wait=True, frame_s=FRAME_S, is_draft=True)
    n = viewport.n_draws
    for i in range(1000):
        view = replace(VIEW, splat_budget=500 + i % 3)
        viewport.draw(scene, OTHER_CAMERA, view, wait=True, frame_s=FRAME_S, is_draft=True)
        if viewport.n_draws > n:
            break
    assert viewport.n_draws == n + 1
    assert np.array_equal(viewport.read_pixels(), whole)


def test_a_scene_that_changes_or_goes_ends_the_parts(viewport: Viewport, scene: Scene) -> None:
    for is_draft in (False, True):
        viewport.draw(scene, CAMERA, VIEW, wait=True, frame_s=FRAME_S, is_draft=is_draft)
        other = objects_scene(n_objects=2, per_object=700, seed=4)
        changed = Scene.of(other.gaussians, other.labels)
        _finish(viewport, changed)
        in_parts = viewport.read_pixels()
        viewport.draw(changed, OTHER_CAMERA, VIEW, wait=True)
        viewport.draw(changed, CAMERA, VIEW, wait=True)
        assert np.array_equal(viewport.read_pixels(), in_parts)
        viewport.draw(changed, OTHER_CAMERA, VIEW, wait=True, frame_s=FRAME_S)
        viewport.draw(None, OTHER_CAMERA, VIEW)
        assert viewport.settled


def test_parts_get_as_long_as_the_frame_has_time() -> None:
    now, cost = [0.0], 1e-5  # seconds a splat
    slices = Slices(lambda: None, lambda: now[0])
    slices.begin(1000)
    for frame in range(20):
        slices.frame(0.05)
        start = now[0]
        while True:
            now[0] += cost * slices.size("blend")
            if slices.is_over():
                break
        slices.leave(start, is_done=False)
        assert now[0] - start < 0.1, frame
    slices.begin(4000)  # four times the pixels: a splat may cost four times as much
    slices.frame(0.05)
    start = now[0]
    now[0] += 4 * cost * slices.size("blend")
    assert now[0] - start < 0.06


@pytest.mark.parametrize("is_draft", [False, True])
def test_slow_panels_do_not_starve_the_picture(is_draft: bool) -> None:
    """Frames whose panels take 0.3 s, on a busy machine, draw it for about as long: pictures of a
    motion came every 13 s, or none until its end."""
    now, left, cost = [0.0], 100_000, 3e-5  # three seconds of splats
    slices = Slices(lambda: None, lambda: now[0])
    slices.begin(1000)
    while left > 0:
        start = now[0]
        slices.frame(0.04, is_draft=is_draft)
        while left > 0:
            n = slices.size("blend")
            left -= n
            now[0] += cost * n
            if slices.is_over():
                break
        slices.leave(start, is_done=left <= 0)
        now[0] += 0.3
    assert now[0] < 8.0
