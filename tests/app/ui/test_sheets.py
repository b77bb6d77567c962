"""The list of commands, as it is drawn frame by frame."""

from collections import Counter
from collections.abc import Callable

import pytest
from imgui_bundle import imgui

from gaga_studio.features import commands
from gaga_studio.features.base import Command
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs import sheets
from gaga_studio.ui.dialogs.sheets import PaletteState

pytestmark = pytest.mark.usefixtures("context")


def test_the_list_of_commands_asks_once_a_frame_and_keeps_its_order(
    new_session: Callable[[], Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An answer that changes, as when a job ends, moves no line under the arrow keys."""
    asked, why_not, ran = Counter[str](), {"split.one": "Busy."}, list[str]()

    def command(id_: str) -> Command:
        def enabled(_: Session) -> str:
            asked[id_] += 1
            return why_not.get(id_, "")

        return Command(id_, f"Split {id_}", lambda _: ran.append(id_), enabled=enabled)

    menu = tuple(map(command, ("split.one", "split.two", "split.three")))
    monkeypatch.setattr(commands, "all_menus", lambda _: {"Menu": menu})
    session, state = new_session(), PaletteState()

    def frame(*, is_first: bool = False) -> None:
        asked.clear()
        imgui.new_frame()
        imgui.begin("Window")
        if is_first:
            sheets.open_commands(state)
        sheets.draw(session, state)
        imgui.end()
        imgui.end_frame()

    def press(key: imgui.Key) -> None:
        for is_down in (True, False):
            imgui.get_io().add_key_event(key, is_down)
            frame()

    frame(is_first=True)
    frame()
    assert asked == {one.id: 1 for one in menu}
    why_not.clear()  # the first one is possible now, and stays the last
    press(imgui.Key.down_arrow)
    press(imgui.Key.down_arrow)
    assert asked == {one.id: 1 for one in menu}
    press(imgui.Key.enter)
    assert ran == ["split.one"]
