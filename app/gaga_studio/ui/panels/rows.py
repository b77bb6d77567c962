"""The rows of the object list, of objects, folders and parts: their columns, names and switches."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import counted
from gaga_core.scene.folders import SEPARATOR, name_of
from gaga_core.scene.objects import UNASSIGNED, ObjectTable
from gaga_core.scene.scene import State
from gaga_studio.features import commands, folders, object_list, objects, selection
from gaga_studio.features.find import memory_bank
from gaga_studio.features.object_list import FolderSums, Line, ObjectListView, Part, PartIndex
from gaga_studio.session.document import Document
from gaga_studio.session.scene_cache import SortKey
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, object_menu, textures, theme, widgets
from gaga_studio.ui.kit.modal import begin_part
from gaga_studio.ui.kit.object_menu import FOLDER_DRAG, MASK_DRAG, OBJECT_DRAG, ObjectMenuState
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.viewport.mask_evidence import MaskMenuState

if TYPE_CHECKING:
    from gaga_core.scene.edits import How

_FLAGS = (
    imgui.SelectableFlags_.span_all_columns
    | imgui.SelectableFlags_.allow_overlap
    | imgui.SelectableFlags_.allow_double_click
)
_HALF_LIT = 0.4  # of the color of a row whose object is selected whole
_STEP, _DEEPEST = 0.8, 4  # of a folder in a folder, ems; deeper ones stand under each other


def indent(depth: int) -> float:
    """Where a row of this depth begins, pixels from the left edge of the list."""
    return min(depth, _DEEPEST) * em(_STEP)


@dataclass(frozen=True)
class RowColumns:
    """Where the columns are that not every width has; -1 = not there."""

    splats: int
    views: int
    quality: int
    shown: int
    is_roomy: bool  # whole numbers
    n_switches: int
    has_picture: bool
    height: float  # of a row, pixels of this screen
    first: float  # width of the first column, pixels
    arrow: float  # ... and in it of what opens and closes; 0 where nothing does

    def goes_to(self, column: int) -> bool:
        """Begin a column, its text in the middle of the row; whether it is there."""
        if column >= 0:
            imgui.table_set_column_index(column)
            lower(self.height)
        return column >= 0


@dataclass
class RowState:
    """What the lines remember: the mouse, the name that is typed, an open menu."""

    hovered: int = 0  # group whose row is under the mouse
    anchor: int | None = None  # group from which Shift selects a range
    renaming: int | None = None  # group whose name is a text field now
    renaming_folder: str | None = None  # folder whose name is one
    text: str = ""  # of that field
    shown: str = ""  # the name when the field was opened: entering it again names nothing
    has_keyboard: bool = False  # it took it; until then it asks
    is_active: bool = False  # it has it
    was_clicked: bool = False  # a row, by which the selection changed: it is in sight
    is_coloring: bool = False  # a group's color is being dragged
    splats: IntArray | None = None  # (K,) selection from before a menu was opened on a row
    menu: ObjectMenuState = field(default_factory=ObjectMenuState)

    def rename(self, group: int, name: str) -> None:
        """Turn the name of an object into a text field."""
        self.renaming, self.renaming_folder = group, None
        self._open(name)

    def rename_folder(self, folder: str) -> None:
        """Turn the name of a folder into a text field."""
        self.renaming, self.renaming_folder = None, folder
        self._open(name_of(folder))

    def _open(self, name: str) -> None:
        self.text = self.shown = name
        self.has_keyboard = self.is_active = False


@contextmanager
def spaced_as_cells() -> Iterator[None]:
    """What can be clicked covers its row: the toolkit makes it as much higher as items are apart,
    and the row as its cells have padding."""
    style = imgui.get_style()
    spacing = ImVec2(style.item_spacing.x, 2 * style.cell_padding.y)
    imgui.push_style_var(imgui.StyleVar_.item_spacing, spacing)
    yield
    imgui.pop_style_var()


def select_area(is_selected: bool, is_partly: bool, height: float) -> bool:
    """Draw what is clicked to select a row, under all its cells; whether it was clicked."""
    lit = imgui.get_style_color_vec4(imgui.Col_.header)
    if is_partly:
        lit = imgui.ImVec4(lit.x, lit.y, lit.z, lit.w * _HALF_LIT)
    imgui.push_style_color(imgui.Col_.header, lit)
    with widgets.lit_while_hovered(is_selected), spaced_as_cells():
        clicked, _ = imgui.selectable("##row", is_selected, _FLAGS, ImVec2(0, height))
    imgui.pop_style_color()
    return clicked


def name_field(state: RowState, name: str, height: float) -> tuple[bool, str] | None:
    """The text field of a name: whether one was entered, and which; None while it is open.

    As long as nobody has touched it, it follows ``name``: objects are described meanwhile.
    """
    if name != state.shown == state.text:
        held = imgui.internal.get_input_text_state(imgui.get_id("##Name"))
        if (
            held is None
            or abs(held.get_selection_end() - held.get_selection_start()) == held.text_len
        ):
            state.text = state.shown = name
            if held is not None:
                held.reload_user_buf_and_select_all()
    if not state.has_keyboard:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(em(0.2), (height - em(1)) / 2))
    flags = imgui.InputTextFlags_.enter_returns_true | imgui.InputTextFlags_.auto_select_all
    entered, state.text = imgui.input_text("##Name", theme.noted(state.text), flags)
    imgui.pop_style_var()
    # A field that was not drawn in some frame has lost the keys without being told.
    was_active, state.is_active = state.is_active, imgui.is_item_active()
    state.has_keyboard = state.has_keyboard or state.is_active
    imgui.internal.get_current_window().dc.prev_line_text_base_offset = 0  # the row's is without it
    is_left = entered or (was_active and not state.is_active)
    # Escape brings back what the field was opened with, which is no name that was typed.
    is_new = state.text != state.shown and not imgui.is_key_pressed(imgui.Key.escape)
    return (is_new, state.text.strip()) if is_left else None


def arrow(low: ImVec2, depth: int, columns: RowColumns, is_open: bool) -> bool:
    """What opens and closes a row of a depth with the corner ``low``; whether it was clicked."""
    left = indent(depth)
    imgui.set_cursor_screen_pos(ImVec2(low.x + left, low.y))
    clicked = imgui.invisible_button("Fold", ImVec2(columns.arrow, columns.height))
    icon = icons.UNFOLDED if is_open else icons.FOLDED
    at = ImVec2(low.x + left + em(0.1), low.y + (columns.height - em(1)) / 2)
    color = theme.TEXT if imgui.is_item_hovered() else theme.DIM
    imgui.get_window_draw_list().add_text(at, theme.u32(color), icon)
    return clicked


@dataclass(frozen=True)
class Across:
    """Text over several columns of a row whose corners are ``low`` and ``high``."""

    low: ImVec2
    high: ImVec2

    def text(self, left: float, top: float, color: int, text: str) -> None:
        """Draw ``text``, pixels from the upper left corner."""
        window = imgui.internal.get_current_window().clip_rect  # of a cell: below the header
        edge = max(self.low.y, window.min.y), min(self.high.y, window.max.y)
        drawing = imgui.get_window_draw_list()
        drawing.push_clip_rect(ImVec2(self.low.x, edge[0]), ImVec2(self.high.x, edge[1]))
        drawing.add_text(ImVec2(self.low.x + left, self.low.y + top), color, text)
        drawing.pop_clip_rect()


def last_row() -> Across:
    """The row whose `select_area` was drawn last."""
    return Across(imgui.get_item_rect_min(), imgui.get_item_rect_max())


def lower(height: float, n_lines: int = 1) -> None:
    """Put text into the middle of the row."""
    room = height - n_lines * imgui.get_text_line_height()
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + room / 2)


def compact(n: int) -> str:
    """A number in at most four letters: "604", "4.5k", "12k", "3.1M"."""
    for unit, sign in ((1_000_000, "M"), (1_000, "k")):
        if n >= 0.9995 * unit:  # 999.5k is 1.0M
            return f"{n / unit:.1f}{sign}" if n < 9.95 * unit else f"{n / unit:.0f}{sign}"
    return f"{n}"


# --- The eye, the lock and the circle at the end of a row of the object list.

Switched = Literal["", "hide", "lock", "alone"]


@dataclass(frozen=True)
class Switches:
    """State of the switches of a row."""

    what: str  # that the row shows: "object", "folder"
    is_hidden: bool
    is_locked: bool
    is_alone: bool  # nothing else is shown

    def draw(self, columns: RowColumns) -> Switched:
        """Draw the switches of a row; which one was clicked. Alt and the eye are the circle."""
        high = min(em(1.25), columns.height)  # of an icon: none makes its row higher
        imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + (columns.height - high) / 2)
        clicked: Switched = ""
        what, is_off, is_locked = self.what, self.is_hidden, self.is_locked
        eye = f"Show this {what}" if is_off else f"Hide this {what} (Alt: show only this)"
        lock = "Unlock: it can be selected again" if is_locked else "Lock: clicks pass it by"
        only = "Show everything again" if self.is_alone else f"Show only this {what}"
        all_of: tuple[tuple[Switched, str, str, bool, str], ...] = (
            ("hide", "Shown", icons.EYE_OFF if is_off else icons.EYE, is_off, eye),
            ("lock", "Locked", icons.LOCK if is_locked else icons.UNLOCK, is_locked, lock),
            ("alone", "Alone", icons.ISOLATE, self.is_alone, only),
        )
        for at, (switch, name, icon, is_on, hint) in enumerate(all_of[: columns.n_switches]):
            if at:
                imgui.same_line(0, 0)
            color = theme.TEXT if is_on else theme.FAINT
            if widgets.small_icon(name, icon, hint=hint, color=color, height=high):
                clicked = "alone" if at == 0 and imgui.get_io().key_alt else switch
        return clicked


# --- The submenu "Put into a folder" of the selected objects.

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
        if begin_part("Folders", ImVec2(em(15), high)):
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


# --- The columns of the object list: which ones a width has room for, and by which it is sorted.

_NAME = 7.5  # least width of a name in no folder, ems: twelve letters, before any other column
# Widths of the other columns, ems: narrow and roomy; of the switches by their number.
_SHOWN, _SPLATS, _QUALITY, _VIEWS = (0.0, 1.4, 2.75, 4.1), (2.8, 3.5), (1.9, 3.3), 2.8
_SORTED = 0.9  # room of the arrow in the header of the sorted column, ems
_ARROW = 1.0  # what opens folders and parts, ems
_KEYS: tuple[SortKey, ...] = get_args(SortKey)  # sort keys by column id


def columns_for(is_measured: bool, height: float, depth: int, has_arrows: bool) -> RowColumns:
    """What fits next to a name of `_NAME`: the eye, lock, picture, quality, splats and views.

    Quality is there once it was measured. ``height`` of a row, pixels; ``depth`` of the deepest
    row: names are shorter in folders, and no column goes for them.
    """
    arrow, color = em(_ARROW) if has_arrows else 0.0, em(1.15)
    first = color + arrow + indent(depth)
    room = (imgui.get_content_region_avail().x - color) / em(1) - _NAME
    has_picture = room > _SHOWN[2] + height / em(1)
    if has_picture:
        first, room = first + height, room - height / em(1)
    is_roomy = room > _SHOWN[3] + _SPLATS[1] + is_measured * _QUALITY[1]
    n_switches = 3 if is_roomy else 1 + (room > _SHOWN[2])
    shown, splats, quality = _SHOWN[n_switches], _SPLATS[is_roomy], _QUALITY[is_roomy]
    has_quality = is_measured and room > shown + quality
    has_splats = room > shown + has_quality * quality + splats
    has_views = room > shown + splats + is_measured * quality + _VIEWS
    last = 2 + has_splats + has_views
    return RowColumns(
        splats=2 if has_splats else -1,
        views=3 if has_views else -1,
        quality=last if has_quality else -1,
        shown=last + has_quality,
        is_roomy=is_roomy,
        n_switches=n_switches,
        has_picture=has_picture,
        height=height,
        first=first,
        arrow=arrow,
    )


def set_up(columns: RowColumns, sorted_by: SortKey = "id") -> None:
    """Headers; the id of each column is the place of its sort key. The sorted one has an arrow."""
    arrow = dict.fromkeys(_KEYS, 0.0) | {sorted_by: _SORTED}
    fixed = imgui.TableColumnFlags_.width_fixed
    plain = fixed | imgui.TableColumnFlags_.no_sort | imgui.TableColumnFlags_.no_header_label
    falling = fixed | imgui.TableColumnFlags_.prefer_sort_descending
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column(
        "id", fixed | imgui.TableColumnFlags_.no_header_label, columns.first, 0
    )
    imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch, 1.0, 1)
    wide = columns.is_roomy
    if columns.splats >= 0:
        imgui.table_setup_column("Splats", falling, em(_SPLATS[wide] - 0.2 + arrow["splats"]), 2)
    if columns.views >= 0:
        imgui.table_setup_column("Views", falling, em(_VIEWS - 0.2 + arrow["views"]), 3)
    if columns.quality >= 0:
        title = "Quality" if wide else f"{icons.QUALITY}###Quality"
        imgui.table_setup_column(title, fixed, em(_QUALITY[wide] - 0.2 + arrow["quality"]), 4)
    imgui.table_setup_column("Shown", plain, em(_SHOWN[columns.n_switches]), 9)
    with theme.text_color(theme.DIM):
        imgui.table_headers_row()


def sorting() -> tuple[SortKey, bool]:
    """By what the open table is sorted, and whether descending."""
    specs = imgui.table_get_sort_specs()
    if specs is None or specs.specs_count == 0:
        return "id", False
    spec = specs.get_specs(0)
    key = _KEYS[spec.column_user_id] if spec.column_user_id < len(_KEYS) else "id"
    return key, spec.get_sort_direction() == imgui.SortDirection.descending


def switches_width(columns: RowColumns) -> float:
    """Of the column of the switches, pixels."""
    return em(_SHOWN[columns.n_switches])


# --- One line of the object list: color, picture, name, numbers, switches.

# Heights of a row, with a picture of 48, in a low list, and in one of few rows; pixels at 96 dpi.
_HIGH, _LOW, _LEAST = 50.0, 25.0, 17.0
_FEW = 4  # low rows; a list that has no room for them has lower ones
_ENOUGH = 5  # high rows that a list must have room for
_GOOD, _FAIR = 0.75, 0.5  # agreements


def height(room: float) -> float:
    """Of a row in a list ``room`` pixels high, in pixels of this screen."""
    if room > _ENOUGH * theme.scaled(_HIGH):
        return theme.scaled(_HIGH)
    low = theme.scaled(_LOW)
    needed = (_FEW + 1) * (low + 2 * imgui.get_style().cell_padding.y)  # with the header
    return low if room > needed else theme.scaled(_LEAST)


def cell_padding(height: float) -> ImVec2:
    """Of the cells of rows so high: least of all where they are many in little room."""
    least = ImVec2(theme.scaled(3), 0)
    return least if height <= theme.scaled(_LEAST) else imgui.get_style().cell_padding


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


class ObjectRow:
    """What is drawn of an object."""

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
        if columns.has_picture:
            imgui.same_line(0, em(0.15))
            self._picture()
        imgui.table_set_column_index(1)
        self._name()
        color = theme.FAINT if self.is_hidden else theme.DIM
        if columns.goes_to(columns.splats):
            count = int(table.counts[self.row])
            widgets.number(f"{count:,}" if columns.is_roomy else compact(count), color)
        if columns.goes_to(columns.views):
            n_views = int(table.n_views[self.row])
            widgets.number(f"{n_views}" if n_views else "–", color)
        if columns.goes_to(columns.quality):
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
                if self.line.has_children:
                    selection.select_groups(self.session, (self.group,))
                    folders.select_with_children(self.session)
                else:
                    self.state.rename(self.group, self.name)
            else:
                self._select()
        self._dragging()
        widgets.popup("Object menu", self._menu, of_item=True)

    def _begin(self) -> None:
        """What opens what is under the object, or its parts; then the row begins."""
        row, parts, columns = last_row(), self.rows.parts, self.rows.columns
        if self.line.has_children:
            if arrow(row.low, self.line.depth, columns, self.line.is_open):
                self.document.feature(ObjectListView).toggle_group(self.group, self.line.is_open)
            widgets.tooltip("Objects under it. Double-click the row to select them with it")
        elif columns.arrow and parts is not None and self.group and parts.parts(self.group):
            listing, key = self.document.feature(ObjectListView), (self.group,)
            if arrow(row.low, self.line.depth, columns, key in listing.open_parts):
                listing.toggle_parts(key)
            widgets.tooltip("Its parts, by the levels of detail of its masks")
        left = indent(self.line.depth) + columns.arrow
        imgui.set_cursor_screen_pos(ImVec2(row.low.x + left, row.low.y))

    def _select(self) -> None:
        self.state.was_clicked = True
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
            what = self.name if n <= 1 else counted(n, "object")
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
            text = (
                f"{icons.JOINED}  Assign the selection to {theme.visual(self.name)}###Assign here"
            )
            if imgui.menu_item_simple(text):
                objects.assign(self.session, self.group, state.splats)
            widgets.tooltip(f"The {len(state.splats):,} splats that were selected before")
            imgui.separator()
        if self.group:
            put_into(self.session)
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

    # --- content

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
        widgets.popup("List color", self._picker, of_button=True)

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
        textures.draw(
            self.session,
            self.rows.table,
            self.row,
            ImVec2(corner.x + gap, corner.y + gap),
            side - 2 * gap,
            0.4 if self.is_hidden else 1.0,
        )
        textures.tooltip(self.session, self.rows.table, self.row)

    def _name(self) -> None:
        if self.state.renaming == self.group:
            typed = name_field(self.state, self.name, self.height)
            self.state.renaming = self.group if typed is None else None
            if typed is not None and typed[0]:
                objects.rename(self.session, self.group, typed[1])
            return
        is_plain = self.name == UNASSIGNED or self.is_hidden
        color = theme.FAINT if is_plain else theme.TEXT
        room, line = imgui.get_content_region_avail().x, imgui.get_text_line_height()
        is_low = self.height < 2 * line
        lines = [widgets.elided(self.name, room)]
        if self.is_partly_selected:
            n, of = self.rows.table.n_selected[self.row], self.rows.table.counts[self.row]
            count, share = f"{n:,} of {of:,}", f"{max(100 * n // of, 1)} %"
            lines.append(count if imgui.calc_text_size(count).x <= room and not is_low else share)
        elif lines[0] != self.name and not is_low:
            lines = widgets.few_lines(self.name, room)
        right = room - imgui.calc_text_size(lines[-1]).x  # of a low row: the share next to the name
        if self.is_partly_selected and is_low:
            lines[0] = widgets.elided(self.name, right - em(0.4))
        lower(self.height, 1 if is_low else len(lines))
        top = imgui.get_cursor_pos()
        for i, text in enumerate(lines):
            place = ImVec2(right * i, 0) if is_low else ImVec2(0, i * line)
            imgui.set_cursor_pos(ImVec2(top.x + place.x, top.y + place.y))
            is_count = self.is_partly_selected and i == 1
            widgets.text(text, theme.ACCENT if is_count else color)
        is_cut = lines[0] != self.name if self.is_partly_selected else " ".join(lines) != self.name
        if is_cut:
            widgets.tooltip(self.name, of_row=True)

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
        clicked = now.draw(self.rows.columns)
        if clicked == "hide":
            objects.set_hidden(self.session, self.group, not self.is_hidden)
        elif clicked == "lock":
            objects.set_locked(self.session, self.group, not self.is_locked)
        elif clicked:
            objects.isolate_item(self.session, self.group)


# --- A folder of the object list: what is in it, its switches, what is dropped on it.


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
        if self.state.renaming_folder != self.path:
            self._text(row)
        elif (typed := name_field(self.state, name_of(self.path), self.columns.height)) is not None:
            self.state.renaming_folder = None
            if typed[0]:
                folders.rename(self.session, self.path, typed[1])
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
        widgets.tooltip(self.path if self.depth else "", of_row=True)
        self._dragging()
        widgets.popup("Folder menu", self._menu, of_item=True)

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
        folder = ("object.folder", "object.folder_out", "object.folder_delete", "")
        command_buttons.command_items(self.session, (*folder, *command_buttons.FOLDER_MENU))

    def _text(self, row: Across) -> None:
        """The sign, the name, and what is in it, over the columns up to the switches."""
        columns, sums, n = self.columns, self.sums, self.sums.n_objects
        is_off = sums.n_splats > 0 and sums.n_hidden == sums.n_splats
        left = indent(self.depth) + columns.arrow
        begin = left + em(1.45)
        room = row.high.x - row.low.x - switches_width(columns) - begin - em(0.3)
        line = imgui.get_text_line_height()
        is_high = columns.height >= 2.2 * line
        top = (columns.height - (2 if is_high else 1) * line) / 2
        name = widgets.elided(name_of(self.path), room)
        sign = icons.FOLDER if self.is_open else icons.FOLDER_PLAIN
        row.text(left, top, theme.u32(theme.DIM), sign)
        row.text(begin, top, theme.u32(theme.FAINT if is_off else theme.TEXT), name)
        if is_high:
            inside = f"{counted(n, 'object')}, {compact(sums.n_splats)} splats"
            inside = widgets.elided(inside if n else "empty", room)
            row.text(begin, top + line, theme.u32(theme.DIM), inside)
            return
        width = imgui.calc_text_size(name).x + em(0.6)
        if width + imgui.calc_text_size(f"{n:,}").x <= room:
            row.text(begin + width, top, theme.u32(theme.FAINT), f"{n:,}")

    def _switches(self) -> None:
        sums = self.sums
        is_full = sums.n_splats > 0
        now = Switches(
            "folder",
            is_full and sums.n_hidden == sums.n_splats,
            is_full and sums.n_locked == sums.n_splats,
            folders.is_alone(self.table, sums),
        )
        clicked = now.draw(self.columns)
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


# --- A part of an object in the list: a click selects its splats, and it can become an object.


@dataclass(frozen=True, eq=False)
class PartRow:
    """What is drawn of a part."""

    rows: "Rows"
    line: Line
    part: Part

    def draw(self) -> None:
        """Draw the cells of the row."""
        columns, part = self.rows.columns, self.part
        imgui.table_next_row(0, columns.height)
        imgui.push_id("part " + " ".join(map(str, part.key)))
        imgui.table_set_column_index(0)
        n_selected = self._n_selected()
        if select_area(n_selected > 0, 0 < n_selected < len(part.rows), columns.height):
            self._select("add" if imgui.get_io().key_ctrl or imgui.get_io().key_shift else "set")
        widgets.popup("Part menu", self._menu, of_item=True)
        self._begin()
        imgui.table_set_column_index(1)
        is_high = columns.splats < 0 and columns.height >= 2.2 * imgui.get_text_line_height()
        lower(columns.height, 1 + is_high)
        left = imgui.get_cursor_pos_x()
        widgets.dim(part.name)
        if is_high:
            top = imgui.get_item_rect_max().y
            imgui.set_cursor_pos_x(left)
            imgui.set_cursor_screen_pos(imgui.ImVec2(imgui.get_cursor_screen_pos().x, top))
            widgets.text(counted(len(part.rows), "splat"), theme.FAINT)
        if columns.goes_to(columns.splats):
            n = len(part.rows)
            widgets.number(f"{n:,}" if columns.is_roomy else compact(n), theme.DIM)
        imgui.pop_id()

    def _begin(self) -> None:
        """What opens the parts of the part, and its sign in the color of the object."""
        row, columns, depth = last_row(), self.rows.columns, self.line.depth
        parts, listing = self.rows.parts, self.rows.document.feature(ObjectListView)
        if parts is not None and parts.parts(self.part):
            if arrow(row.low, depth, columns, self.part.key in listing.open_parts):
                listing.toggle_parts(self.part.key)
            widgets.tooltip("Its parts")
        color = imgui.get_color_u32(widgets.rgba(self.rows.table.colors[self.line.row]))
        left = indent(depth) + columns.arrow + em(0.15)
        row.text(left, (columns.height - em(1)) / 2, color, icons.PART)

    def _n_selected(self) -> int:
        scene = self.rows.document.scene
        key = (self.part, scene.revision.state)

        def count() -> int:
            return int(np.count_nonzero(scene.state[self.part.rows] & np.uint8(State.SELECTED)))

        return self.rows.document.read.once(f"selected of {self.part.key}", key, count)

    def _select(self, how: "How") -> None:
        name = self.rows.table.names[self.line.row]
        object_list.select_part(self.rows.session, self.part, name, how)

    def _menu(self) -> None:
        session = self.rows.session
        if imgui.is_window_appearing():
            self._select("set")
        if len(self.part.key) == 2:  # of an object, not of a part
            if imgui.menu_item_simple(f"{icons.SPLIT}  Split here###Split here"):
                commands.run("object.split_here", session)
            widgets.tooltip("Make objects of all parts of this object")
        if imgui.menu_item_simple(f"{icons.SEPARATE}  Make an object of it###Make an object"):
            commands.run("object.separate", session)
