"""Splats of another file next to those of the scene: one picture with one order."""

from pathlib import Path

import numpy as np
import pytest

from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.overlays import Overlays
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import ViewState
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

pytestmark = pytest.mark.gl
CAMERA = orbit_cameras(1)[0]


@pytest.mark.parametrize("sh_degree", [0, 2])
def test_added_splats_are_drawn_as_if_they_had_always_been_there(
    viewport: Viewport, sh_degree: int
) -> None:
    """Also when their SH are of a higher degree than those of the scene."""

    def picture(scene: Scene) -> np.ndarray:
        viewport.draw(scene, CAMERA, ViewState(show_outline=False), Overlays(), wait=True)
        return viewport.read_pixels().astype(np.int32)

    room = objects_scene(per_object=150)
    scene = Scene.of(room.gaussians, room.labels)
    before = picture(scene)
    history = History(scene)
    other = random_gaussians(300, seed=3, sh_degree=sh_degree)
    history.do(edits.append(scene, other, Path("other.ply"), "digest"))
    both = picture(scene)
    assert np.abs(both - before).max() > 50
    fresh = picture(Scene.of(scene.gaussians, scene.labels))
    assert np.abs(fresh - both).max() <= 1
    picture(scene)
    history.undo()
    assert np.abs(picture(scene) - before).max() <= 1
