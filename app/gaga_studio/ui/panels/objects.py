"""The object list: find, sort, and a line for each object (`object_row`)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.scene.objects import ObjectTable
from gaga_studio import commands
from gaga_studio.actions import quality
from gaga_studio.session.document import Document
from gaga_studio.session.requests import Request
from gaga_studio.session.scene_cache import SortKey
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.panels import detail, object_row, search
from gaga_studio.ui.panels.detail import DetailState
from gaga_studio.ui.panels.object_row import RowColumns, RowState
from gaga_studio.ui.panels.search import SearchBoxState
from gaga_studio.ui.viewport.mask_menu import MaskMenuState

_TABLE_FLAGS = (
    imgui.TableFlags_.sortable
    | imgui.TableFlags_.scroll_y
    | imgui.TableFlags_.row_bg
    | imgui.TableFlags_.no_saved_settings
    | imgui.TableFlags_.no_pad_outer_x
    | imgui.TableFlags_.sizing_fixed_fit
)
_NAME = 7.5  # least width of a name, ems: twelve letters, before any other column
# Widths of the other columns, ems: narrow and roomy.
_SHOWN, _SPLATS, _QUALITY, _VIEWS = (2.75, 4.1), (2.8, 3.5), (1.9, 3.3), 2.8
_KEYS: tuple[SortKey, ...] = get_args(SortKey)  # sort keys by column id


@dataclass
class ObjectListState:
    """What the list remembers between frames."""

    rows: RowState = field(default_factory=RowState)
    search: SearchBoxState = field(default_factory=SearchBoxState)
    detail: DetailState = field(default_factory=DetailState)
    was_row_hovered: bool = False
    scroll_to: int | None = None  # group to scroll to
    last_selected: tuple[int, ...] = ()


def register(table: RequestTable, state: Callable[[], ObjectListState]) -> None:
    """Answer the request to rename (F2)."""
    table.register(Request.RENAME, lambda session: _rename_selected(session, state()))


def draw(session: Session, state: ObjectListState, masks: MaskMenuState, area: PictureArea) -> None:
    """The whole panel; ``masks`` knows the mask that is dragged onto a row."""
    if session.document is None:
        widgets.empty_state(icons.BOXES, "No scene is open", "Its objects will be listed here.")
        return
    table = session.objects()
    if not (table.ids > 0).any():
        _nothing_yet(session)
        return
    detail.draw(session, state.detail)
    state.rows.hovered = state.search.hovered = 0
    if not search.draw(session, state.search, area, session.document, table):
        _list(session, session.document, state, masks, table)
    _highlight(session, state)
    _count(session, table)


def _nothing_yet(session: Session) -> None:
    if session.jobs.running is not None:
        widgets.empty_state(icons.BOXES, "No objects yet", "They appear here as views are done.")
        return
    offer = session.stage_offer()
    reason = offer.reason if offer is not None else "Nothing in this scene belongs to an object."
    widgets.empty_state(icons.BOXES, "No objects yet", reason)
    if offer is not None and offer.command:
        width = min(em(14), imgui.get_content_region_avail().x)
        room = imgui.get_content_region_avail().x - width
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room / 2)
        if widgets.button(offer.action, Face(offer.label, icons.RUN, width=width)):
            commands.run(offer.command, session)


def _list(
    session: Session,
    document: Document,
    state: ObjectListState,
    masks: MaskMenuState,
    table: ObjectTable,
) -> None:
    measured = quality.column(session, table)
    height = object_row.height(imgui.get_content_region_avail().y)
    columns = _columns_for(bool((measured >= 0).any()), height)
    size = ImVec2(0, -imgui.get_text_line_height_with_spacing() - theme.scaled(2))
    imgui.push_style_var(imgui.StyleVar_.cell_padding, ImVec2(theme.scaled(3), theme.scaled(1)))
    is_open = imgui.begin_table("Table", columns.shown + 1, _TABLE_FLAGS, size)
    imgui.pop_style_var()
    if not is_open:
        return
    _columns(columns)
    rows, n_behind = _ordered(session, document, table, measured)
    groups = [int(table.ids[row]) if row >= 0 else -1 for row in rows]
    _follow_selection(session, state, groups, height)
    shown = [group for group in groups if group >= 0]
    lines = object_row.Rows(session, document, state.rows, masks, table, measured, shown, columns)
    clipper = imgui.ListClipper()
    clipper.begin(len(rows))
    while clipper.step():
        for at in range(clipper.display_start, clipper.display_end):
            if rows[at] >= 0:
                lines.draw(rows[at])
            else:
                _background_row(session, n_behind, height)
    clipper.end()
    imgui.end_table()


def _ordered(
    session: Session, document: Document, table: ObjectTable, measured: DoubleArray
) -> tuple[list[int], int]:
    """Rows in the order of the list, -1 where the background begins, and how many that are.

    Objects come first, then the background unless it is folded, then what is in no group.
    """
    rows = document.read.listed(table, "", *_sorting(), measured).tolist()
    found = document.search.described
    behind = found.description.background if found is not None else frozenset()
    back = [row for row in rows if int(table.ids[row]) in behind]
    objects = [row for row in rows if table.ids[row] and int(table.ids[row]) not in behind]
    if not back or not objects:
        return rows, 0
    rest = [row for row in rows if table.ids[row] == 0]
    shown = [] if session.settings.folds_background else back
    return [*objects, -1, *shown, *rest], len(back)


def _background_row(session: Session, n: int, high: float) -> None:
    """The line that folds and unfolds walls, floors, tables and what else is no object."""
    folds = session.settings.folds_background
    imgui.table_next_row(0, high)
    imgui.table_set_column_index(0)
    flags = imgui.SelectableFlags_.span_all_columns
    if imgui.selectable("##background", False, flags, ImVec2(0, high))[0]:
        session.change_settings(replace(session.settings, folds_background=not folds))
    widgets.tooltip("Walls, floors, tables and other large flat things; click to show or hide them")
    low = imgui.get_item_rect_min()
    icon = icons.FOLDED if folds else icons.UNFOLDED
    at = ImVec2(low.x + em(0.4), low.y + (high - em(1)) / 2)
    drawing = imgui.get_window_draw_list()
    high_corner = imgui.get_item_rect_max()
    window = imgui.internal.get_current_window().inner_clip_rect
    top, bottom = max(low.y, window.min.y), min(high_corner.y, window.max.y)
    drawing.push_clip_rect(ImVec2(low.x, top), ImVec2(high_corner.x, bottom))  # over all columns
    drawing.add_text(at, theme.u32(theme.DIM), f"{icon}  Background and supports ({n:,})")
    drawing.pop_clip_rect()


def _columns_for(is_measured: bool, height: float) -> RowColumns:
    """What fits next to a name of `_NAME`: switches first, then quality, splats and views.

    Quality is there because somebody has asked for it.
    """
    room = imgui.get_content_region_avail().x / em(1) - _picture_width(height) / em(1) - _NAME
    is_roomy = room > _SHOWN[1] + _SPLATS[1] + is_measured * _QUALITY[1]
    shown, splats, quality = _SHOWN[is_roomy], _SPLATS[is_roomy], _QUALITY[is_roomy]
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
        height=height,
    )


def _picture_width(height: float) -> float:
    """Of the first column, with the dot of the color; pixels of this screen."""
    return height + em(1.15)


def _highlight(session: Session, state: ObjectListState) -> None:
    """The object whose row is under the mouse is outlined in the picture too."""
    hovered = state.rows.hovered or state.search.hovered
    if hovered:
        session.hovering.group = hovered
    elif state.was_row_hovered:
        session.hovering.away()
    state.was_row_hovered = bool(hovered)


def _columns(columns: RowColumns) -> None:
    """Headers; the id of each column is the place of its sort key."""
    fixed = imgui.TableColumnFlags_.width_fixed
    plain = fixed | imgui.TableColumnFlags_.no_sort | imgui.TableColumnFlags_.no_header_label
    falling = fixed | imgui.TableColumnFlags_.prefer_sort_descending
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column(
        "id", fixed | imgui.TableColumnFlags_.no_header_label, _picture_width(columns.height), 0
    )
    imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch, 1.0, 1)
    wide = columns.is_roomy
    if columns.splats >= 0:
        imgui.table_setup_column("Splats", falling, em(_SPLATS[wide] - 0.2), 2)
    if columns.views >= 0:
        imgui.table_setup_column("Views", falling, em(_VIEWS - 0.2), 3)
    if columns.quality >= 0:
        title = "Quality" if wide else f"{icons.QUALITY}###Quality"
        imgui.table_setup_column(title, fixed, em(_QUALITY[wide] - 0.2), 4)
    imgui.table_setup_column("Shown", plain, em(_SHOWN[wide]), 9)
    with theme.text_color(theme.DIM):
        imgui.table_headers_row()


def _sorting() -> tuple[SortKey, bool]:
    specs = imgui.table_get_sort_specs()
    if specs is None or specs.specs_count == 0:
        return "id", False
    spec = specs.get_specs(0)
    key = _KEYS[spec.column_user_id] if spec.column_user_id < len(_KEYS) else "id"
    return key, spec.get_sort_direction() == imgui.SortDirection.descending


def _follow_selection(
    session: Session, state: ObjectListState, groups: Sequence[int], height: float
) -> None:
    """Scroll to an object that was selected in the picture."""
    selected = session.selected_groups()
    if selected != state.last_selected:
        state.last_selected = selected
        if len(selected) == 1 and not imgui.is_window_hovered(
            imgui.HoveredFlags_.child_windows | imgui.HoveredFlags_.root_window
        ):
            state.scroll_to = selected[0]
    if state.scroll_to is None:
        return
    if state.scroll_to in groups:
        line = height + theme.scaled(2)
        top = groups.index(state.scroll_to) * line
        if (
            not imgui.get_scroll_y()
            <= top
            <= imgui.get_scroll_y() + imgui.get_window_height() * 0.8
        ):
            imgui.set_scroll_y(max(top - imgui.get_window_height() * 0.4, 0.0))
    state.scroll_to = None


def _rename_selected(session: Session, state: ObjectListState) -> None:
    """Turn the name of the object in the inspector into a text field (F2)."""
    if session.document is not None and session.focus:
        object_row.start_renaming(
            state.rows, session.focus, session.document.name_of(session.focus)
        )
        state.scroll_to = session.focus


def _count(session: Session, table: ObjectTable) -> None:
    n_objects = int(np.count_nonzero(table.ids > 0))
    n_selected = len(session.selected_groups())
    text = f"{n_objects:,} object{'' if n_objects == 1 else 's'}"
    widgets.dim(f"{text}, {n_selected:,} selected" if n_selected else text)
