"""What cannot be done now says why, in its menu and in the list of commands; the list offers what
makes objects."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event

import pytest
from imgui_bundle import imgui

from gaga_core.progress import Progress, Stage
from gaga_studio.features import commands
from gaga_studio.features.base import Command
from gaga_studio.features.commands import MENUS
from gaga_studio.features.find import association
from gaga_studio.ui.chrome import menu
from gaga_studio.ui.kit import widgets
from tests.app.window.driver import KEY, Driver, drive

pytestmark = pytest.mark.window
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
    assert said["No objects yet"] == "Nothing in this scene belongs to an object.", "no advice"
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

    def tooltip(text: str, shortcut: str = "") -> None:
        flags = imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled
        if text and imgui.is_item_hovered(flags):
            shown.append(text)
        real(text, shortcut)

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
    d.engine.set_ref(d.engine.window_info("//$FOCUSED/Found").window.id_)
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
