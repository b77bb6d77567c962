"""The object list: swatch, name, splats, views, and whether it is shown and locked."""

from collections.abc import Sequence
from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.scene.objects import UNASSIGNED, ObjectTable
from gaga_studio.document import Document
from gaga_studio.readings import SortKey, listed
from gaga_studio.session import Session
from gaga_studio.ui import actions, icons, theme, widgets
from gaga_studio.ui.state import UiState
from gaga_studio.ui.theme import em

_TABLE_FLAGS = (
    imgui.TableFlags_.sortable
    | imgui.TableFlags_.scroll_y
    | imgui.TableFlags_.row_bg
    | imgui.TableFlags_.no_saved_settings
    | imgui.TableFlags_.no_pad_outer_x
    | imgui.TableFlags_.sizing_fixed_fit
)
_ROW_FLAGS = (
    imgui.SelectableFlags_.span_all_columns
    | imgui.SelectableFlags_.allow_overlap
    | imgui.SelectableFlags_.allow_double_click
)


def draw(session: Session, ui: UiState) -> None:
    """The whole panel."""
    if session.document is None:
        widgets.empty_state(icons.BOXES, "No scene is open", "Its objects will be listed here.")
        return
    table = session.objects()
    if not (table.ids > 0).any():
        _nothing_yet(session)
        return
    _filter(session)
    ui.hovered_row = 0
    _list(session, session.document, ui, table)
    _highlight(session, ui)
    _count(session, table)


def _nothing_yet(session: Session) -> None:
    if session.jobs.running is not None:
        widgets.empty_state(icons.BOXES, "No objects yet", "They appear here as views are done.")
        return
    offer = session.stage_offer()
    reason = offer.reason if offer is not None else "Nothing in this scene belongs to an object."
    widgets.empty_state(icons.BOXES, "No objects yet", reason)


def _filter(session: Session) -> None:
    clear = imgui.get_frame_height() if session.filter else 0.0
    imgui.set_next_item_width(-1 if not clear else -clear - em(0.5))
    hint = f"{icons.SEARCH}  Filter"
    _, session.filter = imgui.input_text_with_hint("##Filter", hint, session.filter)
    if clear:
        imgui.same_line(0, em(0.2))
        if widgets.icon_button("Clear filter", icons.CLOSE):
            session.filter = ""


def _list(session: Session, document: Document, ui: UiState, table: ObjectTable) -> None:
    is_narrow = imgui.get_content_region_avail().x < em(14.5)
    height = -imgui.get_text_line_height_with_spacing() - theme.scaled(2)
    if not imgui.begin_table("Table", 4 if is_narrow else 5, _TABLE_FLAGS, ImVec2(0, height)):
        return
    _columns(is_narrow)
    sort, descending = _sorting()
    rows = listed(table, session.filter, sort, descending)
    groups = [int(group) for group in table.ids[rows]]
    _follow_selection(session, ui, groups)
    clipper = imgui.ListClipper()
    clipper.begin(len(rows))
    while clipper.step():
        for at in range(clipper.display_start, clipper.display_end):
            _Row(session, document, ui, table, int(rows[at]), groups).draw(is_narrow)
    clipper.end()
    if len(rows) == 0:
        imgui.table_next_row()
        imgui.table_set_column_index(1)
        widgets.dim(f"Nothing is called {session.filter}")
    imgui.end_table()


def _highlight(session: Session, ui: UiState) -> None:
    """The object whose row is under the mouse is outlined in the picture too."""
    if ui.hovered_row:
        session.hovering.group = ui.hovered_row
    elif ui.was_row_hovered:
        session.hovering.away()
    ui.was_row_hovered = bool(ui.hovered_row)


def _columns(is_narrow: bool) -> None:
    fixed = imgui.TableColumnFlags_.width_fixed
    plain = fixed | imgui.TableColumnFlags_.no_sort | imgui.TableColumnFlags_.no_header_label
    falling = fixed | imgui.TableColumnFlags_.prefer_sort_descending
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column("id", fixed | imgui.TableColumnFlags_.no_header_label, em(1.0))
    imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch)
    imgui.table_setup_column("Splats", falling, em(3.4))
    if not is_narrow:
        imgui.table_setup_column("Views", falling, em(2.8))
    imgui.table_setup_column("Shown", plain, em(2.75))
    with theme.text_color(theme.DIM):
        imgui.table_headers_row()


def _sorting() -> tuple[SortKey, bool]:
    specs = imgui.table_get_sort_specs()
    if specs is None or specs.specs_count == 0:
        return "id", False
    spec = specs.get_specs(0)
    keys: tuple[SortKey, ...] = get_args(SortKey)
    descending = spec.get_sort_direction() == imgui.SortDirection.descending
    return keys[spec.column_index], descending


def _follow_selection(session: Session, ui: UiState, groups: Sequence[int]) -> None:
    """Scroll to an object that was selected in the picture."""
    selected = session.selected_groups()
    if selected != ui.last_selected:
        ui.last_selected = selected
        if len(selected) == 1 and not imgui.is_window_hovered(
            imgui.HoveredFlags_.child_windows | imgui.HoveredFlags_.root_window
        ):
            ui.scroll_to = selected[0]
    if ui.scroll_to is None:
        return
    if ui.scroll_to in groups:
        line = imgui.get_text_line_height() + 2 * imgui.get_style().cell_padding.y
        top = groups.index(ui.scroll_to) * line
        if (
            not imgui.get_scroll_y()
            <= top
            <= imgui.get_scroll_y() + imgui.get_window_height() * 0.8
        ):
            imgui.set_scroll_y(max(top - imgui.get_window_height() * 0.4, 0.0))
    ui.scroll_to = None


class _Row:
    """One line of the table."""

    def __init__(
        self,
        session: Session,
        document: Document,
        ui: UiState,
        table: ObjectTable,
        row: int,
        shown: Sequence[int],  # groups in the order of the list
    ) -> None:
        self.session, self.document, self.ui, self.shown = session, document, ui, shown
        self.group = int(table.ids[row])
        self.name = table.names[row]
        self.count, self.n_views = int(table.counts[row]), int(table.n_views[row])
        self.color = tuple(float(c) for c in table.colors[row])
        self.is_selected = bool(table.n_selected[row] > 0)
        self.is_hidden = bool(table.n_hidden[row] == table.counts[row])
        self.is_locked = bool(table.n_locked[row] == table.counts[row])

    def draw(self, is_narrow: bool) -> None:
        """The cells."""
        imgui.table_next_row()
        imgui.push_id(f"object {self.group}")
        imgui.table_set_column_index(0)
        self._select_area()
        imgui.same_line(0, 0)
        self._swatch()
        imgui.table_set_column_index(1)
        self._name()
        color = theme.FAINT if self.is_hidden else theme.DIM
        imgui.table_set_column_index(2)
        widgets.number(f"{self.count:,}", color)
        if not is_narrow:
            imgui.table_set_column_index(3)
            widgets.number(f"{self.n_views}" if self.n_views else "–", color)
        imgui.table_set_column_index(3 if is_narrow else 4)
        self._eye()
        imgui.same_line(0, 0)
        self._lock()
        imgui.pop_id()

    def _select_area(self) -> None:
        clicked, _ = imgui.selectable("##row", self.is_selected, _ROW_FLAGS)
        if imgui.is_item_hovered() and self.group:
            self.ui.hovered_row = self.group
        if clicked and self.ui.renaming != self.group:
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.left) and self.group:
                _start_renaming(self.ui, self.group, self.name)
            else:
                self._select()
        if imgui.begin_popup_context_item("Object menu"):
            self._menu()
            widgets.escape_closes()
            imgui.end_popup()

    def _select(self) -> None:
        io = imgui.get_io()
        anchor = self.ui.anchor
        if io.key_shift and anchor in self.shown:
            a, b = sorted((self.shown.index(anchor), self.shown.index(self.group)))
            self.document.select_groups(self.shown[a : b + 1], "set")
            return
        how = ("remove" if self.is_selected else "add") if io.key_ctrl else "set"
        self.document.select_groups((self.group,), how)  # type: ignore[arg-type]  # a How
        self.ui.anchor = self.group

    def _swatch(self) -> None:
        side = imgui.get_text_line_height()
        corner = imgui.get_cursor_screen_pos()
        centre = ImVec2(corner.x + side * 0.5, corner.y + side * 0.5)
        color = widgets.rgba(self.color, 0.35 if self.is_hidden else 1.0)
        drawing = imgui.get_window_draw_list()
        drawing.add_circle_filled(centre, side * 0.33, imgui.get_color_u32(color), 20)
        imgui.dummy(ImVec2(side, side))

    def _name(self) -> None:
        if self.ui.renaming == self.group:
            self._name_field()
            return
        is_plain = self.name == UNASSIGNED or self.is_hidden
        widgets.line(self.name, theme.FAINT if is_plain else theme.TEXT)

    def _name_field(self) -> None:
        ui = self.ui
        if not ui.rename_started:
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(-1)
        imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(em(0.2), 0))
        flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
        entered, ui.rename_text = imgui.input_text("##Name", ui.rename_text, flags)
        imgui.pop_style_var()
        if entered or (ui.rename_started and imgui.is_item_deactivated_after_edit()):
            self.session.rename(self.group, ui.rename_text.strip())
            ui.renaming = None
        elif ui.rename_started and imgui.is_item_deactivated():
            ui.renaming = None
        ui.rename_started = True

    def _eye(self) -> None:
        icon = icons.EYE_OFF if self.is_hidden else icons.EYE
        hint = "Show this object" if self.is_hidden else "Hide this object (Alt: show only this)"
        color = theme.TEXT if self.is_hidden else theme.FAINT
        if widgets.small_icon("Shown", icon, hint=hint, color=color):
            if imgui.get_io().key_alt:
                self.document.isolate_group(self.group)
            else:
                self.document.set_hidden(self.group, not self.is_hidden)

    def _lock(self) -> None:
        icon = icons.LOCK if self.is_locked else icons.UNLOCK
        hint = "Unlock: it can be selected again" if self.is_locked else "Lock: clicks pass it by"
        color = theme.TEXT if self.is_locked else theme.FAINT
        if widgets.small_icon("Locked", icon, hint=hint, color=color):
            self.document.set_locked(self.group, not self.is_locked)

    def _menu(self) -> None:
        if not self.is_selected:
            self.document.select_groups((self.group,), "set")
        if self.group and imgui.menu_item_simple(f"{icons.RENAME}  Rename###Rename", "F2"):
            _start_renaming(self.ui, self.group, self.name)
        actions.object_menu(self.session)


def rename_selected(session: Session, ui: UiState) -> None:
    """Turn the name of the object in the inspector into a text field (F2)."""
    if session.document is not None and session.focus:
        _start_renaming(ui, session.focus, session.document.name_of(session.focus))
        ui.scroll_to = session.focus


def _start_renaming(ui: UiState, group: int, name: str) -> None:
    ui.renaming, ui.rename_text, ui.rename_started = group, name, False


def _count(session: Session, table: ObjectTable) -> None:
    n_objects = int(np.count_nonzero(table.ids > 0))
    n_selected = len(session.selected_groups())
    text = f"{n_objects:,} object{'' if n_objects == 1 else 's'}"
    widgets.dim(f"{text}, {n_selected:,} selected" if n_selected else text)
