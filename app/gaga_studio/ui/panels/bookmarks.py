"""The list of views that a person keeps."""

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.camera_path import Bookmark
from gaga_studio.actions import bookmarks
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.state import UiState
from gaga_studio.ui.kit.theme import em


def draw(session: Session, ui: UiState) -> None:
    """The whole panel."""
    marks = bookmarks.listed(session)
    if session.document is None:
        widgets.empty_state(icons.BOOKMARK, "No bookmarks", "")
        return
    command_buttons.command_button(session, "camera.add_bookmark", "Bookmark this view")
    if not marks:
        widgets.dim("Views kept here are saved with the project. Ctrl+Shift+1 to 9 set", wrap=True)
        widgets.dim("one with a key, Ctrl+1 to 9 go there.", wrap=True)
        return
    if imgui.begin_child("Marks", ImVec2(0, 0)):
        for index, mark in enumerate(marks):
            imgui.push_id(index)
            _row(session, ui, index, mark)
            imgui.pop_id()
    imgui.end_child()


def _row(session: Session, ui: UiState, index: int, mark: Bookmark) -> None:
    room = imgui.get_content_region_avail().x
    tools = em(4.6)
    if ui.renaming_mark == index:
        _name_field(session, ui, index, room - tools)
    else:
        keys = f"Ctrl+{mark.key}" if mark.key else ""
        width = room - tools - imgui.calc_text_size(keys).x - em(0.8)
        flags = imgui.SelectableFlags_.allow_double_click
        shown = widgets.elided(mark.name, width)
        if imgui.selectable(f"{shown}###{mark.name}", False, flags, ImVec2(width, 0))[0]:
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                ui.renaming_mark, ui.mark_text = index, mark.name
            else:
                bookmarks.recall(session, index)
        widgets.tooltip("Click to go there, double click to rename")
        if keys:
            imgui.same_line(0, em(0.4))
            widgets.dim(keys)
    imgui.same_line(room - tools + em(0.3))
    if widgets.small_icon("Update", icons.UPDATE, hint="Keep the present view instead"):
        bookmarks.update(session, index)
    imgui.same_line(0, 0)
    if widgets.small_icon("Up", icons.EARLIER, hint="Move up"):
        bookmarks.move(session, index, -1)
    imgui.same_line(0, 0)
    if widgets.small_icon("Remove", icons.CLOSE, hint="Remove the bookmark"):
        bookmarks.remove(session, index)


def _name_field(session: Session, ui: UiState, index: int, width: float) -> None:
    imgui.set_next_item_width(width)
    if not ui.mark_started:
        imgui.set_keyboard_focus_here()
        ui.mark_started = True
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    with theme.text_color(theme.TEXT):
        entered, ui.mark_text = imgui.input_text("##Name", ui.mark_text, flags)
    if entered or imgui.is_item_deactivated():
        if entered or not imgui.is_key_pressed(imgui.Key.escape):
            bookmarks.rename(session, index, ui.mark_text)
        ui.renaming_mark, ui.mark_started = None, False
