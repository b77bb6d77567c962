"""Delete and fill in the window: where the colors of the hole come from, and why not."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import imgui

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.color import LUMA
from gaga_core.io.splats.ply import write_ply
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.frame import scale_of
from gaga_core.scene.orientation import degrees_of
from gaga_core.scene.project import Project, open_path_stage, save_project
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import cleanup, commands, fill, measure
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.notices import Level
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName
from gaga_studio.tools.base import ViewportPoint
from gaga_studio.tools.pick import PickTool, surface_point
from gaga_studio.ui.chrome import status
from tests.app.floaters import GROUP, planted
from tests.app.looks import snapshot
from tests.app.window.driver import KEY, Driver, drive
from tests.core.fill import models
from tests.core.fill.tables import BOX, table_project
from tests.scenes import objects_scene

pytestmark = pytest.mark.window
_SURROUNDINGS, _MODEL = (
    f"Inspector/**/###object.{name}" for name in ("fill_continue", "fill_model")
)


def test_a_model_is_chosen_in_the_preview_and_left_again(display: str, tmp_path: Path) -> None:
    save_project(table_project(tmp_path / "table"))
    red = models.saved(models.Red(), tmp_path / "red.pt")

    def walk(d: Driver) -> None:
        session = d.session
        d.select(BOX)
        d.menu("Object/Delete and fill")
        d.settle()
        plain = d.pixels().astype(np.int32)
        d.click(_MODEL)
        d.answer_path(red)
        d.settle()
        found = fill.shown(session)
        assert found is not None
        assert found.model == "red.pt"
        painted = d.pixels().astype(np.int32)
        redder = (painted - plain)[:, :, 0] - (painted - plain)[:, :, 1]
        assert (redder > 60).sum() > 200, "the preview shows it"
        d.click(_SURROUNDINGS)
        d.settle()
        assert session.settings.inpainting_model == ""
        assert np.abs(d.pixels().astype(np.int32) - plain).mean() < 0.5

        with models.no_torch():
            d.click(_MODEL)
            assert d.studio.ui.files.dialog is None, "it is off without PyTorch"

    drive(walk, path=tmp_path / "table", size=(1100, 700))


def test_a_filling_stays_until_it_is_applied_or_cancelled(display: str, tmp_path: Path) -> None:
    """Clicks, drags, keys and lists leave the preview alone, and say what to do with it."""
    saved = save_project(table_project(tmp_path / "table"))

    def walk(d: Driver) -> None:
        session = d.session
        d.until(lambda: session.need().feature(SearchState).described is not None, "rows move once")
        d.select(BOX)
        d.menu("Object/Delete and fill")
        d.settle()
        found, entries = fill.shown(session), d.history.cursor
        assert found is not None
        width, height = d.size
        other = next(int(g) for g in session.objects().ids if g)

        def click() -> None:
            d.click_picture(width / 2, height / 2)

        def drag(key: KEY) -> None:
            d.keys(key)
            d.drag_picture((width * 0.1, height * 0.2), (width * 0.7, height * 0.6))

        for act in (
            click,
            partial(d.click_picture, width / 2, height / 2, 1),
            partial(drag, KEY.r),
            partial(drag, KEY.b),
            partial(d.keys, KEY.delete),
            partial(d.keys, KEY.mod_ctrl, KEY.a),
            partial(d.keys, KEY.mod_ctrl, KEY.z),
            partial(d.click, f"**/object {other}/##row"),
            partial(d.keys, KEY.mod_ctrl, KEY.s),
        ):
            act()
            d.settle()
            assert fill.shown(session) is found
            assert d.history.cursor == entries
        assert [n for n in session.notices if n.text.startswith("Apply or cancel")], "it is said"
        d.keys(KEY.mod_ctrl, KEY.w)
        d.click("Question/###Cancel")
        assert fill.shown(session) is found
        d.keys(KEY.escape)
        assert fill.shown(session) is None
        again = run_stage(open_path_stage(saved))
        assert not again.scene.has(State.DELETED).any(), "a save has no preview"

    unfolded = Settings(first_steps_done=True, identities="none", folds_background=False)
    drive(walk, path=saved, size=(1100, 700), settings=unfolded)  # a row that folds has no click


def test_the_teapot_of_the_demo_leaves_no_stain(display: str) -> None:
    """The first object that everybody tries, clicked where no objects were found; the preview is
    applied by Enter, whatever the tool is."""

    def walk(d: Driver) -> None:
        before = d.pixels().astype(np.int32)
        d.click_picture(0.44 * d.size[0], 0.57 * d.size[1])
        d.settle()
        d.click("Inspector/###Fill")
        d.settle()
        found, n = fill.shown(d.session), d.history.cursor
        assert found is not None
        assert len(found.stained) > 100, fill.summary(found)
        assert len(found.splats) > 200, fill.summary(found)
        d.keys(KEY.enter)
        assert (fill.shown(d.session), d.history.cursor) == (None, n + 1)
        after = d.pixels().astype(np.int32)
        place = np.abs(after - before).max(axis=2) > 40
        _, green, blue = np.moveaxis(after, -1, 0)
        # The candle behind it is brass: of the inside of the teapot, or grey, green is less.
        stain = place & (after @ LUMA < 110) & (blue > green - 10)
        assert stain.sum() < 0.01 * place.sum()

    drive(walk, demo=True, size=(1100, 700), patience_s=400)


# --- Clean up in the window: button, picture, Apply, and the keys.


def reddish(picture: UInt8Array) -> int:
    red, green, blue = np.moveaxis(picture.astype(np.int32), -1, 0)
    return int(((red > 110) & (red > green + 40) & (red > blue + 40)).sum())


def _a_preview_is_seen_and_ended_in_a_small_window(d: Driver) -> None:
    """No options of a tool lie over it, and its buttons are in sight."""
    session = d.session
    d.on_main(lambda: session.change_settings(replace(session.settings, ui_scale=2.0)))
    d.resize(800, 500)
    d.frames(10)
    session.tool = ToolName.RECT
    d.frames(3)
    assert d.exists("**/How deep/Through")
    d.on_main(lambda: commands.run("object.clean", session))
    d.settle()
    d.focus("Inspector")
    assert not d.exists("**/How deep/Through")
    words = d.engine.window_info("//Inspector/Preview").window
    for at in (0.0, words.scroll_max.y):
        d.on_main(partial(imgui.internal.set_scroll_y, words, at))
        d.frames(3)
        for name in ("Apply", "Cancel"):
            button = d.engine.item_info(f"//Inspector/###{name}")
            for side in ("min", "max"):
                seen, whole = getattr(button.rect_clipped, side), getattr(button.rect_full, side)
                assert (seen.x, seen.y) == (whole.x, whole.y), (name, at)
    assert words.scroll.y > 0, "what it says does not fit"
    assert d.engine.get_window_by_ref("//Inspector").scroll_max.y == 0, "the buttons stay"
    assert not d.exists("//Viewport/###Cancel"), "one of each"
    d.keys(KEY.mod_ctrl, KEY.f)  # the list of objects comes to the front
    d.frames(4)
    assert "field" in status.status_text(session, PickTool(), is_typing=True)
    d.session.notify(Level.HINT, "Apply or cancel (Esc) the preview of Clean up first.")
    d.frames(6)
    for name in ("Apply", "Cancel"):
        button = d.engine.item_info(f"//Viewport/###{name}")
        rect = button.rect_full
        assert not d.studio.ui.area.has_words_in((rect.min.x, rect.min.y, rect.max.x, rect.max.y))
        assert button.rect_clipped.max.y == button.rect_full.max.y, name
    d.click("Viewport/###Cancel")
    d.frames(3)
    assert cleanup.shown(session) is None
    session.tool = ToolName.PICK
    d.on_main(lambda: session.change_settings(replace(session.settings, ui_scale=1.0)))
    d.resize(1100, 700)
    d.frames(10)


def test_clean_up_and_apply(display: str, tmp_path: Path) -> None:
    scene, floaters = planted()
    model = tmp_path / "balls.ply"
    write_ply(model, scene.gaussians)
    saved = save_project(Project(scene, model), tmp_path / "balls.gaga")

    def walk(d: Driver) -> None:
        session, document = d.session, d.session.need()
        d.select(GROUP)
        d.on_main(lambda: setattr(session.view, "mode", Mode.DEPTH))
        before, plain = snapshot(document.scene), d.pixels()

        d.click("Inspector/###Clean up")
        d.settle()
        assert cleanup.shown(session) is not None
        seen = d.pixels()
        assert reddish(seen) > 100
        assert seen.std(axis=2).mean() < 0.3 * plain.std(axis=2).mean(), "the rest is gray"
        d.on_main(lambda: setattr(session.view, "mode", Mode.COLOR))
        np.testing.assert_array_equal(seen, d.pixels(), "it looks the same in every render mode")
        assert not d.exists("Inspector/###Hide")
        d.click_picture(d.size[0] / 2, d.size[1] / 2)
        d.keys(KEY.mod_ctrl, KEY.d)
        assert cleanup.shown(session) is not None, "its seconds of work are not thrown away"
        assert session.notices[-1].text.startswith("Apply or cancel")
        assert session.selected_groups() == (GROUP,)
        d.keys(KEY.escape)
        assert not d.exists("Inspector/###Apply")
        assert snapshot(document.scene) == before
        assert session.selected_groups() == (GROUP,)

        _a_preview_is_seen_and_ended_in_a_small_window(d)
        assert snapshot(document.scene) == before

        d.click("Inspector/###Clean up")
        d.settle()
        d.click("Inspector/###Apply")
        d.settle()
        assert (document.scene.labels[floaters] == 0).mean() > 0.9
        cleaned = snapshot(document.scene)
        d.keys(KEY.mod_ctrl, KEY.z)
        assert snapshot(document.scene) == before

        d.click("Inspector/###Clean up")
        d.settle()
        d.keys(KEY.enter)
        assert snapshot(document.scene) == cleaned
        d.keys(KEY.mod_ctrl, KEY.z)

        name = document.name_of(GROUP)
        d.click("Inspector/###Clean first")
        d.click("Inspector/###Delete")
        d.settle()
        assert document.scene.has(State.DELETED)[floaters].all()
        assert document.history.undo_title == f"Delete {name}"

    drive(walk, path=saved)


# --- The tool Measure in the window: click, read, set the scale, undo; at several sizes.

_PICTURES = os.environ.get("GAGA_TEST_PICTURES")  # a folder: pictures are taken, at more sizes
_SIZES = [(800, 500), (1440, 900), (2560, 1440)]


@pytest.mark.parametrize("size", _SIZES if _PICTURES else _SIZES[:1], ids=str)
def test_a_length_is_clicked_and_made_a_metre(
    display: str, tmp_path: Path, size: tuple[int, int]
) -> None:
    write_splats(tmp_path / "balls.ply", objects_scene().gaussians)

    def walk(d: Driver) -> None:
        session = d.session
        session.notices = ()
        d.menu("Tools/###Measure lengths, angles and heights")
        width, height = d.size
        spots = [
            (u, v)
            for u in np.linspace(0.4, 0.6, 9) * width
            for v in np.linspace(0.35, 0.8, 10) * height
            if surface_point(session, ViewportPoint(float(u), float(v), width, height)) is not None
        ]
        first, second, third = spots[0], spots[-1], spots[len(spots) // 2]
        for n, spot in enumerate((first, second, third), 1):
            d.click_picture(*spot)
            assert len(measure.clicked(session).points) == n
        d.settle()
        if _PICTURES:
            d.capture(Path(_PICTURES) / f"measure_{size[0]}.png")
        d.keys(KEY.backspace)
        assert len(measure.clicked(session).points) == 2
        d.type_into("**/##Known length", "about 2")
        d.click("**/###Set scale")
        assert any("cannot be read" in notice.text for notice in d.session.notices)
        d.keys(KEY.escape)  # leaves the field, which has kept the keyboard
        d.keys(KEY.escape)  # closes it
        d.type_into("**/##Known length", "250 cm")
        d.click("**/###Set scale")
        d.settle()
        assert session.need().history.undo_title == "Set scale"
        assert measure.reading(session).lengths == pytest.approx((2.5,), rel=1e-4)
        assert session.need().scene.frame.is_metric
        if _PICTURES:
            d.capture(Path(_PICTURES) / f"measure_metres_{size[0]}.png")
        d.keys(KEY.mod_ctrl, KEY.z)
        d.settle()
        assert scale_of(session.need().world) == pytest.approx(1.0)
        d.keys(KEY.escape)
        assert session.tool is ToolName.PICK

    drive(walk, path=tmp_path / "balls.ply", size=size)


# --- Align to ground in the window: three clicks, an orbit between them, a click on nothing.

_TILT = np.radians(20.0)


def test_three_clicks_lay_the_scene_level(display: str, tmp_path: Path) -> None:
    made = Scene.of(objects_scene().gaussians)
    c, s = np.cos(_TILT), np.sin(_TILT)
    tilted = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 1.0]])
    edit = edits.transform(made, np.arange(len(made)), tilted)
    assert edit is not None
    edit.apply(made)
    write_splats(tmp_path / "slope.ply", bake(made))
    floor = np.flatnonzero(objects_scene().gaussians.means[:, 2] < -0.299)

    def ground(d: Driver) -> DoubleArray:
        return world_means(d.scene)[floor].astype(np.float64)

    def click_ground(d: Driver, inside: tuple[float, float], n: int) -> None:
        """On the bare floor near this share of the picture, with nothing of the window there."""
        pixels, _ = d.session.rig.camera(*d.size).project(ground(d))
        wanted = np.array(inside) * d.size
        for u, v in pixels[np.argsort(np.linalg.norm(pixels - wanted, axis=1))]:
            found = d.session.pick(float(u), float(v), *d.size)
            if found is not None and found.splat in floor:
                break
        d.click_picture(float(u), float(v))
        assert len(measure.clicked(d.session).points) == n

    def walk(d: Driver) -> None:
        session = d.session
        session.rig.look_from((0, -1, 1))
        session.notices = ()
        d.settle()
        plain = d.pixels()
        d.keys(KEY.b)
        d.menu("Tools/###Align to ground by three points")
        click_ground(d, (0.3, 0.45), 1)
        d.drag_picture((d.size[0] / 2, d.size[1] / 2), (40, 0))
        d.settle()
        assert len(measure.clicked(session).points) == 1
        empty = [(20, v) for v in range(70, 300) if session.pick(20, v, *d.size) is None]
        d.click_picture(*empty[0])
        assert "no surface" in session.hint
        click_ground(d, (0.7, 0.45), 2)
        d.keys(KEY.backspace)
        assert len(measure.clicked(session).points) == 1
        click_ground(d, (0.7, 0.45), 2)
        assert not session.unsaved
        click_ground(d, (0.5, 0.75), 0)
        d.settle()
        assert session.tool is ToolName.BRUSH
        history = session.need().history
        assert history.undo_title == "Align to ground"
        laid = ground(d)
        normal = np.linalg.svd(laid - laid.mean(axis=0))[2][2]
        assert np.linalg.norm(np.cross(normal, session.rig.up)) < 0.06
        assert np.abs(laid @ session.rig.up).max() < 0.1
        seen = (d.pixels() != np.array([28, 28, 31])).any(axis=2).mean()
        assert seen > 0.5 * (plain != np.array([28, 28, 31])).any(axis=2).mean()
        d.keys(KEY.mod_ctrl, KEY.z)
        d.settle()
        assert not session.unsaved
        seen = (d.pixels() != np.array([28, 28, 31])).any(axis=2).mean()
        assert seen > 0.5 * (plain != np.array([28, 28, 31])).any(axis=2).mean()
        d.menu("Tools/###Align to ground by three points")
        d.keys(KEY.escape)
        assert session.tool is ToolName.BRUSH

    drive(walk, path=tmp_path / "slope.ply")


# --- Numbers of the Inspector: absolute position, rotation and scale, own axes, reset, boxes.

_SCALED = [((800, 500), 1.0), ((1440, 900), 1.0), ((2560, 1440), 2.0)]


@pytest.mark.parametrize(("size", "scale"), _SCALED if _PICTURES else _SCALED[:1], ids=str)
def test_numbers_are_typed_read_again_and_reset(
    display: str, grouped_scene: Path, size: tuple[int, int], scale: float
) -> None:
    def walk(d: Driver) -> None:
        session = d.session
        document = session.need()
        group = int(session.objects().ids[-1])
        d.select(group)
        d.focus("Inspector")
        d.settle()
        splats = session.selected_indices()
        start = world_means(document.scene, splats)
        n = document.history.cursor
        for field, typed in (("Rotation Z", "30"), ("Scale X", "2"), ("Position Y", "0.25")):
            d.type_into(f"Inspector/Properties/##{field}", typed)
            d.settle()
        assert document.history.cursor == n + 3, "one edit for each number"
        pose = document.selected_pose()
        assert pose is not None
        np.testing.assert_allclose(degrees_of(pose, local=False), [0, 0, 30], atol=1e-4)
        np.testing.assert_allclose(pose.scale, 2.0, rtol=1e-6)
        assert pose.centre[1] == pytest.approx(0.25, abs=2e-3)
        d.engine.item_double_click("//Inspector/Properties/##Position Y")
        d.engine.key_chars("0.5")
        d.engine.key_press(int(imgui.Key.enter))
        d.settle()
        pose = document.selected_pose()
        assert pose is not None
        assert pose.centre[1] == pytest.approx(0.5, abs=2e-3), "a double click takes all of 0.250"
        d.type_into("Inspector/Properties/##Position Y", "1e30")
        d.settle()
        far = document.selected_pose()
        assert far is not None
        assert 0 < far.centre[1] < 1.1e4 * session.rig.radius, "no farther than can be drawn"
        document.undo()
        d.settle()
        pose = document.selected_pose()
        d.type_into("Inspector/Properties/##Position Y", "2 parsecs")
        d.settle()
        assert document.selected_pose() is pose
        assert any("cannot be read" in notice.text for notice in session.notices)
        d.click("Inspector/Each axis")
        d.click("Inspector/Own axes")
        d.type_into("Inspector/Properties/##Scale Z", "1")
        d.settle()
        pose = document.selected_pose()
        assert pose is not None
        np.testing.assert_allclose(pose.scale, [2, 2, 1], rtol=1e-6)
        sizes, box = document.selected_sizes(local=True), document.selected_oriented_box()
        assert sizes is not None
        assert box is not None
        assert np.prod(box.size) < 1.02 * np.prod(sizes)
        d.click("Inspector/Box")
        d.settle()
        assert session.view.show_box
        if _PICTURES:
            d.capture(Path(_PICTURES) / f"placement_{size[0]}.png")
        d.click("Inspector/###Reset placement")
        d.settle()
        np.testing.assert_array_equal(world_means(document.scene, splats), start)
        for _ in range(6):
            d.keys(KEY.mod_ctrl, KEY.z)
        d.settle()
        assert document.history.cursor == n
        np.testing.assert_array_equal(world_means(document.scene, splats), start)

    settings = Settings(first_steps_done=True, ui_scale=scale)
    drive(walk, path=grouped_scene, size=size, settings=settings)
