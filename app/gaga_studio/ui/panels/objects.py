"""The object list: find, filter and sort, folders, and a line for each object (`rows`)."""

from dataclasses import dataclass, field, replace

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.scene.objects import ObjectTable
from gaga_core.scene.scene import State
from gaga_studio.features import commands, folders, object_list, objects
from gaga_studio.features.find import association, memory_bank
from gaga_studio.features.object_list import Line, Lines, ObjectListView
from gaga_studio.session.document import Document
from gaga_studio.session.scene_cache import SortKey
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.object_menu import FOLDER_DRAG, OBJECT_DRAG
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.panels import rows as row_kinds
from gaga_studio.ui.panels import search
from gaga_studio.ui.panels.rows import FolderRow, ObjectRow, PartRow, Rows, RowState
from gaga_studio.ui.panels.search import SearchBoxState
from gaga_studio.ui.viewport.mask_evidence import MaskMenuState

_TABLE_FLAGS = (
    imgui.TableFlags_.sortable
    | imgui.TableFlags_.scroll_y
    | imgui.TableFlags_.row_bg
    | imgui.TableFlags_.no_saved_settings
    | imgui.TableFlags_.no_pad_outer_x
    | imgui.TableFlags_.sizing_fixed_fit
)

_NO_OBJECT = "Nothing in this scene belongs to an object."


@dataclass
class ObjectListState:
    """What the list remembers between frames."""

    rows: RowState = field(default_factory=RowState)
    search: SearchBoxState = field(default_factory=SearchBoxState)
    level: int | None = None  # of detail that is being dragged to
    sort: tuple[SortKey, bool] = ("id", False)  # and whether descending
    was_row_hovered: bool = False
    scroll_to: int | str | None = None  # group or folder to scroll to
    last_selected: tuple[int, ...] = ()
    background: tuple[int, ...] = (-1,)  # groups that were drawn there last; -1: not drawn yet
    pitch: tuple[float, float] = (0.0, 0.0)  # height of a row, and from one to the next as drawn


def draw(session: Session, state: ObjectListState, masks: MaskMenuState, area: PictureArea) -> None:
    """The whole panel; ``masks`` knows the mask that is dragged onto a row."""
    if session.document is None:
        title = session.nothing_open_text
        widgets.empty_state(icons.BOXES, title, "Objects will be listed here.")
        return
    table = session.objects()
    if not (table.ids > 0).any():
        if not commands.command("object.find").enabled(session):
            search.draw(session, state.search, area, session.document, table)
        _nothing_yet(session)
        return
    _detail_slider(session, state)
    state.rows.hovered = state.search.hovered = 0
    if not search.draw(session, state.search, area, session.document, table):
        _list(session, session.document, state, masks, table)
    _highlight(session, state)
    is_low = search.is_low() or state.search.is_short
    if not is_low or _is_dragging(session):
        _foot(session, table)


def _nothing_yet(session: Session) -> None:
    if session.live is not None:
        widgets.empty_state(icons.BOXES, "No objects yet", "They appear here as views are done.")
        return
    offer = association.stage_offer(session)
    is_empty = session.need().scene.has(State.DELETED).all()
    nothing = "All splats are deleted." if is_empty else _NO_OBJECT
    busy = session.jobs.why_busy or nothing
    reason = offer.reason if offer is not None else busy
    widgets.empty_state(icons.BOXES, "No objects yet", reason)
    if offer is not None and offer.command:
        room, padding = imgui.get_content_region_avail().x, 2 * imgui.get_style().frame_padding.x
        texts = (offer.label, offer.short_label, offer.action)
        wide = {text: imgui.calc_text_size(f"{icons.RUN}  {text}").x + padding for text in texts}
        shown = next((text for text in texts if wide[text] <= room), offer.action)
        width = min(max(wide[shown], em(14)), room)
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + (room - width) / 2)
        hint = "" if shown == offer.label else offer.label
        if widgets.button(offer.action, Face(shown, icons.RUN, width=width), hint=hint):
            commands.run(offer.command, session)


def _detail_slider(session: Session, state: ObjectListState) -> None:
    """Draw the slider where the groups of the scene have levels.

    It keeps its place while a job runs: the rows below do not move.
    """
    levels = object_list.levels_of(session)
    if levels is None:
        state.level = None
        return
    shown = levels.chosen if state.level is None else state.level
    why_not = session.jobs.why_busy if state.level is None else ""
    widgets.field_name("Detail", em(4))
    imgui.begin_disabled(bool(why_not))
    moved, level = imgui.slider_int(
        "##Detail", shown, 0, len(levels.labels) - 1, "", imgui.SliderFlags_.always_clamp
    )
    ended = imgui.is_item_deactivated()
    imgui.end_disabled()
    hint = "Left: groups of objects. Right: small pieces. Ctrl+Z takes a change back."
    widgets.tooltip(why_not or hint)
    if moved and level != state.level:
        state.level = level
        objects.preview_level(session, level)
    if ended and state.level is not None:
        chosen, state.level = state.level, None
        objects.choose_level(session, chosen)
        state.scroll_to = next(iter(session.selected_groups()), None)  # its row is elsewhere now


def _list(
    session: Session,
    document: Document,
    state: ObjectListState,
    masks: MaskMenuState,
    table: ObjectTable,
) -> None:
    measured = memory_bank.quality_column(session, table)
    _follow_selection(session, document, state)  # its folder opens before there are lines
    lines = object_list.lines(session, table, *state.sort, state.rows.renaming)
    if lines.background != state.background:  # rows went there: names are found after opening
        state.background = lines.background
        state.scroll_to = state.scroll_to or next(iter(session.selected_groups()), None)
    height = row_kinds.height(imgui.get_content_region_avail().y)
    parts = object_list.part_index(session)
    order = document.scene.folders
    has_arrows = parts is not None or bool(order.paths or order.parent)
    is_measured = bool((measured >= 0).any())
    columns = row_kinds.columns_for(is_measured, height, lines.depth, has_arrows)
    size = ImVec2(0, -_foot_height(session))
    imgui.push_style_var(imgui.StyleVar_.cell_padding, ImVec2(theme.scaled(3), theme.scaled(1)))
    is_open = imgui.begin_table("Table", columns.shown + 1, _TABLE_FLAGS, size)
    imgui.pop_style_var()
    if not is_open:
        return
    imgui.push_style_var(imgui.StyleVar_.cell_padding, row_kinds.cell_padding(height))
    row_kinds.set_up(columns, state.sort[0])
    state.sort = row_kinds.sorting()
    _scroll(state, lines, height)
    rows = Rows(session, document, state.rows, masks, table, measured, lines.shown, columns, parts)
    open_name = state.rows.renaming_folder or state.rows.renaming
    pitch = _draw_lines(rows, lines, None if open_name is None else _line_at(lines, open_name))
    state.pitch = height, pitch
    imgui.end_table()
    imgui.pop_style_var()


def _draw_lines(rows: Rows, lines: Lines, renamed: int | None) -> float:
    """Those that can be seen, and the line with an open text field: not drawn it loses the keys.
    Return the pixels from one to the next."""
    sums, chosen = folders.sums(rows.session), folders.chosen(rows.session)
    clipper = imgui.ListClipper()
    clipper.begin(len(lines.lines))
    if renamed is not None:
        clipper.include_item_by_index(renamed)
    while clipper.step():
        for at in range(clipper.display_start, clipper.display_end):
            line = lines.lines[at]
            if line.kind == "object":
                ObjectRow(rows, line).draw()
            elif line.kind == "folder":
                FolderRow(rows, line, sums[line.folder], line.folder in chosen).draw()
            elif line.part is not None:
                PartRow(rows, line, line.part).draw()
            else:
                _background_row(rows.session, len(lines.background), rows.columns.height)
    clipper.end()
    return clipper.items_height


def _background_row(session: Session, n: int, high: float) -> None:
    """The line that folds and unfolds walls, floors, tables and what else is no object."""
    folds = session.settings.folds_background
    imgui.table_next_row(0, high)
    imgui.table_set_column_index(0)
    flags = imgui.SelectableFlags_.span_all_columns
    with row_kinds.spaced_as_cells():
        is_clicked = imgui.selectable("##background", False, flags, ImVec2(0, high))[0]
    if is_clicked:
        session.change_settings(replace(session.settings, folds_background=not folds))
    widgets.tooltip(
        "Walls, floors, tables and other large flat objects; click to show or hide them"
    )
    icon = icons.FOLDED if folds else icons.UNFOLDED
    text = f"{icon}  Background and supports ({n:,})"
    row = row_kinds.last_row()
    text = widgets.elided(text, row.high.x - row.low.x - em(0.2))
    row.text(em(0.1), (high - em(1)) / 2, theme.u32(theme.DIM), text)


def _highlight(session: Session, state: ObjectListState) -> None:
    """The object whose row is under the mouse is outlined in the picture too."""
    hovered = state.rows.hovered or state.search.hovered
    if hovered:
        session.hovering.group = hovered
    elif state.was_row_hovered:
        session.hovering.away()
    state.was_row_hovered = bool(hovered)


def _follow_selection(session: Session, document: Document, state: ObjectListState) -> None:
    """Have an object scrolled to that was selected, but not by its row; its folder opens."""
    selected = session.selected_groups()
    if selected != state.last_selected:
        state.last_selected = selected
        if len(selected) == 1 and not state.rows.was_clicked:
            state.scroll_to = selected[0]
            document.feature(ObjectListView).reveal_group(document.scene.folders, selected[0])
    state.rows.was_clicked = False


def _scroll(state: ObjectListState, lines: Lines, height: float) -> None:
    """Scroll to what is asked for, unless it is in view; in the next frame where rows of this
    height were not drawn yet."""
    known, line = state.pitch
    if state.scroll_to is None or known != height or line <= 0:
        return
    at = _line_at(lines, state.scroll_to)
    if at is not None:
        header = imgui.get_text_line_height() + 2 * imgui.get_style().cell_padding.y  # stays on top
        top, room = at * line, imgui.get_window_height() - header
        if not imgui.get_scroll_y() <= top <= imgui.get_scroll_y() + room - line:
            imgui.set_scroll_y(max(top - (room - line) / 2, 0.0))
    state.scroll_to = None


def _line_at(lines: Lines, what: int | str) -> int | None:
    """The line of a group or of a folder."""
    if isinstance(what, int):
        return lines.groups.index(what) if what in lines.groups else None

    def is_it(line: Line) -> bool:
        return line.kind == "folder" and line.folder == what

    return next((i for i, line in enumerate(lines.lines) if is_it(line)), None)


def rename_selected(session: Session, state: ObjectListState) -> None:
    """Turn the name of the chosen folder, else of the object in the inspector, into a text field
    (F2)."""
    if session.document is None:
        return
    chosen = folders.chosen(session)
    if len(chosen) == 1:
        state.rows.rename_folder(chosen[0])
        state.scroll_to = chosen[0]
    elif session.focus:
        state.rows.rename(session.focus, session.document.name_of(session.focus))
        state.scroll_to = session.focus
        session.document.feature(ObjectListView).reveal_group(
            session.document.scene.folders, session.focus
        )


def _foot_height(session: Session) -> float:
    """Of what is under the list, pixels."""
    if search.is_low() and not _is_dragging(session):
        return 0.0
    line = imgui.get_text_line_height()
    if _is_dragging(session):
        line = imgui.get_frame_height()
    elif session.need().feature(ObjectListView).filter.is_on:
        line = em(1.25)
    return line + imgui.get_style().item_spacing.y + theme.scaled(2)


def _is_dragging(session: Session) -> bool:
    """Whether rows are dragged that can go out of a folder, or out from under an object."""
    dragged = imgui.get_drag_drop_payload_py_id()
    order = session.need().scene.folders
    can_leave = bool(order.paths or order.parent)
    return can_leave and dragged is not None and dragged.type in (OBJECT_DRAG, FOLDER_DRAG)


def _foot(session: Session, table: ObjectTable) -> None:
    """How many objects there are; while rows are dragged, the place that is in nothing."""
    if _is_dragging(session):
        label = "Drop here: in no folder, under nothing"
        widgets.button("Drop here: in no folder", Face(label, icons.FOLDER_OUT, width=-1))
        row_kinds.drop_target(session, "")
        return
    if search.foot(session, table):
        return
    n_objects = int(np.count_nonzero(table.ids > 0))
    n_selected = len(session.selected_groups())
    text = f"{n_objects:,} object{'' if n_objects == 1 else 's'}"
    widgets.dim(f"{text}, {n_selected:,} selected" if n_selected else text)
