"""Everything but the main job: beginnings, bad files, cancelling, sizes, keys, questions."""

import logging
import os
import shutil
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from imgui_bundle import ImVec2, imgui

from gaga_core.errors import GagaError, plain_text
from gaga_core.export.export import export_objects_stage
from gaga_core.io.splats.splat_files import SplatFormat, read_splats, write_splats
from gaga_core.placing.photos import list_photos
from gaga_core.progress import Progress, Stage, run_stage
from gaga_core.scene.scene import Scene
from gaga_studio.features import commands, export
from gaga_studio.features.base import Command
from gaga_studio.features.commands import MENUS
from gaga_studio.features.find import association
from gaga_studio.session.notices import Level, UserQuestion
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName
from gaga_studio.system import paths
from gaga_studio.ui.chrome import command_buttons, menu, toasts, toolbar
from gaga_studio.ui.dialogs import files, sheets
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.textures import groups_of_view
from gaga_studio.ui.panels import inspector
from tests.app.folders import write_scene
from tests.app.window.driver import KEY, Driver, drive
from tests.core.io.splat_parts import write_without_up
from tests.core.placing.photo_scenes import write_photos
from tests.scenes import objects_scene, random_gaussians

pytestmark = pytest.mark.window


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scene") / "balls"
    write_scene(folder, n_objects=4)
    return folder


@pytest.fixture(autouse=True)
def _clean(balls: Path) -> Iterator[None]:
    yield
    work = balls / "gaga"
    assert not work.exists(), "these tests save nothing"


def test_nothing_open_offers_four_ways(display: str, balls: Path, tmp_path: Path) -> None:
    photos = tmp_path / "shots"
    write_photos(photos, 3)

    def test(d: Driver) -> None:
        d.click("Viewport/Start from photos or a film")
        d.answer_path(photos / sorted(path.name for path in photos.iterdir())[0])
        d.settle()
        assert d.session.photos is not None
        assert d.session.photos.photos == photos, "a photo stands for its folder"
        d.on_main(d.session.close)
        d.frames(3)
        d.menu("File/###Start from photos or a film…")
        d.answer_path(photos)
        assert d.session.photos is None, "it is entered"
        d.keys(KEY.enter)
        d.settle()
        assert d.session.photos is not None, "nothing named in it: all of it"
        assert d.session.photos.photos == photos
        d.on_main(d.session.close)
        d.frames(3)
        for choice in ("Open a scene folder", "Open a splat file", "Try the demo"):
            assert d.exists(f"Viewport/{choice}"), choice
        d.click("Viewport/Open a scene folder")
        d.answer_path(balls)
        d.settle()
        assert d.session.title == "balls"
        assert not d.exists("Viewport/Try the demo")
        d.keys(KEY.mod_ctrl, KEY.w)
        assert d.session.document is None
        assert d.exists("Viewport/Try the demo")
        assert paths.picture_of(str(balls)).is_file(), "its picture is in the list"
        d.click("Viewport/###Recent 0")
        d.settle()
        assert d.session.title == "balls"
        d.keys(KEY.mod_ctrl, KEY.o)
        d.answer_path(photos / "no_splats.txt")
        assert d.session.title == "balls", "no folder and nothing that opens"
        dialog = d.studio.ui.files.dialog
        assert dialog is not None
        assert "Choose a scene folder" in dialog.message, "what does open"
        d.answer_path(balls / "point_cloud.ply")  # a file that opens is opened
        d.settle()
        assert d.session.title == "point_cloud.ply"

    (photos / "no_splats.txt").touch()
    drive(test)


def test_a_small_start_page_names_what_was_open_lately(display: str, tmp_path: Path) -> None:
    """At 800x500 with large text there was no way but the menu."""
    names = [tmp_path / f"scene {k}.ply" for k in range(5)]
    for name in names:
        write_splats(name, random_gaussians(60))

    def test(d: Driver) -> None:
        page = d.engine.get_window_by_ref("//Viewport").rect()
        first = d.engine.item_info("**/###Recent 0").rect_full
        assert page.min.y < first.min.y < first.max.y <= page.max.y, "without scrolling"
        d.engine.mouse_move("**/###Recent 0")
        d.engine.mouse_wheel_y(-20)
        d.frames(4)
        d.click("**/###Recent 4")
        d.settle()
        assert d.session.title == "scene 4.ply"

    settings = Settings(first_steps_done=True, ui_scale=2.0, recent=tuple(map(str, names)))
    drive(test, size=(800, 500), settings=settings)


def test_the_recent_list_has_a_picture_of_all_that_was_opened(display: str, tmp_path: Path) -> None:
    """Folders of exported objects, and what was just saved, had none."""
    made = objects_scene(3, 60)
    parts, file = tmp_path / "parts", tmp_path / "one.ply"
    run_stage(export_objects_stage(Scene.of(made.gaussians, made.labels), parts))
    write_splats(file, made.gaussians)

    def test(d: Driver) -> None:
        for path in (parts, file):
            d.on_main(partial(d.session.open, path))
            d.settle()
            assert paths.picture_of(d.session.settings.recent[0]).is_file(), path
            d.on_main(d.session.save)
            d.settle()
            assert d.session.settings.recent[0] == str(d.session.need().project.path)
            assert paths.picture_of(d.session.settings.recent[0]).is_file(), "as it was saved"

    drive(test)


@pytest.mark.skipif(sys.platform == "win32", reason="files cannot have such names")
def test_a_name_with_control_characters_is_drawn_one_way(
    display: str, balls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad, drawn = tmp_path / "bad\x1b name.ply", [""]
    bad.write_bytes((balls / "point_cloud.ply").read_bytes())

    def logged(session: Session, draw: Callable[[Session], None] = menu._title) -> None:
        imgui.log_to_clipboard()
        draw(session)
        imgui.log_finish()
        drawn[0] = imgui.get_clipboard_text()

    monkeypatch.setattr(menu, "_title", logged)

    def test(d: Driver) -> None:
        d.settle()
        d.resize(1600, 900)  # where there is room for a title
        assert drawn[0].strip() == plain_text(bad.name)
        recent = plain_text(str(bad)).replace("\\", "\\\\").replace("/", "\\/")
        d.menu(f"###File/###Open recent/###{recent}")
        d.settle()
        assert d.session.title == bad.name
        proposed = export.proposed(d.session, "scene", SplatFormat.PLY)
        assert proposed.name.isprintable()
        assert files.stem(d.session).isprintable()

    drive(test, path=bad)


def test_a_bad_file_is_a_notice_and_what_is_open_stays(
    display: str, balls: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "broken.ply"
    bad.write_bytes((balls / "point_cloud.ply").read_bytes()[:5000])

    def test(d: Driver) -> None:
        before = d.session.scene
        d.studio.window.hooks.dropped([bad])  # as when it is dropped into the window
        d.frames(3)
        d.click("Question/###Open")  # not added to what is open
        d.settle()
        assert d.session.scene is before
        assert [notice.level for notice in d.session.notices] == [Level.ERROR]
        assert "broken.ply" in d.session.notices[0].text
        d.click("Notice 0/###Close")
        assert not d.exists("Notice 0/###Close")
        d.studio.window.hooks.dropped([balls])
        d.settle()
        assert d.session.scene is not before
        assert not d.session.notices, "the error does not stay over what was opened"

    drive(test, path=balls)


def test_what_a_task_says_under_a_sheet_is_there_when_it_closes(
    display: str, balls: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What labelled data had made was said behind a sheet, and gone when that closed."""
    now = [time.monotonic()]
    monkeypatch.setattr(toasts, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def test(d: Driver) -> None:
        d.command("Preferences")
        d.frames(4)
        d.session.notify(Level.INFO, "8 labelled pictures.", shows=tmp_path)
        for _ in range(3):
            now[0] += 50
            d.frames(3)
        d.keys(KEY.escape)
        d.frames(4)
        assert d.exists("Notice 0/###Show in folder")
        now[0] += 50
        d.frames(3)
        assert not d.exists("Notice 0/###Show in folder"), "it was in sight for long enough"

    drive(test, path=balls)


def test_what_is_in_a_folder_is_opened_and_its_pictures_are_no_photos(
    display: str, balls: Path, tmp_path: Path
) -> None:
    """Textures of splats, and pictures next to exported objects, are not taken for photos."""
    sog, objects = tmp_path / "sog", tmp_path / "objects"
    write_splats(tmp_path / "one.sog", random_gaussians(40))
    with zipfile.ZipFile(tmp_path / "one.sog") as file:
        file.extractall(sog)
    made = objects_scene(3)
    run_stage(export_objects_stage(Scene.of(made.gaussians, made.labels), objects))
    shutil.copy(next((balls / "images").iterdir()), objects / "preview.png")
    assert list_photos(sog), "pictures in it look like photos"
    assert list_photos(objects)

    def test(d: Driver) -> None:
        for folder, n in ((sog, 40), (objects, int((made.labels > 0).sum()))):
            d.studio.window.hooks.dropped([folder])
            d.settle()
            assert d.session.photos is None
            assert len(d.scene) == n

    drive(test, path=balls)


def test_advice_on_the_picture_goes_once_it_is_followed(
    display: str, balls: Path, tmp_path: Path
) -> None:
    lone = Path(shutil.copy(balls / "point_cloud.ply", tmp_path / "lone.ply"))

    def test(d: Driver) -> None:
        offer = association.stage_offer(d.session)
        assert offer is not None
        assert not offer.command, "nothing to run: it advises the tool Object"
        assert d.exists("Viewport/**/###Not now")
        d.session.tool = ToolName.OBJECT
        d.settle()
        assert not d.exists("Viewport/**/###Not now")
        assert d.studio.ui.area.offer_top == float("inf"), "nothing keeps clear of it"

    drive(test, path=lone)


@pytest.mark.parametrize("what", ["cleared", "made an object"])
def test_clicks_on_a_scene_that_is_turned_then_are_still_the_tools(
    display: str, balls: Path, tmp_path: Path, what: str
) -> None:
    lone = tmp_path / "lone.spz"  # does not say how it stands: it may be turned
    write_without_up(lone, read_splats(balls / "point_cloud.ply"))

    def test(d: Driver) -> None:
        d.keys(KEY.o)
        d.settle()
        means = d.scene.gaussians.means.astype(np.float64)
        nearest = means[np.linalg.norm(means - d.session.rig.eye, axis=1).argmin()]
        d.click_picture(*d.project(nearest))
        d.settle()
        clicked = len(d.session.selected_indices())
        assert clicked
        d.menu("Tools/Turn upright")
        d.settle()
        assert len(d.session.selected_indices()) == clicked
        d.keys(KEY.escape if what == "cleared" else KEY.enter)
        d.settle()
        if what == "cleared":
            assert len(d.session.selected_indices()) == 0
        else:
            assert np.count_nonzero(d.scene.labels) == clicked
        assert d.tool() is ToolName.OBJECT

    drive(test, path=lone)


def _endless(when_ended: Callable[[], object] = lambda: None) -> Stage[None]:
    try:
        for step in range(100_000):
            time.sleep(0.002)
            yield Progress("Counting", step, 100_000)
    finally:
        when_ended()


def test_escape_closes_what_is_on_top_and_a_click_opens_another_menu(
    display: str, balls: Path
) -> None:
    any_popup = imgui.PopupFlags_.any_popup_id | imgui.PopupFlags_.any_popup_level

    def is_open(d: Driver) -> bool:
        return bool(d.on_main(lambda: imgui.is_popup_open("", any_popup)))

    def test(d: Driver) -> None:
        d.keys(KEY.mod_ctrl, KEY.a)
        n = len(d.session.selected_indices())
        assert n > 0
        d.menu("Edit")
        assert is_open(d)
        d.keys(KEY.escape)
        assert not is_open(d)
        assert len(d.session.selected_indices()) == n
        d.engine.mouse_move("//##MainMenuBar/##MenuBar/Edit")
        d.engine.mouse_click(0)
        d.frames(4)
        d.engine.mouse_move("//##MainMenuBar/##MenuBar/View")
        d.engine.mouse_click(0)
        d.frames(4)
        assert is_open(d), "a click on another title opens that menu"
        assert d.exists("**/###Depth")
        d.engine.mouse_click(0)
        d.frames(4)
        assert not is_open(d), "a further click closes it"
        d.menu("Edit/###Preferences…")
        d.engine.set_ref(d.engine.window_info("//Preferences/Rows").window)
        d.engine.item_click("##Theme")
        d.frames(4)
        assert d.exists("**/###Theme light")
        d.keys(KEY.escape)
        assert not d.exists("**/###Theme light")
        assert is_open(d), "Escape closed the list, not the sheet"
        d.keys(KEY.escape)
        assert not is_open(d)
        assert len(d.session.selected_indices()) == n
        for text in ("One file is damaged.", "So is another."):
            d.session.notify(Level.ERROR, text)
        d.session.notify(Level.HINT, "This goes by itself.")
        d.frames(4)
        for n_cards in (3, 2, 1):
            assert len([k for k in range(3) if d.exists(f"Notice {k}/###Close")]) == n_cards
            assert len(d.session.selected_indices()) == n
            d.keys(KEY.escape)
        assert len(d.session.selected_indices()) == 0, "nothing is left on top"
        assert d.exists("Notice 0/###Close"), "the hint is no error"

    drive(test, path=balls)


def test_a_project_is_opened_by_its_path_as_a_file_is(
    display: str, balls: Path, tmp_path: Path
) -> None:
    """It is a folder: the dialog went into it, and showed what a person never opens."""
    project = tmp_path / "kept.gaga"

    def test(d: Driver) -> None:
        d.on_main(lambda: d.session.save(project))
        d.settle()
        d.on_main(d.session.close)
        d.settle()
        assert d.session.document is None
        d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.o)
        d.answer_path(project)
        d.settle()
        assert d.session.need().project.path == project

    drive(test, path=balls)


def test_left_and_right_go_from_menu_to_menu_and_do_nothing_else(display: str, balls: Path) -> None:
    """Once around in both directions; a submenu has the keys first."""
    titles = tuple(MENUS)

    def test(d: Driver) -> None:
        def opened() -> tuple[str, int]:
            return d.studio.ui.menu.opened, len(imgui.get_current_context().open_popup_stack)

        pose, shown = d.session.rig.pose, d.session.active_view
        d.menu(titles[0])
        for key in (KEY.right_arrow, KEY.right_arrow, KEY.left_arrow, KEY.left_arrow):
            d.keys(key)  # the mouse rests on the title
        assert opened() == (titles[0], 1)
        d.keys(KEY.right_arrow)
        assert opened() == (titles[1], 1)
        d.keys(KEY.left_arrow)
        d.keys(KEY.down_arrow)
        for key, listed in (
            (KEY.right_arrow, (*titles[1:], titles[0])),
            (KEY.left_arrow, (*titles[:0:-1], titles[0])),
        ):
            for title in listed:
                d.keys(key)
                assert opened() == (title, 1)
        d.keys(KEY.down_arrow)
        d.keys(KEY.right_arrow)
        assert opened() == (titles[1], 1), "from an entry further down, too"
        while opened()[0] != "View":
            d.keys(KEY.right_arrow)
        submenu = d.engine.item_info("//$FOCUSED/###Look from").id_
        while imgui.get_current_context().nav_id != submenu:
            d.keys(KEY.down_arrow)
        d.keys(KEY.right_arrow)
        assert opened() == ("View", 2), "a submenu opens"
        d.keys(KEY.left_arrow)
        assert opened() == ("View", 1), "and closes"
        assert d.session.rig.pose == pose
        assert d.session.active_view == shown

    drive(test, path=balls, size=(1200, 700))


def test_keys_walk_through_sheets_and_their_lists(display: str, balls: Path) -> None:
    """Tab, the arrows, Enter and Space press what has the focus, and nothing else as well."""

    def test(d: Driver) -> None:
        def theme() -> str:
            return d.session.settings.theme

        def n_open() -> int:
            return len(imgui.get_current_context().open_popup_stack)

        before = theme()
        d.menu("Edit/###Preferences…")
        d.keys(KEY.tab)
        d.keys(KEY.space)
        assert n_open() == 2, "Space opens the list that Tab went to"
        d.keys(KEY.down_arrow)
        d.keys(KEY.escape)
        assert n_open() == 1, "Escape closed the list alone"
        assert theme() == before
        d.keys(KEY.enter)
        d.keys(KEY.down_arrow)
        d.keys(KEY.enter)
        assert theme() != before
        d.keys(KEY.mod_shift, KEY.tab)
        d.keys(KEY.space)
        assert n_open() == 0, "the last button is before the first field"

        d.menu("File/###Export scene…")
        sheet, n_notices = d.studio.ui.export, len(d.session.notices)
        d.click("**/###GLB")
        d.engine.set_ref(d.engine.window_info("//Export/Choices").window)
        d.engine.item_click("##Splats")
        d.frames(4)
        d.keys(KEY.down_arrow)
        d.keys(KEY.down_arrow)
        d.keys(KEY.enter)
        d.settle()
        assert sheet.options.decimate < 1
        assert n_open() == 1, "Enter took the choice, nothing was exported"
        assert len(d.session.notices) == n_notices
        d.keys(KEY.escape)

    drive(test, path=balls, size=(1000, 700))


@pytest.mark.parametrize(
    ("loses", "keys", "answer"),
    [
        (False, (KEY.enter,), "A"),
        (False, (KEY.space,), "A"),
        (False, (KEY.tab, KEY.enter), "B"),
        (False, (KEY.right_arrow, KEY.enter), "B"),
        (False, (KEY.tab, KEY.right_arrow, KEY.space), "C"),
        (False, (KEY.tab, KEY.tab, KEY.tab, KEY.enter), "A"),
        (False, (KEY.escape,), "C"),
        (True, (KEY.enter,), "C"),
        (True, (KEY.space,), "C"),
        (True, (KEY.tab, KEY.enter), "A"),
        (True, (KEY.left_arrow, KEY.enter), "B"),
        (True, (KEY.escape,), "C"),
    ],
)
def test_a_question_is_answered_by_the_button_that_has_the_focus(
    display: str, loses: bool, keys: tuple[imgui.Key, ...], answer: str
) -> None:
    answers: list[str] = []

    def test(d: Driver) -> None:
        d.session.pending_question = UserQuestion(
            "Which?", ("A", "B", "C"), answers.append, loses=loses
        )
        d.frames(4)
        for key in keys:
            d.keys(key)

    drive(test)
    assert answers == [answer]


def test_a_task_is_cancelled_by_its_button(display: str, balls: Path) -> None:
    ended = []

    def test(d: Driver) -> None:
        d.session.jobs.start("Count", _endless(lambda: ended.append(True)))
        d.frames(4)
        places = dict[bool, set[float]]()

        def is_told() -> bool:
            job = d.session.jobs.running
            assert job is not None
            place = d.engine.item_info("//**/###Cancel").rect_full.min.x
            places.setdefault(job.eta_s is None, set()).add(place)
            return job.eta_s is not None

        d.until(is_told, "the time left")
        d.frames(2)
        is_told()
        assert len(places) == 2
        assert len(set.union(*places.values())) == 1, "the button stays where it is"
        d.click("**/###Cancel")
        d.settle()
        assert ended == [True]
        assert [notice.text for notice in d.session.notices] == ["Cancelled: Count."]

    drive(test, path=balls, size=(1280, 720))


def test_a_small_window_and_the_picture_alone(display: str, balls: Path) -> None:
    size = (640, 400)

    def test(d: Driver) -> None:
        d.click("**/###Find objects")
        d.settle()
        width, height = d.size
        assert width > 0.5 * size[0]
        assert height > 0.6 * size[1]
        for panel in ("Objects", "Inspector", "Memory bank", "Views", "History"):
            d.focus(panel)
        d.focus("Inspector")
        _click_some_object(d)
        assert d.exists("Inspector/###Delete")
        picture = d.pixels()
        assert picture.shape[:2] == (height, width)
        d.keys(KEY.tab)
        assert d.size[0] == size[0], "Tab leaves the picture alone"
        d.keys(KEY.tab)
        assert d.size == (width, height)

    drive(test, path=balls, size=size)


def test_objects_are_used_by_hand(display: str, balls: Path) -> None:
    def test(d: Driver) -> None:
        home = d.session.rig.pose
        _the_mouse_moves_the_camera_and_a_photo_is_flown_to(d)
        d.session.rig.pose = home
        d.click("**/###Find objects")
        d.settle()
        for step in (
            _the_palette_runs_a_command,
            _a_rectangle_selects_what_it_holds,
            _typing_a_name_fires_no_shortcut,
            _the_memory_bank_shows_its_masks,
            _the_list_selects_ranges_hides_and_filters,
            _unsaved_edits_are_asked_about,
        ):
            d.on_main(lambda: d.history.go_to(1))
            d.session.tool, d.session.view.mode, d.session.rig.pose = (
                ToolName.PICK,
                Mode.COLOR,
                home,
            )
            d.focus("Objects")
            d.settle()
            step(d)

    drive(test, path=balls)


def _the_palette_runs_a_command(d: Driver) -> None:
    """Enter on a gray one says why, and the next letters are those of another one."""
    d.keys(KEY.mod_ctrl, KEY.p)
    d.engine.key_chars("merge obj")
    d.frames(2)
    d.engine.key_press(KEY.enter)
    d.frames(4)
    d.engine.key_chars("depth")
    d.frames(2)
    d.engine.key_press(KEY.enter)
    d.frames(3)
    assert d.mode() is Mode.DEPTH
    d.keys(KEY.f1)
    assert d.exists("Keys and mouse/###Close")
    d.engine.key_chars("depth")
    d.frames(2)
    assert d.studio.ui.palette.text_of_keys == "depth", "the field has the keyboard"
    d.keys(KEY.escape)
    assert not d.exists("Keys and mouse/###Close")
    d.focus("Inspector")
    for panel in ("Memory bank", "Inspector", "Objects"):
        d.command(panel.lower())
        window = imgui.get_current_context().nav_window
        assert not d.engine.get_window_by_ref(f"//{panel}").hidden
        assert window.root_window.name == panel, "it has the keyboard"


def _a_rectangle_selects_what_it_holds(d: Driver) -> None:
    d.keys(KEY.r)
    assert d.tool() is ToolName.RECT
    width, height = d.size
    d.drag_picture((width * 0.02, height * 0.1), (width * 0.94, height * 0.85))
    assert len(d.session.selected_groups()) >= 4
    d.keys(KEY.mod_ctrl, KEY.mod_shift, KEY.a)
    assert d.session.selected_groups() == ()


def _typing_a_name_fires_no_shortcut(d: Driver) -> None:
    group = _click_some_object(d)
    n_visible = int(d.scene.visible.sum())
    d.keys(KEY.f2)
    d.engine.key_chars("hmr /1")
    d.engine.key_press(KEY.enter)
    d.frames(3)
    assert d.scene.names == {group: "hmr /1"}
    assert int(d.scene.visible.sum()) == n_visible
    assert d.mode() is Mode.COLOR
    assert d.tool() is ToolName.PICK
    d.keys(KEY.m)
    assert d.mode() is Mode.GROUPS


def _the_list_selects_ranges_hides_and_filters(d: Driver) -> None:
    table = d.session.objects()
    groups = [int(group) for group in table.ids if group > 0]
    d.click(_row(groups[0]))
    d.engine.key_down(KEY.mod_shift)
    d.click(_row(groups[2]))
    d.engine.key_up(KEY.mod_shift)
    assert d.session.selected_groups() == tuple(groups[:3])
    d.engine.key_down(KEY.mod_ctrl)
    d.click(_row(groups[1]))
    d.engine.key_up(KEY.mod_ctrl)
    assert d.session.selected_groups() == (groups[0], groups[2])
    d.click(f"**/object {groups[0]}/###Shown")
    hidden = d.session.objects()
    assert hidden.n_hidden[hidden.row(groups[0])] == hidden.counts[hidden.row(groups[0])]
    d.engine.item_click("//Objects/##Find")
    d.engine.key_chars(f"group {groups[1]}")
    d.frames()
    assert d.exists(_row(groups[1]))
    assert not d.exists(_row(groups[2]))


def _the_mouse_moves_the_camera_and_a_photo_is_flown_to(d: Driver) -> None:
    width, height = d.size
    start = d.session.rig.eye
    d.drag_picture((width / 2, height / 2), (60, 10))
    orbited = d.session.rig.eye
    assert np.linalg.norm(orbited - start) > 0.1
    d.move_to(width / 2, height / 2)
    d.engine.mouse_wheel_y(3)
    d.frames()
    assert d.session.rig.pose.distance < np.linalg.norm(orbited - d.session.rig.pivot)
    d.focus("Views")
    d.click("**/View 001.png")
    d.settle()
    np.testing.assert_allclose(d.session.rig.eye, d.session.cameras[1].position, atol=1e-6)
    d.engine.key_down(KEY.w)
    d.frames(8)
    d.engine.key_up(KEY.w)
    assert np.linalg.norm(d.session.rig.eye - d.session.cameras[1].position) > 1e-4


def _the_memory_bank_shows_its_masks(d: Driver) -> None:
    group = _click_some_object(d)
    decisions = d.session.decisions(group)
    assert len({decision.view for decision in decisions}) >= 6
    d.focus("Memory bank")
    chosen = decisions[1]
    d.click(f"**/{chosen.view} {chosen.mask}/##decision")
    d.settle()
    assert d.studio.ui.scene.picture.evidence.decision == chosen
    table = groups_of_view(d.scene.bank, chosen.view)
    assert table is not None
    assert table[chosen.mask] == group
    d.click("**/###Go to view")
    d.settle()
    camera = next(c for c in d.session.cameras if c.name == chosen.view)
    np.testing.assert_allclose(d.session.rig.eye, camera.position, atol=1e-6)
    d.keys(KEY.escape)
    assert d.studio.ui.scene.picture.evidence.decision is None
    assert d.session.selected_groups() == (group,), "Escape closes the innermost thing only"


def _unsaved_edits_are_asked_about(d: Driver) -> None:
    assert not d.studio.window.hooks.may_close()
    d.frames(3)
    assert d.exists("Question/###Discard")
    d.click("Question/###Cancel")
    assert d.session.unsaved
    d.session.jobs.start("Count", _endless())
    d.keys(KEY.mod_ctrl, KEY.q)
    question = d.session.pending_question
    assert question is not None
    for lost in ("Count is still running", "has unsaved changes"):
        assert lost in question.text, "one question names both"
    d.click("Question/###Cancel")
    d.session.jobs.cancel()
    d.settle()
    assert not d.session.should_quit
    d.keys(KEY.mod_ctrl, KEY.w)
    d.click("Question/###Discard")
    assert d.session.document is None


def test_selections_are_kept_and_taken_by_hand(display: str, grouped_copy: Path) -> None:
    """At every size of the text: kept with Enter or the button, a row selects, Shift adds."""
    long = "everything that stands on the table next to the window of the kitchen"

    def walk(d: Driver) -> None:
        for scale in (1.0, 2.0):
            settings = replace(d.session.settings, ui_scale=scale)
            d.on_main(partial(d.session.change_settings, settings))
            d.frames(5)
            look(d)

    def look(d: Driver) -> None:
        d.focus("Select by")
        field = "Select by/##Name to keep"
        kept: dict[str, Any] = {}
        for group, name in ((2, "a"), (3, long)):
            d.select(group)
            d.type_into(field, name)
            kept[name] = d.session.selected_indices()
            assert list(d.scene.named_selections) == list(kept), "Enter keeps"
        d.select()
        d.type_into(field, "last")
        assert d.session.hint == "Nothing is selected.", "Enter says why it keeps nothing"
        d.select(4)
        d.click("Select by/Keep")
        kept["last"] = d.session.selected_indices()
        assert list(d.scene.named_selections) == list(kept)
        for name, splats in kept.items():
            d.select()
            d.click(f"Select by/{name}/###Take")
            np.testing.assert_array_equal(d.session.selected_indices(), splats)
        d.engine.key_down(KEY.mod_shift)
        d.click("Select by/a/###Take")
        d.engine.key_up(KEY.mod_shift)
        wanted = np.union1d(kept["a"], kept["last"])
        np.testing.assert_array_equal(d.session.selected_indices(), wanted)
        for name in kept:
            d.click(f"Select by/{name}/###Forget")
        assert not d.scene.named_selections

    drive(walk, path=grouped_copy, size=(1200, 700))


def test_nothing_is_drawn_again_while_nothing_changes(display: str, balls: Path) -> None:
    def test(d: Driver) -> None:
        d.pixels()
        viewport = d.studio.viewport
        assert viewport is not None
        before = viewport.n_draws
        d.frames(30)
        assert viewport.n_draws == before

    drive(test, path=balls, settings=Settings(ui_scale=1.5))


def test_a_picture_that_is_asked_for_and_not_shown_keeps_no_window_awake(
    display: str, balls: Path
) -> None:
    """As the thumbnails of a list that another panel covers before they are there."""

    def test(d: Driver) -> None:
        d.settle()
        images = d.studio.images
        assert images is not None
        pixels = np.zeros((4, 4, 3), np.uint8)
        assert d.on_main(lambda: images.texture("asked for once", lambda: pixels)) is None
        d.settle()

    drive(test, path=balls)


def _row(group: int) -> str:
    return f"**/object {group}/##row"


def _click_some_object(d: Driver) -> int:
    """Click the ball that is nearest to the eye; its group."""
    table = d.session.objects()
    rows = [row for row, count in enumerate(table.counts) if count < 400 and table.ids[row]]
    eye = d.session.rig.eye
    row = min(rows, key=lambda row: float(np.linalg.norm(table.centre[row] - eye)))
    d.click_picture(*d.project(table.centre[row]))
    assert d.session.focus == int(table.ids[row])
    return d.session.focus


# --- Errors while panels are drawn: the window tells of them, closes what they left open, lives
# on.


def in_a_child() -> None:
    imgui.push_style_color(imgui.Col_.text, 0xFFFFFFFF)
    imgui.begin_disabled()
    imgui.push_id("lost")
    imgui.begin_child("Lost", ImVec2(0, 40))
    raise IndexError("a child is open")


def in_a_table() -> None:
    imgui.begin_group()
    if imgui.begin_table("Lost", 2, imgui.TableFlags_.scroll_y, ImVec2(0, 60)):
        clipper = imgui.ListClipper()
        clipper.begin(100)
        while clipper.step():
            imgui.table_next_row()
            imgui.table_next_column()
            imgui.tree_push("lost")
            raise IndexError("a table is open")
    raise IndexError("a group is open")


def in_a_popup() -> None:
    imgui.open_popup("Lost")
    imgui.begin_popup("Lost")
    imgui.begin_tab_bar("Lost")
    imgui.push_font(imgui.get_font(), 30.0)
    raise IndexError("a popup is open")


def in_a_window() -> None:
    imgui.push_style_var(imgui.StyleVar_.window_rounding, 4.0)
    imgui.begin("Lost")
    raise IndexError("a window is open")


def test_an_error_that_leaves_something_open_is_told(
    display: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Once in this frame, once in five frames running: each is told of once, and all goes on."""
    wanted = [0]

    def failing(real: Callable[..., None], leave_open: Callable[[], None], *args: object) -> None:
        if wanted[0]:
            wanted[0] -= 1
            leave_open()
        real(*args)

    def walk(d: Driver) -> None:
        for (place, module), leave_open in product(
            {"Inspector": inspector, "Dialogs": sheets, "Tool bar": toolbar}.items(),
            (in_a_child, in_a_table, in_a_popup, in_a_window),
        ):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(module, "draw", partial(failing, module.draw, leave_open))
                for times in (1, 5):
                    d.session.notices = ()
                    _fails(d, times, place, leave_open)
            d.menu("Help/###Keys and mouse")  # every part of the window still works
            assert d.exists("Keys and mouse/###Close")
            d.keys(KEY.escape)
            assert d.exists("Viewport/Try the demo")

    def _fails(d: Driver, times: int, place: str, leave_open: Callable[[], None]) -> None:
        caplog.clear()
        wanted[0] = times
        d.until(lambda: not wanted[0], "it failed")
        d.frames(3)
        told = [notice.text for notice in d.session.notices if notice.level is Level.ERROR]
        assert told == [paths.failure(place)]
        (entry,) = [r for r in caplog.records if r.levelno == logging.ERROR]
        assert entry.exc_info is not None
        assert leave_open.__name__ in caplog.text

    drive(walk, may_fail=True)


def test_what_fails_in_an_open_menu_is_told_and_the_menu_bar_stays(
    display: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The toolkit closed the menu bar with the menu, and the window ended."""

    def walk(d: Driver) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(command_buttons, "command_item", lambda *_: 1 / 0)
            d.engine.item_click("//##MainMenuBar/##MenuBar/Find")
            d.frames(5)
            told = [notice.text for notice in d.session.notices]
            assert told == [paths.failure("Menu")]
        d.keys(KEY.escape)
        d.menu("Help/###Keys and mouse")
        assert d.exists("Keys and mouse/###Close")

    drive(walk, may_fail=True)


def test_what_a_user_can_mend_is_said_as_it_is(
    display: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(*_: object) -> None:
        raise GagaError("The disk is full. Make room.")

    def walk(d: Driver) -> None:
        monkeypatch.setattr(inspector, "draw", draw)
        d.frames(4)
        assert [notice.text for notice in d.session.notices] == ["The disk is full. Make room."]

    drive(walk)


def test_an_error_between_two_frames_is_told_and_a_file_may_still_be_dropped(
    display: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def walk(d: Driver) -> None:
        def fails(*_: object) -> None:
            raise RuntimeError("no")

        wanted = [paths.failure(place) for place in ("Open", "Session")]
        with monkeypatch.context() as broken:
            broken.setattr(d.session, "open", fails)
            d.on_main(lambda: d.studio.window.hooks.dropped([tmp_path]))
        monkeypatch.setattr(d.session, "tick", fails)
        d.frames(4)
        assert [notice.text for notice in d.session.notices] == wanted

    drive(walk, may_fail=True)


def test_the_tests_themselves_hear_of_what_failed(
    display: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a panel, and in what a test does in the thread of the window."""

    def fails() -> None:
        raise IndexError("of the test")

    def walk(d: Driver) -> None:
        with pytest.raises(IndexError, match="of the test"):
            d.on_main(fails)
        assert d.on_main(lambda: 5) == 5

    monkeypatch.setattr(widgets, "empty_state", lambda *_: 1 / 0)
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        drive(walk)


# --- What cannot be done now says why, in its menu and in the list of commands; the list offers
# what
# makes objects.

# Every fourth is enough: one function draws all. GAGA_ALL_COMMANDS=1 hovers each.
_EACH = 1 if os.environ.get("GAGA_ALL_COMMANDS") else 4


def test_disabled_commands_say_why_and_an_empty_list_offers_objects(
    display: str, scene_folder: Path
) -> None:
    def walk(d: Driver) -> None:
        d.on_main(_at_once)
        with _tooltips() as shown:
            _menus(d, shown)
            _palette(d, shown)
        d.on_main(lambda: d.session.open(scene_folder))
        d.settle()
        assert d.exists("Objects/###Find objects")
        offer = association.stage_offer(d.session)
        assert offer is not None
        assert offer.command == "object.associate", "what the button runs"
        _no_offer_while_a_job_runs(d)

    drive(walk, size=(520, 760))


def test_every_entry_of_the_menus_is_in_the_palette(
    display: str, balls: Path, grouped_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Submenus and what hangs on the scene, too: recent files, mask folders."""
    shutil.copytree(grouped_copy / "masks" / "made", grouped_copy / "masks" / "others")
    drawn, submenus, lines = set[str](), dict[str, list[str]](), set[str]()

    def entry(label: str) -> str:
        return label.partition("###")[0].lstrip(icons.BLANK).split("  ", 1)[-1].strip()

    def listening(name: str, hear: Callable[[str], object]) -> None:
        real = getattr(imgui, name)

        def call(label: str, *args: Any, **kwargs: Any) -> Any:
            hear(label)
            return real(label, *args, **kwargs)

        monkeypatch.setattr(imgui, name, call)

    def walk(d: Driver) -> None:
        d.on_main(lambda: d.session.open(balls))
        d.settle()
        d.on_main(lambda: d.session.open(grouped_copy))
        d.settle()
        within = [""]
        for name in ("menu_item", "menu_item_simple"):
            listening(name, lambda label: drawn.add(entry(label)))
        listening("begin_menu", lambda label: submenus.setdefault(within[0], []).append(label))
        for title in MENUS:
            within[0] = title
            d.engine.set_ref("//##MainMenuBar")
            hover = imgui.test_engine.TestAction.hover
            d.engine.menu_action(hover, f"{title}/")
            d.frames(4)
            below = {text for text in submenus.get(title, ()) if "###" in text}
            for label in sorted(below):
                d.engine.set_ref("//##MainMenuBar")
                d.engine.menu_action(hover, f"{title}/###{label.partition('###')[2]}/")
                d.frames(4)
            d.keys(KEY.escape)
            d.keys(KEY.escape)
        front = commands.command("view.front").title
        recent = f"{balls.name}, in {paths.shown(balls.parent)}"
        assert {recent, "others", "Put panels back", front} <= drawn
        assert len(drawn) > 0.9 * len(commands.COMMANDS)
        listening("selectable", lambda label: lines.add(entry(label)))
        d.on_main(lambda: commands.run("help.palette", d.session))
        d.frames(4)
        cut = [line.partition("…") for line in lines if "…" in line]  # a path: in its folders
        left = {
            text
            for text in drawn - lines
            if not any(text.startswith(begin) and text.endswith(end) for begin, _, end in cut)
        }
        assert left == set()
        d.engine.key_chars("recent balls")
        d.keys(KEY.enter)
        d.settle()
        assert d.session.need().name == balls.name

    drive(walk, size=(1500, 950))


def _no_offer_while_a_job_runs(d: Driver) -> None:
    card, button, ends = "Viewport/**/###Not now", "Objects/###Find objects", Event()
    assert d.exists(card)
    assert d.on_main(lambda: d.session.jobs.start("Wait", _waits(ends)))
    d.frames(3)
    assert not d.exists(card), "on the picture"
    assert not d.exists(button)
    said: dict[str, str] = {}
    real = widgets.empty_state

    def empty_state(icon: str, title: str, detail: str) -> None:
        said[title] = detail
        real(icon, title, detail)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(widgets, "empty_state", empty_state)
        d.frames(2)
    assert said["No objects yet"] == "Wait is still running.", "no advice"
    ends.set()
    d.settle()
    assert d.exists(card)
    assert d.exists(button)


def _waits(ends: Event) -> Stage[None]:
    yield Progress("Wait", 0, 1)
    ends.wait()


def _at_once() -> None:
    """Tooltips without a delay."""
    style = imgui.get_style()
    style.hover_stationary_delay = style.hover_delay_short = style.hover_delay_normal = 0.0


@contextmanager
def _tooltips() -> Iterator[list[str]]:
    """The texts of the tooltips that are shown inside the block, in order."""
    shown: list[str] = []
    real = widgets.tooltip

    def tooltip(text: str, shortcut: str = "", **kwargs: bool) -> None:
        flags = imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled
        if text and imgui.is_item_hovered(flags):
            shown.append(text)
        real(text, shortcut, **kwargs)

    widgets.tooltip = tooltip
    try:
        yield shown
    finally:
        widgets.tooltip = real


def _disabled(d: Driver, of: tuple[Command, ...]) -> list[Command]:
    return [command for command in of if command.enabled(d.session)]


def _menus(d: Driver, shown: list[str]) -> None:
    n = 0
    for title, listed in MENUS.items():
        here = [c for c in _disabled(d, listed) if c.id not in menu.IN_SUBMENUS][::_EACH]
        if not here:
            continue
        d.engine.set_ref("//##MainMenuBar")
        for command in here:
            shown.clear()
            d.engine.menu_action(imgui.test_engine.TestAction.hover, f"{title}/###{command.title}")
            _says(d, shown, command)
        n += len(here)
        d.keys(KEY.escape)
    assert n > 80 // _EACH, "nearly everything needs a scene"


def _palette(d: Driver, shown: list[str]) -> None:
    """Those of submenus are here, too."""
    d.on_main(lambda: commands.run("help.palette", d.session))
    d.frames(3)
    d.engine.set_ref(d.engine.window_info("//$FOCUSED/Found").window)
    for command in _disabled(d, commands.COMMANDS)[::_EACH]:
        shown.clear()
        d.engine.mouse_move(f"###{command.id}")
        _says(d, shown, command)
    d.keys(KEY.escape)


def _says(d: Driver, shown: list[str], command: Command) -> None:
    d.check(command.id)
    d.frames(1)
    why = command.enabled(d.session)
    assert why.endswith(".")
    assert shown[-1:] == [why], command.id
