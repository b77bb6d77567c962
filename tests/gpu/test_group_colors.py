"""A color that a person gave a group shows in the group pictures."""

import numpy as np
import pytest

from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.overlays import Overlays
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import Mode, ViewState
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


def test_muted_colors_stand_in_for_those_of_groups(viewport: Viewport) -> None:
    made = objects_scene()
    scene, view = Scene.of(made.gaussians, made.labels), ViewState(mode=Mode.GROUPS)
    overlays = Overlays(muted={2: (0.5, 0.5, 0.5)})

    def draw(over: Overlays) -> np.ndarray:
        viewport.draw(scene, made.cameras[0], view, over, wait=True)
        return viewport.read_pixels().astype(int)

    before = draw(Overlays())
    calm = draw(overlays)
    differs = (before != calm).any(axis=2)
    assert differs.sum() > 50
    assert np.ptp(calm[differs], axis=1).mean() < 0.6 * np.ptp(before[differs], axis=1).mean()
    np.testing.assert_array_equal(draw(Overlays()), before)
