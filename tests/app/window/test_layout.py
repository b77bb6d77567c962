"""Docks: wide enough for their text at every scale, and never lost."""

import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import glfw
import numpy as np
import pytest
from imgui_bundle import ImVec2, ImVec4, glfw_utils, imgui
from PIL import Image

from gaga_core.grouping.associate import BankSnapshot
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.pipeline.place import PlacementReport
from gaga_core.scene import edits
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import State
from gaga_core.scene.selection.algebra import world_means
from gaga_core.training.train import Measured, TrainUpdate
from gaga_studio.features import (
    camera,
    commands,
    measure,
    objects,
    selection,
    split_view,
    transform,
)
from gaga_studio.features.find import memory_bank
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.notices import Level, UserQuestion
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, PhotoCompareMode, Side, ToolName, TrainingPreview
from gaga_studio.studio import _panel
from gaga_studio.system.fonts import fonts_with
from gaga_studio.ui.chrome.status import status_text
from gaga_studio.ui.dialogs.files import FileDialog, PathKind, writing
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.modal import QUESTION
from gaga_studio.ui.kit.picture_area import overlap
from gaga_studio.ui.kit.theme import visual
from gaga_studio.ui.viewport import photo_compare
from tests.app.window.driver import KEY, Driver, drive
from tests.app.window.layout_check import TextWatch, findings
from tests.core.io.splat_parts import write_without_up
from tests.core.placing.photo_scenes import write_photos
from tests.display import openbox, xvfb
from tests.scenes import random_gaussians

pytestmark = pytest.mark.window
_LEAST = 100  # pixels of a dock, times the scale of the text


def _check(d: Driver) -> None:
    """Picture, list and inspector have room."""
    scale = d.session.settings.ui_scale
    for name in ("Viewport", "Objects", "Inspector"):
        size = d.engine.get_window_by_ref(f"//{name}").size
        assert min(size.x, size.y) >= _LEAST * scale, (name, size.x, size.y)
    assert d.engine.get_window_by_ref("//Objects").size.x >= 240 * scale


def test_docks_keep_room_when_window_and_text_change(display: str, tmp_path: Path) -> None:
    layout = tmp_path / "window.ini"

    def walk(d: Driver) -> None:
        _check(d)  # the compact layout
        d.resize(1900, 1060)
        d.frames(20)
        _check(d)  # the wide one, never shown before
        for scale in (1.0, 2.0, 1.0):
            changed = Settings(first_steps_done=True, ui_scale=scale)
            d.on_main(partial(d.session.change_settings, changed))
            d.frames(20)
            _check(d)
        # Both in one: the panels are laid out for the window that is there in the end.
        d.on_main(partial(d.session.change_settings, Settings(first_steps_done=True, ui_scale=1.5)))
        d.frames(2)
        d.resize(1300, 1000)
        d.frames(2)
        d.on_main(partial(d.session.change_settings, Settings(first_steps_done=True)))
        d.frames(20)
        _check(d)
        list_width = d.engine.get_window_by_ref("//Objects").size.x
        assert 270 <= list_width <= 330, list_width

    settings = Settings(first_steps_done=True, ui_scale=1.5)
    drive(walk, size=(1300, 1000), settings=settings, layout_file=layout)


def test_a_small_window_shows_the_picture_and_the_same_tabs(display: str, tmp_path: Path) -> None:
    """At least 55 % of the width, whatever was there before; each scale keeps its layout."""

    def share(d: Driver) -> float:
        d.frames(20)
        return float(
            d.engine.get_window_by_ref("//Viewport").size.x / imgui.get_io().display_size.x
        )

    def scaled(d: Driver, scale: float) -> None:
        d.on_main(
            partial(d.session.change_settings, Settings(first_steps_done=True, ui_scale=scale))
        )
        d.frames(20)

    def in_front(d: Driver, panel: str) -> bool:
        window = d.engine.get_window_by_ref(f"//{panel}")
        return bool(window.active and not window.hidden)

    def walk(d: Driver) -> None:
        d.frames(10)
        d.focus("History")
        d.focus("Objects")
        d.focus("History")
        for size in ((1050, 620), (800, 500)):
            d.resize(*size)
            assert share(d) >= 0.55, size
            assert in_front(d, "History"), size
        for scale in (2.0, 1.0):
            scaled(d, scale)
            assert share(d) >= 0.55, scale
            assert in_front(d, "History"), scale
        d.resize(1600, 1000)
        d.frames(20)
        wide = d.engine.get_window_by_ref("//Objects").size.x
        node = d.engine.get_window_by_ref("//Objects").dock_node
        edge = ImVec2(node.pos.x + node.size.x, node.pos.y + 200)
        d.engine.mouse_move_to_pos(edge)
        d.engine.mouse_drag_with_delta(ImVec2(90, 0))
        d.frames(5)
        arranged = d.engine.get_window_by_ref("//Objects").size.x
        assert arranged > wide + 40, "a person makes the list wider"
        scaled(d, 1.25)
        scaled(d, 1.0)
        assert abs(d.engine.get_window_by_ref("//Objects").size.x - arranged) < 4

    drive(walk, size=(1600, 1000), layout_file=tmp_path / "window.ini")


def _in_front(d: Driver) -> set[str]:
    """Titles of the panels that are seen."""
    windows = [d.engine.get_window_by_ref(f"//{panel.label}") for panel in d.studio.window.panels]
    return {one.name for one in windows if one.active and not one.hidden}


def test_tabs_come_back_as_they_were_after_a_tiny_window(display: str) -> None:
    """Of panels that share one place there only one is in front: the others were forgotten."""

    def walk(d: Driver) -> None:
        d.frames(20)
        for row in ("Bookmarks", "Camera path", "Timeline", "Views"):
            for side in ("Select by", "History"):
                d.focus(row)
                d.focus(side)
                d.focus("Objects")
                d.frames(4)
                before = _in_front(d)
                assert {row, side, "Objects"} <= before
                d.resize(720, 480)
                d.frames(20)
                assert _in_front(d) <= before, "nothing comes to the front"
                d.resize(1500, 900)
                d.frames(20)
                assert _in_front(d) == before

    drive(walk, size=(1500, 900))


def test_tabs_come_back_as_they_were_after_the_picture_alone(display: str) -> None:
    """Hidden panels come back one after the other, and the last one came to the front."""

    def walk(d: Driver) -> None:
        for size in ((1500, 900), (800, 500)):
            d.resize(*size)
            d.frames(20)
            for panel in ("Objects", "Inspector", "Views"):
                d.focus(panel)
                d.frames(20)
                before = _in_front(d)
                assert panel in before
                d.keys(imgui.Key.tab)
                d.frames(20)
                assert _in_front(d) == {"Viewport"}
                d.keys(imgui.Key.tab)
                d.frames(20)
                assert _in_front(d) == before, size

    drive(walk, size=(1500, 900))


def test_a_remembered_layout_without_a_picture_is_put_right(display: str, tmp_path: Path) -> None:
    layout = tmp_path / "window.ini"
    drive(lambda d: d.frames(8), size=(1300, 800), layout_file=layout)
    text = re.sub(r"Size=\d+,\d+", "Size=32,56", layout.read_text())
    text = re.sub(r"^DockId.*\n", "", text, flags=re.M)
    layout.write_text(text)

    def walk(d: Driver) -> None:
        d.frames(20)
        _check(d)

    drive(walk, size=(1300, 800), layout_file=layout)


@pytest.mark.skipif(shutil.which("openbox") is None, reason="no window manager (openbox)")
def test_a_maximized_window_is_maximized_at_the_next_start(tmp_path: Path) -> None:
    layout = tmp_path / "window.ini"

    def attribute() -> bool:
        handle = glfw_utils.glfw_window_hello_imgui()
        return bool(glfw.get_window_attrib(handle, glfw.MAXIMIZED))

    def maximize(d: Driver) -> None:
        assert not d.on_main(attribute)
        handle = glfw_utils.glfw_window_hello_imgui()
        d.on_main(lambda: glfw.maximize_window(handle))
        d.until(lambda: bool(d.on_main(attribute)), "it is maximized")

    def size() -> tuple[int, int]:
        width, height = glfw.get_window_size(glfw_utils.glfw_window_hello_imgui())
        return width, height

    def is_again(d: Driver) -> None:
        d.until(lambda: bool(d.on_main(attribute)), "it is maximized again")
        d.frames(10)

    def restore(d: Driver) -> None:
        is_again(d)
        handle = glfw_utils.glfw_window_hello_imgui()
        assert d.on_main(size)[0] > 1000
        d.on_main(lambda: glfw.restore_window(handle))
        d.until(lambda: not d.on_main(attribute), "it is not")
        d.until(lambda: d.on_main(size) == (1000, 640), "it is as large as it was before")
        d.frames(4)

    def look(d: Driver) -> None:
        d.frames(10)
        assert not d.on_main(attribute)

    with xvfb(), openbox():
        for walk in (maximize, is_again, restore, look):
            drive(walk, size=(1000, 640), layout_file=layout)


# --- What pictures of the window at three sizes showed: cards over their object, cut rows and
# bars.


def test_a_small_window(display: str, grouped_copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def walk(d: Driver) -> None:
        group = _lowest(d)
        _the_card_of_a_mask_keeps_off_its_object(d, group, monkeypatch)
        _the_chosen_mask_is_in_sight(d, group)
        _a_clicked_mask_stays_where_it_is(d, group)
        _nothing_lies_over_the_choices_of_a_split_view(d, group)
        _titles_of_panels_are_whole(d)

    drive(walk, path=grouped_copy, size=(800, 500))


def _middle(d: Driver, group: int) -> tuple[float, float]:
    """Where an object is on the screen."""
    scene = d.scene
    u, v = d.project(np.median(world_means(scene, group_indices(scene, group)), axis=0))
    left, top = d.corner
    return left + u, top + v


def _lowest(d: Driver) -> int:
    """The object of several masks that is nearest to the middle of the lower half."""
    wanted = d.corner[0] + 0.5 * d.size[0], d.corner[1] + 0.7 * d.size[1]
    ids: list[int] = d.session.objects().ids.tolist()
    groups = [g for g in ids if g and len(d.session.decisions(g)) > 4]
    return min(groups, key=lambda g: np.hypot(*np.subtract(_middle(d, g), wanted)))


def _the_card_of_a_mask_keeps_off_its_object(
    d: Driver, group: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It lay over the object, and its title was cut."""
    shown: list[str] = []
    draw: Callable[[str], None] = imgui.text_unformatted

    def watched(text: str) -> None:
        shown.append(text)
        draw(text)

    decision = _choose(d, group, 1)
    monkeypatch.setattr(imgui, "text_unformatted", watched)
    d.frames(3)
    monkeypatch.undo()
    card = d.engine.window_info("//Viewport/Mask in its photo").window.rect()
    u, v = _middle(d, group)
    assert v > d.corner[1] + 0.4 * d.size[1], "the test looks at an object that is low"
    assert not (card.min.x <= u <= card.max.x and card.min.y <= v <= card.max.y)
    cube = d.engine.item_info("//Viewport/View cube").rect_full
    assert card.max.x <= cube.min.x
    assert any(text.endswith(f", mask {decision.mask}") for text in shown)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_the_view_that_is_looked_at_lies_over_no_button(
    display: str, grouped_copy: Path, scale: float
) -> None:
    """In a small window its card lay over *Make object* while objects were found."""

    def walk(d: Driver) -> None:
        bank = d.scene.bank
        assert bank is not None
        live = BankSnapshot(bank.log[0].view, bank, bank.n_groups)
        n_cards = 0
        for tool in (ToolName.OBJECT, ToolName.RECT, ToolName.BRUSH, ToolName.COLOR):
            d.session.tool = tool
            d.frames(3)
            d.session.live = live
            d.frames(3)
            low, high = d.corner[1], d.corner[1] + d.size[1]
            rects = {
                name: info.window.rect()
                for name in ("Tool options", "Mask in its photo")
                if (info := d.engine.window_info(f"//Viewport/{name}")).window
                and info.window.was_active
            }
            n_cards += "Mask in its photo" in rects
            assert all(low <= rect.min.y < rect.max.y <= high for rect in rects.values())
            both = [*rects.values()]
            assert len(both) < 2 or both[0].max.y <= both[1].min.y
            d.session.live = None
        assert n_cards > 0 or scale > 1, "it is shown where there is room"

    settings = Settings(first_steps_done=True, identities="none", ui_scale=scale)
    drive(walk, path=grouped_copy, size=(640, 400) if scale == 1 else (800, 500), settings=settings)


def _choose(d: Driver, group: int, at: int) -> Any:
    d.select(group)
    d.focus("Memory bank")
    decision = d.session.decisions(group)[at]
    d.click(f"**/{decision.view} {decision.mask}/##decision")
    d.settle()
    return decision


def test_the_card_of_a_mask_closes_once_another_object_is_selected(
    display: str, grouped_copy: Path
) -> None:
    """It stayed, with its splats lit, when a search selected another one."""

    def walk(d: Driver) -> None:
        ids = d.session.objects().ids.tolist()
        one, other = [group for group in ids if d.session.decisions(group)][:2]
        evidence = d.studio.ui.scene.picture.evidence
        decision = _choose(d, one, 0)
        assert evidence.decision == decision
        d.select()
        d.frames(3)
        assert evidence.decision == decision
        d.select(other)
        d.frames(3)
        assert evidence.decision is None

    drive(walk, path=grouped_copy)


def _a_clicked_mask_stays_where_it_is(d: Driver, group: int) -> None:
    """Bars came above the table, and its rows went down under the mouse."""
    d.studio.ui.scene.picture.evidence.decision = None
    d.select(group)
    d.focus("Memory bank")
    d.settle()
    seen = 0
    for decision in d.session.decisions(group):
        ref = f"//Memory bank/**/{decision.view} {decision.mask}/##decision"
        if not d.engine.item_exists(ref):
            continue
        row = d.engine.item_info(ref)
        if row.rect_clipped.get_height() < row.rect_full.get_height() or seen == 5:
            continue
        at, seen = row.rect_full.min.y, seen + 1
        d.engine.mouse_move_to_pos(row.rect_full.get_center())
        d.engine.mouse_click(0)
        d.settle()
        assert d.studio.ui.scene.picture.evidence.decision == decision
        assert d.engine.item_info(ref).rect_full.min.y == at
    assert seen > 1


def _the_chosen_mask_is_in_sight(d: Driver, group: int) -> None:
    """Its row was out of sight where it was chosen elsewhere, far down."""
    d.keys(KEY.escape)
    _choose(d, group, 0)
    decision = d.session.decisions(group)[-1]
    d.studio.ui.scene.picture.evidence.decision = decision
    d.settle()
    row = d.engine.item_info(f"//**/{decision.view} {decision.mask}/##decision")
    seen, whole = row.rect_clipped, row.rect_full
    assert seen.max.y - seen.min.y > 0.9 * (whole.max.y - whole.min.y)
    d.keys(KEY.escape)


def _nothing_lies_over_the_choices_of_a_split_view(d: Driver, group: int) -> None:
    """The way out of isolation lay over them, and what the colors say next to them."""
    d.on_main(partial(objects.isolate_item, d.session, group))
    d.session.view.mode = Mode.GROUPS
    d.on_main(partial(commands.run, "camera.split_photo_groups", d.session))
    d.settle()
    assert d.exists("Viewport/###Show all")
    assert d.exists("Viewport/##Left side")
    bar = d.engine.item_info("//Viewport/##Left side").rect_full
    assert d.engine.item_info("//Viewport/###Show all").rect_full.min.y >= bar.max.y


def _titles_of_panels_are_whole(d: Driver) -> None:
    """They were cut to "Came…"; the panel of the replay is there while there is a replay."""

    def titles() -> list[str]:
        nodes = [d.engine.get_window_by_ref(f"//{n}").dock_node for n in ("Objects", "Inspector")]
        for node in nodes:
            bar = node.tab_bar
            assert all(tab.width >= tab.content_width for tab in bar.tabs)
            assert bar.width_all_tabs <= bar.bar_rect.max.x - bar.bar_rect.min.x, "all are seen"
        return [window.name for node in nodes for window in node.windows]

    shown = titles()
    assert {"Objects", "Camera path", "Memory bank"} < set(shown)
    assert "Timeline" not in shown
    d.on_main(partial(commands.run, "view.timeline", d.session))
    d.until(lambda: memory_bank.timeline_of(d.session).is_open, "the growth is known")
    growth = memory_bank.timeline_of(d.session).growth
    assert growth is not None
    for step, said in ((0, "start"), (1, "view 1"), (growth.last_step, "end")):
        d.on_main(partial(memory_bank.go_to_step, d.session, step))
        with _texts() as texts:
            d.frames(4)
        assert said in texts, "the end counts as no view"
    d.click("Timeline/**/###Close replay")
    assert titles() == shown


def test_sheets_scroll_only_where_they_must(display: str, grouped_copy: Path) -> None:
    def scroll(d: Driver, child: str) -> tuple[float, float]:
        window = d.engine.window_info(f"//{child}").window
        return float(window.scroll.y), float(window.scroll_max.y)

    def walk(d: Driver) -> None:
        d.on_main(partial(commands.run, "edit.preferences", d.session))
        d.frames(4)
        assert scroll(d, "Preferences/Rows") == (0.0, 0.0), "all of it has room"
        d.keys(KEY.escape)
        d.menu("Find/###Make masks…")
        dialog = d.studio.ui.scene.masks
        assert scroll(d, "Make masks/How") == (0.0, 0.0), "with the picture of the try"
        d.resize(800, 500)
        d.frames(4)
        d.click("**/###Try on one photo")
        d.until(lambda: dialog.n_previews == 1, "one photo is done")
        d.settle()
        at, end = scroll(d, "Make masks/How")
        assert at == end > 0, "the try is looked at"

    drive(walk, path=grouped_copy, size=(1440, 900))


def test_a_line_over_the_picture_is_wider_where_text_is_larger(
    display: str, grouped_copy: Path, tmp_path: Path
) -> None:
    """A lasso was a hair at UI scale 2."""
    wide: dict[float, int] = {}

    def walk(d: Driver, scale: float) -> None:
        d.session.tool = ToolName.RECT
        left, top = d.corner
        u, v = 0.2 * d.size[0], 0.4 * d.size[1]
        d.move_to(u, v)
        d.engine.mouse_down(0)
        d.move_to(0.8 * d.size[0], 0.9 * d.size[1])
        d.frames()
        file = tmp_path / f"{scale}.png"
        d.capture_now(file)
        d.engine.mouse_up(0)
        with Image.open(file) as image:
            picture = np.asarray(image.convert("RGB"), np.float64)
        row = picture[round(top + 0.6 * d.size[1]), round(left + u) - 8 : round(left + u) + 8]
        accent = np.array([0x5B, 0x9D, 0xF5])
        wide[scale] = int((np.abs(row - accent).max(axis=1) < 60).sum())

    for scale in (1.0, 2.0):
        settings = Settings(first_steps_done=True, ui_scale=scale)
        drive(partial(walk, scale=scale), path=grouped_copy, size=(1000, 700), settings=settings)
    assert wide[2.0] > wide[1.0] >= 1, wide


# --- Four sizes of the window at three scales of the text: nothing is cut, overlaps or gets lost.

_PANELS = ("Objects", "Inspector", "Memory bank", "History", "Select by", "Views", "Camera path")
_FRONTS = (("Inspector", "Memory bank", "Views"), ("Select by", "History", "Camera path"))
_SIZES = {  # of the window, by the scale of the text
    1.0: ((800, 500), (1900, 1060)),
    1.25: ((1280, 720),),
    1.5: ((1440, 900),),
    2.0: ((800, 500), (480, 320)),  # the smallest that the window can be
}
_SMALLEST, _LEAST_SIZE = (800, 500), (480, 320)
_WITH_OPTIONS = (ToolName.LASSO, ToolName.OBJECT, ToolName.COLOR)
_SHEETS = (
    "edit.preferences",
    "file.export_objects",
    "file.export_cameras",
    "camera.film",
    "file.dataset",
    "edit.reduce",
    "help.about",
    "help.shortcuts",
    "object.models",
)


def test_no_text_is_cut_at_any_size(
    display: str, grouped_copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = TextWatch()
    wrong: list[str] = []

    def walk(d: Driver) -> None:
        d.select(2)
        _add_keyframes(d, 3)
        d.select(2)
        monkeypatch.setattr(imgui, "text_unformatted", watch.text(imgui.text_unformatted))
        monkeypatch.setattr(imgui, "button", watch.button(imgui.button))
        for named in ("checkbox", "radio_button"):
            monkeypatch.setattr(imgui, named, watch.labelled(getattr(imgui, named)))
        hinted = watch.hinted(imgui.input_text_with_hint)
        monkeypatch.setattr(imgui, "input_text_with_hint", hinted)
        for scale, sizes in _SIZES.items():
            settings = replace(d.session.settings, ui_scale=scale)
            d.on_main(partial(d.session.change_settings, settings))
            for size in sizes:
                look(d, size, scale)
        monkeypatch.undo()

    def look(d: Driver, size: tuple[int, int], scale: float) -> None:
        d.resize(*size)
        d.frames(5)
        has_room = size != _LEAST_SIZE
        assert (imgui.get_style().font_scale_main == scale) is has_room, "as it was asked for"
        watch.found.clear()
        for panels in _FRONTS:
            for panel in panels:
                d.engine.window_focus(f"//{panel}")
            watch.frame(d)
        wrong.extend(f"{size} {scale}: {text}" for text in findings(d, _PANELS))
        for tool in _WITH_OPTIONS if size == _SMALLEST else ():
            d.session.tool = tool
            watch.frame(d)
            d.session.tool = ToolName.PICK
        for command in _SHEETS if size in (_SMALLEST, _LEAST_SIZE) else ():
            d.on_main(partial(commands.run, command, d.session))
            watch.frame(d)
            wrong.extend(f"{size} {scale}: {command}: {text}" for text in _out_of_reach(d))
            d.keys(KEY.escape)
            d.until(lambda: d.session.jobs.running is None, "an estimate ends with its sheet")
        wrong.extend(f"{size} {scale}: {text}" for text in watch.found)

    drive(walk, path=grouped_copy, size=_SMALLEST)
    assert watch.n_seen > 500, "the texts were looked at"
    assert not wrong, "\n".join(wrong)


def _out_of_reach(d: Driver) -> Iterator[str]:
    """What is wrong with the open sheet: it leaves the screen, or its buttons scroll away."""
    context = imgui.get_current_context()
    if not (opened := context.open_popup_stack):
        yield "did not open"
        return
    sheet = opened[0].window
    assert sheet is not None
    box, screen = sheet.rect(), imgui.get_io().display_size
    if min(box.min.x, box.min.y) < 0 or box.max.x > screen.x or box.max.y > screen.y:
        yield "leaves the screen"
    if sheet.scroll_max.x > 0 or sheet.scroll_max.y > 0:
        yield "scrolls with its buttons"


def test_all_of_the_tool_bar_is_in_reach_at_any_width(display: str) -> None:
    """Photos, flying, framing and the search were left out of a narrow one."""

    def ends(ref: str, d: Driver) -> bool:
        box = d.engine.item_info(f"//{ref}").rect_full
        return bool(0 <= box.min.x < box.max.x <= imgui.get_io().display_size.x)

    def walk(d: Driver) -> None:
        ids = ("view.frusta", "view.fly", "view.frame_all", "help.palette")
        listed = [commands.command(command_id).title for command_id in ids]
        found = set()
        for width in (480, 560, 640, 680, 720, 800, 1200):
            d.resize(width, 400)
            d.frames(10)
            assert ends("**/###More render modes", d), width
            direct = [d.exists(f"**/###{title.rstrip('…')}") for title in listed]
            found.add(all(direct))
            if all(direct):
                assert all(ends(f"**/###{title.rstrip('…')}", d) for title in listed), width
                continue
            d.click("**/###More render modes")
            for title in listed:
                assert d.exists(f"$FOCUSED/###{title}"), (width, title)
            d.keys(KEY.escape)
        assert found == {True, False}, "narrow and wide ones were looked at"

    drive(walk, size=(800, 500), settings=Settings(first_steps_done=True))


def test_what_an_empty_list_offers_fits_its_panel(
    display: str, scene_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """ "Make masks (now, without a mo" in a window of 1440x900."""
    shutil.rmtree(scene_folder / "masks")
    watch = TextWatch()

    def walk(d: Driver) -> None:
        monkeypatch.setattr(imgui, "text_unformatted", watch.text(imgui.text_unformatted))
        monkeypatch.setattr(imgui, "button", watch.button(imgui.button))
        for size in ((1440, 900), (800, 500)):
            d.resize(*size)
            d.focus("Objects")
            watch.frame(d)
            assert d.exists("Objects/###Make masks"), size
        monkeypatch.undo()

    drive(walk, path=scene_folder, settings=Settings(first_steps_done=True, ui_scale=1.5))
    assert not watch.found, list(watch.found)


# --- What an hour of use met: ways out of isolation, file dialogs by key, calm bars and lists.


def test_snags_of_an_hour_of_use(display: str, grouped_copy: Path, tmp_path: Path) -> None:
    def walk(d: Driver) -> None:
        _isolation(d)
        _history(d)
        _tool_bar(d)
        _playback(d)
        _letters(d)
        _what_is_hidden_comes_back(d)
        _what_is_dark_is_seen(d)
        _a_rename_box_moves_nothing(d, tmp_path)
        _names_of_what_was_done(d)
        _every_form_is_whole(d)
        _notices(d, tmp_path / "notice.png")
        _letters_of_a_folder(d, tmp_path)
        _file_dialog(d, tmp_path)

    drive(walk, path=grouped_copy, size=(1280, 720))


def _isolation(d: Driver) -> None:
    """A button in the picture shows all again, without a selection; the command is a switch."""
    session = d.session
    assert not d.exists("Viewport/Show all")
    d.on_main(lambda: objects.isolate_item(session, 2))
    d.on_main(lambda: commands.run("select.none", session))
    d.frames()
    assert objects.isolated(session) == session.need().name_of(2)
    d.click("Viewport/Show all")
    assert not objects.isolated(session)
    d.select(3)
    d.on_main(lambda: commands.run("object.isolate", session))
    assert objects.isolated(session)
    d.on_main(lambda: commands.run("object.isolate", session))
    assert not objects.isolated(session)


def _what_is_hidden_comes_back(d: Driver) -> None:
    d.keys(KEY.mod_ctrl, KEY.a)
    d.keys(KEY.h)
    assert objects.all_hidden(d.session)
    assert not d.session.objects().n_hidden.sum() < len(d.scene)
    d.click("Viewport/Show all")
    assert not d.scene.has(State.HIDDEN).any()


def _what_is_dark_is_seen(d: Driver) -> None:
    """A black object that is shown alone on black has a gray background, until all is shown."""
    d.select(2)
    black = replace(d.session.settings, background="#000000")
    d.on_main(partial(d.session.change_settings, black))
    d.on_main(partial(transform.recolor, d.session, (0.0, 0.0, 0.0)))
    d.keys(KEY.slash)
    assert objects.isolated(d.session)
    assert d.pixels()[-1, 0].tolist() == [128, 128, 128]
    d.click("Viewport/Show all")
    assert d.pixels()[-1, 0].max() < 128
    d.on_main(partial(d.session.change_settings, replace(black, background="#1c1c1f")))


def _a_rename_box_moves_nothing(d: Driver, folder: Path) -> None:
    """The numbers of a row stay where they are while its name is a text field."""
    d.focus("Objects")
    d.select(3)
    d.settle()
    d.engine.mouse_move_to_pos(ImVec2(4, 4))
    d.frames()
    d.capture_now(folder / "row.png")
    d.keys(KEY.f2)
    box = d.engine.item_info("//Objects/**/object 3/##Name").rect_full
    end = d.engine.item_info("//Objects/**/object 3/Shown").rect_full
    d.capture_now(folder / "box.png")
    area = (round(box.max.x) + 3, round(box.min.y), round(end.min.x), round(box.max.y))
    row, now = (
        Image.open(folder / name).convert("RGB").crop(area) for name in ("row.png", "box.png")
    )
    assert np.asarray(row).std() > 5, "a number is there"
    np.testing.assert_array_equal(np.asarray(row), np.asarray(now))
    d.keys(KEY.escape)


def _names_of_what_was_done(d: Driver) -> None:
    """The history, the list of commands and sheets say what they mean."""
    d.select(3)
    d.keys(KEY.f2)
    d.engine.key_chars_replace_enter("mug")
    d.frames()
    assert re.fullmatch("Rename .+ to mug", d.history.undo_title)
    for word, wanted in (
        ("drop", "object.simulate"),
        ("scale", "tool.set_scale"),
        ("versions", "view.history"),
    ):
        d.keys(KEY.mod_ctrl, KEY.p)
        d.engine.key_chars(word)
        d.frames(3)
        d.engine.set_ref(d.engine.window_info("//$FOCUSED/Found").window.id_)
        assert d.engine.item_exists(f"###{wanted}"), word
        d.keys(KEY.escape)
    d.command("recolor")
    d.type_into("$FOCUSED/##Picker/##hex/##Text", "#F02010")
    d.keys(KEY.escape)
    assert d.history.undo_title.startswith("Recolor")
    for command, panel in (("history", "History"), ("rename", "Objects")):
        d.command(command)
        assert not d.engine.get_window_by_ref(f"//{panel}").hidden, panel
    d.keys(KEY.escape)
    d.engine.set_ref("//##MainMenuBar")
    d.engine.menu_action(imgui.test_engine.TestAction.hover, "View/###Color")
    opened = d.engine.window_info("//$FOCUSED").window
    assert opened.name.startswith("View"), opened.name
    assert 300 < opened.content_size.y < 860, "it fits 900 pixels"
    d.keys(KEY.escape)
    _add_keyframes(d, 2)
    d.session.view.playback.is_playing = True
    assert _said(d, "camera.film", "takes about"), "by what films took here, as in the status bar"
    assert not d.session.view.playback.is_playing, "it stops behind the sheet"
    d.keys(KEY.escape)
    assert "%.3f" in _number_formats(d)
    d.on_main(lambda: d.session.edit(lambda scene: edits.set_scale(scene, 1.0, 2.0, np.zeros(3))))
    assert {"%.3f m", "%.3f"} & _number_formats(d) == {"%.3f m"}, "positions are in metres"
    d.on_main(partial(commands.run, "file.export_scene", d.session))
    d.frames(3)
    field = d.engine.item_info("//**/##Units")
    assert field.id_
    d.keys(KEY.escape)
    assert _said(d, "edit.preferences", "Copy of huggingface.co")
    d.keys(KEY.escape)


def _number_formats(d: Driver) -> set[str]:
    """How numbers of the Inspector are written."""
    d.focus("Inspector")
    formats: set[str] = set()
    draw = imgui.drag_float

    def noting(*shown: Any) -> Any:
        formats.add(shown[5])
        return draw(*shown)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imgui, "drag_float", noting)
        d.frames(3)
    return formats


def _every_form_is_whole(d: Driver) -> None:
    """The last ones were cut at the edge of the sheet."""
    d.select(3)
    assert _said(d, "file.export_objects", " in 1 file, ")
    for name in ("PLY", "Web page"):
        button = d.engine.item_info(f"//**/###{name}")
        assert button.rect_clipped.max.x == button.rect_full.max.x, name
    d.keys(KEY.escape)


def test_all_ways_to_begin_are_in_reach(display: str) -> None:
    """Large text in a small window showed one and a half of four."""

    def walk(d: Driver) -> None:
        for choice in ("Start from photos or a film", "Try the demo"):
            card = d.engine.item_info(f"//Viewport/{choice}")
            assert card.rect_clipped.max.y == card.rect_full.max.y, choice
        (tab,) = [t for t in _tabs(d) if t.window.name == "Objects"]
        assert tab.width >= tab.content_width

    drive(walk, size=(800, 500), settings=Settings(ui_scale=2.0))


def test_a_low_window_with_large_text_is_used_by_hand(
    display: str, grouped_copy: Path, tmp_path: Path
) -> None:
    """The last menu, the right end of the tool bar, most forms of an export and half of the ways
    on from photos were cut; under the list's search there was no row."""
    write_photos(tmp_path / "shots", 6)

    def is_whole(d: Driver, ref: str) -> None:
        item = d.engine.item_info(f"//{ref}")
        for side in ("min", "max"):
            seen, whole = getattr(item.rect_clipped, side), getattr(item.rect_full, side)
            assert (seen.x, seen.y) == (whole.x, whole.y), ref

    def walk(d: Driver) -> None:
        panels = [d.engine.get_window_by_ref(f"//{name}") for name in ("Objects", "Inspector")]
        assert [window.hidden for window in panels] == [False, True], "one place, the list first"
        is_whole(d, "##MainMenuBar/##MenuBar/Help")
        is_whole(d, "**/More render modes")
        d.click("**/More render modes")
        listed = d.engine.window_info("//$FOCUSED").window.rect()
        assert listed.max.x <= 800, "its list is on the screen"
        assert listed.max.y <= 500
        d.click("**/###Groups")
        assert d.session.view.mode is Mode.GROUPS
        d.select(1)
        d.focus("Inspector")
        d.keys(KEY.f2)
        assert not panels[0].hidden, "the name that is typed is seen"
        d.keys(KEY.escape)
        d.on_main(partial(commands.run, "view.history", d.session))
        d.frames(20)
        bar = d.engine.get_window_by_ref("//History").dock_node.tab_bar
        (tab,) = [one for one in bar.tabs if one.window.name == "History"]
        left = tab.offset - bar.scrolling_anim
        assert 0 <= left < left + tab.width <= bar.bar_rect.get_width(), "its tab is seen"
        d.focus("Objects")
        d.on_main(partial(commands.run, "camera.split_groups", d.session))
        d.frames(4)
        side = d.engine.item_info("//Viewport/##Left side").rect_full
        assert side.get_width() > imgui.calc_text_size("Picture").x + 1.5 * side.get_height()
        d.click("Viewport/Close split view")
        d.on_main(partial(commands.run, "select.all", d.session))
        d.on_main(partial(commands.run, "object.hide", d.session))
        d.frames(4)
        area = d.studio.ui.area
        assert area.bottom - area.chip_bottom > 0.6 * area.height, "a notice has room for its lines"
        d.on_main(partial(commands.run, "edit.undo", d.session))
        d.on_main(partial(commands.run, "edit.undo", d.session))
        d.frames(4)
        d.command("clone with a brush")
        assert d.session.tool is ToolName.CLONE
        is_whole(d, "**/###Clone with a brush")
        d.on_main(partial(commands.run, "tool.pick", d.session))
        d.until(lambda: bool(d.scene.described), "the floor is listed with the background")
        d.frames(2)
        table = d.engine.window_info("//Objects/Table").window
        d.on_main(partial(imgui.internal.set_scroll_y, table, 0.0))
        d.frames(2)
        for group in range(2, 6):
            is_whole(d, f"Objects/**/object {group}/##row")
        d.keys(KEY.escape)
        d.command("make masks")
        assert d.engine.get_window_by_ref("//Make masks").scroll_max.y == 0, "the buttons stay"
        is_whole(d, "Make masks/Close")
        d.keys(KEY.escape)
        contrast = _edge(d, tmp_path)
        d.on_main(partial(commands.run, "file.export_scene", d.session))
        d.frames(4)
        sheet = d.engine.get_window_by_ref("//Export")
        assert sheet.scroll_max.y == 0, "the choices scroll, the buttons stay"
        d.until(lambda: imgui.get_current_context().dim_bg_ratio >= 1, "it has faded in")
        assert _edge(d, tmp_path) < 0.3 * contrast, "the window behind is dimmed"
        for form in ("PLY", "Web page", "USD"):
            d.click(f"Export/**/###{form}")
            is_whole(d, f"Export/**/###{form}")
        d.keys(KEY.escape)
        d.on_main(partial(commands.run, "file.export_scene", d.session))
        assert d.studio.ui.export.form is SplatFormat.USD, "as it was chosen"
        d.keys(KEY.escape)
        d.on_main(partial(d.session.open, tmp_path / "shots"))
        d.settle()
        for button in ("Make splats", "Settings…", "Open another…"):
            is_whole(d, f"Viewport/{button}")
        d.click("Viewport/Settings…")
        d.frames(4)
        assert d.engine.get_window_by_ref("//Make splats").scroll_max.y == 0, "the buttons stay"
        is_whole(d, "Make splats/Start")
        d.keys(KEY.escape)

    settings = Settings(first_steps_done=True, identities="none", ui_scale=2.0)
    drive(walk, path=grouped_copy, size=(800, 500), settings=settings)


def test_a_low_window_with_large_text_shows_what_it_offers(
    display: str, grouped_copy: Path
) -> None:
    def walk(d: Driver) -> None:
        _sizes_of_a_film(d)
        _buttons_of_sheets(d)
        _find_menu(d)
        _numbers_of_an_object(d)
        _photos_of_a_narrow_panel(d)
        _a_long_question(d)
        _a_question_of_four_answers(d)
        _names_in_the_memory_bank(d)
        _stacked_notices(d)
        _what_lies_over_the_picture(d)
        _names_in_the_list(d)
        _name_of_what_is_isolated(d)
        _times_of_a_camera_path(d)
        _training(d)
        _the_title_in_front_is_whole(d)

    settings = Settings(first_steps_done=True, identities="none", ui_scale=2.0)
    drive(walk, path=grouped_copy, size=(800, 500), settings=settings)


def test_a_question_leaves_the_splats_of_a_low_window_in_sight(
    display: str, tmp_path: Path
) -> None:
    """Its card and that of the first steps covered the head and the feet."""
    file = tmp_path / "a guitar on its stand.spz"
    write_without_up(file, random_gaussians(60, seed=4))

    def walk(d: Driver) -> None:
        card = d.engine.get_window_by_ref("//Notice 0")
        area = d.studio.ui.area
        assert card.pos.y + card.size.y - area.top < 0.4 * area.height
        assert card.scroll_max.y == 0
        assert not d.exists("//First steps/###Put away")
        edges = [d.engine.item_info(f"//Notice 0/###{title}") for title in _ANSWERS]
        assert all(edge.rect_clipped.max.x == edge.rect_full.max.x for edge in edges)
        with _texts() as shown:
            d.frames(2)
        assert "Is it upside down?" in shown, "what is asked, whole"
        d.click("Notice 0/###Turn upright")
        d.frames(2)
        assert d.exists("//First steps/###Put away")
        assert not any(notice.otherwise for notice in d.session.notices)
        assert d.session.unsaved

    settings = Settings(identities="none", ui_scale=2.0)
    drive(walk, path=file, size=(800, 500), settings=settings)


_ANSWERS = ("Turn upright", "It is upright")


def test_a_low_window_with_large_text_says_what_matters(
    display: str, grouped_copy: Path, tmp_path: Path
) -> None:
    def walk(d: Driver) -> None:
        _file_that_is_replaced(d, tmp_path)
        _titles_of_menus(d)
        _answers_of_the_search(d)
        _header_of_the_list(d, tmp_path)
        _what_a_notice_says_first(d)
        _files_at_the_end_of_long_paths(d, tmp_path)
        _long_error(d)
        _preview_behind_a_tab(d)
        _known_length(d)

    settings = Settings(first_steps_done=True, identities="none", ui_scale=2.0)
    drive(walk, path=grouped_copy, size=(800, 500), settings=settings)


def _file_that_is_replaced(d: Driver, folder: Path) -> None:
    """Only a sentence said so, below what was scrolled to."""
    (folder / "there.ply").touch()
    d.on_main(partial(commands.run, "file.export_scene", d.session))
    d.frames(4)
    for name, label in (("there.ply", "Replace file"), ("new.ply", "Export")):
        d.studio.ui.export.path = str(folder / name)
        with _buttons() as shown:
            d.frames(2)
        assert f"{label}###Export now" in shown
        button = d.engine.item_info("//Export/###Export now")
        assert button.rect_clipped.max.y == button.rect_full.max.y
    d.studio.ui.export.path = str(d.session.need().project.model_path)  # never
    d.frames(2)
    d.engine.item_click("//Export/###Export now")
    d.frames(2)
    assert d.session.jobs.running is None
    assert d.engine.item_exists("//Export/###Export now"), "it stays open"
    d.keys(KEY.escape)


def _titles_of_menus(d: Driver) -> None:
    """A click on a title whose menu had opened under the mouse closed it."""
    for title in ("Help", "View"):
        low = d.engine.item_info(f"//##MainMenuBar/##MenuBar/{title}").rect_full.min
        d.engine.mouse_move_to_pos(ImVec2(low.x + 10, low.y + 10))
        d.frames(4)
        if title == "Help":
            d.engine.mouse_click(0)
            d.frames(4)
    assert d.studio.ui.menu.opened == "View", "the mouse opens it"
    d.engine.mouse_click(0)
    d.frames(4)
    assert d.studio.ui.menu.opened == "View"
    d.engine.mouse_click(0)
    d.frames(4)
    assert d.studio.ui.menu.opened == "", "its own click closes it"


def _answers_of_the_search(d: Driver) -> None:
    """Under the sentence and the button there were three pixels of the first row."""
    d.focus("Objects")
    d.keys(KEY.mod_ctrl, KEY.f)
    d.engine.key_chars("green")
    found = d.session.need().feature(SearchState)
    d.until(lambda: len(found.meant) >= 2, "the green balls are found")
    d.frames(4)
    answer = d.engine.window_info("//Objects/Answer").window
    row = answer.content_size.y / len(found.hits)
    seen = answer.inner_clip_rect
    assert seen.max.y - seen.min.y > row, "a whole row"
    d.keys(KEY.escape)
    d.keys(KEY.escape)


def _header_of_the_list(d: Driver, folder: Path) -> None:
    """The name of a folder that was scrolled away was drawn over it."""
    d.select(1, 2)
    d.on_main(partial(commands.run, "object.folder", d.session))
    d.frames(4)
    d.keys(KEY.escape)
    d.select()
    table = d.engine.window_info("//Objects/Table").window
    headers = []
    for scrolled in (0.0, 40.0):
        d.on_main(partial(imgui.internal.set_scroll_y, table, scrolled))
        d.engine.mouse_move_to_pos(ImVec2(4, 490))
        d.capture_now(folder / "list.png")
        low, high = table.inner_rect.min, table.inner_rect.max
        header = low.x, low.y, high.x, low.y + imgui.get_font_size()
        headers.append(np.array(Image.open(folder / "list.png").crop(header)))
    assert table.scroll.y == 40
    assert (headers[0] == headers[1]).all()


def _what_a_notice_says_first(d: Driver) -> None:
    """Two of them covered the picture, and said neither which file nor what to do."""
    for name in ("first", "white flat object"):
        path = Path("/tmp") / f"{name}.ply"
        d.session.notify(Level.INFO, f"Exported {path.name}: 9,017 splats, in /tmp.", shows=path)
    with _texts() as shown:
        d.frames(4)
    said = " ".join(text for text in shown if text)
    assert "Exported white flat object.ply" in said.replace("  ", " ")
    assert "first.ply" not in said
    d.session.notices = ()


def _files_at_the_end_of_long_paths(d: Driver, folder: Path) -> None:
    """The end of a path was cut: which file it is."""
    deep = folder / "scenes of the year" / "a-house-with-many-rooms-and-a-garden" / "second floor"
    deep.mkdir(parents=True)
    for name in ("x.gaga", "white flat object.ply"):
        for shows in (None, deep):
            d.session.notify(Level.INFO, f"Saved to {deep / name}.", shows=shows)
            with _texts() as shown:
                d.frames(4)
            assert f"{name}." in " ".join(text for text in shown if text)
            assert str(deep) not in shown, "not whole"
            d.session.notices = d.session.notices[:-1]
    d.session.notify(Level.INFO, f"Saved to {deep / name}.")
    d.frames(4)
    card = d.engine.get_window_by_ref("//Notice 0")
    with _texts() as shown:
        line = ImVec2(card.pos.x + 0.35 * card.size.x, card.pos.y + 0.25 * card.size.y)
        d.engine.mouse_move_to_pos(line)
        d.until(lambda: "garden/second" in "".join(shown), "the whole path")
    d.session.notices = ()
    d.on_main(lambda: d.studio.ui.files.ask(FileDialog("Open", PathKind.OPEN_FILE, deep), print))
    with _texts() as shown:
        d.frames(4)
    assert any(text.endswith("…/second floor") for text in shown)
    d.keys(KEY.escape)


def _long_error(d: Driver) -> None:
    """It ran out of the window; its end says what to do."""
    path = "/home/someone/photos-scene/gaga-before-2/project.json"
    d.session.notify(Level.ERROR, f"{path} changed since it was saved. " * 3 + "Move it away.")
    d.frames(6)
    card = d.engine.get_window_by_ref("//Notice 0")
    assert card.pos.y + card.size.y <= d.corner[1] + d.size[1]
    assert card.scroll_max.y > 0, "its end can be scrolled to"
    d.session.notices = ()


def _preview_behind_a_tab(d: Driver) -> None:
    """What applies a preview was behind the list."""
    d.select(1)
    d.focus("Objects")
    panel = d.engine.get_window_by_ref("//Inspector")
    assert panel.hidden
    edit = edits.delete(d.scene, group_indices(d.scene, 1))
    assert edit is not None
    d.on_main(lambda: d.session.need().show(edit, waits_as="Delete and fill"))
    d.frames(6)
    assert not panel.hidden
    d.on_main(lambda: selection.select_groups(d.session, (2,)))
    assert d.session.notices[-1].text.startswith("Apply or cancel")
    d.on_main(d.session.cancel_preview)
    d.session.notices = ()


def _known_length(d: Driver) -> None:
    """Its card covered the picture, and a number that was typed changed the tool."""
    d.on_main(partial(commands.run, "tool.set_scale", d.session))
    points = [d.project(world_means(d.scene)[group_indices(d.scene, group)[0]]) for group in (1, 2)]
    for at in points:
        found = d.session.pick(*at, *d.size)
        assert found is not None
        x, y, z = found.point.tolist()
        d.on_main(partial(measure.add, d.session, (x, y, z)))
    d.frames(6)
    card = d.engine.window_info("//Viewport/Measure").window
    assert card.size.y < d.size[1] / 2
    d.engine.key_chars("abc")
    d.keys(KEY.enter)
    d.frames(2)
    assert "cannot be read" in d.session.notices[-1].text
    d.engine.key_chars("2.5")  # into the field again, whose text is selected
    d.keys(KEY.enter)
    assert d.tool() is ToolName.MEASURE
    assert d.history.entries()[-1].title == "Set scale"
    assert measure.reading(d.session).lengths[0] == pytest.approx(2.5)
    d.keys(KEY.escape)


def _add_keyframes(d: Driver, n: int) -> None:
    for _ in range(n):
        d.on_main(partial(camera.add_keyframe, d.session))
        d.session.rig.orbit(60.0, 0)


def _sizes_of_a_film(d: Driver) -> None:
    """The fourth was cut, the fifth out of reach."""
    _add_keyframes(d, 2)
    d.on_main(partial(commands.run, "camera.film", d.session))
    d.frames(4)
    sheet = d.engine.window_info("//Save film/Choices").window
    ref = sheet.name.replace("/", "\\/")
    for size in ("1280 × 720", "3840 × 2160", "1080 × 1080", "1080 × 1920"):
        button = d.engine.item_info(f"//{ref}/{size}").rect_full
        assert button.max.x <= sheet.inner_clip_rect.max.x, size
    d.click(f"{ref}/1080 × 1920")
    assert d.studio.ui.film.film_size[1] == 1920
    d.studio.ui.film.film_size = (321, 180)
    with _texts() as shown:
        d.frames(2)
    assert "Written as 320 × 180: sides are even." in shown
    d.studio.ui.film.film_size = (1920, 1080)
    d.keys(KEY.escape)


def _buttons_of_sheets(d: Driver) -> None:
    """They scrolled away with the fields."""
    for command, name in (("file.dataset", "Labelled data"), ("file.export_masks", "Export masks")):
        d.on_main(partial(commands.run, command, d.session))
        d.frames(4)
        sheet = d.engine.get_window_by_ref(f"//{name}")
        assert sheet.active, name
        assert sheet.scroll_max.y == 0, name
        d.keys(KEY.escape)


def _find_menu(d: Driver) -> None:
    """A long title made it wider than the window: keys and scroll bar were outside."""
    d.engine.set_ref("//##MainMenuBar")
    d.engine.menu_action(imgui.test_engine.TestAction.hover, "Find/###Make masks…")
    d.frames(2)
    menu = d.engine.window_info("//$FOCUSED").window.rect()
    assert 0 <= menu.min.x < menu.max.x <= 800
    d.keys(KEY.escape)
    d.keys(KEY.escape)


def _numbers_of_an_object(d: Driver) -> None:
    """Three in a line read "0.0" each."""
    d.select(2)
    d.focus("Inspector")
    d.frames(2)
    whole = imgui.calc_text_size("-0.000").x + 2 * imgui.get_style().frame_padding.x
    for name in ("Position X", "Position Z", "Rotation Y", "Scale Z"):
        field = d.engine.item_info(f"//Inspector/Properties/##{name}").rect_full
        assert field.get_width() >= whole, name
    with _texts() as shown:
        d.frames(2)
    assert any(re.fullmatch("#[0-9A-F]{6}", text) for text in shown)
    cut: list[str] = []

    def header(draw: Callable[[str], bool], label: str) -> bool:
        is_open = draw(label)
        left = imgui.get_item_rect_min().x + imgui.get_font_size()
        left += 3 * imgui.get_style().frame_padding.x  # as the toolkit sets it
        edge = imgui.get_item_rect_max().x
        if left + imgui.calc_text_size(label.partition("###")[0]).x > edge:
            cut.append(label)
        return is_open

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imgui, "collapsing_header", partial(header, imgui.collapsing_header))
        d.frames(2)
    assert not cut


def _a_long_question(d: Driver) -> None:
    """It was scrolled to its end, where the buttons are."""
    text = " ".join(f"Sentence {n} of a question that tells much." for n in range(30))
    d.session.pending_question = UserQuestion(text, ("Yes", "No"), lambda _: None)
    d.frames(6)
    sheet = d.engine.get_window_by_ref(f"//{QUESTION}")
    assert (sheet.scroll_max.y, sheet.scroll.y) == (0, 0)
    d.keys(KEY.escape)
    d.frames(2)


def _a_question_of_four_answers(d: Driver) -> None:
    """The last one reached out of the sheet."""
    answers = ("Save with a copy", "Save elsewhere…", "Reload", "Cancel")
    d.session.pending_question = UserQuestion("A question?", answers, lambda _: None)
    d.frames(6)
    rects = [d.engine.item_info(f"//{QUESTION}/{answer}").rect_full for answer in answers]
    sheet = d.engine.get_window_by_ref(f"//{QUESTION}")
    left, top = sheet.pos
    right, bottom = left + sheet.size.x, top + sheet.size.y
    for one in rects:
        assert left < one.min.x
        assert top < one.min.y
        assert one.max.x < right
        assert one.max.y < bottom
    assert sheet.scroll_max.y == 0
    d.keys(KEY.escape)
    d.frames(2)


def _photos_of_a_narrow_panel(d: Driver) -> None:
    """One and a third were seen over an empty half of the panel."""
    d.focus("Views")
    d.on_main(partial(camera.go_to_view, d.session, 0))
    d.settle()
    names = [f"View {one.name}" for one in d.session.cameras[:4]]
    seen = [d.engine.item_info(f"//**/{name}").rect_full for name in names]
    assert seen[0].min.y == seen[1].min.y < seen[2].min.y == seen[3].min.y
    assert all(one.get_width() > theme.em(3) for one in seen)
    assert seen[0].max.x < seen[1].min.x


def _names_in_the_memory_bank(d: Driver) -> None:
    """Every photo was called "view_…"."""
    d.focus("Memory bank")
    decisions = [replace(one, view=f"a_long_name_{one.view}") for one in d.session.decisions(2)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(d.session, "decisions", lambda _: decisions)
        with _texts() as shown:
            d.frames(2)
    assert {Path(one.view).stem[-3:] for one in decisions[:2]} <= {text[-3:] for text in shown}
    table = d.engine.window_info("//Memory bank/Decisions").window.rect()
    assert table.get_height() > 3 * imgui.get_text_line_height_with_spacing(), "one half of a row"
    decision = d.session.decisions(2)[0]
    d.on_main(lambda: objects.rename(d.session, 2, "a round object with a long name " * 3))
    d.click(f"Memory bank/**/{decision.view} {decision.mask}/##decision")
    panel = d.engine.get_window_by_ref("//Memory bank")
    d.on_main(partial(imgui.internal.set_scroll_y, panel, panel.scroll_max.y))
    d.settle()
    bars = d.engine.window_info("//Memory bank/Chosen mask").window.rect()
    style = imgui.get_style()
    before = style.hover_delay_normal, style.hover_delay_short, style.hover_stationary_delay
    style.hover_delay_normal = style.hover_delay_short = style.hover_stationary_delay = 0.0
    last = bars.max.y - 0.75 * imgui.get_text_line_height_with_spacing()
    d.engine.mouse_move_to_pos(ImVec2((bars.min.x + bars.max.x) / 2, last))
    assert _tooltip(d)
    style.hover_delay_normal, style.hover_delay_short, style.hover_stationary_delay = before
    tip = d.engine.get_window_by_ref("//##Tooltip_00")
    assert tip.content_size.x < tip.size.x, "names went on outside of the window"
    d.on_main(partial(commands.run, "object.isolate", d.session))
    d.settle()
    card = d.engine.window_info("//Viewport/Mask in its photo").window.rect()
    way_out = d.engine.item_info("//Viewport/Show all").rect_full
    assert d.corner[1] <= way_out.min.y < way_out.max.y <= card.min.y, "it lay under the card"
    d.on_main(partial(commands.run, "edit.undo", d.session))
    d.on_main(partial(commands.run, "edit.undo", d.session))
    d.click("Viewport/**/Close photo")


def _stacked_notices(d: Driver) -> None:
    """The lower one lay over the status bar, its button outside of the window."""
    long = "Exported 9,017 splats to /home/someone/exports/white flat object, large.ply."
    d.session.notify(Level.INFO, long, shows=Path("/home"))
    d.session.notify(Level.INFO, "Saved to /home/someone/scenes/a room with a table/gaga.")
    d.frames(6)
    bottom = d.corner[1] + d.size[1]
    cards = [d.engine.get_window_by_ref(f"//Notice {slot}") for slot in range(2)]
    seen = [card for card in cards if card is not None and card.active]
    assert seen
    assert all(card.pos.y + card.size.y <= bottom for card in seen)
    d.session.notices = d.session.notices[:-1]
    d.frames(6)
    assert d.exists("//Notice 0/**/###Show in folder"), "it waited for its turn"
    d.session.notices = ()


def _what_lies_over_the_picture(d: Driver) -> None:
    """Options of a tool and one notice covered the most of it."""
    d.session.tool = ToolName.BRUSH
    d.frames(4)
    assert d.engine.item_info("//Viewport/**/###Visible surface").rect_full.max.y - d.corner[1] < (
        d.size[1] / 4
    )
    d.session.tool = ToolName.PICK
    long = "Exported 9,017 splats to /home/someone/exports/white flat object, large.ply."
    d.session.notify(Level.INFO, long, shows=Path("/home"))
    d.frames(6)
    assert d.engine.get_window_by_ref("//Notice 0").size.y <= 0.5 * d.size[1]
    d.session.notices = ()


def _names_in_the_list(d: Driver) -> None:
    """Pictures and switches left five letters of each."""
    d.on_main(lambda: objects.rename(d.session, 2, "wooden chair leg"))
    d.focus("Objects")
    with _texts() as shown:
        d.frames(2)
    assert any(text.startswith("wooden cha") for text in shown)


def _name_of_what_is_isolated(d: Driver) -> None:
    """It was cut to "…" where the picture had room for it."""
    for name, wanted in (
        ("Rider", "Isolated: Rider"),
        ("Motorbike rider", "Motorbike rider"),
        ("A rider on a motorbike of the fifties", "A rider"),
    ):
        d.on_main(partial(objects.rename, d.session, 2, name))
        d.on_main(partial(objects.isolate_item, d.session, 2))
        with _buttons() as shown:
            d.frames(2)
        button = d.engine.item_info("//Viewport/Show all")
        assert button.rect_clipped.max.x == button.rect_full.max.x
        text = next(one for one in shown if "Show all" in one)
        assert text.startswith(wanted)
        d.click("Viewport/Show all")


def _times_of_a_camera_path(d: Driver) -> None:
    """The slider was 45 pixels wide, and the whole time ran out of the panel."""
    _add_keyframes(d, 2)
    d.focus("Camera path")
    d.frames(4)
    for name in ("##Time", "##Total"):
        item = d.engine.item_info(f"//Camera path/{name}")
        assert item.rect_clipped.max.x == item.rect_full.max.x, name
        assert item.rect_full.max.x - item.rect_full.min.x > theme.em(4), name
    camera.clear_path(d.session)


def _the_title_in_front_is_whole(d: Driver) -> None:
    """Eight tabs were cut to a few letters each: now they are scrolled to."""
    node = d.engine.get_window_by_ref("//Objects").dock_node
    bar = node.tab_bar
    assert bar.width_all_tabs > bar.bar_rect.max.x - bar.bar_rect.min.x, "no room for all"
    titles = [window.name for window in node.windows]
    for title in titles:
        d.on_main(partial(_panel(title), d.session))
        d.frames(6)
        d.until(lambda: bar.scrolling_anim == bar.scrolling_target, "it is scrolled to")
        shown = next(one for one in bar.tabs if one.id_ == bar.visible_tab_id)
        assert d.engine.get_window_by_ref(f"//{title}").tab_id == shown.id_
        assert shown.width >= shown.content_width
        begin = bar.bar_rect.min.x + shown.offset - bar.scrolling_anim
        assert bar.bar_rect.min.x - 1 <= begin
        assert begin + shown.width <= bar.bar_rect.max.x + 1


def _training(d: Driver) -> None:
    """Options of a tool that was taken before lay under the card of a training."""
    d.session.tool = ToolName.LASSO
    d.frames(4)
    assert d.exists("//Viewport/**/###Visible surface")
    d.session.training = TrainingPreview("photos", 100, scene=d.scene)
    d.frames(4)
    assert not d.exists("//Viewport/**/###Visible surface")
    d.session.training = None
    d.session.tool = ToolName.PICK


def test_the_card_of_a_training_is_whole_and_its_curves_leave_the_numbers_free(
    display: str, grouped_copy: Path, tmp_path: Path
) -> None:
    upright, mask = tmp_path / "upright.png", tmp_path / "mask.png"
    Image.new("RGB", (90, 160), (90, 120, 60)).save(upright)
    Image.new("L", (90, 160), 255).save(mask)
    names = tuple(f"photo {k}" for k in range(30))
    out = dict.fromkeys(names[:5], "It shows nothing that another photo shows")
    placement = PlacementReport(names, out, ((6, 7, 90),), (upright, mask))
    losses = np.concatenate([np.full(50, 3.0), np.full(50, 0.1)]).astype(np.float32)
    measured = tuple(Measured(at, 10.0 + at / 10, 0.5) for at in (20, 60, 100))
    update = TrainUpdate(100, losses, 1234, measured)

    def walk(d: Driver) -> None:
        for size in ((1280, 720), (1000, 640)):
            d.resize(*size)
            d.session.training = TrainingPreview(
                "photos", 100, scene=d.scene, update=update, placement=placement
            )
            d.frames(8)
            card = d.engine.window_info("//Viewport/Training").window
            picture = d.engine.get_window_by_ref("//Viewport").rect()
            assert card.rect().max.y <= picture.max.y, "the rest is scrolled to"
            assert d.engine.item_info("//**/###Stop here").rect_full.max.y < card.rect().max.y
            d.capture_now(tmp_path / "window.png")
            with Image.open(tmp_path / "window.png") as image:
                seen = np.asarray(image.convert("RGB")).astype(int)
            inner = card.work_rect
            area = seen[int(inner.min.y) : int(card.rect().max.y)]
            area = area[:, int(inner.max.x) - int(0.9 * _em(d)) : int(inner.max.x)]
            colorful = np.ptp(area, axis=2) > 40
            assert not colorful.any(axis=1).any(), "a curve runs through the numbers of its range"
        d.session.training = None

    drive(walk, path=grouped_copy, size=(1280, 720))


def test_a_notice_leaves_the_card_of_a_training_free_and_esc_closes_it(
    display: str, grouped_copy: Path
) -> None:
    """ "Make splats is still running." lay over its button *Stop here*, and no key took it away."""
    losses = np.full(50, 1.0, np.float32)
    update = TrainUpdate(50, losses, 1234, (Measured(20, 20.0, 0.5),))

    def walk(d: Driver) -> None:
        for size in ((1280, 720), (1000, 640), (800, 500)):
            d.resize(*size)
            d.session.training = TrainingPreview("photos", 100, scene=d.scene, update=update)
            d.session.notify(Level.WARNING, "Make splats is still running. Wait, or cancel it.")
            d.frames(8)
            card = d.engine.window_info("//Viewport/Training").window.rect()
            (notice,) = d.studio.ui.area.notices
            apart = notice[0] >= card.max.x or notice[1] >= card.max.y
            assert apart, (size, notice, card.max.x, card.max.y)
            d.keys(KEY.escape)
            d.frames(3)
            assert d.studio.ui.area.notices == ()
            assert d.session.training is not None
        d.session.training = None

    drive(walk, path=grouped_copy, size=(1280, 720))


_LOW_SIZES = ((1280, 720), (1000, 640), (800, 500), (700, 800), (480, 500), (480, 320))


def test_no_notice_lies_over_the_options_of_the_tool(display: str, grouped_copy: Path) -> None:
    """It lay over the length that was to be typed again, whose letters became shortcuts."""
    refused = '"abc" cannot be read. Type a length as 1.5 m, 80 cm, 12 in or 5 ft.'
    saved = "Saved the film to /home/someone/films of the house/the table.mp4."

    def walk(d: Driver) -> None:
        area = d.studio.ui.area
        clicked = measure.clicked(d.session)
        clicked.points = ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0), (0.5, 0.5, 0.0))
        d.session.view.mode = Mode.DEPTH
        shown = set[ToolName]()
        for scale, size in product((1.0, 2.0), _LOW_SIZES):
            settings = replace(d.session.settings, ui_scale=scale)
            d.on_main(partial(d.session.change_settings, settings))
            d.resize(*size)
            for tool in (ToolName.MEASURE, ToolName.BRUSH, ToolName.COLOR):
                d.session.tool = tool
                for level, text in ((Level.ERROR, refused), (Level.INFO, saved)):
                    shows = Path("/home") if level is Level.INFO else None
                    d.session.notify(level, text, shows=shows)
                    d.frames(6)
                    assert area.notices, (scale, size, tool)
                    for notice in area.notices:
                        said = scale, size, tool, level, notice, area.options
                        assert area.options is None or not overlap(notice, area.options), said
                        assert notice[3] <= area.bottom + 1, said
                    d.session.notices = ()
                    d.frames(2)
                if area.options is not None:
                    shown.add(tool)
                    assert area.head_bottom > area.options[3] + _em(d), "the mode is named below"
        assert shown == {ToolName.MEASURE, ToolName.BRUSH, ToolName.COLOR}

    settings = Settings(first_steps_done=True, identities="none")
    drive(walk, path=grouped_copy, size=(1280, 720), settings=settings)


def _em(d: Driver) -> float:
    """Size of the letters, pixels."""
    return float(d.on_main(imgui.get_font_size))


def _edge(d: Driver, folder: Path) -> float:
    """Contrast of the left edge of the window, 0..255, where no sheet is."""
    d.capture(folder / "window.png")
    with Image.open(folder / "window.png") as image:
        return float(np.asarray(image.convert("L"))[:, 2:20].std())


def _tabs(d: Driver) -> list[Any]:
    return list(d.engine.get_window_by_ref("//Objects").dock_node.tab_bar.tabs)


def test_a_submenu_does_not_cover_its_menu(display: str, grouped_copy: Path) -> None:
    """Large text in a small window leaves room on neither side of it."""

    def walk(d: Driver) -> None:
        d.engine.set_ref("//##MainMenuBar")
        d.engine.menu_action(imgui.test_engine.TestAction.hover, "View/###Color")
        d.click("$FOCUSED/###More colors")
        line = d.engine.item_info("//$FOCUSED/###More colors").rect_full
        first = d.engine.item_info("//$FOCUSED/###Confidence").rect_full
        assert first.min.y >= line.max.y
        d.click("$FOCUSED/###Confidence")
        assert d.mode() is Mode.CONFIDENCE

    settings = Settings(first_steps_done=True, ui_scale=2.0)
    drive(walk, path=grouped_copy, size=(800, 500), settings=settings)


def _said(d: Driver, command: str, words: str) -> bool:
    """Whether the sheet of a command says ``words``."""
    with _texts() as shown:
        d.on_main(partial(commands.run, command, d.session))
        d.frames(4)
    return any(words in text for text in shown)


@contextmanager
def _texts() -> Iterator[list[str]]:
    """All that is drawn as text meanwhile."""
    shown: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        for name in ("text_unformatted", "text_wrapped"):
            draw = getattr(imgui, name)
            patch.setattr(imgui, name, partial(_noting, shown, draw))
        yield shown


@contextmanager
def _buttons() -> Iterator[list[str]]:
    """The labels of all buttons that are drawn meanwhile."""
    shown: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imgui, "button", partial(_noting, shown, imgui.button))
        yield shown


def _noting(shown: list[str], draw: Callable[..., Any], text: str, *more: Any) -> Any:
    shown.append(text)
    return draw(text, *more)


def _history(d: Driver) -> None:
    """Selections in a row are one line, until it is clicked."""
    session, document = d.session, d.session.need()
    for group in (2, 3, 4):
        d.on_main(partial(document.select, group_indices(document.scene, group)))
    d.focus("History")
    at = len(document.history.entries())
    assert not d.exists(f"History/**/$${at}/**")
    d.click("History/**/###selections")
    assert session.need().history.cursor == at


def _tool_bar(d: Driver) -> None:
    """Nothing moves when a tool with options is taken."""

    def places() -> list[tuple[float, float]]:
        found = [d.engine.item_info(f"//**/###{name}").rect_full.min for name in ("Undo", "Color")]
        return [(at.x, at.y) for at in found]

    d.session.tool = type(d.session.tool)("pick")
    d.frames()
    before = places()
    for tool in ("rect", "object", "lasso"):
        d.session.tool = type(d.session.tool)(tool)
        d.frames()
        assert places() == before


def _notices(d: Driver, picture: Path) -> None:
    """They stand next to the view cube, and leave the middle of the picture free.

    Green is only what was done.
    """
    d.session.notify(Level.INFO, "Saved.")
    d.frames(3)
    cube = d.engine.item_info("//Viewport/View cube").rect_full
    notice = d.engine.get_window_by_ref("//Notice 0")
    assert notice.pos.x + notice.size.x <= cube.min.x
    assert notice.pos.y + notice.size.y < d.corner[1] + d.size[1] / 3
    assert _green(d, picture)
    d.session.notify(Level.HINT, "Nothing is selected.")
    d.frames(3)
    assert not _green(d, picture)


def _green(d: Driver, picture: Path) -> int:
    """Green pixels of the newest notice."""
    d.capture(picture)
    card = d.engine.get_window_by_ref("//Notice 0")
    left, top = int(card.pos.x), int(card.pos.y)
    with Image.open(picture) as image:
        box = (left, top, left + int(card.size.x), top + int(card.size.y))
        red, green, _ = np.asarray(image.convert("RGB").crop(box), np.int32).transpose(2, 0, 1)
    return int((green - red > 40).sum())


def _letters(d: Driver) -> None:
    """Names in other scripts have glyphs, where a font of the system has them."""
    if not fonts_with("ش"):
        pytest.skip("no font of this system has Arabic letters")
    d.on_main(lambda: objects.rename(d.session, 2, "شاي"))
    d.frames(3)
    font = theme._Loaded.regular
    assert font is not None
    assert all(font.is_glyph_in_font(ord(letter)) for letter in visual("شاي"))
    d.session.notify(Level.INFO, "شاي")
    d.frames(2)
    with _texts() as shown:
        d.frames(2)
    assert visual("شاي") in shown, "in text that is wrapped, too"


def _letters_of_a_folder(d: Driver, folder: Path) -> None:
    """What has no glyph is drawn as its code, never as "?", wherever it is drawn."""
    names = ("杯子", "k\U000130ae")
    for name in names:
        (folder / name).mkdir()
    dialog = FileDialog("Choose a folder", PathKind.OPEN_FOLDER, folder)
    d.on_main(lambda: d.studio.ui.files.ask(dialog, lambda _: None))
    d.frames(3)
    font = theme._Loaded.regular
    assert font is not None
    for name in names:
        assert all(font.is_glyph_in_font(ord(letter)) for letter in visual(name)), name
        assert visual(name) == "".join(
            letter if font.is_glyph_in_font(ord(letter)) else f"[{ord(letter):X}]"
            for letter in name
        )
    d.keys(KEY.escape)


def _playback(d: Driver) -> None:
    d.session.view.playback.is_playing = True
    d.studio._escape()
    assert not d.session.view.playback.is_playing


def _file_dialog(d: Driver, folder: Path) -> None:
    """Enter presses the button, Esc closes, folders are made, places are one click away."""
    taken: list[Path] = []

    def ask(title: str = "Choose a folder") -> FileDialog:
        dialog = FileDialog(title, PathKind.OPEN_FOLDER, folder)
        d.on_main(lambda: d.studio.ui.files.ask(dialog, taken.append))
        d.frames(3)
        return dialog

    ask()
    d.keys(KEY.enter)
    assert taken == [folder]
    taken[1:] = []
    ask()
    d.keys(KEY.escape)
    assert d.studio.ui.files.dialog is None
    assert len(taken) == 1
    dialog = ask("Choose another folder")  # the first one begins where it ended
    d.click("$FOCUSED/New folder")
    d.engine.key_chars_replace_enter("results")
    d.frames()
    assert (folder / "results").is_dir()
    assert dialog.folder == folder / "results"
    d.click("$FOCUSED/Places")
    d.click("$FOCUSED/###place 0")
    assert dialog.folder == Path.home().resolve()
    d.keys(KEY.escape)
    saving = FileDialog("Save a picture", PathKind.SAVE_FILE, folder, "n" * 300, (".png",))
    d.on_main(lambda: d.studio.ui.files.ask(saving, taken.append))
    d.frames(3)
    d.keys(KEY.enter)
    assert saving.message.startswith("The name is too long")
    d.keys(KEY.escape)


def test_path_fields_complete_what_is_typed(
    display: str, scene_folder: Path, tmp_path: Path
) -> None:
    """Tab writes what all that fit have in common, and goes on where there is nothing to write.

    From a path that is not there it goes on only where a new one can be named.
    """
    for name in ("mugs", "mugs and pans/deep", "Vase"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("Vase/biker.spz", "Vase/notes.txt"):
        (tmp_path / name).touch()

    def ask(d: Driver, kind: PathKind = PathKind.OPEN_FOLDER) -> FileDialog:
        dialog = FileDialog("Choose a folder", kind, tmp_path, suffixes=(".spz",), is_placed=True)
        d.on_main(lambda: d.studio.ui.files.ask(dialog, lambda _: None))
        d.frames(3)
        return dialog

    def walk(d: Driver) -> None:
        dialog = ask(d)
        for typed, wanted in (
            ("mu", "mugs"),
            (" ", "mugs and pans/"),
            ("d", "mugs and pans/deep/"),
        ):
            d.engine.key_chars(typed)
            d.keys(KEY.tab)
            assert dialog._text == wanted
        d.keys(KEY.enter)
        assert d.studio.ui.files.dialog is None
        for typed, wanted in (
            ("Vase/b", "Vase/biker.spz"),  # such files can be opened, too
            ("Vase/n", "Vase/n"),
            ("none that is so called", "none that is so called"),
        ):
            dialog = ask(d)
            d.engine.key_chars(typed)
            d.keys(KEY.tab)
            d.engine.key_chars(" go")
            d.frames()
            assert dialog._text == f"{wanted} go", "what is typed next arrives"
            d.keys(KEY.escape)
        for chord, button in (((KEY.tab,), "###Open"), ((KEY.mod_shift, KEY.tab), "###New folder")):
            for text in ("new", "mugs", "Vase/biker.spz", ""):
                dialog = ask(d, PathKind.NEW_FOLDER if text == "new" else PathKind.OPEN_FOLDER)
                d.engine.key_chars(text)
                d.keys(*chord)
                assert dialog._text == text
                at = imgui.get_current_context().nav_id
                assert at == d.engine.item_info(f"//$FOCUSED/{button}").id_, "on, as ever"
                assert imgui.get_current_context().nav_cursor_visible
                d.keys(KEY.escape)
        dialog = ask(d)
        d.engine.key_chars(f"{tmp_path.parent}/")
        d.frames()
        assert dialog.folder == tmp_path.parent, "the list follows what is typed"
        lefts = [
            d.engine.item_info(f"//$FOCUSED/###{n}").rect_full.min.x for n in ("Open", "Cancel")
        ]
        assert lefts == sorted(lefts), "as in every other sheet"
        d.keys(KEY.escape)
        _the_field_of_an_export_completes(d, tmp_path)
        _a_film_has_a_free_name_or_replaces_when_asked(d, scene_folder)

    drive(walk, path=scene_folder, size=(1280, 720))


def _a_film_has_a_free_name_or_replaces_when_asked(d: Driver, folder: Path) -> None:
    """The name of the film before was proposed, which *Save* would replace."""
    taken: list[Path] = []
    for n in (1, 2, 3):
        dialog = d.on_main(lambda: writing("Save the film", d.session, "film.mp4", (".mp4",)))
        d.on_main(partial(d.studio.ui.files.ask, dialog, taken.append))
        d.frames(3)
        d.keys(KEY.enter)
        assert taken[-1] == folder / ("film.mp4" if n == 1 else f"film {n}.mp4"), "asks nothing"
        taken[-1].touch()
    (folder / "films").mkdir()
    for typed, wanted in (("films/a.mp4", "films/a.mp4"), ("", "films/film.mp4")):
        dialog = d.on_main(lambda: writing("Save the film", d.session, "film.mp4", (".mp4",)))
        d.on_main(partial(d.studio.ui.files.ask, dialog, taken.append))
        d.frames(3)
        d.engine.key_chars(typed)
        d.keys(KEY.enter)
        assert taken[-1] == folder / wanted, "the next one begins where the last one went"
    dialog = d.on_main(lambda: writing("Save the film", d.session, "film.mp4", (".mp4", ".webm")))
    d.on_main(partial(d.studio.ui.files.ask, dialog, taken.append))
    d.frames(3)
    for typed, is_wrong in (("a.m", False), ("4v", True), ("a.webm", False), ("a", True)):
        d.engine.key_chars(typed) if typed != "a.webm" else d.engine.key_chars_replace(typed)
        d.frames(2)
        assert bool(dialog.message) == is_wrong, f"{typed}: said while it is typed"
    d.keys(KEY.enter)
    assert not dialog.is_done
    d.keys(KEY.escape)
    dialog = FileDialog("Save", PathKind.SAVE_FILE, folder, "film.mp4", (".mp4",))
    d.on_main(lambda: d.studio.ui.files.ask(dialog, taken.append))
    d.frames(3)
    d.keys(KEY.enter)
    assert not dialog.is_done
    assert "exists already" in dialog.message
    d.keys(KEY.enter)
    assert taken[-1] == folder / "film.mp4"


def _the_field_of_an_export_completes(d: Driver, folder: Path) -> None:
    sheet = d.studio.ui.export
    d.menu("File/###Export scene…")
    for typed, wanted in (("", None), ("va", "Vase/"), ("Va", "Vase/"), ("Vase/none", "Vase/none")):
        d.engine.item_click("//Export/**/##Path")
        before = sheet.path
        if typed:
            d.keys(KEY.mod_ctrl, KEY.a)
            d.engine.key_chars(f"{folder}/{typed}")
        d.keys(KEY.tab)
        assert sheet.path == (before if wanted is None else f"{folder}/{wanted}")
        at = imgui.get_current_context().nav_id
        button = d.engine.item_info("//Export/**/###Choose a place").id_
        assert (at == button) is (wanted in (None, typed))
    d.keys(KEY.escape)


# --- Parts of the window that people stumbled over: menus, sheets, lists, cards, in one window.

_KEYFRAMES = 6


def test_parts_of_the_window(display: str, grouped_copy: Path, tmp_path: Path) -> None:
    def walk(d: Driver) -> None:
        _disabled_commands_say_why(d)
        _menus_part_finding_from_editing(d)
        _a_mask_moves_from_its_card(d)
        _keys_photo_after_photo(d)
        _the_camera_path_shows_its_keyframes(d)
        _a_click_on_a_tick_goes_to_its_keyframe(d)
        _sheets_that_theme_the_window_do_not_dim_it(d)
        _no_specks_where_panels_end(d, tmp_path)
        _nothing_covers_what_opened_it(d)
        _numbers_of_sliders_are_free(d)
        _the_list_shows_what_is_chosen(d, tmp_path)
        _the_search_keeps_the_keys(d)

    drive(walk, path=grouped_copy, size=(1280, 720))


def test_the_object_of_a_menu_is_typed_at_once(display: str, grouped_copy: Path) -> None:
    """The field had no keyboard in *Assign to* and *Move to*: what was typed did nothing."""

    def walk(d: Driver) -> None:
        some = group_indices(d.scene, 1)[:9]  # so many objects that there is a field
        many = edits.set_labels(d.scene, some, 101 + np.arange(len(some), dtype=np.int32))
        d.on_main(lambda: d.session.need().do(many))
        d.engine.item_click("//Objects/**/object 2/##row", 1)
        d.frames(4)
        d.click("$FOCUSED/###Assign to")
        assert d.exists("**/###to 3")
        d.engine.key_chars("no such name")
        d.frames(4)
        assert not d.exists("**/###to 3"), "what is typed is looked for"
        for _ in range(2):
            d.keys(KEY.escape)
        d.select(2)
        d.focus("Memory bank")
        decision = d.session.decisions(2)[1]
        d.click(f"**/{decision.view} {decision.mask}/##decision")
        d.click("**/###Move mask")
        assert d.exists("**/###to 3")
        d.engine.key_chars("no such name")
        d.frames(4)
        assert not d.exists("**/###to 3"), "what is typed is looked for"

    drive(walk, path=grouped_copy, size=(1280, 720), patience_s=30)


def test_cards_and_colors_keep_off_what_is_worked_on(display: str, grouped_copy: Path) -> None:
    def walk(d: Driver) -> None:
        _the_card_of_an_object_stays_in_the_picture(d)
        _no_card_lies_over_handles(d)
        _no_card_lies_over_a_notice(d)
        _no_card_lies_over_a_length(d)
        for size in ((1280, 720), (800, 500)):
            d.resize(*size)
            d.frames(20)
            _colors_are_chosen_over_the_panel(d)

    drive(walk, path=grouped_copy, size=(1280, 720))


def _the_card_of_an_object_stays_in_the_picture(d: Driver) -> None:
    """It lay over the Inspector and the status bar, whose buttons it covered."""
    group = _lowest(d)
    d.on_main(lambda: objects.rename(d.session, group, "the round one with a long name " * 4))
    d.engine.mouse_move_to_pos(ImVec2(*_middle(d, group)))
    d.until(lambda: d.session.hovered_group == group, "the mouse rests on it")
    d.frames(4)
    assert _tooltip(d)
    card, picture = (
        d.engine.get_window_by_ref(f"//{n}").rect() for n in ("##Tooltip_00", "Viewport")
    )
    assert picture.min.x - 1 <= card.min.x < card.max.x <= picture.max.x + 1
    assert picture.min.y - 1 <= card.min.y < card.max.y <= picture.max.y + 1
    assert card.get_width() <= 0.4 * picture.get_width() + 1, "it was as wide as the picture"
    assert card.get_height() > 40, "the name goes on in a second line"
    d.on_main(partial(commands.run, "edit.preferences", d.session))
    d.frames(4)
    assert not _tooltip(d), "nor over a sheet"
    d.keys(KEY.escape)


def _no_card_lies_over_handles(d: Driver) -> None:
    """It covered the handles that were to be taken."""
    group = _lowest(d)
    d.select(group)
    d.session.tool = ToolName.MOVE
    u, v = _middle(d, group)
    for away in (0, 20):
        d.engine.mouse_move_to_pos(ImVec2(u + away, v))
        d.frames(4)
        d.session.hovering.group = group
        d.frames(2)
        assert d.session.hovered_group == group
        assert not _tooltip(d), away
    d.session.tool = ToolName.PICK
    d.session.hovering.away()


def _no_card_lies_over_a_notice(d: Driver) -> None:
    """It lay over its words and its buttons; next to it the card is still there."""
    group = _lowest(d)
    d.on_main(lambda: objects.rename(d.session, group, "vase"))
    d.on_main(lambda: d.session.notify(Level.ERROR, "Nothing is left to be done"))
    d.frames(4)
    notice = d.engine.get_window_by_ref("//Notice 0").rect()
    y = (notice.min.y + notice.max.y) / 2
    places = [(notice.min.x - away, y) for away in (4, 40)]
    places += [(x, notice.max.y + 4) for x in np.linspace(notice.min.x, notice.max.x, 4)]
    for place in places:
        d.engine.mouse_move_to_pos(ImVec2(*place))
        d.frames(4)
        for _ in range(30):  # meanwhile it is told what really is under the mouse
            d.session.hovering.group = group
            d.frames(1)
            card = d.engine.get_window_by_ref("//##Tooltip_00")
            if card.active:
                break
        assert card.active, place
        assert not card.rect().overlaps(notice), place
    d.click("Notice 0/###Close")
    d.session.hovering.away()


def _no_card_lies_over_a_length(d: Driver) -> None:
    """It lay over the labels of lengths, and at twice the size these over each other."""
    settings, group = d.session.settings, _lowest(d)
    scene = d.scene
    at = np.median(world_means(scene, group_indices(scene, group)), axis=0)
    d.on_main(partial(d.session.change_settings, replace(settings, ui_scale=2.0)))
    d.session.tool = ToolName.MEASURE
    to_right = d.session.rig.camera(*d.size).cam_from_world[0, :3]
    step = 0.02 * float(np.ptp(world_means(scene), axis=0).max())
    clicked = measure.clicked(d.session)
    first, second, third = (tuple((at + k * step * to_right).tolist()) for k in range(3))
    clicked.points = (first, second, third)
    d.frames(6)
    labels = d.studio.ui.area.labels
    assert len(labels) == 2
    assert not overlap(*labels)
    d.on_main(partial(d.session.change_settings, settings))
    d.frames(6)
    seen = 0
    for left, top, right, bottom in d.studio.ui.area.labels:
        us = (left - 60, left - 20, (left + right) / 2, right)
        for place in product(us, (top - 40, bottom)):
            d.engine.mouse_move_to_pos(ImVec2(*place))
            d.frames(4)  # it is told what really is under the mouse
            for _ in range(5):  # and told again, by a thread that is late on a busy machine
                d.session.hovering.group = group
                d.frames(3)  # the card has the size of this name
                card = d.engine.get_window_by_ref("//##Tooltip_00")
                if card.active and d.session.hovered_group == group:
                    seen += 1
                    low, high = card.rect().min, card.rect().max
                    rect = (low.x, low.y, high.x, high.y)
                    assert not any(overlap(rect, label) for label in d.studio.ui.area.labels)
                    break
    assert seen > 2
    clicked.points = ()
    d.session.tool = ToolName.PICK
    d.session.hovering.away()
    d.frames(6)


def _colors_are_chosen_over_the_panel(d: Driver) -> None:
    """They lay over the object whose color changes."""
    d.select(_lowest(d))
    d.focus("Inspector")
    d.click("Inspector/Properties/Color")
    popup = d.engine.window_info("//$FOCUSED").window
    card, picture = popup.rect(), d.engine.get_window_by_ref("//Viewport").rect()
    panel = d.engine.get_window_by_ref("//Inspector").rect()
    assert popup.active
    wide = max(panel.get_width(), card.get_width())
    assert panel.max.x - wide - 1 <= card.min.x < card.max.x <= panel.max.x + 1
    if card.get_width() <= panel.get_width():
        assert card.min.x >= picture.max.x - 1 or card.min.y >= picture.max.y - 1
    assert not _overlap(d, f"//{popup.name}", "Inspector/Properties/Color")
    d.keys(KEY.escape)


def _tooltip(d: Driver) -> bool:
    """Whether a tooltip is shown after the mouse has rested."""
    d.frames(3)
    window = d.engine.get_window_by_ref("//##Tooltip_00")
    return window is not None and bool(window.active)


def _disabled_commands_say_why(d: Driver) -> None:
    """The tooltip of an item of a menu that is grey, also of those that users asked about."""
    hover = imgui.test_engine.TestAction.hover
    style = imgui.get_style()
    before = style.hover_delay_short, style.hover_stationary_delay
    style.hover_delay_short = style.hover_stationary_delay = 0.0
    for menu, command_id in (
        ("Camera", "camera.save_path"),
        ("Find", "object.find_in_view"),
        ("Find", "object.index"),
    ):
        chosen = commands.command(command_id)
        assert chosen.enabled(d.session)
        d.engine.set_ref("//##MainMenuBar")
        d.engine.menu_action(hover, f"{menu}/###{chosen.title}")
        d.check(command_id)
        assert _tooltip(d), f"{chosen.title} does not say why it is off"
        if menu == "Find":
            for one in commands.MENUS[menu]:
                item = f"##Menu_00/###{one.title}"
                assert not d.exists(item) or not _overlap(d, "//##Tooltip_00", item), item
        d.keys(KEY.escape)
        d.keys(KEY.escape)
    settings = d.session.settings
    d.session.change_settings(replace(settings, recent=()))
    d.engine.set_ref("//##MainMenuBar")
    d.engine.menu_action(hover, f"File/###{commands.OPEN_RECENT}")
    d.frames(4)
    assert _tooltip(d), "a submenu that is off says why, too"
    d.keys(KEY.escape)
    d.keys(KEY.escape)
    d.session.change_settings(settings)
    style.hover_delay_short, style.hover_stationary_delay = before


def _menus_part_finding_from_editing(d: Driver) -> None:
    """No menu is longer than a low window; ways to split are one submenu of the object's menu."""
    assert {c.id for c in commands.MENUS["Find"]} >= {"object.masks", "object.associate"}
    assert not {c.id for c in commands.MENUS["Object"]} & {"object.masks", "object.associate"}
    d.select(2)
    d.engine.set_ref("//##MainMenuBar")
    d.engine.menu_click("Object/###Split/###Split into parts that do not touch")
    d.check("Split")
    d.frames()


def _a_mask_moves_from_its_card(d: Driver) -> None:
    d.select(2)
    d.focus("Memory bank")
    decision = d.session.decisions(2)[1]
    d.click(f"**/{decision.view} {decision.mask}/##decision")
    d.click("**/###Move mask")
    d.click("**/###No object")
    d.settle()
    moved = d.session.need().read.decision_of(decision.view, decision.mask)
    assert moved is not None
    assert (moved.group, moved.by_hand) == (0, True)
    d.keys(KEY.escape)


def _keys_photo_after_photo(d: Driver) -> None:
    """K brought another tab to the front: there was no photo to go to next."""
    d.focus("Views")
    for place in range(3):
        d.on_main(partial(camera.go_to_view, d.session, place))
        d.settle()
        d.keys(KEY.k)
        window = d.engine.get_window_by_ref("//Views")
        assert window.active
        assert not window.hidden, "the tab stays"
        assert status_text(d.session, d.studio.picture.controller.tool(d.session)) == (
            f"Keyframe {place + 1} added"
        )
        d.keys(KEY.k)
        assert len(camera.path_of(d.session).keyframes) == place + 1
    camera.clear_path(d.session)


def _the_camera_path_shows_its_keyframes(d: Driver) -> None:
    """Several columns where the panel is wide and low: nothing is scrolled away."""
    _add_keyframes(d, _KEYFRAMES)
    d.focus("Camera path")
    d.frames(4)
    for index in range(_KEYFRAMES):
        info = d.engine.item_info(f"//**/Columns/$${index}/###Remove")
        seen = info.rect_clipped
        assert seen.max.y - seen.min.y >= theme.em(1.0), index
        assert seen.max.x - seen.min.x >= theme.em(1.0), index


def _a_click_on_a_tick_goes_to_its_keyframe(d: Driver) -> None:
    """Ticks stood up to half a knob from the moment of their keyframe."""
    path = camera.path_of(d.session)
    slider = d.engine.item_info("//Camera path/##Time").rect_full
    left, right, y = slider.min.x, slider.max.x, (slider.min.y + slider.max.y) / 2
    for t in path.times()[1:-1]:
        x = d.on_main(partial(widgets.knob_at, left, right, t / path.seconds))
        d.engine.mouse_move_to_pos(ImVec2(x, y))
        d.engine.mouse_click()
        d.frames(2)
        assert d.session.view.playback.at == pytest.approx(t, abs=2 * path.seconds / (right - left))


def _sheets_that_theme_the_window_do_not_dim_it(d: Driver) -> None:
    def dimming() -> float:
        color: ImVec4 = imgui.get_style().color_(imgui.Col_.modal_window_dim_bg)
        return color.w

    for command, is_dimmed in (("edit.preferences", False), ("camera.film", True)):
        commands.run(command, d.session)
        d.frames(4)
        assert (dimming() > 0) is is_dimmed, command
        if not is_dimmed:
            boxes = ("Always clean first", "Children go along")
            lefts = {d.engine.item_info(f"//**/{name}").rect_full.min.x for name in boxes}
            assert len(lefts) == 1, "boxes stand below each other"
        d.keys(KEY.escape)


def _overlap(d: Driver, window: str, item: str) -> bool:
    over = d.engine.get_window_by_ref(window)
    assert over is not None, window
    a, b = over.rect(), d.engine.item_info(f"//{item}").rect_full
    return bool(min(a.max.x, b.max.x) > max(a.min.x, b.min.x) + 1) and bool(
        min(a.max.y, b.max.y) > max(a.min.y, b.min.y) + 1
    )


def _nothing_covers_what_opened_it(d: Driver) -> None:
    """Tooltips and lists stand under or above their buttons."""
    style = imgui.get_style()
    before = style.hover_delay_short, style.hover_stationary_delay
    style.hover_delay_short = style.hover_stationary_delay = 0.0
    for item in ("**/###Undo", "Objects/###Filter", "Objects/**/object 2/###Shown"):
        d.engine.mouse_move(f"//{item}")
        assert _tooltip(d)
        assert not _overlap(d, "//##Tooltip_00", item), item
    for _ in range(4):
        d.on_main(lambda: commands.run("camera.add_bookmark", d.session))
    d.focus("Bookmarks")
    names = [f"Bookmarks/**/###{mark.name}" for mark in camera.bookmarks(d.session)]
    d.focus("History")
    titles = [entry.title for entry in d.history.entries()]
    entries = [f"History/**/###{title}" for title in titles if titles.count(title) == 1]
    assert len(entries) > 1
    for panel, rows in (("Bookmarks", names), ("History", entries)):
        d.focus(panel)
        for row in rows:
            if d.exists(row):
                d.engine.mouse_move(f"//{row}")
                assert _tooltip(d), row
                over = [name for name in rows if _overlap(d, "//##Tooltip_00", name)]
                assert over == [], "it covers no row of the list"
    style.hover_delay_short, style.hover_stationary_delay = before
    for item in ("Objects/###Filter", "Objects/###More ways to find"):
        d.click(item)
        popup = d.engine.window_info("//$FOCUSED").window
        assert not _overlap(d, f"//{popup.name}", item), item
        d.keys(KEY.escape)


def _numbers_of_sliders_are_free(d: Driver) -> None:
    """The number of a slider stands next to it: its knob covers none."""
    drawn: dict[str, float] = {}
    draw = imgui.text_unformatted

    def watched(text: str) -> None:
        drawn[text] = imgui.get_cursor_screen_pos().x
        draw(text)

    d.on_main(partial(commands.run, "file.dataset", d.session))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(imgui, "text_unformatted", watched)
        d.frames(4)
    share = round(100 * d.studio.ui.dataset.config.moved)
    slider = d.engine.item_info("//Labelled data/**/##Objects elsewhere").rect_full
    assert drawn[f"{share} %"] >= slider.max.x
    d.keys(KEY.escape)


def _the_list_shows_what_is_chosen(d: Driver, folder: Path) -> None:
    """A selected row is one under the mouse, too; the title of the sorted column is whole."""
    d.focus("Objects")
    d.select(2)
    d.click("Objects/**/Splats")
    title = d.engine.item_info("//Objects/**/Splats").rect_full
    arrow = 0.65 * imgui.get_font_size() + imgui.get_style().frame_padding.x
    assert title.max.x - title.min.x >= imgui.calc_text_size("Splats").x + arrow
    row = d.engine.item_info("//Objects/**/object 2/##row").rect_clipped
    blue = []
    for item in ("Objects/**/object 2/##row", "**/###Undo"):
        d.engine.mouse_move(f"//{item}")
        d.frames(2)
        d.capture_now(folder / "row.png")
        with Image.open(folder / "row.png") as image:
            at = round(row.max.x) - 3, round(row.min.y) + 4
            red, _, b = image.convert("RGB").getpixel(at)  # type: ignore[misc]
        blue.append(b - red)
    assert blue[0] >= blue[1] > 20, blue


def test_names_of_the_sides_of_a_split_view_are_read(display: str, grouped_copy: Path) -> None:
    """Whole where there is room, else in short words that are whole; no name is cut."""

    def look(d: Driver, size: tuple[int, int], scale: float) -> None:
        d.resize(*size)
        scaled = replace(d.session.settings, ui_scale=scale)
        d.on_main(partial(d.session.change_settings, scaled))
        d.frames(20)
        d.on_main(lambda: objects.rename(d.session, 1, "ball"))
        d.session.view.compare = PhotoCompareMode.SWIPE
        said: dict[str, tuple[str, float, float]] = {}
        begin = imgui.begin_combo

        def noting(label: str, text: str, *rest: Any) -> bool:
            opened = begin(label, text, *rest)
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            arrow = imgui.get_frame_height() + imgui.get_style().frame_padding.x
            said[label] = text, imgui.calc_text_size(text).x, high.x - low.x - arrow
            return opened

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(imgui, "begin_combo", noting)
            for left in (Side.BEFORE, Side.PHOTO, Side.PRESET):
                for right in (Side.PICTURE, Side.GROUPS):
                    d.session.view.sides = left, right
                    said.clear()
                    d.frames(3)
                    for text, wide, room in (said["##Left side"], said["##Right side"]):
                        assert wide <= room
                        assert "…" not in text
                    if scale == 1.0:
                        assert said["##Left side"][0] == photo_compare._NAMES[left]
            d.on_main(lambda: objects.rename(d.session, 1, "long name " * 9))
            d.on_main(lambda: split_view.compare_version(d.session, d.history.cursor))
            d.frames(3)
            text, wide, room = said["##Right side"]
            assert text == "Picture"
            assert wide <= room, "the longer name is cut"
            assert said["##Left side"][0].startswith("After")

    def walk(d: Driver) -> None:
        for size, scale in product(((1600, 900), (800, 500)), (1.0, 2.0)):
            look(d, size, scale)

    drive(walk, path=grouped_copy, size=(1600, 900))


def _the_search_keeps_the_keys(d: Driver) -> None:
    """Enter selects what was found; the next word is typed at once."""
    box = "Objects/##Find"
    search, session = d.session.need().feature(SearchState), d.session
    for tool in (ToolName.PICK, ToolName.RECT):
        for n_frames in (1, 2, 40):  # a quick hand, and a slow one
            session.tool = tool
            d.click(box)
            d.engine.key_chars_replace_enter("object")
            d.frames(n_frames)
            chosen = session.selected_groups()
            assert chosen
            d.keys(KEY.escape)
            assert search.text == "", "the first Escape clears"
            assert d.engine.item_info(f"//{box}").id_ == imgui.internal.get_active_id()
            assert (session.selected_groups(), session.tool) == (chosen, tool)
            d.keys(KEY.escape)
            assert imgui.internal.get_active_id() == 0, "the second leaves"
            assert (session.selected_groups(), session.tool) == (chosen, tool)


def _no_specks_where_panels_end(d: Driver, folder: Path) -> None:
    """In the light theme the edges of the window are light, all around."""
    light = replace(d.session.settings, theme="light")
    d.on_main(partial(d.session.change_settings, light))
    d.frames(3)
    d.capture_now(folder / "light.png")
    with Image.open(folder / "light.png") as image:
        picture = np.asarray(image.convert("L"))
    for edge in (picture[:, 0], picture[:, -1], picture[-1]):
        assert edge.min() > 128, int(np.argmin(edge))
