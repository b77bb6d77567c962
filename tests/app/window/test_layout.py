"""Docks: wide enough for their text at every scale, and never lost."""

import re
from functools import partial
from pathlib import Path

import pytest

from gaga_studio.session.settings import Settings
from tests.app.window.driver import Driver, drive

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
