"""A color that a person gave a group shows in the group pictures."""

import numpy as np
import pytest

from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view_state import Mode, ViewState
from tests.scenes import objects_scene

pytestmark = pytest.mark.gl


def test_a_group_color_shows_and_undo_takes_it_back(viewport: Viewport) -> None:
    made = objects_scene()
    scene = Scene.of(made.gaussians, made.labels)
    history, view = History(scene), ViewState(mode=Mode.GROUPS)

    def picture() -> np.ndarray:
        viewport.draw(scene, made.cameras[0], view, wait=True)
        return viewport.read_pixels()

    before = picture()
    viewport.buffers.uploads.clear()
    history.do(edits.set_color(scene, 2, (1.0, 0.0, 0.0)))
    red = picture().astype(int)
    assert (red[..., 0] > red[..., 1:].max(axis=2) + 150).sum() > 50
    assert viewport.buffers.uploads.total() == 0  # a palette, not a splat, was sent
    history.undo()
    np.testing.assert_array_equal(picture(), before)
