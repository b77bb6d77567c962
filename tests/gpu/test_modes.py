"""Every render mode says what it promises, and no other mode pays for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.color import group_palette
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.history import History
from gaga_core.scene.scene import Identities, Scene, State
from gaga_studio.gpu.overlays import Overlays
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import CentreColors, Mode, ViewState
from tests.scenes import objects_scene, orbit_cameras, random_gaussians

pytestmark = pytest.mark.gl
CAMERA = orbit_cameras(1, width=192, height=144)[0]
BACKGROUND = (40, 20, 10)
VIEW = ViewState(background=(40 / 255, 20 / 255, 10 / 255))


@pytest.fixture
def scene() -> Scene:
    synthetic = objects_scene(per_object=600)
    return Scene.of(synthetic.gaussians, synthetic.labels)


def _test_modes_picture(viewport: Viewport, scene: Scene, mode: Mode, focus: int = 0) -> UInt8Array:
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
    pictures = [_test_modes_picture(viewport, scene, mode, focus=1) for mode in Mode]
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
    found = _test_modes_picture(viewport, scene, Mode.MASK, group)
    assert np.abs(found.astype(float) - 255 * expected[..., None]).mean() < 1
    assert found.max() > 200
    assert _test_modes_picture(viewport, scene, Mode.MASK).max() == 0
    scene.state = np.where(scene.labels == group, np.uint8(State.HIDDEN), np.uint8(0))
    scene.revision.state += 1
    assert _test_modes_picture(viewport, scene, Mode.MASK, group).max() == 0


def test_a_sure_object_is_blue_an_unsure_one_is_red(viewport: Viewport, scene: Scene) -> None:
    scene.confidence = np.where(scene.labels == 1, 250, 5).astype(np.uint8)
    found = _test_modes_picture(viewport, scene, Mode.CONFIDENCE).astype(int)
    sure, unsure = found[_centre(scene, 1)], found[_centre(scene, 2)]
    assert sure[2] > sure[0] + 40
    assert unsure[0] > unsure[2] + 40
    scene.confidence = (255 - scene.confidence).astype(np.uint8)
    scene.revision.labels += 1
    turned = _test_modes_picture(viewport, scene, Mode.CONFIDENCE).astype(int)
    assert turned[_centre(scene, 1)][0] > turned[_centre(scene, 1)][2] + 40


def _some_colors(scene: Scene) -> UInt8Array:
    return np.random.default_rng(3).integers(0, 256, (scene.labels.max() + 1, 3), np.uint8)[
        scene.labels
    ]


def test_identities_have_the_colors_that_the_command_renders(
    viewport: Viewport, scene: Scene
) -> None:
    plain = _test_modes_picture(viewport, scene, Mode.COLOR)
    assert np.array_equal(_test_modes_picture(viewport, scene, Mode.IDENTITY), plain), "none yet"
    colors = _some_colors(scene)
    scene.identities = Identities(colors=colors)
    scene.revision.labels += 1
    view = replace(VIEW, mode=Mode.IDENTITY, background=(0.0, 0.0, 0.0))
    viewport.draw(scene, CAMERA, view, Overlays(), wait=True)
    channels = colors.astype(np.float32) / np.float32(255)
    expected = choose("cpu").render(scene.gaussians, CAMERA, channels=channels).image
    assert np.abs(viewport.read_pixels().astype(float) - 255 * expected).mean() < 1
    assert np.array_equal(_test_modes_picture(viewport, scene, Mode.COLOR), plain)


def test_splats_without_a_group_are_gray_in_the_heat_map(viewport: Viewport, scene: Scene) -> None:
    scene.labels = np.zeros(len(scene), np.int32)
    scene.confidence = np.full(len(scene), 255, np.uint8)
    at = _centre(Scene.of(scene.gaussians, objects_scene(per_object=600).labels), 1)
    pixel = _test_modes_picture(viewport, scene, Mode.CONFIDENCE)[at].astype(int)
    assert np.ptp(pixel) < 25


def test_confidence_that_is_not_known_shows_the_colors(viewport: Viewport, scene: Scene) -> None:
    color = _test_modes_picture(viewport, scene, Mode.COLOR)
    assert np.array_equal(_test_modes_picture(viewport, scene, Mode.CONFIDENCE), color)


@pytest.mark.parametrize("mode", [Mode.CONFIDENCE, Mode.IDENTITY])
def test_columns_take_time_and_memory_only_while_they_are_shown(
    viewport: Viewport, scene: Scene, mode: Mode, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene.confidence = np.full(len(scene), 9, np.uint8)
    scene.identities = Identities(colors=_some_colors(scene))
    n_made = 0

    def made(scene: Scene, column: UInt8Array | None, added: int) -> UInt8Array | None:
        nonlocal n_made
        n_made += 1
        return by_splat(scene, column, added)

    by_splat = Scene._by_splat
    monkeypatch.setattr(Scene, "_by_splat", made)
    history = History(scene)
    _test_modes_picture(viewport, scene, Mode.COLOR)
    before = viewport.buffers.nbytes
    history.do(edits.set_labels(scene, np.arange(5), 9))
    _test_modes_picture(viewport, scene, Mode.COLOR)
    assert n_made == 0
    _test_modes_picture(viewport, scene, mode)
    _test_modes_picture(viewport, scene, mode)
    assert n_made == 1
    assert viewport.buffers.nbytes > before
    _test_modes_picture(viewport, scene, Mode.COLOR)
    assert viewport.buffers.nbytes == before


def test_centres_are_where_the_splats_project_to(viewport: Viewport, scene: Scene) -> None:
    found = _test_modes_picture(viewport, scene, Mode.CENTRES)
    pixels, depths = CAMERA.project(scene.gaussians.means.astype(np.float64))
    seen = (depths > 0.01) & (scene.gaussians.opacities > 0.01)
    mask = np.zeros((CAMERA.height, CAMERA.width), bool)
    for u, v in pixels[seen].astype(int):
        mask[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4] = True
    drawn = (found != np.array(BACKGROUND)).any(axis=2)
    assert drawn.sum() > 100
    assert not (drawn & ~mask).any()


def test_selected_splats_stand_out_as_centres(viewport: Viewport, scene: Scene) -> None:
    plain = _test_modes_picture(viewport, scene, Mode.CENTRES).astype(int)
    scene.state = (scene.labels == 1).astype(np.uint8)
    scene.revision.state += 1
    changed = np.abs(_test_modes_picture(viewport, scene, Mode.CENTRES) - plain).max(axis=2) > 30
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
    row = _test_modes_picture(viewport, one, Mode.RINGS)[72].astype(int).sum(axis=1)
    assert row[96] < 0.6 * row.max()
    assert row[0] == sum(BACKGROUND)


# --- A color over that of each splat, and centres in the colors of their groups.

BLACK = ViewState(background=(0.0, 0.0, 0.0))


def _tinted(
    viewport: Viewport, scene: Scene, view: ViewState, tint: UInt8Array | None = None
) -> UInt8Array:
    viewport.draw(scene, CAMERA, view, Overlays(tint=tint), wait=True)
    return viewport.read_pixels()


def test_a_tint_colors_its_splats_and_no_other(viewport: Viewport, scene: Scene) -> None:
    plain = _tinted(viewport, scene, BLACK).astype(int)
    tint = np.zeros((len(scene), 4), np.uint8)
    assert np.array_equal(_tinted(viewport, scene, BLACK, tint), plain)
    chosen = scene.labels == 2
    tint = tint.copy()
    tint[chosen] = (255, 0, 0, 255)
    tinted = _tinted(viewport, scene, BLACK, tint).astype(int)
    pixels, _ = CAMERA.project(scene.gaussians.means[chosen].astype(np.float64))
    u, v = pixels.mean(axis=0).astype(int)
    assert tinted[v, u, 0] > 100
    assert tinted[v, u, 1:].max() < 20
    far = np.abs(np.indices(plain.shape[:2]) - np.array([v, u])[:, None, None]).max(axis=0) > 60
    assert np.abs(tinted - plain)[far].max() <= 1
    assert np.array_equal(_tinted(viewport, scene, BLACK), plain)  # and it leaves nothing


def test_a_tint_of_other_rows_is_left_out(viewport: Viewport, scene: Scene) -> None:
    plain = _tinted(viewport, scene, BLACK)
    wrong = np.full((len(scene) - 1, 4), 255, np.uint8)
    assert np.array_equal(_tinted(viewport, scene, BLACK, wrong), plain)


def test_centres_have_the_colors_of_their_identities(viewport: Viewport, scene: Scene) -> None:
    colors = np.zeros((len(scene), 3), np.uint8)
    colors[scene.labels == 2] = (0, 255, 0)
    view = replace(BLACK, mode=Mode.CENTRES, centre_colors=CentreColors.IDENTITY)
    own = _tinted(viewport, scene, replace(BLACK, mode=Mode.CENTRES))
    assert np.array_equal(_tinted(viewport, scene, view), own)  # they are not known
    scene.identities = Identities(colors=colors)
    shown = _tinted(viewport, scene, view).astype(int)
    assert shown[..., 1].max() > 240
    assert shown[..., [0, 2]].max() < 10


def test_centres_have_the_colors_of_their_groups(viewport: Viewport, scene: Scene) -> None:
    own = replace(BLACK, mode=Mode.CENTRES)
    by_group = replace(own, centre_colors=CentreColors.GROUPS)
    shown = _tinted(viewport, scene, by_group)
    assert np.abs(shown.astype(int) - _tinted(viewport, scene, own)).mean() > 1
    palette = group_palette(int(scene.labels.max()))
    for group in (1, 2, 3):
        pixels, _ = CAMERA.project(scene.gaussians.means[scene.labels == group].astype(np.float64))
        u, v = pixels.mean(axis=0).astype(int)
        around = shown[v - 4 : v + 5, u - 4 : u + 5].reshape(-1, 3).astype(float)
        lengths = np.linalg.norm(around, axis=1) * np.linalg.norm(palette[group])
        alike = around @ palette[group] > 0.99 * lengths
        assert alike[around.max(axis=1) < 255].mean() > 0.3  # brighter ones are cut off


# --- A color that a person gave a group shows in the group pictures.


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


# --- Splats of another file next to those of the scene: one picture with one order.

ADDED_CAMERA = orbit_cameras(1)[0]


@pytest.mark.parametrize("sh_degree", [0, 2])
def test_added_splats_are_drawn_as_if_they_had_always_been_there(
    viewport: Viewport, sh_degree: int
) -> None:
    """Also when their SH are of a higher degree than those of the scene."""

    def picture(scene: Scene) -> np.ndarray:
        viewport.draw(scene, ADDED_CAMERA, ViewState(show_outline=False), Overlays(), wait=True)
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
