"""When the picture is drawn again, what is sent to the card for it, and that nothing is left."""

import gc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.scene.scene import Placements, Scene, State
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.overlays import ACCENT, Ground, Overlays
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.view import Mode, ViewState
from tests.scenes import Synthetic, objects_scene, orbit_cameras, random_gaussians

pytestmark = pytest.mark.gl
CAMERA, OTHER_CAMERA = orbit_cameras(2)
BACKGROUND = (40, 20, 10)
VIEW = ViewState(background=(40 / 255, 20 / 255, 10 / 255))


@pytest.fixture
def synthetic() -> Synthetic:
    return objects_scene(per_object=150)


@pytest.fixture
def scene(synthetic: Synthetic) -> Scene:
    return Scene.of(synthetic.gaussians, synthetic.labels)


def _picture(
    viewport: Viewport,
    scene: Scene | None,
    camera: Camera = CAMERA,
    view: ViewState = VIEW,
    overlays: Overlays = Overlays(),  # noqa: B008  (frozen)
) -> UInt8Array:
    viewport.draw(scene, camera, view, overlays, wait=True)
    return viewport.read_pixels()


def _set(scene: Scene, column: str, values: Any) -> None:
    """Replace a column as an edit does."""
    setattr(scene, column, values)
    setattr(scene.revision, column, getattr(scene.revision, column) + 1)


def test_idle_draws_nothing(viewport: Viewport, scene: Scene) -> None:
    first = _picture(viewport, scene)
    drawn, uploads = viewport.n_draws, viewport.buffers.uploads.total()
    for _ in range(5):
        same = Camera(CAMERA.K.copy(), CAMERA.cam_from_world.copy(), CAMERA.width, CAMERA.height)
        viewport.draw(scene, same, VIEW, Overlays())
    assert (viewport.n_draws, viewport.buffers.uploads.total()) == (drawn, uploads)
    assert np.array_equal(viewport.read_pixels(), first)


def test_a_jump_shows_the_whole_scene_where_drawing_is_slow(viewport: Viewport, gl: Any) -> None:
    """The first picture after it was that of what the camera before had in sight."""
    scene = Scene.of(random_gaussians(20_000, extent=3.0))
    inside = np.eye(4)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0])  # looks the other way
    cameras = [replace(CAMERA, cam_from_world=pose) for pose in (inside, turned) * 3]
    whole = [_picture(viewport, scene, camera) for camera in cameras[:2]]
    assert not np.array_equal(whole[0], whole[1])
    for i, camera in enumerate(cameras):
        viewport.slices.seconds = 60.0  # the last picture took long
        viewport.draw(scene, camera, VIEW)
        assert viewport.settled
        np.testing.assert_array_equal(viewport.read_pixels(), whole[i % 2])


def test_every_setting_draws_once(viewport: Viewport, scene: Scene) -> None:
    _picture(viewport, scene)
    settings = [
        (OTHER_CAMERA, VIEW, Overlays()),
        (OTHER_CAMERA, replace(VIEW, mode=Mode.GROUPS), Overlays()),
        (OTHER_CAMERA, replace(VIEW, mode=Mode.DEPTH), Overlays()),
        (OTHER_CAMERA, replace(VIEW, background=(1.0, 1.0, 1.0)), Overlays()),
        (OTHER_CAMERA, replace(VIEW, resolution_scale=0.5), Overlays()),
        (OTHER_CAMERA, VIEW, Overlays(hovered_group=2)),
        (OTHER_CAMERA, VIEW, Overlays(cameras=(CAMERA,))),
        (OTHER_CAMERA, VIEW, Overlays(cameras=(CAMERA,), active_camera=0)),
    ]
    before = viewport.read_pixels()
    for camera, view, overlays in settings:
        drawn = viewport.n_draws
        viewport.draw(scene, camera, view, overlays, wait=True)
        viewport.draw(scene, camera, view, overlays, wait=True)
        assert viewport.n_draws == drawn + 1
        after = viewport.read_pixels()
        assert not np.array_equal(after, before)
        before = after


@pytest.mark.parametrize("column", ["state", "labels", "placement", "placements"])
def test_a_change_shows_and_sends_its_column_only(
    viewport: Viewport, scene: Scene, column: str
) -> None:
    _set(scene, "placements", Placements.identity(2))
    view = replace(VIEW, mode=Mode.GROUPS)
    _set(scene, "placement", (scene.labels == 1).astype(np.int32))
    before = _picture(viewport, scene, view=view)
    viewport.buffers.uploads.clear()
    moved = Placements.identity(2)
    moved.matrix[1, :, 3] = [0.5, 0, 0]
    values = {
        "state": np.where(scene.labels == 1, np.uint8(State.HIDDEN), np.uint8(0)),
        "labels": np.where(scene.labels == 1, 3, scene.labels).astype(np.int32),
        "placement": np.zeros(len(scene), np.int32),
        "placements": moved,
    }
    if column == "placement":  # its row must differ from the one that the splats go to
        _set(scene, "placements", moved)
        before = _picture(viewport, scene, view=view)
        viewport.buffers.uploads.clear()
    _set(scene, column, values[column])
    after = _picture(viewport, scene, view=view)
    assert dict(viewport.buffers.uploads) == {column: 1}
    assert not np.array_equal(after, before)


def test_only_the_lines_that_differ_are_sent(gl: Any) -> None:
    """Pixels of unchanged texels must not be touched: the old texture is still right there."""
    scene = Scene.of(random_gaussians(9000))
    buffers = SceneBuffers(gl)
    buffers.sync(scene)
    state = scene.state.copy()
    state[[2500, 4100]] = State.SELECTED
    _set(scene, "state", state)
    buffers.sync(scene)
    texture = dict(buffers.textures())["u_state"]
    data = np.frombuffer(texture.read(alignment=1), np.uint8)[:9000]
    assert np.array_equal(data, state)
    assert buffers.has_selected
    buffers.release()


def test_columns_arrive_whole_at_every_length(gl: Any) -> None:
    """Lengths around the width of a data texture; written from any row on."""
    for n in (1, 2047, 2048, 2049, 5000):
        scene = Scene.of(random_gaussians(n), np.arange(n, dtype=np.int32))
        buffers = SceneBuffers(gl)
        buffers.sync(scene)
        textures = dict(buffers.textures())
        labels = np.frombuffer(textures["u_labels"].read(alignment=1), np.int32)[:n]
        means = np.frombuffer(textures["u_means"].read(alignment=1), np.float32)[: 3 * n]
        assert np.array_equal(labels, scene.labels)
        assert np.array_equal(means.reshape(n, 3), scene.gaussians.means)
        buffers.release()


def test_a_hidden_object_looks_as_if_it_were_not_there(
    viewport: Viewport, scene: Scene, synthetic: Synthetic
) -> None:
    _set(scene, "state", np.where(scene.labels == 2, np.uint8(2), np.uint8(0)))
    rest = Scene.of(synthetic.gaussians.take(np.flatnonzero(synthetic.labels != 2)))
    difference = _picture(viewport, scene).astype(int) - _picture(viewport, rest)
    assert np.abs(difference).max() <= 3


def test_settled_only_with_the_order_of_this_camera(viewport: Viewport, scene: Scene) -> None:
    viewport.draw(scene, CAMERA, VIEW, wait=True)
    assert viewport.settled
    viewport.draw(scene, OTHER_CAMERA, VIEW)
    stale = viewport.n_draws
    for _ in range(2000):
        viewport.draw(scene, OTHER_CAMERA, VIEW)
        if viewport.settled:
            break
        viewport._sorter.wait(viewport._ticket, timeout=0.01)
    assert viewport.settled
    assert viewport.n_draws <= stale + 1
    fresh = viewport.read_pixels()
    assert np.array_equal(fresh, _picture(viewport, scene, OTHER_CAMERA))


def test_live_labels_stand_in_for_those_of_the_scene(viewport: Viewport, scene: Scene) -> None:
    view = replace(VIEW, mode=Mode.GROUPS)
    wanted = np.where(scene.labels > 0, 7, 0).astype(np.int32)
    live = _picture(viewport, scene, view=view, overlays=Overlays(labels=wanted))
    back = _picture(viewport, scene, view=view)
    _set(scene, "labels", wanted)
    assert np.array_equal(_picture(viewport, scene, view=view), live)
    assert not np.array_equal(back, live)


def test_live_labels_of_another_length_are_ignored(viewport: Viewport, scene: Scene) -> None:
    """A duplicate made while an association runs: its snapshots are too short for a moment."""
    view = replace(VIEW, mode=Mode.GROUPS)
    plain = _picture(viewport, scene, view=view)
    short = Overlays(labels=np.ones(len(scene) - 1, np.int32))
    assert np.array_equal(_picture(viewport, scene, view=view, overlays=short), plain)


def test_selected_objects_get_an_outline_and_keep_their_color(viewport: Viewport) -> None:
    synthetic = objects_scene(per_object=600)
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    plain = _picture(viewport, scene).astype(int)
    selected = scene.labels == 1
    _set(scene, "state", selected.astype(np.uint8))
    outlined = _picture(viewport, scene).astype(int)
    changed = np.abs(outlined - plain).max(axis=2) > 10
    pixels, _ = CAMERA.project(scene.gaussians.means[selected].astype(np.float64))
    u, v = pixels.mean(axis=0).astype(int)
    assert not changed[v - 5 : v + 5, u - 5 : u + 5].any()
    rows, columns = np.nonzero(changed)
    assert rows.min() < pixels[:, 1].min() < pixels[:, 1].max() < rows.max() + 3
    assert columns.min() < pixels[:, 0].min() + 3
    assert changed.mean() < 0.1
    off = _picture(viewport, scene, view=replace(VIEW, show_outline=False)).astype(int)
    assert np.array_equal(off, plain)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_crowded_outlines_leave_the_picture_seen(viewport: Viewport, share: float) -> None:
    """As where an added scene that is selected lies in another one: each splat had its outline."""
    synthetic = objects_scene(per_object=600)
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    plain = _picture(viewport, scene).astype(int)
    whole = (scene.labels == 1).astype(np.uint8)
    _set(scene, "state", whole)
    alone = _picture(viewport, scene).astype(int)
    chosen = np.random.default_rng(3).random(len(scene)) < share
    _set(scene, "state", chosen.astype(np.uint8))
    crowded = _picture(viewport, scene).astype(int)
    changes = [np.abs(picture - plain).max(axis=2) for picture in (alone, crowded)]
    line = np.percentile(changes[0][changes[0] > 10], 90)
    covered = (plain != plain[0, 0]).any(axis=2)
    # Two lines of two pixels, and as much of their rims, of each 32 pixels.
    assert changes[1][covered].mean() < 2 * 4 / 32 * line
    assert (np.abs(alone - np.array(ACCENT) * 255).max(axis=2) < 3).any(), "a line of its own"


@pytest.mark.parametrize(("mode", "resolution"), [(Mode.COLOR, 0.4), (Mode.DEPTH, 1.0)])
def test_outlines_are_the_same_by_tiles_of_any_width(
    gl: Any, monkeypatch: pytest.MonkeyPatch, mode: Mode, resolution: float
) -> None:
    """Only tiles that an outline reaches are looked at; one tile is the whole picture."""
    synthetic = objects_scene(per_object=600)
    scene = Scene.of(synthetic.gaussians, synthetic.labels)
    _set(scene, "state", (scene.labels == 1).astype(np.uint8))
    view = replace(VIEW, mode=mode, resolution_scale=resolution)
    overlays = Overlays(hovered_group=2, pixel_scale=1.5)
    pictures = []
    for width in (4096, 16, 5):
        monkeypatch.setattr("gaga_studio.gpu.overlays._TILE", width)
        viewport = Viewport(gl)
        pictures.append(_picture(viewport, scene, view=view, overlays=overlays))
        viewport.release()
    plain = Overlays(pixel_scale=1.5)
    viewport = Viewport(gl)
    _set(scene, "state", np.zeros(len(scene), np.uint8))
    assert (pictures[0] != _picture(viewport, scene, view=view, overlays=plain)).any()
    viewport.release()
    for picture in pictures[1:]:
        np.testing.assert_array_equal(picture, pictures[0])


def test_a_hidden_selection_has_no_outline(viewport: Viewport, scene: Scene) -> None:
    both = np.uint8(State.SELECTED | State.HIDDEN)
    _set(scene, "state", np.where(scene.labels == 1, both, np.uint8(0)))
    outlined = _picture(viewport, scene)
    off = _picture(viewport, scene, view=replace(VIEW, show_outline=False))
    assert np.array_equal(outlined, off)


def test_frusta_and_ground_are_drawn_over_the_background(viewport: Viewport) -> None:
    ground = Ground(np.zeros(3), np.array([0, 0, 1.0]), 0.3)
    for overlays in (Overlays(cameras=orbit_cameras(6)[1:]), Overlays(ground=ground)):
        pixels = _picture(viewport, None, overlays=overlays)
        share = (pixels != np.array(BACKGROUND)).any(axis=2).mean()
        assert 0.005 < share < 0.6
    assert (_picture(viewport, None) == np.array(BACKGROUND)).all()


@pytest.mark.parametrize("n", [0, 1])
def test_no_splats_is_plain_background(viewport: Viewport, n: int) -> None:
    empty = Scene.of(random_gaussians(n))
    empty.state[:] = State.HIDDEN
    assert (_picture(viewport, empty) == np.array(BACKGROUND)).all()
    assert viewport.settled
    assert (_picture(viewport, None) == np.array(BACKGROUND)).all()
    assert viewport.settled


def _stop_sorting(viewport: Viewport, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on every order is a stale one."""
    monkeypatch.setattr(viewport._sorter, "submit", lambda _: None)


def test_hiding_shows_before_the_new_order_is_there(
    viewport: Viewport, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    _picture(viewport, scene)
    _stop_sorting(viewport, monkeypatch)
    _set(scene, "state", np.where(scene.labels == 1, np.uint8(8), np.uint8(2)))
    viewport.draw(scene, CAMERA, VIEW)
    assert not viewport.settled
    assert (viewport.read_pixels() == np.array(BACKGROUND)).all()


def test_an_order_of_another_scene_is_never_used(
    viewport: Viewport, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the one in use nor one that arrives late."""
    _picture(viewport, scene)
    viewport.draw(scene, OTHER_CAMERA, VIEW)
    viewport._sorter.wait(viewport._ticket)
    _stop_sorting(viewport, monkeypatch)
    other = Scene.of(random_gaussians(len(scene)))
    viewport.draw(other, OTHER_CAMERA, VIEW)
    assert not viewport.settled
    assert (viewport.read_pixels() == np.array(BACKGROUND)).all()


def test_rows_that_are_gone_leave_a_stale_order(
    viewport: Viewport, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What lies outside of a data texture is undefined on a real graphics card."""
    _picture(viewport, scene)
    _stop_sorting(viewport, monkeypatch)
    n = 700
    scene.gaussians = scene.gaussians.take(np.arange(n))
    for name in ("labels", "state", "placement", "source"):
        setattr(scene, name, getattr(scene, name)[:n])
    scene.revision.splats += 1
    viewport.draw(scene, CAMERA, VIEW)
    order = viewport._splats._order
    assert order is not None
    rows = np.frombuffer(order.read(alignment=1), np.uint32)[: viewport._splats._n_order]
    assert 0 < len(rows) <= n
    assert rows.max() < n


def test_splats_appended_and_cut_off_again(
    viewport: Viewport, scene: Scene, synthetic: Synthetic
) -> None:
    """A duplicate and its undo, drawn at once with whatever order there is."""
    before = _picture(viewport, scene)
    n = len(scene)
    rows = np.r_[np.arange(n), np.flatnonzero(synthetic.labels == 1)]
    whole = {name: getattr(scene, name) for name in ("gaussians", "labels", "state", "placement")}
    scene.gaussians = synthetic.gaussians.take(rows)
    scene.labels, scene.state = scene.labels[rows], scene.state[rows]
    scene.placement = np.r_[scene.placement, np.ones(len(rows) - n, np.int32)].astype(np.int32)
    scene.placements = Placements.identity(2)
    scene.placements.matrix[1, :, 3] = [0, 0, 0.6]
    scene.revision.splats += 1
    viewport.draw(scene, CAMERA, VIEW)
    assert not np.array_equal(_picture(viewport, scene), before)
    for name, column in whole.items():
        setattr(scene, name, column)
    scene.revision.splats += 1
    viewport.draw(scene, CAMERA, VIEW)
    assert np.array_equal(_picture(viewport, scene), before)


def test_resize_follows_the_camera(viewport: Viewport, scene: Scene) -> None:
    for width, height in ((160, 120), (200, 90), (1, 1), (33, 57)):
        camera = CAMERA.resized(width, height)
        pixels = _picture(viewport, scene, camera)
        assert pixels.shape == (height, width, 3)


def test_half_resolution_is_a_softer_picture_of_the_same_size(
    viewport: Viewport, scene: Scene
) -> None:
    full = _picture(viewport, scene).astype(int)
    half = _picture(viewport, scene, view=replace(VIEW, resolution_scale=0.5))
    assert half.shape == full.shape
    assert 0 < np.abs(half - full).mean() < 12


def test_a_budget_draws_fewer_splats(viewport: Viewport, scene: Scene) -> None:
    full = _picture(viewport, scene)
    few = _picture(viewport, scene, view=replace(VIEW, splat_budget=100))
    assert (few == np.array(BACKGROUND)).all(axis=2).sum() > (full == np.array(BACKGROUND)).all(
        axis=2
    ).sum()


def test_the_bound_framebuffer_stays_bound(gl: Any, viewport: Viewport, scene: Scene) -> None:
    mine = gl.simple_framebuffer((20, 10))
    mine.use()
    _picture(viewport, scene)
    mine.clear(1.0, 0.0, 0.0)
    found = gl.detect_framebuffer()
    assert found.glo == mine.glo
    assert tuple(found.viewport) == (0, 0, 20, 10)
    assert not (viewport.read_pixels() == np.array([255, 0, 0])).all()
    gl.detect_framebuffer(0).use()  # moderngl binds the last one again: it must exist
    mine.release()


def test_release_gives_every_object_back(gl: Any, scene: Scene) -> None:
    gc.collect()
    gl.gc_mode = "context_gc"  # objects that were never released are collected in gl.objects
    gl.objects.clear()
    viewport = Viewport(gl)
    cameras = orbit_cameras(3)
    for mode in Mode:
        overlays = Overlays(cameras=cameras, hovered_group=1)
        viewport.draw(scene, CAMERA, replace(VIEW, mode=mode), overlays, wait=True)
        viewport.draw(scene, CAMERA.resized(50, 40), replace(VIEW, mode=mode), wait=True)
    viewport.release()
    del viewport
    gc.collect()
    kinds = [type(thing).__name__ for thing in gl.objects]
    leaked = [kind for kind in kinds if kind != "InvalidObject"]  # what a released one becomes
    gl.gc_mode = None
    assert leaked == []
    assert gl.error == "GL_NO_ERROR"
