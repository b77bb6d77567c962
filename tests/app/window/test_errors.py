"""Errors while panels are drawn: the window tells of them, closes what they left open, lives on."""

import logging
from collections.abc import Callable
from itertools import product
from pathlib import Path

import pytest
from imgui_bundle import ImVec2, imgui

from gaga_core.errors import GagaError
from gaga_studio.session.notices import Level
from gaga_studio.ui.chrome import toolbar
from gaga_studio.ui.dialogs import sheets
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.panels import inspector
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


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
    display: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Once in this frame, once in five frames running: each is told of once, and all goes on."""
    wanted = [0]

    def failing(module: object, leave_open: Callable[[], None]) -> None:
        real = module.draw  # type: ignore[attr-defined]

        def draw(*args: object) -> None:
            if wanted[0]:
                wanted[0] -= 1
                leave_open()
            real(*args)

        monkeypatch.setattr(module, "draw", draw)

    def walk(d: Driver) -> None:
        for (place, module), leave_open in product(
            {"Inspector": inspector, "Dialogs": sheets, "Tool bar": toolbar}.items(),
            (in_a_child, in_a_table, in_a_popup, in_a_window),
        ):
            failing(module, leave_open)
            for times in (1, 5):
                _fails(d, times, place, leave_open)
            monkeypatch.undo()
            d.menu("Help/###Keys and mouse")  # every part of the window still works
            assert d.exists("Keys and mouse/###Close")
            d.keys(KEY.escape)
            assert d.exists("Viewport/Try the demo")

    def _fails(d: Driver, times: int, place: str, leave_open: Callable[[], None]) -> None:
        d.session.notices = ()
        caplog.clear()
        wanted[0] = times
        d.until(lambda: not wanted[0], "it failed")
        d.frames(3)
        told = [notice.text for notice in d.session.notices if notice.level is Level.ERROR]
        assert told == [f"Something went wrong in {place}; the details are in the log file."]
        (entry,) = [r for r in caplog.records if r.levelno == logging.ERROR]
        assert entry.exc_info is not None
        assert leave_open.__name__ in caplog.text

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

        monkeypatch.setattr(d.session, "open", fails)
        d.on_main(lambda: d.studio.window.hooks.dropped([tmp_path]))
        monkeypatch.undo()
        monkeypatch.setattr(d.session, "tick", fails)
        d.frames(4)
        assert [notice.text for notice in d.session.notices] == [
            f"Something went wrong in {place}; the details are in the log file."
            for place in ("Open", "Session")
        ]

    drive(walk, may_fail=True)


def test_the_tests_themselves_hear_of_a_panel_that_failed(
    display: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(widgets, "empty_state", lambda *_: 1 / 0)
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        drive(lambda d: d.frames(3))
