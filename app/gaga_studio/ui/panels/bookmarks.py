"""The list of views that a person keeps."""

from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.camera_path import Bookmark
from gaga_studio.features import camera
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em


@dataclass
class BookmarkState:
    """The name that is being typed."""

    renaming: int | None = None  # bookmark whose name is a text field now
    text: str = ""
    has_keyboard: bool = False  # the text field has taken it


def draw(session: Session, state: BookmarkState) -> None:
    """The whole panel."""
    marks = camera.bookmarks(session)
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
            _row(session, state, index, mark)
            imgui.pop_id()
    imgui.end_child()


def _row(session: Session, state: BookmarkState, index: int, mark: Bookmark) -> None:
    room = imgui.get_content_region_avail().x
    tools = em(4.6)
    if state.renaming == index:
        _name_field(session, state, index, room - tools)
    else:
        keys = f"Ctrl+{mark.key}" if mark.key else ""
        width = room - tools - imgui.calc_text_size(keys).x - em(0.8)
        flags = imgui.SelectableFlags_.allow_double_click
        shown = widgets.elided(mark.name, width)
        if imgui.selectable(f"{shown}###{mark.name}", False, flags, ImVec2(width, 0))[0]:
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                state.renaming, state.text = index, mark.name
            else:
                camera.recall_bookmark(session, index)
        widgets.tooltip("Click to go there, double click to rename")
        if keys:
            imgui.same_line(0, em(0.4))
            widgets.dim(keys)
    imgui.same_line(room - tools + em(0.3))
    if widgets.small_icon("Update", icons.UPDATE, hint="Keep the present view instead"):
        camera.update_bookmark(session, index)
    imgui.same_line(0, 0)
    if widgets.small_icon("Up", icons.EARLIER, hint="Move up"):
        camera.move_bookmark(session, index, -1)
    imgui.same_line(0, 0)
    if widgets.small_icon("Remove", icons.CLOSE, hint="Remove the bookmark"):
        camera.remove_bookmark(session, index)


def _name_field(session: Session, state: BookmarkState, index: int, width: float) -> None:
    imgui.set_next_item_width(width)
    if not state.has_keyboard:
        imgui.set_keyboard_focus_here()
        state.has_keyboard = True
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    with theme.text_color(theme.TEXT):
        entered, state.text = imgui.input_text("##Name", state.text, flags)
    if entered or imgui.is_item_deactivated():
        if entered or not imgui.is_key_pressed(imgui.Key.escape):
            camera.rename_bookmark(session, index, state.text)
        state.renaming, state.has_keyboard = None, False
