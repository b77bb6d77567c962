"""The history of edits, newest last; a click undoes or redoes up to one."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.edits.history import HistoryEntry
from gaga_studio.features import split_view
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets

_HINT = "Every edit of splats and objects is listed here; a click goes back."


@dataclass
class HistoryState:
    """Where the list was scrolled to."""

    seen: int = 0  # entries done at that time
    unfolded: set[int] = field(default_factory=set)  # first entries of runs that are shown whole


def draw(session: Session, state: HistoryState) -> None:
    """The whole panel."""
    document = session.document
    if document is None or not (document.history.entries() or any(document.view_steps())):
        widgets.empty_state(
            icons.HISTORY,
            "No edits since the scene was opened" if document else "No edits",
            _HINT if document else "",
        )
        return
    history = document.history
    entries = history.entries()
    foot = imgui.get_text_line_height_with_spacing()
    if not imgui.begin_child("Entries", ImVec2(0, -foot)):
        imgui.end_child()
        _total(history.nbytes, history.budget)
        return
    n_views: int | None = None
    at = None if document.view_steps()[0] else history.cursor  # the entry that is marked
    target = 0 if _line(session, 0, "As opened", "", at == 0, True) else None
    if history.cursor == 0:
        n_views = _view_lines(document)
    for first, last in _runs(entries):
        if last - first and first not in state.unfolded:
            is_here = at is not None and first <= at <= last
            if _folded(first, last, is_here, entries[first - 1].done):
                state.unfolded.add(first)
            if first <= history.cursor <= last:
                n_views = _view_lines(document)
            continue
        for position in range(first, last + 1):
            entry, size = entries[position - 1], _size(entries[position - 1].nbytes)
            if _line(session, position, entry.title, size, position == at, entry.done):
                target = position
            if position == history.cursor:
                n_views = _view_lines(document)
    if state.seen != history.cursor:
        state.seen = history.cursor
        line = imgui.get_text_line_height_with_spacing()
        imgui.set_scroll_y(max(history.cursor * line - imgui.get_window_height() * 0.6, 0.0))
    if target is not None and target != history.cursor:
        document.go_to(target)
    elif target is not None or n_views is not None:
        session.go_to_view_step(n_views or 0)
    imgui.end_child()
    _total(history.nbytes, history.budget)


def _view_lines(document: Document) -> int | None:
    """Steps of bookmarks and of the camera's path after the newest edit; how many are to be done
    after a click on one."""
    done, undone = document.view_steps()
    clicked = None
    for n, title in enumerate((*done, *undone), start=1):
        imgui.push_id(f"view {n}")
        with theme.text_color(theme.TEXT if n <= len(done) else theme.FAINT):
            shown = widgets.elided(f"{icons.BOOKMARK} {title}", imgui.get_content_region_avail().x)
            if imgui.selectable(f"{shown}###{title}", n == len(done))[0]:
                clicked = n
        where = "You are here" if n == len(done) else "Go back to here"
        widgets.tooltip(where if n <= len(done) else "Do again up to here", of_row=True)
        imgui.pop_id()
    return clicked


def _runs(entries: Sequence[HistoryEntry]) -> list[tuple[int, int]]:
    """First and last entry, counted from 1, of each line: an edit, or selections in a row."""
    runs: list[tuple[int, int]] = []
    for position, entry in enumerate(entries, start=1):
        joins = entry.is_selection and position > 1 and entries[position - 2].is_selection
        runs.append((runs.pop()[0] if joins else position, position))
    return runs


def _folded(first: int, last: int, is_here: bool, done: bool) -> bool:
    """The line of selections in a row; whether it was clicked."""
    imgui.push_id(first)
    with theme.text_color(theme.DIM if done else theme.FAINT):
        text = f"{icons.FOLDED} {last - first + 1} selections"
        clicked, _ = imgui.selectable(f"{text}###selections", is_here)
    widgets.tooltip("Show them one by one", of_row=True)
    imgui.pop_id()
    return clicked


def _total(used: int, budget: int) -> None:
    """What undo holds, and may hold."""
    room = imgui.get_content_region_avail().x
    widgets.dim(widgets.elided(f"{_size(used)} of {_size(budget)}", room))
    widgets.tooltip(
        "Memory used by undo, and its limit (Preferences); beyond the limit the oldest edits "
        "can no longer be undone"
    )


def _line(
    session: Session, position: int, title: str, size: str, is_here: bool, done: bool
) -> bool:
    """One entry, its bytes in its tooltip, *Compare* in its menu; whether it was clicked."""

    def menu() -> None:
        if imgui.menu_item_simple(f"{icons.SPLIT}  Compare with what is shown###Compare"):
            split_view.compare_version(session, position)

    imgui.push_id(position)
    color = theme.TEXT if done else theme.FAINT
    shown = widgets.elided(title, imgui.get_content_region_avail().x)
    with theme.text_color(color):
        clicked, _ = imgui.selectable(f"{shown}###{title}", is_here)
    where = "You are here" if is_here else "Go back to here" if done else "Do again up to here"
    said = f"{where}{f', {size}' if size else ''}. Right-click to compare"
    widgets.tooltip(said, of_row=True)
    if not is_here:
        widgets.popup("Entry", menu, of_item=True)
    imgui.pop_id()
    return clicked


def _size(n: int) -> str:
    if n < 1000:
        return f"{n} B"
    if n < 1_000_000:
        return f"{n / 1000:.0f} kB"
    return f"{n / 1e6:.1f} MB" if n < 100_000_000 else f"{n / 1e6:,.0f} MB"
