"""What an hour of use met: ways out of isolation, file dialogs by key, calm bars and lists."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaga_core.scene.objects import group_indices
from gaga_studio.features import commands, objects, selection
from gaga_studio.session.notices import Level
from gaga_studio.system.fonts import fonts_with
from gaga_studio.ui.dialogs.file_dialog import FileDialog, PathKind
from gaga_studio.ui.kit import theme
from gaga_studio.ui.kit.right_to_left import visual
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window


def test_snags_of_an_hour_of_use(display: str, grouped_scene: Path, tmp_path: Path) -> None:
    folder = tmp_path / "table"
    shutil.copytree(grouped_scene, folder)

    def walk(d: Driver) -> None:
        _isolation(d)
        _history(d)
        _tool_bar(d)
        _playback(d)
        _letters(d)
        _notices(d, tmp_path / "notice.png")
        _file_dialog(d, tmp_path)

    drive(walk, path=folder, size=(1280, 720))


def _isolation(d: Driver) -> None:
    """A button in the picture shows all again, without a selection; the command is a switch."""
    session = d.session
    assert not d.exists("Viewport/Show all")
    d.on_main(lambda: objects.isolate_item(session, 2))
    d.on_main(lambda: commands.run("select.none", session))
    d.frames()
    assert objects.isolated(session) == session.need().name_of(2)
    d.click("Viewport/Show all")
    d.frames()
    assert not objects.isolated(session)
    d.on_main(lambda: selection.select_groups(session, (3,)))
    d.on_main(lambda: commands.run("object.isolate", session))
    assert objects.isolated(session)
    d.on_main(lambda: commands.run("object.isolate", session))
    assert not objects.isolated(session)


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


def _playback(d: Driver) -> None:
    d.session.view.playback.is_playing = True
    d.studio._escape()
    assert not d.session.view.playback.is_playing


def _file_dialog(d: Driver, folder: Path) -> None:
    """Enter presses the button, Esc closes, folders are made, places are one click away."""
    taken: list[Path] = []

    def ask() -> FileDialog:
        dialog = FileDialog("Choose a folder", PathKind.OPEN_FOLDER, folder)
        d.on_main(lambda: d.studio.ui.files.ask(dialog, taken.append))
        d.frames(3)
        return dialog

    ask()
    d.keys(KEY.enter)
    assert taken == [folder]
    ask()
    d.keys(KEY.escape)
    assert d.studio.ui.files.dialog is None
    assert len(taken) == 1
    dialog = ask()
    d.click("$FOCUSED/New folder")
    d.frames()
    d.engine.key_chars_replace_enter("results")
    d.frames()
    assert (folder / "results").is_dir()
    assert dialog.folder == folder / "results"
    d.click("$FOCUSED/Places")
    d.frames()
    d.click("$FOCUSED/###place 0")
    d.frames()
    assert dialog.folder == Path.home().resolve()
    d.keys(KEY.escape)
