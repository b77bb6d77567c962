"""What was done, newest last; a click goes back or forth to it."""

from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui

from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em


@dataclass
class HistoryState:
    """Where the list was scrolled to."""

    seen: int = 0  # entries done at that time


def draw(session: Session, state: HistoryState) -> None:
    """The whole panel."""
    document = session.document
    if document is None or not document.history.entries():
        hint = "Every edit will be listed here; a click goes back to it." if document else ""
        widgets.empty_state(icons.HISTORY, "Nothing done yet", hint)
        return
    history = document.history
    entries = history.entries()
    foot = imgui.get_text_line_height_with_spacing()
    if not imgui.begin_child("Entries", ImVec2(0, -foot)):
        imgui.end_child()
        _total(history.nbytes, history.budget)
        return
    clicked = _line(0, "As opened", "", history.cursor == 0, True)
    target = 0 if clicked else None
    for position, entry in enumerate(entries, start=1):
        is_here = position == history.cursor
        if _line(position, entry.title, _size(entry.nbytes), is_here, entry.done):
            target = position
    if state.seen != history.cursor:
        state.seen = history.cursor
        line = imgui.get_text_line_height_with_spacing()
        imgui.set_scroll_y(max(history.cursor * line - imgui.get_window_height() * 0.6, 0.0))
    if target is not None and target != history.cursor:
        document.go_to(target)
    imgui.end_child()
    _total(history.nbytes, history.budget)


def _total(used: int, budget: int) -> None:
    """What undo holds, and may hold."""
    widgets.dim(widgets.elided(f"{_size(used)} of {_size(budget)}", _room()))
    widgets.tooltip(
        "What undo holds, and what it may hold (Preferences); with more, the oldest edits cannot "
        "be undone any more"
    )


def _room() -> float:
    return float(imgui.get_content_region_avail().x)


def _line(position: int, title: str, size: str, is_here: bool, done: bool) -> bool:
    imgui.push_id(position)
    color = theme.TEXT if done else theme.FAINT
    room = imgui.get_content_region_avail().x
    right = imgui.calc_text_size(size).x
    shown = widgets.elided(title, room - right - em(0.8))
    with theme.text_color(color):
        clicked, _ = imgui.selectable(f"{shown}###{title}", is_here)
    widgets.tooltip("" if is_here else "Go back to here" if done else "Do again up to here")
    if size:
        imgui.same_line(imgui.get_cursor_pos_x() + room - right)
        widgets.dim(size)
    imgui.pop_id()
    return clicked


def _size(n: int) -> str:
    if n < 1000:
        return f"{n} B"
    if n < 1_000_000:
        return f"{n / 1000:.0f} kB"
    return f"{n / 1e6:.1f} MB" if n < 100_000_000 else f"{n / 1e6:,.0f} MB"
