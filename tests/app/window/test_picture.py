"""The rarer modes, the look and the background in the window; a moving picture comes back."""

import gzip
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs
from imgui_bundle import ImVec2
from PIL import Image

from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.splats.splat_files import SplatFormat, write_splats
from gaga_core.scene.scene import State
from gaga_studio import studio
from gaga_studio.features import camera, commands, export, selection
from gaga_studio.features.commands import run
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.memory_bank import Timeline
from gaga_studio.gpu import viewport
from gaga_studio.gpu.viewport import Viewport
from gaga_studio.session.notices import Level
from gaga_studio.session.view import CentreColors, Mode, PhotoCompareMode, Side, SplatLook
from gaga_studio.ui.viewport import viewport as picture_panel
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive
from tests.scenes import random_gaussians

pytestmark = pytest.mark.window


def _choose(d: Driver, title: str) -> None:
    """An entry of the drop-down next to the modes."""
    d.click("**/###More render modes")
    d.engine.item_click(f"//$FOCUSED/###{title}")
    d.check(title)
    d.frames()


def test_modes_look_background_and_a_motion(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        color = d.pixels()
        _choose(d, "Centres")
        assert d.mode() is Mode.CENTRES
        assert np.abs(d.pixels().astype(int) - color).mean() > 5
        _choose(d, "Antialiased look (mip)")
        assert d.session.view.look is SplatLook.ANTIALIASED
        _choose(d, "Next background color")
        assert d.session.view.background == (0.0, 0.0, 0.0)
        _choose(d, "Mask of the object")
        d.on_main(lambda: selection.select_groups(d.session, (int(d.session.objects().ids[1]),)))
        mask = d.pixels()
        assert np.ptp(mask.astype(int), axis=2).max() <= 2  # white on black
        assert mask.max() > 150
        d.capture(tmp_path / "mask.png")

        d.on_main(lambda: commands.run("view.color", d.session))
        d.on_main(lambda: commands.run("view.look_auto", d.session))
        full = d.pixels()
        pacing = d.studio._pacing
        d.drag_picture((200, 150), (60, 0), 2)
        d.settle()
        assert pacing.is_settled
        d.drag_picture((260, 150), (-60, 0), 2)
        assert np.abs(d.pixels().astype(int) - full).mean() < 1  # full again, as before

    drive(walk, path=grouped_scene)


def test_a_motion_is_seen_where_pictures_became_slow_after_fast_ones(
    display: str, grouped_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fast pictures are drawn in full while something moves. When they take more than a frame,
    because other programs run, each was begun again by the next frame, and none was whole before
    the end."""

    def walk(d: Driver) -> None:
        d.settle()
        picture = d.studio.viewport
        assert picture is not None
        d.studio._pacing._save(0.0)  # as after many fast pictures
        monkeypatch.setattr(studio, "_PART_S", 1e-4)
        monkeypatch.setattr(viewport, "_MOST_TIMES", 1.0)  # each takes several frames
        before = picture.n_draws
        for _ in range(60):
            d.on_main(lambda: d.session.rig.orbit(2, 0))
            d.frames(1)
        assert picture.n_draws >= before + 2

    drive(walk, path=grouped_scene, fills_window=True)


def test_what_the_label_says_is_what_the_picture_shows(
    display: str, grouped_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ "Group colors" stood over the scene's own while a slow machine still drew the groups."""
    said, seen = list[str](), list[tuple[bytes, list[str]]]()
    draw, badge = picture_panel._on_the_picture, picture_panel._badge
    watched: list[Viewport] = []

    def drawn(*args: Any) -> None:
        said.clear()
        draw(*args)
        seen.extend((viewport.read_pixels().tobytes(), list(said)) for viewport in watched)

    def labelled(text: str, *rest: Any) -> float:
        said.append(text)
        return badge(text, *rest)

    monkeypatch.setattr(picture_panel, "_on_the_picture", drawn)
    monkeypatch.setattr(picture_panel, "_badge", labelled)
    labels = {Mode.GROUPS: ["Group colors"], Mode.DEPTH: ["Depth: near is bright"], Mode.COLOR: []}

    def walk(d: Driver) -> None:
        viewport = d.studio.viewport
        assert viewport is not None
        pictures = dict[bytes, list[str]]()
        for mode, label in labels.items():
            d.session.view.mode = mode
            pictures[d.pixels().tobytes()] = label
        assert len(pictures) == len(labels)
        with monkeypatch.context() as slow, d.looking():
            slow.setattr(viewport.slices, "is_over", lambda: True)  # one part a frame
            watched.append(viewport)
            for mode in labels:
                d.session.view.mode = mode
                d.settle()
            watched.clear()
        known = [(pictures[picture], label) for picture, label in seen if picture in pictures]
        assert len(known) > len(labels)
        for of_picture, label in known:
            assert label == of_picture

    drive(walk, path=grouped_scene)


def test_the_next_scene_is_shown_in_its_colors(
    display: str, grouped_scene: Path, tmp_path: Path
) -> None:
    """A mode, a split view, a pivot and a polygon are about the scene that they were chosen for."""
    write_splats(tmp_path / "ball.ply", random_gaussians(300, seed=4, extent=0.2))

    def walk(d: Driver) -> None:
        d.menu("View/Groups")
        d.menu("Camera/Split: picture and groups")
        d.menu("Tools/Set the pivot at the camera's focus")
        d.keys(KEY.p)
        d.click_picture(d.size[0] * 0.3, d.size[1] * 0.5)
        view = d.session.view
        assert (view.mode, view.compare) == (Mode.GROUPS, PhotoCompareMode.SWIPE)
        assert None not in (view.pivot, view.outline)
        d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.o)
        d.answer_path(tmp_path / "ball.ply")
        d.settle()
        assert not d.session.need().scene.labels.any()
        assert (view.mode, view.compare) == (Mode.COLOR, PhotoCompareMode.OFF)
        assert (view.pivot, view.outline) == (None, None)

    drive(walk, path=grouped_scene)


# --- A right click in the picture: the menu of the object there, or of the scene.


def test_the_menu_of_the_object_under_the_mouse(display: str, tmp_path: Path) -> None:
    made = write_scene(tmp_path / "balls")
    ball = int(made.labels.max())
    centre = made.gaussians.means[made.labels == ball].mean(axis=0).astype(np.float64)

    def walk(d: Driver) -> None:
        d.click("**/###Find objects")
        d.settle()
        u, v = d.project(centre)
        d.click_picture(u, v, 1)
        (group,) = d.session.selected_groups()
        inside = made.labels[d.session.selected_indices()]
        assert np.bincount(inside).argmax() == ball
        d.click("$FOCUSED/###Set the pivot here")
        assert d.session.view.pivot is not None
        assert np.linalg.norm(np.array(d.session.view.pivot) - centre) < 0.5
        d.click_picture(u, v, 1)
        d.click("$FOCUSED/###Hide")
        assert d.scene.has(State.HIDDEN)[made.labels == ball].mean() > 0.9
        before = d.session.rig.pose.pivot.copy()
        d.drag_picture((u, v), (60, 10), 1)
        assert not np.array_equal(d.session.rig.pose.pivot, before), "a right drag pans"
        assert not d.exists("$FOCUSED/###Set the pivot here")
        d.click_picture(4, 4, 1)
        d.click("$FOCUSED/###Show all")
        assert not d.scene.has(State.HIDDEN).any()
        d.keys(KEY.escape)
        assert group in d.session.objects().ids

    drive(walk, path=tmp_path / "balls", size=(800, 500))


# --- The paper's figures in the window: the splats of a mask, the growth of the bank, two
# pictures.


def test_figures_of_the_paper(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))

    def walk(d: Driver) -> None:
        plain = d.pixels().astype(int)
        _mask_in_3d(d, plain)
        _centres_by_group(d, plain)
        _replay(d)
        with d.looking():
            _split(d, d.pixels().astype(int))

    drive(walk, path=grouped_scene)


def _mask_in_3d(d: Driver, plain: np.ndarray) -> None:
    """A click on a row lights up the splats of its mask; the gate is a switch."""
    d.select(3)
    d.focus("Memory bank")
    decision = d.session.decisions(3)[0]
    d.click(f"Memory bank/**/{decision.view} {decision.mask}/##decision")
    d.until(lambda: memory_bank.mask_splats_of(d.session, decision) is not None, "the view is read")
    lit = d.pixels().astype(int)
    assert np.abs(lit - plain).mean() > 5
    d.click("Memory bank/**/Depth gate")
    free = d.pixels().astype(int)
    assert np.abs(free - lit).max() > 60  # the floor behind the ball is pink
    d.click("Memory bank/**/###Light up")
    assert np.abs(d.pixels().astype(int) - plain).mean() < 2  # but for the outline
    d.on_main(lambda: run("select.none", d.session))
    d.click("**/###Close photo")


def _centres_by_group(d: Driver, plain: np.ndarray) -> None:
    d.command("Centres in the colors of their groups")
    assert d.session.view.centre_colors is CentreColors.GROUPS
    assert np.abs(d.pixels().astype(int) - plain).mean() > 5
    d.command("Centres in the colors of their groups")
    d.menu("View/###Color")


def _replay(d: Driver) -> None:
    """The bank grows from nothing to the saved groups; a step can be taken from the curve."""
    d.on_main(lambda: run("view.groups", d.session))
    saved = d.pixels().astype(int)
    d.on_main(lambda: run("view.color", d.session))
    timeline = d.session.document.feature(Timeline)  # type: ignore[union-attr]
    timeline.follows = False
    d.menu("View/###Replay the memory bank")
    d.until(lambda: timeline.is_open, "the growth is known")
    growth = timeline.growth
    assert growth is not None
    d.until(lambda: not timeline.is_playing, "the replay has ended")
    assert timeline.step == growth.last_step
    d.click("Timeline/**/###Step back")
    assert timeline.step == growth.last_step - 1
    d.click("Timeline/**/###Close replay")
    assert d.mode() is Mode.COLOR
    d.on_main(lambda: run("view.groups", d.session))
    assert np.abs(d.pixels().astype(int) - saved).mean() < 1
    d.on_main(lambda: run("view.color", d.session))
    d.menu("View/###Replay the memory bank")
    d.until(lambda: timeline.is_open, "the replay is shown at once")
    d.click("Timeline/**/###Camera follows")
    d.until(lambda: d.session.active_view is not None, "the camera follows")
    d.on_main(lambda: run("view.depth", d.session))
    d.keys(KEY.escape)
    assert not timeline.is_open
    assert d.mode() is Mode.DEPTH  # chosen during the replay
    d.on_main(lambda: run("view.color", d.session))


def _split(d: Driver, plain: np.ndarray) -> None:
    """Picture left of the line, groups right of it; the line moves by a drag."""
    d.menu("Camera/###Split: picture and groups")
    d.frames(8)
    d.on_main(lambda: setattr(d.session.view, "swipe", 0.4))
    width, height = d.size
    d.move_to(0.4 * width, 0.7 * height)
    d.engine.mouse_drag_with_delta(ImVec2(0.3 * width, 0), 0)
    d.frames()
    assert abs(d.session.view.swipe - 0.7) < 0.03
    right = d.pixels().astype(int)  # the picture under it all: groups
    assert d.studio.left is not None
    left = d.on_main(d.studio.left.read_pixels).astype(int)
    assert np.abs(left - plain).mean() < 2
    assert np.abs(right - plain).mean() > 5
    assert d.on_main(d.session.muted_colors)
    d.on_main(lambda: setattr(d.session.view, "sides", (Side.GROUPS, Side.GROUPS)))
    d.frames(8)
    left = d.on_main(d.studio.left.read_pixels).astype(int)
    assert np.abs(left - right).mean() < 0.1, "groups have the same colors on both sides"
    d.select(3)
    d.on_main(lambda: run("object.hide", d.session))
    d.on_main(lambda: run("select.none", d.session))
    d.menu("Camera/###Split: before and after the last edit")
    d.settle()
    left = d.on_main(d.studio.left.read_pixels).astype(int)
    assert np.abs(left - plain).mean() < 2
    assert np.abs(d.pixels().astype(int) - plain).mean() > 0.5
    d.on_main(lambda: d.session.notify(Level.WARNING, "A notice"))
    d.frames(3)
    close = d.engine.item_info("//**/###Close split view").rect_full
    assert d.engine.get_window_by_ref("//Notice 0").pos.y >= close.max.y, "it covers no choice"
    d.click("**/###Close split view")
    assert d.studio.left is None
    d.on_main(lambda: run("edit.undo", d.session))


def test_a_file_that_may_stand_on_its_head_offers_to_turn_it(
    display: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GAGA_HOME", str(tmp_path / "home"))
    path = tmp_path / "toy.spz"
    write_splats(path, random_gaussians(200, seed=4), SplatFormat.SPZ)
    data = bytearray(gzip.decompress(path.read_bytes())[:-12])
    data[14] &= ~2  # the flag of extensions: nothing says which way is up
    path.write_bytes(gzip.compress(bytes(data)))

    def walk(d: Driver) -> None:
        before = d.pixels().astype(int)
        later = time.monotonic() + 3600
        with monkeypatch.context() as an_hour_later:
            an_hour_later.setattr(time, "monotonic", lambda: later)
            d.frames(3)
        d.click("Notice 0/###Turn upright")
        assert np.abs(d.pixels().astype(int) - before).mean() > 1
        assert d.session.settings.upright == (str(path),)
        assert not d.exists("Notice 0/###Turn upright")

    drive(walk, path=path)


# --- The camera in the window: the view cube, the swipe line, a film and a picture saved by hand.


def test_cube_compare_film_and_picture(display: str, scene_folder: Path, tmp_path: Path) -> None:
    film, picture = tmp_path / "film.mp4", tmp_path / "picture.png"
    photos = tmp_path / "photos.mp4"

    def walk(d: Driver) -> None:
        s = d.session
        before = s.rig.camera(*d.size).forward
        d.click("Viewport/View cube")  # its middle: what looks at the eye most
        d.settle()
        after = s.rig.camera(*d.size).forward
        assert np.abs(after - before).max() > 1e-3
        local = s.rig.cube[2]
        assert np.sort(np.abs(local))[:2].max() < 1e-2 or np.abs(local).min() < 1e-2
        d.engine.mouse_drag_with_delta(ImVec2(30, 0))
        assert np.abs(s.rig.camera(*d.size).forward - after).max() > 0.05
        forward = s.rig.camera(*d.size).forward
        d.drag_picture((d.size[0] * 0.3, d.size[1] * 0.4), (40, 0))  # the picture has its own drags
        assert np.abs(s.rig.camera(*d.size).forward - forward).max() > 0.05

        d.menu("Camera/Swipe between photo and picture")
        d.settle()
        assert s.view.compare is PhotoCompareMode.SWIPE
        d.engine.mouse_move("//Viewport/Swipe line")
        d.engine.mouse_drag_with_delta(ImVec2(-60, 0))
        assert s.view.swipe < 0.48
        commands.run("camera.swipe", s)

        d.menu("Camera/Save film…")  # without a path: nobody has chosen the photos
        assert d.studio.ui.film.through_photos
        d.keys(KEY.escape)
        d.keys(KEY.k)
        s.rig.orbit(100, 0)
        d.keys(KEY.k)
        assert len(camera.path_of(s).keyframes) == 2
        d.studio.ui.film.film_size, d.studio.ui.film.picture_size = (64, 48), (48, 36)
        d.studio.ui.film.fps = 5.0
        d.menu("Camera/Save film…")
        assert not d.studio.ui.film.through_photos
        d.click("Save film/###Save film…")
        d.keys(KEY.escape)
        assert d.exists("Save film/###Save film…"), "without a path the sheet comes back"
        d.keys(KEY.enter)  # as the button
        d.answer_path(film)
        d.settle()
        d.menu("Camera/Save film…")  # through the photos: half a second each
        d.click("Save film/**/Way/###Through the photos")
        d.studio.ui.film.seconds = 0.4
        d.click("Save film/###Save film…")
        d.answer_path(photos)
        d.settle()
        d.menu("Camera/Save film…")
        assert d.studio.ui.film.through_photos, "as it was chosen"
        d.keys(KEY.escape)
        d.menu("File/Save picture…")
        d.click("Save picture/###Save picture…")
        d.answer_path(picture)
        d.settle()
        commands.run("view.rings", s)  # only OpenGL draws these
        export.save_picture(s, tmp_path / "rings.png", (80, 60), transparent=True)
        d.settle()

    drive(walk, path=scene_folder, size=(1000, 640))
    assert film.stat().st_size > 500
    n_frames, _ = count_frames_and_secs(str(photos))
    assert n_frames == 2 * len(open_scene_folder(scene_folder).image_paths) > 0
    with Image.open(picture) as saved:
        assert saved.size == (48, 36)
        assert np.asarray(saved).std() > 5
    with Image.open(tmp_path / "rings.png") as saved:
        assert saved.mode == "RGBA"
        assert np.asarray(saved)[..., 3].max() > 100
