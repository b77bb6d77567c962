"""The submenu "Put into a folder" of the selected objects."""

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.folders import SEPARATOR, name_of
from gaga_studio.features import folders
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.panels.row_parts import indent

_HIGHEST = 10  # lines, then the list scrolls


def put_into(session: Session) -> None:
    """Folders as items of a submenu, a new one, and out of them."""
    if not imgui.begin_menu(f"{icons.FOLDER_PLAIN}  Put into a folder###Put into a folder"):
        return
    command_buttons.command_item(session, "object.folder")
    command_buttons.command_item(session, "object.folder_out")
    paths = session.need().scene.folders.paths
    if paths:
        imgui.separator()
        high = min(len(paths), _HIGHEST) * imgui.get_text_line_height_with_spacing() + em(0.4)
        if imgui.begin_child("Folders", ImVec2(em(15), high)):
            for path in paths:
                _item(session, path)
        imgui.end_child()
    imgui.end_menu()


def _item(session: Session, path: str) -> None:
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + indent(path.count(SEPARATOR)))
    name = widgets.elided(name_of(path), imgui.get_content_region_avail().x - em(1.6))
    if imgui.selectable(f"{icons.FOLDER_PLAIN}  {name}###into {path}", False)[0]:
        folders.put_in(session, path, session.selected_groups(), folders.chosen(session))
        imgui.close_current_popup()
