"""The menu bar, from the table of commands."""

from collections.abc import Callable
from pathlib import Path

from imgui_bundle import imgui

from gaga_studio.commands import COMMANDS, GROUPS
from gaga_studio.session import Session
from gaga_studio.ui import actions, icons, theme
from gaga_studio.ui.state import UiState

# A line above these, to set apart what belongs together.
_LINE_BEFORE = {
    "file.save",
    "file.export_scene",
    "file.close",
    "edit.duplicate",
    "edit.cancel",
    "edit.preferences",
    "object.hide",
    "object.rename",
    "object.clean",
    "view.frame_selected",
    "view.front",
    "view.next_photo",
    "view.outline",
    "tool.move",
    "tool.splats",
    "tool.visible_only",
    "job.cancel",
    "help.about",
}


def draw(session: Session, ui: UiState, reset_layout: Callable[[], None]) -> None:
    """Menus, and at the right end the name of what is open."""
    for group in GROUPS:
        if imgui.begin_menu(group):
            for command in COMMANDS:
                if command.group == group:
                    if command.id in _LINE_BEFORE:
                        imgui.separator()
                    actions.command_item(session, command.id)
                    if command.id == "file.demo":
                        _recent(session)
            if group == "View":
                imgui.separator()
                if imgui.menu_item_simple(f"{icons.RESET}  Put panels back###Put panels back"):
                    reset_layout()
            imgui.end_menu()
    _title(session)


def _recent(session: Session) -> None:
    recent = session.settings.recent
    if imgui.begin_menu(f"{icons.CLOCK}  Open recent###Open recent", bool(recent)):
        for name in recent:
            if imgui.menu_item_simple(name):
                session.open(Path(name))
        imgui.end_menu()


def _title(session: Session) -> None:
    title = session.title
    if not title:
        return
    width = imgui.calc_text_size(title).x
    left = (imgui.get_window_width() - width) / 2
    if left > imgui.get_cursor_pos_x() + theme.em(2):
        imgui.set_cursor_pos_x(left)
        with theme.text_color(theme.DIM):
            imgui.text_unformatted(title)
