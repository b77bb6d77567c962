"""A folder of the object list: what is in it, its switches, what is dropped on it."""

from imgui_bundle import imgui

from gaga_core.scene.folders import name_of
from gaga_studio.features import folders, objects
from gaga_studio.features.object_list import FolderSums, Line, ObjectListView
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.object_menu import FOLDER_DRAG, OBJECT_DRAG
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.panels import list_columns, row_switches
from gaga_studio.ui.panels.object_row import Rows
from gaga_studio.ui.panels.row_parts import (
    Across,
    arrow,
    compact,
    indent,
    last_row,
    name_field,
    select_area,
)
from gaga_studio.ui.panels.row_switches import Switches


class FolderRow:
    """What is drawn of a folder."""

    def __init__(self, rows: Rows, line: Line, sums: FolderSums, is_chosen: bool) -> None:
        self.session, self.document, self.state = rows.session, rows.document, rows.state
        self.table, self.columns = rows.table, rows.columns
        self.path, self.depth = line.folder, line.depth
        self.sums, self.is_chosen, self.is_open = sums, is_chosen, line.is_open

    def draw(self) -> None:
        """Draw the cells of the row."""
        imgui.table_next_row(0, self.columns.height)
        imgui.push_id(f"folder {self.path}")
        imgui.table_set_column_index(0)
        self._select_area()
        row = last_row()
        if arrow(row.low, self.depth, self.columns, self.is_open):
            self.document.feature(ObjectListView).toggle(self.path)
        widgets.tooltip("Close this folder" if self.is_open else "Open this folder")
        imgui.table_set_column_index(1)
        if self.state.renaming_folder == self.path:
            self._name_field()
        else:
            self._text(row)
        imgui.table_set_column_index(self.columns.shown)
        self._switches()
        imgui.pop_id()

    def _select_area(self) -> None:
        sums = self.sums
        whole = sums.n_splats - max(sums.n_hidden, sums.n_locked)
        is_partly = not self.is_chosen and 0 < sums.n_selected < whole
        is_lit = self.is_chosen or sums.n_selected > 0
        clicked = select_area(is_lit, is_partly, self.columns.height)
        if clicked and self.state.renaming_folder != self.path:
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
                self.state.rename_folder(self.path)
            elif imgui.get_io().key_ctrl or imgui.get_io().key_shift:
                folders.choose(self.session, self.path, "remove" if self.is_chosen else "add")
            else:
                folders.choose(self.session, self.path)
        widgets.tooltip(self.path if self.depth else "")
        self._dragging()
        if imgui.begin_popup_context_item("Folder menu"):
            self._menu()
            widgets.escape_closes()
            imgui.end_popup()

    def _dragging(self) -> None:
        paths = self.document.scene.folders.paths  # a drop above may have moved this one
        if self.path in paths and imgui.begin_drag_drop_source():
            imgui.set_drag_drop_payload_py_id(FOLDER_DRAG, paths.index(self.path))
            n = len(folders.chosen(self.session)) if self.is_chosen else 1
            what = f"folder {name_of(self.path)}" if n <= 1 else f"{n} folders"
            widgets.dim(f"{what}: drop it on a folder")
            imgui.end_drag_drop_source()
        drop_target(self.session, self.path)

    def _menu(self) -> None:
        if imgui.is_window_appearing() and not self.is_chosen:
            folders.choose(self.session, self.path)
        if imgui.menu_item_simple(f"{icons.RENAME}  Rename###Rename"):
            self.state.rename_folder(self.path)
        for command_id in ("object.folder", "object.folder_out", "object.folder_delete"):
            command_buttons.command_item(self.session, command_id)
        imgui.separator()
        for command_id in ("view.frame_selected", "object.isolate", "object.hide", "object.lock"):
            command_buttons.command_item(self.session, command_id)
        imgui.separator()
        command_buttons.command_item(self.session, "file.export_selected")

    def _text(self, row: Across) -> None:
        """The sign, the name, and what is in it, over the columns up to the switches."""
        columns, sums, n = self.columns, self.sums, self.sums.n_objects
        is_off = sums.n_splats > 0 and sums.n_hidden == sums.n_splats
        left = indent(self.depth) + columns.arrow
        begin = left + em(1.45)
        room = row.high.x - row.low.x - list_columns.switches_width(columns) - begin - em(0.3)
        line = imgui.get_text_line_height()
        is_high = columns.height >= 2.2 * line
        top = (columns.height - (2 if is_high else 1) * line) / 2
        name = widgets.elided(name_of(self.path), room)
        sign = icons.FOLDER if self.is_open else icons.FOLDER_PLAIN
        row.text(left, top, theme.u32(theme.DIM), sign)
        row.text(begin, top, theme.u32(theme.FAINT if is_off else theme.TEXT), name)
        if is_high:
            inside = f"{n:,} object{'' if n == 1 else 's'}, {compact(sums.n_splats)} splats"
            inside = widgets.elided(inside if n else "empty", room)
            row.text(begin, top + line, theme.u32(theme.DIM), inside)
            return
        width = imgui.calc_text_size(name).x + em(0.6)
        if width + imgui.calc_text_size(f"{n:,}").x <= room:
            row.text(begin + width, top, theme.u32(theme.FAINT), f"{n:,}")

    def _name_field(self) -> None:
        typed = name_field(self.state, self.columns.height)
        if typed is None:
            return
        self.state.renaming_folder = None
        if typed[0]:
            folders.rename(self.session, self.path, typed[1])

    def _switches(self) -> None:
        sums = self.sums
        is_full = sums.n_splats > 0
        now = Switches(
            "folder",
            is_full and sums.n_hidden == sums.n_splats,
            is_full and sums.n_locked == sums.n_splats,
            folders.is_alone(self.table, sums),
        )
        clicked = row_switches.draw(now, self.columns.height, self.columns.is_roomy)
        if clicked == "hide":
            objects.set_hidden(self.session, self.path, not now.is_hidden)
        elif clicked == "lock":
            objects.set_locked(self.session, self.path, not now.is_locked)
        elif clicked:
            objects.isolate_item(self.session, self.path)


def drop_target(session: Session, folder: str) -> None:
    """The last item takes objects and folders into ``folder``; "" takes them out of all."""
    if not imgui.begin_drag_drop_target():
        return
    dropped = imgui.accept_drag_drop_payload_py_id(OBJECT_DRAG)
    if dropped is not None:
        selected = session.selected_groups()
        if dropped.data_id in selected:
            folders.put_in(session, folder, selected, folders.chosen(session))
        else:
            folders.put_in(session, folder, (dropped.data_id,))
    dropped = imgui.accept_drag_drop_payload_py_id(FOLDER_DRAG)
    if dropped is not None:
        _take_folders(session, folder, dropped.data_id)
    imgui.end_drag_drop_target()


def _take_folders(session: Session, folder: str, at: int) -> None:
    scene, chosen = session.need().scene, folders.chosen(session)
    if not 0 <= at < len(scene.folders.paths):
        return
    path = scene.folders.paths[at]
    if path not in chosen:
        folders.put_in(session, folder, (), (path,))
        return
    moved = [p for p in chosen if p != folder]
    inside = {g for p in chosen for g in scene.folders.groups(p)}
    others = [group for group in session.selected_groups() if group not in inside]
    folders.put_in(session, folder, others, moved)
