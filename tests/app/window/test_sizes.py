"""What pictures of the window at three sizes showed: cards over their object, cut rows and bars."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imgui_bundle import imgui
from PIL import Image

from gaga_core.scene.objects import group_indices
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import commands, objects, selection
from gaga_studio.features.find import memory_bank
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_a_small_window(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def walk(d: Driver) -> None:
        group = _lowest(d)
        _the_card_of_a_mask_keeps_off_its_object(d, group, monkeypatch)
        _the_chosen_mask_is_in_sight(d, group)
        _nothing_lies_over_the_choices_of_a_split_view(d, group)
        _titles_of_panels_are_whole(d)

    drive(walk, path=folder, size=(800, 500))


def _middle(d: Driver, group: int) -> tuple[float, float]:
    """Where an object is on the screen."""
    scene = d.session.need().scene
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


def _choose(d: Driver, group: int, at: int) -> Any:
    d.on_main(partial(selection.select_groups, d.session, (group,)))
    d.focus("Memory bank")
    decision = d.session.decisions(group)[at]
    d.click(f"**/{decision.view} {decision.mask}/##decision")
    d.settle()
    return decision


def _the_chosen_mask_is_in_sight(d: Driver, group: int) -> None:
    """Its row went out of sight when the bars above the table came."""
    d.keys(KEY.escape)
    decision = _choose(d, group, 4)
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
            assert all(tab.width >= tab.content_width for tab in node.tab_bar.tabs)
        return [window.name for node in nodes for window in node.windows]

    shown = titles()
    assert {"Objects", "Camera path", "Memory bank"} < set(shown)
    assert "Timeline" not in shown
    d.on_main(partial(commands.run, "view.timeline", d.session))
    d.until(lambda: memory_bank.timeline_of(d.session).is_open, "the growth is known")
    d.frames(4)
    d.click("Timeline/**/###Close replay")
    d.frames(4)
    assert titles() == shown


def test_sheets_scroll_only_where_they_must(
    display: str, grouped_scene: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def scroll(d: Driver, child: str) -> tuple[float, float]:
        window = d.engine.window_info(f"//{child}").window
        return float(window.scroll.y), float(window.scroll_max.y)

    def walk(d: Driver) -> None:
        d.on_main(partial(commands.run, "edit.preferences", d.session))
        d.frames(4)
        assert scroll(d, "Preferences/Rows") == (0.0, 0.0), "all of it has room"
        d.keys(KEY.escape)
        d.menu("Find/###Make masks…")
        d.frames(4)
        dialog = d.studio.ui.scene.masks
        assert scroll(d, "Make masks/How") == (0.0, 0.0), "with the picture of the try"
        d.resize(800, 500)
        d.frames(4)
        d.click("**/###Try on one photo")
        d.until(lambda: dialog.n_previews == 1, "one photo is done")
        d.settle()
        at, end = scroll(d, "Make masks/How")
        assert at == end > 0, "the try is looked at"

    drive(walk, path=folder, size=(1440, 900))


def test_a_line_over_the_picture_is_wider_where_text_is_larger(
    display: str, grouped_scene: Path, tmp_path: Path
) -> None:
    """A lasso was a hair at UI scale 2."""
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)
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
        drive(partial(walk, scale=scale), path=folder, size=(1000, 700), settings=settings)
    assert wide[2.0] > wide[1.0] >= 1, wide
