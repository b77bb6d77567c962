"""Parts of the window that people stumbled over: menus, sheets, lists, cards, in one window."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from imgui_bundle import ImVec4, imgui
from PIL import Image

from gaga_studio.features import camera, commands, selection
from gaga_studio.ui.kit import theme
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window
_KEYFRAMES = 6


def test_parts_of_the_window(display: str, grouped_scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def walk(d: Driver) -> None:
        _disabled_commands_say_why(d)
        _menus_part_finding_from_editing(d)
        _a_mask_moves_from_its_card(d)
        _the_camera_path_shows_its_keyframes(d)
        _sheets_that_theme_the_window_do_not_dim_it(d)
        _no_specks_where_panels_end(d, tmp_path)

    drive(walk, path=folder, size=(1280, 720))


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
        d.keys(KEY.escape)
        d.keys(KEY.escape)
    style.hover_delay_short, style.hover_stationary_delay = before


def _menus_part_finding_from_editing(d: Driver) -> None:
    """No menu is longer than a low window; ways to split are one submenu of the object's menu."""
    assert {c.id for c in commands.MENUS["Find"]} >= {"object.masks", "object.associate"}
    assert not {c.id for c in commands.MENUS["Object"]} & {"object.masks", "object.associate"}
    d.on_main(partial(selection.select_groups, d.session, (2,)))
    d.engine.set_ref("//##MainMenuBar")
    d.engine.menu_click("Object/###Split/###Split into parts that do not touch")
    d.check("Split")
    d.frames()


def _a_mask_moves_from_its_card(d: Driver) -> None:
    d.on_main(partial(selection.select_groups, d.session, (2,)))
    d.focus("Memory bank")
    decision = d.session.decisions(2)[1]
    d.click(f"**/{decision.view} {decision.mask}/##decision")
    d.frames(3)
    d.click("**/###Move mask")
    d.frames(3)
    d.click("**/###No object")
    d.settle()
    moved = d.session.need().read.decision_of(decision.view, decision.mask)
    assert moved is not None
    assert (moved.group, moved.by_hand) == (0, True)
    d.keys(KEY.escape)


def _the_camera_path_shows_its_keyframes(d: Driver) -> None:
    """Several columns where the panel is wide and low: nothing is scrolled away."""
    for turn in range(_KEYFRAMES):
        d.session.rig.orbit(60.0 * (turn > 0), 0)
        d.on_main(partial(camera.add_keyframe, d.session))
    d.focus("Camera path")
    d.frames(4)
    for index in range(_KEYFRAMES):
        info = d.engine.item_info(f"//**/Columns/$${index}/###Remove")
        seen = info.rect_clipped
        assert seen.max.y - seen.min.y >= theme.em(1.0), index
        assert seen.max.x - seen.min.x >= theme.em(1.0), index


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
