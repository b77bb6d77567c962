"""One line of the object list: color, picture, name, numbers, switches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.scene.objects import UNASSIGNED, ObjectTable
from gaga_studio.features import commands, folders, objects, selection
from gaga_studio.features.find import memory_bank
from gaga_studio.features.object_list import Line, ObjectListView, PartIndex
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, object_menu, object_picture, theme, widgets
from gaga_studio.ui.kit.object_menu import MASK_DRAG, OBJECT_DRAG
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.panels import folder_menu, row_switches
from gaga_studio.ui.panels.row_parts import (
    Across,
    RowColumns,
    RowState,
    arrow,
    compact,
    indent,
    last_row,
    lower,
    name_field,
    select_area,
)
from gaga_studio.ui.panels.row_switches import Switches
from gaga_studio.ui.viewport.mask_menu import MaskMenuState

_HIGH, _LOW = 50.0, 25.0  # of a row, with a picture of 48, and in a low list; pixels at 96 dpi
_ENOUGH = 5  # high rows that a list must have room for
_GOOD, _FAIR = 0.75, 0.5  # agreements


def height(room: float) -> float:
    """Of a row in a list ``room`` pixels high, in pixels of this screen."""
    return theme.scaled(_HIGH if room > _ENOUGH * theme.scaled(_HIGH) else _LOW)


@dataclass(frozen=True, eq=False)
class Rows:
    """What all lines of the list share."""

    session: Session
    document: Document
    state: RowState
    masks: MaskMenuState  # the mask that is dragged onto a row
    table: ObjectTable
    quality: DoubleArray  # (G,) -1 = not measured
    shown: Sequence[int]  # groups in the order of the list
    columns: RowColumns
    parts: PartIndex | None  # None: the groups have no levels

    def draw(self, line: Line) -> None:
        """The cells of the row of an object."""
        _Row(self, line).draw()


class _Row:
    def __init__(self, rows: Rows, line: Line) -> None:
        table, row = rows.table, line.row
        self.rows, self.row, self.line = rows, row, line
        self.session, self.document, self.state = rows.session, rows.document, rows.state
        self.group = int(table.ids[row])
        self.name, self.height = table.names[row], rows.columns.height
        self.color = tuple(float(c) for c in table.colors[row])
        self.is_selected = bool(table.n_selected[row] > 0)
        whole = table.counts[row] - max(table.n_hidden[row], table.n_locked[row])
        self.is_partly_selected = bool(0 < table.n_selected[row] < whole)
        self.is_hidden = bool(table.n_hidden[row] == table.counts[row])
        self.is_locked = bool(table.n_locked[row] == table.counts[row])

    def draw(self) -> None:
        """The cells."""
        table, columns = self.rows.table, self.rows.columns
        imgui.table_next_row(0, self.height)
        imgui.push_id(f"object {self.group}")
        imgui.table_set_column_index(0)
        self._select_area()
        self._begin()
        self._swatch()
        imgui.same_line(0, em(0.15))
        self._picture()
        imgui.table_set_column_index(1)
        self._name()
        color = theme.FAINT if self.is_hidden else theme.DIM
        if columns.splats >= 0:
            imgui.table_set_column_index(columns.splats)
            lower(self.height)
            count = int(table.counts[self.row])
            widgets.number(f"{count:,}" if columns.is_roomy else compact(count), color)
        if columns.views >= 0:
            imgui.table_set_column_index(columns.views)
            lower(self.height)
            n_views = int(table.n_views[self.row])
            widgets.number(f"{n_views}" if n_views else "–", color)
        if columns.quality >= 0:
            imgui.table_set_column_index(columns.quality)
            lower(self.height)
            self._quality()
        imgui.table_set_column_index(columns.shown)
        self._switches()
        imgui.pop_id()

    # --- selecting, dragging, the menu

    def _select_area(self) -> None:
        clicked = select_area(self.is_selected, self.is_partly_selected, self.height)
        if imgui.is_item_hovered() and self.group:
            self.state.hovered = self.group
        if clicked and self.state.renaming != self.group:
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left) and self.group:
                self._double_clicked()
            else:
                self._select()
        self._dragging()
        if imgui.begin_popup_context_item("Object menu"):
            self._menu()
            widgets.escape_closes()
            imgui.end_popup()

    def _double_clicked(self) -> None:
        if not self.line.has_children:
            self.state.rename(self.group, self.name)
            return
        selection.select_groups(self.session, (self.group,))
        folders.select_with_children(self.session)

    def _begin(self) -> None:
        """What opens what is under the object, or its parts; then the row begins."""
        row, parts, columns = last_row(), self.rows.parts, self.rows.columns
        if self.line.has_children:
            self._fold(row)
        elif columns.arrow and parts is not None and self.group and parts.parts(self.group):
            listing, key = self.document.feature(ObjectListView), (self.group,)
            if arrow(row.low, self.line.depth, columns, key in listing.open_parts):
                listing.toggle_parts(key)
            widgets.tooltip("Its parts, by the levels of detail of its masks")
        left = indent(self.line.depth) + columns.arrow
        imgui.set_cursor_screen_pos(ImVec2(row.low.x + left, row.low.y))

    def _fold(self, row: Across) -> None:
        """What opens and closes what lies under the object."""
        listing, is_open = self.document.feature(ObjectListView), self.line.is_open
        if arrow(row.low, self.line.depth, self.rows.columns, is_open):
            listing.toggle_group(self.group, is_open)
        widgets.tooltip("Objects under it. Double-click the row to select them with it")

    def _select(self) -> None:
        io = imgui.get_io()
        anchor, shown = self.state.anchor, self.rows.shown
        if io.key_shift and anchor in shown:
            a, b = sorted((shown.index(anchor), shown.index(self.group)))
            selection.select_groups(self.session, shown[a : b + 1], "set")
            return
        how = ("remove" if self.is_selected else "add") if io.key_ctrl else "set"
        selection.select_groups(self.session, (self.group,), how)  # type: ignore[arg-type]  # a How
        self.state.anchor = self.group

    def _dragging(self) -> None:
        """Rows go under the object that they are dropped on, with Ctrl they become a part of it;
        masks become masks of it."""
        if self.group and imgui.begin_drag_drop_source():
            imgui.set_drag_drop_payload_py_id(OBJECT_DRAG, self.group)
            n = len(self.session.selected_groups()) if self.is_selected else 1
            what = self.name if n <= 1 else f"{n} objects"
            onto = " or folder" if self.document.scene.folders.paths else ""
            widgets.dim(f"{what}: drop it on the object{onto} to put it under")
            widgets.dim("Ctrl: make it a part of that object")
            imgui.end_drag_drop_source()
        if not imgui.begin_drag_drop_target():
            return
        dropped = imgui.accept_drag_drop_payload_py_id(OBJECT_DRAG)
        if dropped is not None and dropped.data_id != self.group:
            self._take(dropped.data_id)
        if imgui.accept_drag_drop_payload_py_id(MASK_DRAG) is not None:
            mask, self.rows.masks.dragged = self.rows.masks.dragged, None
            if mask is not None:
                memory_bank.move_mask(self.session, mask, self.group or memory_bank.NONE)
        imgui.end_drag_drop_target()

    def _take(self, group: int) -> None:
        """An object was dropped here: with it, all that is selected when it is, too."""
        if not self.group or imgui.get_io().key_ctrl:
            if group not in self.session.selected_groups():
                selection.select_groups(self.session, (group,), "set")
            objects.assign(self.session, self.group)
            return
        selected = self.session.selected_groups()
        groups = selected if group in selected else (group,)
        folders.put_under(self.session, self.group, [g for g in groups if g != self.group])

    def _menu(self) -> None:
        state = self.state
        if imgui.is_window_appearing():
            state.splats = None
            if not self.is_selected:
                state.splats = self.session.selected_indices()
                selection.select_groups(self.session, (self.group,), "set")
        if state.splats is not None and len(state.splats):
            text = f"{icons.JOINED}  Assign the selection to {self.name}###Assign here"
            if imgui.menu_item_simple(text):
                objects.assign(self.session, self.group, state.splats)
            widgets.tooltip(f"The {len(state.splats):,} splats that were selected before")
            imgui.separator()
        if self.group:
            folder_menu.put_into(self.session)
            self._put_under()
        if imgui.begin_menu(f"{icons.JOINED}  Assign to###Assign to"):
            to = object_menu.objects(state.menu, self.rows.table, without=(self.group,))
            if to is not None:
                objects.assign(self.session, to)
            imgui.end_menu()
        if self.group in self.document.scene.colors and imgui.menu_item_simple(
            f"{icons.RESET}  Color of its own number###Reset color"
        ):
            objects.set_color(self.session, self.group, None)
        imgui.separator()
        command_buttons.object_menu(self.session)

    def _put_under(self) -> None:
        """Objects as items of a submenu: the selected ones go under the one that is chosen."""
        if imgui.begin_menu(f"{icons.UNFOLDED}  Put under###Put under"):
            selected = self.session.selected_groups()
            without = (*selected, *self.document.scene.folders.under(*selected))
            above = object_menu.objects(self.state.menu, self.rows.table, without=without)
            if above is not None:
                folders.put_under(self.session, above, selected)
            imgui.end_menu()
        for command_id in ("object.leave_parent", "select.children"):
            if not commands.command(command_id).enabled(self.session):
                command_buttons.command_item(self.session, command_id)

    # --- what is shown

    def _swatch(self) -> None:
        """A dot in the color of the object; a click changes it."""
        side, corner = em(1.0), imgui.get_cursor_screen_pos()
        centre = ImVec2(corner.x + side * 0.5, corner.y + self.height * 0.5)
        alpha = 0.35 if self.is_hidden else 1.0
        if not self.group:
            widgets.dot(centre, side * 0.33, self.color, alpha)
            imgui.dummy(ImVec2(side, self.height))
            return
        if imgui.invisible_button("Color", ImVec2(side, self.height)):
            imgui.open_popup("List color")
        is_over = imgui.is_item_hovered()
        widgets.dot(centre, side * (0.42 if is_over else 0.33), self.color, alpha)
        widgets.tooltip("Color in this list and in Groups: click to change it")
        if imgui.begin_popup("List color"):
            self._picker()
            widgets.escape_closes()
            imgui.end_popup()

    def _picker(self) -> None:
        """Shown while the mouse is down, one entry of the history when it is released."""
        state = self.state
        flags = imgui.ColorEditFlags_.no_alpha | imgui.ColorEditFlags_.no_side_preview
        imgui.set_next_item_width(em(13))
        own = self.document.scene.colors.get(self.group, self.color)
        changed, picked = imgui.color_picker3("##Picker", list(own), flags)
        if changed:
            objects.preview_color(self.session, self.group, picked)
            state.is_coloring = True
        if state.is_coloring and not imgui.is_any_item_active():
            self.session.commit_preview()
            state.is_coloring = False

    def _picture(self) -> None:
        gap, side = theme.scaled(1), self.height
        corner = imgui.get_cursor_screen_pos()
        imgui.dummy(ImVec2(side, side))
        object_picture.draw(
            self.session,
            self.rows.table,
            self.row,
            ImVec2(corner.x + gap, corner.y + gap),
            side - 2 * gap,
            0.4 if self.is_hidden else 1.0,
        )
        object_picture.tooltip(self.session, self.rows.table, self.row)

    def _name(self) -> None:
        if self.state.renaming == self.group:
            self._name_field()
            return
        is_plain = self.name == UNASSIGNED or self.is_hidden
        color = theme.FAINT if is_plain else theme.TEXT
        room = imgui.get_content_region_avail().x
        lines = [widgets.elided(self.name, room)]
        if self.is_partly_selected:
            n, of = self.rows.table.n_selected[self.row], self.rows.table.counts[self.row]
            lines.append(f"{n:,} of {of:,}")
        elif lines[0] != self.name and self.height >= 2 * imgui.get_text_line_height():
            lines = widgets.two_lines(self.name, room)
        lower(self.height, len(lines))
        top = imgui.get_cursor_pos()
        for i, text in enumerate(lines):
            imgui.set_cursor_pos(ImVec2(top.x, top.y + i * imgui.get_text_line_height()))
            is_count = self.is_partly_selected and i == 1
            with theme.text_color(theme.ACCENT if is_count else color):
                imgui.text_unformatted(text)
        if " ".join(lines) != self.name and not self.is_partly_selected:
            widgets.tooltip(self.name)

    def _name_field(self) -> None:
        typed = name_field(self.state, self.height)
        if typed is None:
            return
        self.state.renaming = None
        if typed[0]:
            objects.rename(self.session, self.group, typed[1])

    def _quality(self) -> None:
        value = float(self.rows.quality[self.row])
        color = theme.GOOD if value >= _GOOD else theme.WARN if value >= _FAIR else theme.BAD
        _, is_now = memory_bank.shown_quality(self.session)
        color = color if is_now else theme.FAINT
        sign = " %" if self.rows.columns.is_roomy else ""
        if value < 0:
            widgets.number("–", theme.FAINT)
            return
        widgets.number(f"{100 * value:.0f}{sign}", color)
        text = f"{100 * value:.0f} % agreement of its picture with its masks"
        widgets.tooltip(text if is_now else f"{text}, before the last change of the objects")

    # --- switches

    def _switches(self) -> None:
        table = self.rows.table
        shown = table.n_hidden < table.counts
        own = {self.group, *self.document.scene.folders.under(self.group)}
        is_alone = bool(shown[self.row] and np.count_nonzero(shown) <= len(own))
        is_alone = is_alone and own.issuperset(table.ids[shown].tolist())
        now = Switches("object", self.is_hidden, self.is_locked, is_alone)
        clicked = row_switches.draw(now, self.height, self.rows.columns.is_roomy)
        if clicked == "hide":
            objects.set_hidden(self.session, self.group, not self.is_hidden)
        elif clicked == "lock":
            objects.set_locked(self.session, self.group, not self.is_locked)
        elif clicked:
            objects.isolate_item(self.session, self.group)
