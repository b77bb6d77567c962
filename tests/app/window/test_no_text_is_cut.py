"""Four sizes of the window at three scales of the text: nothing is cut, overlaps or gets lost."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from imgui_bundle import imgui

from gaga_studio import commands
from gaga_studio.actions import camera_path, selection
from gaga_studio.session.settings import Settings
from gaga_studio.session.view_state import ToolName
from tests.app.window.driver import KEY, Driver, drive
from tests.app.window.layout_check import TextWatch, findings

pytestmark = pytest.mark.window
_PANELS = ("Objects", "Inspector", "Memory bank", "History", "Select by", "Views", "Camera path")
_FRONTS = (("Inspector", "Memory bank", "Views"), ("Select by", "History", "Camera path"))
_SIZES = {  # of the window, by the scale of the text
    1.0: ((800, 500), (1900, 1060)),
    1.25: ((1280, 720),),
    1.5: ((1440, 900),),
}
_SMALLEST = (800, 500)
_WITH_OPTIONS = (ToolName.LASSO, ToolName.OBJECT, ToolName.COLOR)
_SHEETS = ("edit.preferences", "file.export_objects", "file.export_cameras", "camera.film")


def test_no_text_is_cut_at_any_size(
    display: str, grouped_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)
    watch = TextWatch()
    wrong: list[str] = []

    def walk(d: Driver) -> None:
        d.on_main(partial(selection.select_groups, d.session, (2,)))
        for _ in range(3):
            d.on_main(partial(camera_path.add_keyframe, d.session))
        d.on_main(partial(selection.select_groups, d.session, (2,)))
        monkeypatch.setattr(imgui, "text_unformatted", watch.text(imgui.text_unformatted))
        monkeypatch.setattr(imgui, "button", watch.button(imgui.button))
        for scale, sizes in _SIZES.items():
            settings = replace(d.session.settings, ui_scale=scale)
            d.on_main(partial(d.session.change_settings, settings))
            for size in sizes:
                look(d, size, scale)
        monkeypatch.undo()

    def look(d: Driver, size: tuple[int, int], scale: float) -> None:
        d.resize(*size)
        d.frames(5)
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
        for command in _SHEETS if (size, scale) == (_SMALLEST, 1.0) else ():
            d.on_main(partial(commands.run, command, d.session))
            watch.frame(d)
            d.keys(KEY.escape)
        wrong.extend(f"{size} {scale}: {text}" for text in watch.found)

    drive(walk, path=folder, size=_SMALLEST)
    assert watch.n_seen > 1000, "the texts were looked at"
    assert not wrong, "\n".join(wrong)


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
