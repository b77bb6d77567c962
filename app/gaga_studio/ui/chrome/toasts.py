"""Notices of the session: short cards in the corner of the picture.

Errors stay until they are closed; other notices disappear after a while. Esc closes errors and
warnings, the newest first.
"""

import time
from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_studio.features import commands, export
from gaga_studio.session.notices import HINT_SECONDS, Level, Notice
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea, Rect
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

_SECONDS = {
    Level.HINT: HINT_SECONDS,
    Level.INFO: 4.0,
    Level.WARNING: 8.0,
    Level.ERROR: float("inf"),
}
_OFFER_SECONDS = 30.0  # with a button: it must be read and found
_CLOSED_BY_KEY = (Level.WARNING, Level.ERROR)  # Esc has another use while the others are read
_SHORT = (
    Level.HINT,
    Level.INFO,
)  # in a low picture: few lines, the rest in the tooltip; all where one fits
_LINES = (2, 3)  # of these; where no other notice is
_ANY_POPUP = imgui.PopupFlags_.any_popup_id | imgui.PopupFlags_.any_popup_level
_OF_QUESTION = 2  # lines over its two answers
_LOW = 14.0  # em: height of a picture of which a whole notice covers the most
_AROUND = 5.4  # em: of a card's width, the icon, the cross and the edges
_LEAST, _ROOM = 12.0, 6.0  # em: least width of a card, and height for one of three lines
_LEAST_HIGH = 2.4  # em: of a card of one line
_MOST = 4  # on screen at once, where there is room; older ones wait
_SIGNS = {
    Level.HINT: (icons.INFO, theme.DIM),
    Level.INFO: (icons.SUCCESS, theme.GOOD),
    Level.WARNING: (icons.WARNING, theme.WARN),
    Level.ERROR: (icons.ERROR, theme.BAD),
}


@dataclass
class ToastState:
    """Which notices were closed, and whether some will go by themselves."""

    closed: set[Notice] = field(default_factory=set)
    are_passing: bool = False  # keep drawing
    sizes: dict[Notice, ImVec2] = field(default_factory=dict)  # of cards as drawn last
    seen_s: dict[Notice, float] = field(default_factory=dict)  # since each was in sight
    drawn_at: float = 0.0  # when they were drawn last


def draw(session: Session, state: ToastState, area: PictureArea) -> None:
    """The newest notices, at the upper edge of the picture or below a card there, next to the cube.

    In the middle of a small picture they would lie over what is being worked on.
    """
    now = time.monotonic()
    is_covered = imgui.is_popup_open("", _ANY_POPUP)  # nobody reads them under a sheet
    passed = 0.0 if is_covered else now - state.drawn_at
    state.drawn_at = now
    known = set(session.notices)
    state.closed &= known
    state.sizes = {notice: size for notice, size in state.sizes.items() if notice in known}
    seen = state.seen_s
    seen = state.seen_s = {one: seen[one] + passed if one in seen else 0.0 for one in known}
    fresh = [
        notice
        for notice in session.notices
        if notice not in state.closed and seen[notice] < _seconds(notice)
    ]
    state.are_passing = any(_seconds(notice) < float("inf") for notice in fresh)
    is_low = area.height < em(_LOW)
    if is_low:  # the newest, and what must be read
        fresh = [n for n in fresh if n is fresh[-1] or n.otherwise or n.level not in _SHORT]
    n_lines = _LINES[len(fresh) == 1] if is_low else 0
    right = area.left + area.width - area.cube_height - em(0.7)  # the cube is as wide as high
    top = max(area.top, area.chip_bottom, area.card_bottom)
    at = ImVec2(right, top + em(0.3 if is_low else 0.7))
    left = max(area.left, area.live_right)
    if right - left - em(0.7) < em(_LEAST):  # no room next to the card of a training
        left = area.left
        if area.bottom - area.live_bottom > em(_ROOM):
            at.y = max(at.y, area.live_bottom + em(0.4))
    least, most = em(4), em(20)
    if area.options is not None:  # next to them, or below where that has no room
        if right - max(left, area.options[2]) - em(0.7) >= em(_LEAST):
            left = max(left, area.options[2])
        else:
            at.y, least = max(at.y, area.options[3] + em(0.2)), em(_LEAST_HIGH)
            most = min(most, area.bottom - at.y - em(0.2))
            is_low |= most < em(_ROOM)
            lines = most - 2 * imgui.get_style().window_padding.y
            fitting = max(int(lines / imgui.get_text_line_height_with_spacing()), 1)
            n_lines = min(fitting, n_lines or _LINES[0]) if is_low else 0
    width = max(min(em(24), right - left - em(0.7)), em(_LEAST))
    drawn: list[Rect] = []
    for slot, notice in enumerate(reversed(fresh[-_MOST:])):
        size = state.sizes.get(notice, ImVec2(0, 0))  # until it has been drawn
        if slot and size.x == width and at.y + size.y > area.bottom:
            break  # its buttons would be out of reach
        highest = max(area.bottom - at.y - em(0.2), least) if is_low else most
        wide = min(_question_width(notice), width) if is_low and notice.otherwise else width
        place = at, ImVec2(wide, highest), n_lines
        bottom = _card(session, state, notice, slot, place)
        state.sizes[notice] = ImVec2(wide, bottom - at.y)
        drawn.append((at.x - wide, at.y, at.x, bottom))
        at.y = bottom + em(0.4)
    area.notices = tuple(drawn)


def is_asking(session: Session, state: ToastState, area: PictureArea) -> bool:
    """Whether a question stands over a low picture, which has no room for more."""
    asked = any(notice.otherwise and notice not in state.closed for notice in session.notices)
    return asked and area.height < em(_LOW)


def _question(notice: Notice) -> str:
    """The first sentence of a notice that asks; the tooltip has all of it."""
    return notice.text[: notice.text.find("?") + 1]


def _question_width(notice: Notice) -> float:
    """Of a card with the question on one line and both answers on the next, pixels."""
    style = imgui.get_style()
    titles = [commands.command(name).title for name in (notice.command, notice.otherwise)]
    answers = sum(imgui.calc_text_size(t).x + 2 * style.frame_padding.x for t in titles)
    answers += style.item_spacing.x + 2 * style.window_padding.x
    return max(imgui.calc_text_size(_question(notice)).x + em(_AROUND), answers)


def close_newest(session: Session, state: ToastState) -> bool:
    """Close the newest error or warning that is left; whether there was one."""
    left = [
        notice
        for notice in session.notices
        if notice.level in _CLOSED_BY_KEY
        and not notice.otherwise
        and notice not in state.closed
        and state.seen_s.get(notice, 0.0) < _seconds(notice)
    ]
    if left:
        state.closed.add(left[-1])
    return bool(left)


def _seconds(notice: Notice) -> float:
    """How long a notice stays."""
    if notice.otherwise:
        return float("inf")
    seconds = _SECONDS[notice.level]
    return max(seconds, _OFFER_SECONDS) if notice.command or notice.shows else seconds


def _card(
    session: Session,
    state: ToastState,
    notice: Notice,
    slot: int,
    place: tuple[ImVec2, ImVec2, int],
) -> float:
    """One card at ``place``: its upper right corner, its width and greatest height, lines if low.

    Returns its lower edge.
    """
    corner, most, n_lines = place
    width = most.x
    is_low = n_lines > 0
    bottom = 0.0

    def draw() -> None:
        nonlocal bottom
        icon, color = _SIGNS[notice.level]
        top = imgui.get_cursor_pos_y()
        widgets.text(icon, color)
        imgui.same_line()
        room, left = width - em(_AROUND), imgui.get_cursor_pos_x()
        if is_low and (notice.level in _SHORT or n_lines == 1):
            most = _OF_QUESTION if notice.otherwise else n_lines
            said = _question(notice) if notice.otherwise else notice.text
            for text in widgets.few_lines(said, room, most):
                imgui.set_cursor_pos_x(left)
                imgui.text_unformatted(text)
                widgets.tooltip(notice.text)
        else:
            imgui.push_text_wrap_pos(left + room)
            widgets.paragraph(notice.text)
            imgui.pop_text_wrap_pos()
        if notice.shows is not None:
            if is_low:
                imgui.same_line(width - em(2.2))
            else:
                imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + em(1.6))
            name = "Show in folder"
            if (
                widgets.small_icon(name, icons.FOLDER, hint=name)
                if is_low
                else widgets.button(name, Face(name, icons.FOLDER))
            ):
                export.show_in_folder(session, notice.shows)
        for name in filter(None, (notice.command, notice.otherwise)):
            command = commands.command(name)
            if name == notice.otherwise:
                widgets.next_to(command.title)
            if widgets.button(command.title, why_not=command.enabled(session)):
                commands.run(name, session)
                if not notice.otherwise:  # an answer closes it, wherever it is given
                    state.closed.add(notice)
        imgui.set_cursor_pos(ImVec2(width - em(2.2), top))
        hint = "Close (Esc)" if notice.level in _CLOSED_BY_KEY else "Close"
        if widgets.small_icon("Close", icons.CLOSE, hint=hint):
            state.closed.add(notice)
        bottom = imgui.get_window_pos().y + imgui.get_window_height()

    imgui.set_next_window_pos(corner, imgui.Cond_.always, ImVec2(1, 0))
    imgui.set_next_window_size_constraints(ImVec2(width, 0), most)
    before = state.sizes.get(notice)
    is_cut = before is not None and before.y >= most.y - 1
    pad = imgui.get_style().window_padding
    is_tight = n_lines == 1 or (is_low and notice.otherwise)
    inside = ImVec2(pad.x, em(0.3)) if is_tight else pad
    imgui.push_style_var(imgui.StyleVar_.window_padding, inside)
    widgets.floating_card(f"Notice {slot}", draw, scrolls=is_cut)
    imgui.pop_style_var()
    return bottom
