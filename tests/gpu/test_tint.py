"""A color over that of each splat, and centres in the colors of their groups."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.color import group_palette
from gaga_core.scene.scene import Identities, Scene
from gaga_studio.gpu.overlays import Overlays
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import CentreColors, Mode, ViewState
from tests.scenes import objects_scene, orbit_cameras

pytestmark = pytest.mark.gl
CAMERA = orbit_cameras(1, width=192, height=144)[0]
VIEW = ViewState(background=(0.0, 0.0, 0.0))


@pytest.fixture
def scene() -> Scene:
    synthetic = objects_scene(per_object=600)
    return Scene.of(synthetic.gaussians, synthetic.labels)


def _picture(
    viewport: Viewport, scene: Scene, view: ViewState, tint: UInt8Array | None = None
) -> UInt8Array:
    viewport.draw(scene, CAMERA, view, Overlays(tint=tint), wait=True)
    return viewport.read_pixels()


def test_a_tint_colors_its_splats_and_no_other(viewport: Viewport, scene: Scene) -> None:
    plain = _picture(viewport, scene, VIEW).astype(int)
    tint = np.zeros((len(scene), 4), np.uint8)
    assert np.array_equal(_picture(viewport, scene, VIEW, tint), plain)
    chosen = scene.labels == 2
    tint = tint.copy()
    tint[chosen] = (255, 0, 0, 255)
    tinted = _picture(viewport, scene, VIEW, tint).astype(int)
    pixels, _ = CAMERA.project(scene.gaussians.means[chosen].astype(np.float64))
    u, v = pixels.mean(axis=0).astype(int)
    assert tinted[v, u, 0] > 100
    assert tinted[v, u, 1:].max() < 20
    far = np.abs(np.indices(plain.shape[:2]) - np.array([v, u])[:, None, None]).max(axis=0) > 60
    assert np.abs(tinted - plain)[far].max() <= 1
    assert np.array_equal(_picture(viewport, scene, VIEW), plain)  # and it leaves nothing


def test_a_tint_of_other_rows_is_left_out(viewport: Viewport, scene: Scene) -> None:
    plain = _picture(viewport, scene, VIEW)
    wrong = np.full((len(scene) - 1, 4), 255, np.uint8)
    assert np.array_equal(_picture(viewport, scene, VIEW, wrong), plain)


def test_centres_have_the_colors_of_their_identities(viewport: Viewport, scene: Scene) -> None:
    colors = np.zeros((len(scene), 3), np.uint8)
    colors[scene.labels == 2] = (0, 255, 0)
    view = replace(VIEW, mode=Mode.CENTRES, centre_colors=CentreColors.IDENTITY)
    own = _picture(viewport, scene, replace(VIEW, mode=Mode.CENTRES))
    assert np.array_equal(_picture(viewport, scene, view), own)  # they are not known
    scene.identities = Identities(colors=colors)
    shown = _picture(viewport, scene, view).astype(int)
    assert shown[..., 1].max() > 240
    assert shown[..., [0, 2]].max() < 10


def test_centres_have_the_colors_of_their_groups(viewport: Viewport, scene: Scene) -> None:
    own = replace(VIEW, mode=Mode.CENTRES)
    by_group = replace(own, centre_colors=CentreColors.GROUPS)
    shown = _picture(viewport, scene, by_group)
    assert np.abs(shown.astype(int) - _picture(viewport, scene, own)).mean() > 1
    palette = group_palette(int(scene.labels.max()))
    for group in (1, 2, 3):
        pixels, _ = CAMERA.project(scene.gaussians.means[scene.labels == group].astype(np.float64))
        u, v = pixels.mean(axis=0).astype(int)
        around = shown[v - 4 : v + 5, u - 4 : u + 5].reshape(-1, 3).astype(float)
        lengths = np.linalg.norm(around, axis=1) * np.linalg.norm(palette[group])
        alike = around @ palette[group] > 0.99 * lengths
        assert alike[around.max(axis=1) < 255].mean() > 0.3  # brighter ones are cut off
