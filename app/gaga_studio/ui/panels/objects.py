"""The object list: find, sort, and a line for each object (`object_row`)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.scene.objects import ObjectTable
from gaga_studio.actions import quality
from gaga_studio.session.document import Document
from gaga_studio.session.requests import Request
from gaga_studio.session.scene_cache import SortKey
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.kit.theme import em
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
# Widths of the panel, in lines of text, from which on there is room for more.
_ROOM_FOR_VIEWS, _ROOM_FOR_SOLO, _ROOM_FOR_ALL = 18.0, 20.0, 23.0
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


def _list(
    session: Session,
    document: Document,
    state: ObjectListState,
    masks: MaskMenuState,
    table: ObjectTable,
) -> None:
    measured = quality.column(session, table)
    columns = _columns_for(bool((measured >= 0).any()))
    size = ImVec2(0, -imgui.get_text_line_height_with_spacing() - theme.scaled(2))
    imgui.push_style_var(imgui.StyleVar_.cell_padding, ImVec2(theme.scaled(3), theme.scaled(1)))
    is_open = imgui.begin_table("Table", columns.shown + 1, _TABLE_FLAGS, size)
    imgui.pop_style_var()
    if not is_open:
        return
    _columns(columns)
    rows = document.read.listed(table, "", *_sorting(), measured)
    groups = [int(group) for group in table.ids[rows]]
    _follow_selection(session, state, groups)
    lines = object_row.Rows(session, document, state.rows, masks, table, measured, groups, columns)
    clipper = imgui.ListClipper()
    clipper.begin(len(rows))
    while clipper.step():
        for at in range(clipper.display_start, clipper.display_end):
            lines.draw(int(rows[at]))
    clipper.end()
    imgui.end_table()


def _columns_for(is_measured: bool) -> RowColumns:
    """What fits: views make room for the quality when it is known."""
    room = imgui.get_content_region_avail().x / em(1)
    has_views = room > (_ROOM_FOR_ALL if is_measured else _ROOM_FOR_VIEWS)
    last = 3 + has_views
    return RowColumns(
        views=3 if has_views else -1,
        quality=last if is_measured else -1,
        shown=last + is_measured,
        is_roomy=room > _ROOM_FOR_SOLO,
    )


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
    pictures = object_row.height() + em(1.15)
    imgui.table_setup_scroll_freeze(0, 1)
    imgui.table_setup_column("id", fixed | imgui.TableColumnFlags_.no_header_label, pictures, 0)
    imgui.table_setup_column("Name", imgui.TableColumnFlags_.width_stretch, 1.0, 1)
    imgui.table_setup_column("Splats", falling, em(3.3 if columns.is_roomy else 2.6), 2)
    if columns.views >= 0:
        imgui.table_setup_column("Views", falling, em(2.6), 3)
    if columns.quality >= 0:
        title = "Quality" if columns.is_roomy else f"{icons.QUALITY}###Quality"
        imgui.table_setup_column(title, fixed, em(3.1 if columns.is_roomy else 1.7), 4)
    imgui.table_setup_column("Shown", plain, em(4.1 if columns.is_roomy else 2.75), 9)
    with theme.text_color(theme.DIM):
        imgui.table_headers_row()


def _sorting() -> tuple[SortKey, bool]:
    specs = imgui.table_get_sort_specs()
    if specs is None or specs.specs_count == 0:
        return "id", False
    spec = specs.get_specs(0)
    key = _KEYS[spec.column_user_id] if spec.column_user_id < len(_KEYS) else "id"
    return key, spec.get_sort_direction() == imgui.SortDirection.descending


def _follow_selection(session: Session, state: ObjectListState, groups: Sequence[int]) -> None:
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
        line = object_row.height() + theme.scaled(2)
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
