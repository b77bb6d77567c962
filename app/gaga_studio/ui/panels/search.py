"""The search box of the object list, what was understood, the objects meant, and the filter."""

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.errors import counted
from gaga_core.scene.objects import ObjectTable
from gaga_studio.features import commands, object_list, selection
from gaga_studio.features.find import search as search_actions
from gaga_studio.features.find.search import SearchHit, SearchState
from gaga_studio.features.measure import unit as length_unit
from gaga_studio.features.object_list import ListFilter, Measure, ObjectListView, Range
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.number_fields import drag_range
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

# --- The filter of the object list: ranges of size, splats, confidence and quality.

_POPUP = "Filter of the list"
_ROWS: tuple[tuple[Measure, str, str], ...] = (
    ("size", "Size", "Diameter, scene units"),
    ("splats", "Splats", "Number of splats"),
    ("confidence", "Confidence", "How sure the vote of the masks was, on average"),
    ("quality", "Quality", "Agreement of its picture with its masks"),
)
_UNKNOWN = {
    "confidence": "The confidence of the groups is not known. Use Find objects.",
    "quality": "Nothing is measured. Use Find, Measure the quality of the objects.",
}


def button(session: Session) -> None:
    """The button next to the search box, and what it opens."""
    is_on = session.need().feature(ObjectListView).filter.is_on
    hint = "List only objects of some size, confidence or quality"
    if widgets.icon_button("Filter", icons.FILTER, hint=hint, on=is_on):
        imgui.open_popup(_POPUP)
    widgets.popup(_POPUP, lambda: _ranges(session), of_button=True)


def foot(session: Session, table: ObjectTable) -> bool:
    """How many objects the filter lists, of what is looked for, and its end; False while off."""
    listing = session.need().feature(ObjectListView)
    kept = object_list.kept_rows(session, table)
    if kept is None:
        return False
    n_kept, n = int(np.count_nonzero(kept)), int(np.count_nonzero(table.ids > 0))
    text, search = f"{n_kept:,} of {counted(n, 'object')}", session.need().feature(SearchState)
    if search.text.strip():
        n_kept = len(search.meant)
        text = f"{n_kept:,} of {n_kept + search.n_left_out:,} that fit"
    widgets.text(text, theme.ACCENT if n_kept else theme.WARN)
    imgui.same_line()
    if widgets.small_icon("Clear filter", icons.CLOSE, hint="List all objects again"):
        listing.filter = ListFilter()
    return True


def _ranges(session: Session) -> None:
    """A range for each measure; what nothing is known of says why."""
    table = session.objects()
    measures = object_list.measures(session, table)
    widgets.heading("List only objects with")
    for measure, name, hint in _ROWS:
        _range(session, table, (measure, name, hint), measures[measure])
    imgui.dummy(imgui.ImVec2(0, em(0.2)))
    listing = session.need().feature(ObjectListView)
    why_not = "" if listing.filter.is_on else "Nothing is left out."
    if widgets.button("Clear", why_not=why_not):
        listing.filter = ListFilter()
    imgui.same_line()
    command_buttons.command_button(session, "object.list_unsure", "Unsure only", Face())
    imgui.same_line()
    kept = int(np.count_nonzero(listing.filter.keeps(table, measures)))
    widgets.dim(f"{kept:,} of {counted(int((table.ids > 0).sum()), 'object')}")


def _range(
    session: Session, table: ObjectTable, row: tuple[Measure, str, str], values: DoubleArray
) -> None:
    measure, name, hint = row
    listing = session.need().feature(ObjectListView)
    whole = object_list.whole_range(table, measure, values)
    why_not = _UNKNOWN.get(measure, "") if whole is None else ""
    imgui.align_text_to_frame_padding()
    widgets.dim(name)
    imgui.same_line(em(6.5))
    imgui.set_next_item_width(em(13))
    imgui.begin_disabled(bool(why_not))
    low, high = whole or (0.0, 1.0)
    now = listing.filter.ranges.get(measure, (low, high))
    unit = length_unit(session) if measure == "size" else ""
    wanted = _drag(measure, now, (low, high), unit)
    imgui.end_disabled()
    widgets.tooltip(why_not or f"{hint}: drag, or double click and type")
    if wanted is not None and not why_not:
        listing.filter = listing.filter.within(measure, wanted, (low, high))


def _drag(measure: Measure, now: Range, whole: Range, unit: str) -> Range | None:
    """Two numbers that are dragged; None while they stay."""
    is_share, is_count = measure in ("confidence", "quality"), measure == "splats"
    scale, form = (100.0, "%.0f %%") if is_share else (1.0, "%.0f" if is_count else f"%.3g{unit}")
    low, high, first, last = (scale * value for value in (*whole, *now))
    speed = max((high - low) / 200, 0.2 if is_count else 1e-6)
    is_new, (first, last) = drag_range(f"##{measure}", (first, last), speed, (low, high), form)
    if is_count:
        first, last = round(first), round(last)
    return (first / scale, last / scale) if is_new else None


_HINTS = "Search objects", "Search"
_MENU = "More ways to find"
_LOW = 11.0  # em: a lower panel has no line under the list
_LEAST_HITS = 3  # in sight, or what is said about them is cut to one line
_LEAST_WORDS = 4.0  # em: in less room, next to a button, a sentence cannot be read
_HIGH, _SHORT = 48.0, 34.0  # pixels at 96 dpi: height of a hit, and where there is little room
_ONE_LINE, _WITH_BAR = 1.0, 1.97  # em: the least height of a hit, and of one with its bar
_ASKING = ("object.find_in_view", "object.index", "object.name_all")
_WAYS_OUT = _ASKING[:2]
_LOOKING, _LOOKING_UP = "Looking at the objects…", "Looking the words up in the index…"
_KEYS = (
    "Up and Down choose, Enter selects, Shift+Enter selects all that fit, "
    "Escape clears, and leaves where there is no text"
)


@dataclass
class SearchBoxState:
    """The keyboard's way into the box, and where the answer was scrolled to."""

    wants_keyboard: bool = False
    seen: int = 0  # line of the answer that was last scrolled to
    hovered: int = 0  # group whose line is under the mouse
    is_short: bool = False  # the answer has little room: hits come before what is said about them


def focus(state: SearchBoxState) -> None:
    """Bring the keyboard to the box (Ctrl+F)."""
    state.wants_keyboard = True  # at the next frame


def is_low() -> bool:
    """Whether the panel has room for a few lines: they are the list's."""
    return imgui.get_window_height() < em(_LOW)


def draw(
    session: Session,
    state: SearchBoxState,
    area: PictureArea,
    document: Document,
    table: ObjectTable,
) -> bool:
    """The box, and under it the answer; False while nothing is looked for, or there is nothing."""
    search = document.feature(SearchState)
    state.is_short = False
    _box(session, state, area.size, search)
    imgui.same_line(0, em(0.2))
    button(session)
    if not (table.ids > 0).any():
        return False
    search_actions.answer(session, object_list.kept_groups)
    if not search.text.strip():
        return False
    state.is_short = bool(search.hits) and _leaves_few(session, search)
    if state.is_short:
        _in_one_line(session, search)
    else:
        _understood(session, search)
    _hits(session, state, table, search)
    return True


# --- the box


def _box(
    session: Session, state: SearchBoxState, size: tuple[int, int], search: SearchState
) -> None:
    side = imgui.get_frame_height() * 1.12 + em(0.2)
    room = side * (3 if search.text else 2)
    if state.wants_keyboard:
        imgui.set_keyboard_focus_here()
        state.wants_keyboard = False
    imgui.set_next_item_width(-room)
    hint = widgets.hint_of_field(*(f"{icons.SEARCH}  {text}" for text in _HINTS))
    flags = imgui.InputTextFlags_.escape_clears_all | imgui.InputTextFlags_.auto_select_all
    changed, text = imgui.input_text_with_hint("##Find", hint, theme.noted(search.text), flags)
    is_active, has_ended = imgui.is_item_active(), imgui.is_item_deactivated()
    if not is_active:
        widgets.tooltip(
            f"By name, color, size or place: {search_actions.EXAMPLES}. {_KEYS}", "Ctrl+F"
        )
    if changed:
        search_actions.type_text(session, text, size)
    if is_active or has_ended:
        _keys(session, state, search, has_ended)
    if search.text:
        imgui.same_line(0, em(0.2))
        if widgets.icon_button("Clear search", icons.CLOSE):
            search.clear()
    imgui.same_line(0, em(0.2))
    if widgets.icon_button(_MENU, icons.MORE, hint="An index of pictures, a detector, names"):
        imgui.open_popup(_MENU)
    widgets.popup(_MENU, lambda: _menu(session), of_button=True)


def _keys(session: Session, state: SearchBoxState, search: SearchState, has_ended: bool) -> None:
    """Keys while the text is typed; Escape clears it, and ends the typing where there is none."""
    step = imgui.is_key_pressed(imgui.Key.down_arrow) - imgui.is_key_pressed(imgui.Key.up_arrow)
    if step:
        search.move(step)
    if not has_ended:
        return
    if imgui.is_key_pressed(imgui.Key.escape, False):
        search.clear()
    elif widgets.enter_pressed():
        state.wants_keyboard = True  # the next word is typed at once
        if imgui.get_io().key_shift:
            search_actions.take_all(session)
        else:
            search_actions.take_hit(session)


def _menu(session: Session) -> None:
    imgui.push_text_wrap_pos(em(22))
    widgets.dim(search_actions.index_state(session), wrap=True)
    imgui.pop_text_wrap_pos()
    imgui.separator()
    for command_id in _ASKING:
        command_buttons.command_item(session, command_id)


# --- the answer


def _leaves_few(session: Session, search: SearchState) -> bool:
    """Whether too few hits would be in sight under all that `_understood` says."""
    room, gap = imgui.get_content_region_avail(), imgui.get_style().item_spacing.y
    texts = (search.sentence, search.problem or (_LOOKING_UP if search.is_looking_up else ""))
    high = sum(imgui.calc_text_size(x, wrap_width=room.x).y + gap for x in texts if x)
    n_buttons = (len(search.meant) > 1) + len(_WAYS_OUT) * _needs_ways_out(search)
    high += n_buttons * imgui.get_frame_height_with_spacing() + _foot_height(session)
    return room.y - high < min(len(search.hits), _LEAST_HITS) * (theme.scaled(_HIGH) + gap)


def _in_one_line(session: Session, search: SearchState) -> None:
    """What was understood, cut; all of it is in the tooltip, more ways to find in the menu."""
    if search.measured is None:
        widgets.dim(_LOOKING)
        return
    whole = f"{search.sentence}\n{search.problem}".strip()
    text, color = search.sentence, theme.DIM
    if search.problem:
        text, color = search.problem, theme.WARN
    elif search.is_looking_up:
        text = _LOOKING_UP
    room = imgui.get_content_region_avail().x
    if len(search.meant) > 1:
        _take_all_button(session, search, whole)
        room -= imgui.get_item_rect_size().x + imgui.get_style().item_spacing.x
        if room < em(_LEAST_WORDS):
            return
        imgui.same_line()
        imgui.align_text_to_frame_padding()
    if text:
        widgets.text(widgets.elided(text, room), color)
        widgets.tooltip(whole)


def _take_all_button(session: Session, search: SearchState, hint: str) -> None:
    face = Face(f"Select all {len(search.meant):,}")
    if widgets.button("Select all that fit", face, hint=hint, shortcut="Shift+Enter"):
        search_actions.take_all(session)


def _understood(session: Session, search: SearchState) -> None:
    """What was understood, what is still looked up, and what can be done with it."""
    if search.measured is None:
        widgets.dim(_LOOKING)
        return
    n = len(search.meant)
    if search.sentence:
        widgets.dim(search.sentence, wrap=True)
    if search.problem:
        widgets.text(search.problem, theme.WARN, wrap=True)
    elif search.is_looking_up:
        widgets.dim(_LOOKING_UP)
    if search.n_left_out and not search.hits:
        widgets.text("The filter of the list leaves out all that fit.", theme.WARN, wrap=True)
        return
    if n > 1:
        wanted = imgui.calc_text_size(f"{search.sentence}Select all {n:,}").x + em(2.5)
        if wanted < imgui.get_content_region_avail().x:
            imgui.same_line()
        _take_all_button(session, search, "These and nothing else")
    if _needs_ways_out(search):
        _ways_out(session)


def _needs_ways_out(search: SearchState) -> bool:
    is_short = not search.hits or bool(search.unknown)
    return is_short and not search.in_view and not search.is_looking_up


def _ways_out(session: Session) -> None:
    """Show what else understands more: nothing was found, or a word is not known."""
    for command_id in _WAYS_OUT:
        command = commands.command(command_id)
        why_not = command.enabled(session)
        if widgets.button(command.title, Face(width=-1), why_not=why_not):
            commands.run(command_id, session)


def _foot_height(session: Session) -> float:
    """Of what is under the hits, pixels."""
    if is_low():
        return 0.0
    is_filtered = session.need().feature(ObjectListView).filter.is_on
    line = em(1.25) if is_filtered else imgui.get_text_line_height()
    return line + imgui.get_style().item_spacing.y + theme.scaled(2)


def _hits(session: Session, state: SearchBoxState, table: ObjectTable, search: SearchState) -> None:
    high, gap = theme.scaled(_HIGH), imgui.get_style().item_spacing.y
    room = imgui.get_content_region_avail().y
    if state.is_short:
        each = (room + gap) / min(len(search.hits), _LEAST_HITS) - gap
        high = min(max(each, em(_ONE_LINE)), theme.scaled(_SHORT))
        room = max(room, high)  # the panel scrolls where not even one has room
    else:
        room -= _foot_height(session)
    if imgui.begin_child("Answer", ImVec2(0, room)):
        _lines(session, state, table, search, high)
    imgui.end_child()


def _lines(
    session: Session, state: SearchBoxState, table: ObjectTable, search: SearchState, high: float
) -> None:
    step = high + imgui.get_style().item_spacing.y
    if state.seen != search.at:
        state.seen = search.at
        top = search.at * step
        first = imgui.get_scroll_y()
        if not first <= top <= first + imgui.get_window_height() - step:
            imgui.set_scroll_y(max(top - imgui.get_window_height() / 2, 0.0))
    clipper = imgui.ListClipper()
    clipper.begin(len(search.hits), step)
    while clipper.step():
        for at in range(clipper.display_start, min(clipper.display_end, len(search.hits))):
            _line(session, state, table, at, high)
    clipper.end()


def _line(
    session: Session, state: SearchBoxState, table: ObjectTable, at: int, high: float
) -> None:
    search = session.need().feature(SearchState)
    hit = search.hits[at]
    row = table.row(hit.group)
    if row is None:
        imgui.dummy(ImVec2(1, high))
        return
    imgui.push_id(f"object {hit.group}")
    corner, room = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
    flags = imgui.SelectableFlags_.allow_double_click
    with widgets.lit_while_hovered(at == search.at):
        clicked, _ = imgui.selectable("##row", at == search.at, flags, ImVec2(0, high))
    if imgui.is_item_hovered() and hit.group:
        state.hovered = hit.group
    if clicked:
        _clicked(session, at)
    textures.draw(session, table, row, corner, high)
    textures.tooltip(session, table, row)
    # The object's color, at the edge of its picture.
    color = imgui.get_color_u32(widgets.rgba(table.colors[row]))
    edge = ImVec2(corner.x + em(0.22), corner.y + high)
    imgui.get_window_draw_list().add_rect_filled(corner, edge, color, em(0.1))
    left = corner.x + high + em(0.5)
    name = table.names[row]
    size = ImVec2(corner.x + room - left, high)
    _words(hit, name, ImVec2(left, corner.y), size, is_selected=table.n_selected[row] > 0)
    imgui.pop_id()


def _clicked(session: Session, at: int) -> None:
    io, search = imgui.get_io(), session.need().feature(SearchState)
    if io.key_ctrl or io.key_shift:
        selection.select_groups(session, (search.hits[at].group,), "add")
        search.at = at
        return
    search_actions.take_hit(
        session, at, flies=imgui.is_mouse_double_clicked(imgui.MouseButton_.left)
    )


def _words(hit: SearchHit, name: str, at: ImVec2, size: ImVec2, *, is_selected: bool) -> None:
    """The name, how well it fits in words, and a bar of the score where it has room."""
    drawing, room = imgui.get_window_draw_list(), size.x
    has_bar = size.y >= em(_WITH_BAR)
    percent = f"{round(100 * hit.score)} %"
    width = imgui.calc_text_size(percent).x + em(0.5)
    color = theme.CHOSEN if is_selected else theme.TEXT if hit.fits else theme.DIM
    line = at.y + (em(0.15) if has_bar else (size.y - em(1)) / 2)
    drawing.add_text(ImVec2(at.x, line), theme.u32(color), widgets.elided(name, room - width))
    drawing.add_text(ImVec2(at.x + room - width, line), theme.u32(theme.DIM), percent)
    if not has_bar:
        return
    top = at.y + em(1.75)
    bar = max(room - em(0.5), em(1))
    ends = ImVec2(at.x + bar, top + em(0.22))
    drawing.add_rect_filled(ImVec2(at.x, top), ends, theme.u32(theme.RAISED), em(0.11))
    full = ImVec2(at.x + bar * min(max(hit.score, 0.0), 1.0), ends.y)
    fill = theme.ACCENT if hit.fits else theme.LINE_STRONG
    drawing.add_rect_filled(ImVec2(at.x, top), full, theme.u32(fill), em(0.11))
