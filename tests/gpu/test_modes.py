"""Every render mode says what it promises, and no other mode pays for it."""

from dataclasses import replace

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.raster import choose
from gaga_core.scene.scene import Identities, Scene, State
from gaga_studio.gpu.overlays import Overlays
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import Mode, ViewState
from tests.scenes import objects_scene, orbit_cameras

pytestmark = pytest.mark.gl
CAMERA = orbit_cameras(1, width=192, height=144)[0]
BACKGROUND = (40, 20, 10)
VIEW = ViewState(background=(40 / 255, 20 / 255, 10 / 255))


@pytest.fixture
def scene() -> Scene:
    synthetic = objects_scene(per_object=600)
    return Scene.of(synthetic.gaussians, synthetic.labels)


def _picture(viewport: Viewport, scene: Scene, mode: Mode, focus: int = 0) -> UInt8Array:
    view = replace(VIEW, mode=mode)
    viewport.draw(scene, CAMERA, view, Overlays(focused_group=focus), wait=True)
    return viewport.read_pixels()


def _centre(scene: Scene, group: int) -> tuple[int, int]:
    """Row and column of the middle of a group."""
    pixels, _ = CAMERA.project(scene.gaussians.means[scene.labels == group].astype(np.float64))
    u, v = pixels.mean(axis=0)
    return int(v), int(u)


def test_every_mode_is_another_picture(viewport: Viewport, scene: Scene) -> None:
    scene.confidence = np.linspace(0, 255, len(scene)).astype(np.uint8)
    scene.identities = Identities(colors=_some_colors(scene))
    pictures = [_picture(viewport, scene, mode, focus=1) for mode in Mode]
    for i, one in enumerate(pictures):
        assert one.std() > 5
        for other in pictures[i + 1 :]:
            assert np.abs(one.astype(int) - other).mean() > 1


def test_the_mask_is_the_share_of_the_object_in_each_pixel(
    viewport: Viewport, scene: Scene
) -> None:
    group = 2
    white = (scene.labels == group).astype(np.float32)[:, None]
    expected = choose("cpu").render(scene.gaussians, CAMERA, channels=white).image[..., 0]
    found = _picture(viewport, scene, Mode.MASK, group)
    assert np.abs(found.astype(float) - 255 * expected[..., None]).mean() < 1
    assert found.max() > 200
    assert _picture(viewport, scene, Mode.MASK).max() == 0
    scene.state = np.where(scene.labels == group, np.uint8(State.HIDDEN), np.uint8(0))
    scene.revision.state += 1
    assert _picture(viewport, scene, Mode.MASK, group).max() == 0


def test_a_sure_object_is_blue_an_unsure_one_is_red(viewport: Viewport, scene: Scene) -> None:
    scene.confidence = np.where(scene.labels == 1, 250, 5).astype(np.uint8)
    found = _picture(viewport, scene, Mode.CONFIDENCE).astype(int)
    sure, unsure = found[_centre(scene, 1)], found[_centre(scene, 2)]
    assert sure[2] > sure[0] + 40
    assert unsure[0] > unsure[2] + 40
    scene.confidence = (255 - scene.confidence).astype(np.uint8)
    scene.revision.labels += 1
    turned = _picture(viewport, scene, Mode.CONFIDENCE).astype(int)
    assert turned[_centre(scene, 1)][0] > turned[_centre(scene, 1)][2] + 40


def _some_colors(scene: Scene) -> UInt8Array:
    return np.random.default_rng(3).integers(0, 256, (scene.labels.max() + 1, 3), np.uint8)[
        scene.labels
    ]


def test_identities_have_the_colors_that_the_command_renders(
    viewport: Viewport, scene: Scene
) -> None:
    plain = _picture(viewport, scene, Mode.COLOR)
    assert np.array_equal(_picture(viewport, scene, Mode.IDENTITY), plain), "none yet"
    colors = _some_colors(scene)
    scene.identities = Identities(colors=colors)
    scene.revision.labels += 1
    view = replace(VIEW, mode=Mode.IDENTITY, background=(0.0, 0.0, 0.0))
    viewport.draw(scene, CAMERA, view, Overlays(), wait=True)
    channels = colors.astype(np.float32) / np.float32(255)
    expected = choose("cpu").render(scene.gaussians, CAMERA, channels=channels).image
    assert np.abs(viewport.read_pixels().astype(float) - 255 * expected).mean() < 1
    assert np.array_equal(_picture(viewport, scene, Mode.COLOR), plain)


def test_splats_without_a_group_are_gray_in_the_heat_map(viewport: Viewport, scene: Scene) -> None:
    scene.labels = np.zeros(len(scene), np.int32)
    scene.confidence = np.full(len(scene), 255, np.uint8)
    at = _centre(Scene.of(scene.gaussians, objects_scene(per_object=600).labels), 1)
    pixel = _picture(viewport, scene, Mode.CONFIDENCE)[at].astype(int)
    assert np.ptp(pixel) < 25


def test_confidence_that_is_not_known_shows_the_colors(viewport: Viewport, scene: Scene) -> None:
    color = _picture(viewport, scene, Mode.COLOR)
    assert np.array_equal(_picture(viewport, scene, Mode.CONFIDENCE), color)


def test_confidence_takes_memory_only_while_it_is_shown(viewport: Viewport, scene: Scene) -> None:
    scene.confidence = np.full(len(scene), 9, np.uint8)
    _picture(viewport, scene, Mode.COLOR)
    before = viewport.buffers.nbytes
    _picture(viewport, scene, Mode.CONFIDENCE)
    assert viewport.buffers.nbytes > before
    _picture(viewport, scene, Mode.COLOR)
    assert viewport.buffers.nbytes == before


def test_centres_are_where_the_splats_project_to(viewport: Viewport, scene: Scene) -> None:
    found = _picture(viewport, scene, Mode.CENTRES)
    pixels, depths = CAMERA.project(scene.gaussians.means.astype(np.float64))
    seen = (depths > 0.01) & (scene.gaussians.opacities > 0.01)
    mask = np.zeros((CAMERA.height, CAMERA.width), bool)
    for u, v in pixels[seen].astype(int):
        mask[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4] = True
    drawn = (found != np.array(BACKGROUND)).any(axis=2)
    assert drawn.sum() > 100
    assert not (drawn & ~mask).any()


def test_selected_splats_stand_out_as_centres(viewport: Viewport, scene: Scene) -> None:
    plain = _picture(viewport, scene, Mode.CENTRES).astype(int)
    scene.state = (scene.labels == 1).astype(np.uint8)
    scene.revision.state += 1
    changed = np.abs(_picture(viewport, scene, Mode.CENTRES) - plain).max(axis=2) > 30
    rows, columns = np.nonzero(changed)
    pixels, _ = CAMERA.project(scene.gaussians.means[scene.labels == 1].astype(np.float64))
    assert changed.sum() > 20
    assert rows.min() > pixels[:, 1].min() - 4
    assert columns.max() < pixels[:, 0].max() + 4


def test_the_ring_of_one_splat_is_brighter_than_its_inside(viewport: Viewport) -> None:
    gaussians = objects_scene(per_object=2).gaussians.take(np.array([0]))
    middle = CAMERA.unproject(96, 72, 2.0).astype(np.float32)[None]
    one = Scene.of(
        replace(
            gaussians,
            means=middle,
            log_scales=np.full((1, 3), np.log(0.2), np.float32),
            logit_opacities=np.full(1, 6, np.float32),
            sh=np.full((1, 1, 3), 1.7, np.float32),
        )
    )
    row = _picture(viewport, one, Mode.RINGS)[72].astype(int).sum(axis=1)
    assert row[96] < 0.6 * row.max()
    assert row[0] == sum(BACKGROUND)
