"""A sheet in the middle of the window: its frame, its height and its last row."""

from collections.abc import Iterator
from contextlib import contextmanager

from imgui_bundle import ImVec2, imgui

from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

_MODAL = (
    imgui.WindowFlags_.no_resize
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.always_auto_resize
    | imgui.WindowFlags_.no_move
)
QUESTION = "Question"  # the sheet that Escape answers instead of closing it
EDGE = 1.1  # left and right of what a sheet holds, ems
HIGH = 0.92  # of the window's height: the highest sheet


def highest() -> float:
    """Height of the highest sheet, pixels; the toolkit lets none be higher than what the menu bar
    leaves."""
    viewport, edge = imgui.get_main_viewport(), imgui.get_style().display_safe_area_padding.y
    return min(viewport.size.y * HIGH, viewport.work_size.y - 2 * edge)


def begin_modal(
    name: str,
    width: float,
    *,
    dims: bool = True,
    is_possible: bool = True,
    is_aside: bool = False,
) -> bool:
    """A sheet in the middle of the window, ``width`` wide where there is room.

    The window behind it is dimmed, but not where it is what the sheet changes; where the sheet
    shows things in the picture, it stands ``is_aside``, in the lower left corner. A sheet that is
    no longer ``is_possible`` closes itself.
    """
    viewport = imgui.get_main_viewport()
    at, pivot = viewport.get_center(), ImVec2(0.5, 0.5)
    if is_aside:
        edge = em(1)
        at = ImVec2(viewport.work_pos.x + edge, viewport.pos.y + viewport.size.y - edge)
        pivot = ImVec2(0, 1)
    imgui.set_next_window_pos(at, imgui.Cond_.always, pivot)
    fitting = min(width, viewport.size.x * 0.94)
    imgui.set_next_window_size_constraints(ImVec2(fitting, 0), ImVec2(fitting, highest()))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, theme.scaled(8))
    # Whole pixels: half of one is enough for a scroll bar.
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(round(em(EDGE)), round(em(0.9))))
    is_open, _ = imgui.begin_popup_modal(name, None, _MODAL)
    imgui.pop_style_var(2)
    if is_open:
        theme.dim_behind(dims)
        if imgui.is_window_appearing():  # nothing in it was chosen by keys: Enter is its button
            imgui.set_nav_cursor_visible(False)
    if is_open and not is_possible:
        imgui.close_current_popup()
        imgui.end_popup()
        return False
    return is_open


def body_height(wanted: float, rows: int = 1) -> float:
    """Height of a part that scrolls, so that what is above it and the rows below stay visible."""
    style = imgui.get_style()
    row = em(0.3) + rows * imgui.get_frame_height() + (1 + rows) * style.item_spacing.y
    return max(min(wanted, highest() - imgui.get_cursor_pos_y() - row - em(0.9) - em(0.1)), em(4))


def begin_part(name: str, size: ImVec2, flags: int = 0) -> bool:
    """A child window of a sheet; the keys walk through it as through the rest of the sheet."""
    return imgui.begin_child(name, size, flags | imgui.ChildFlags_.nav_flattened)


@contextmanager
def body(name: str, wanted: float = 1e6, rows: int = 1) -> Iterator[None]:
    """The part of a sheet that scrolls where it is too high; the rows of buttons below it stay."""
    imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(1e6, body_height(wanted, rows)))
    begin_part(name, ImVec2(0, 0), imgui.ChildFlags_.auto_resize_y)
    try:
        yield
    finally:
        imgui.end_child()


def close_row() -> None:
    """The last row of a sheet."""
    imgui.dummy(ImVec2(0, em(0.3)))
    width = em(6)
    room = imgui.get_content_region_avail().x
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - width)
    if widgets.button("Close", Face(width=width)):
        imgui.close_current_popup()


def answer(name: str, face: Face, *, why_not: str = "") -> bool:
    """The last row of a sheet: a button ``name`` and Cancel, as wide; both close it.

    Whether the button was pressed, or Enter where neither field nor button has the keyboard.
    """
    goes, cancels = answers(name, face, why_not=why_not)
    goes = goes or (not why_not and enter_is_free())
    if goes or cancels:
        imgui.close_current_popup()
    return goes


def answers(name: str, face: Face, *, why_not: str = "") -> tuple[bool, bool]:
    """The button ``name``, then Cancel, at the right edge; whether each was pressed."""
    room = imgui.get_content_region_avail().x - 2 * face.width - imgui.get_style().item_spacing.x
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(room, 0.0))
    goes = widgets.button(name, face, why_not=why_not)
    imgui.same_line()
    return goes, widgets.button("Cancel", Face(width=face.width))


def enter_is_free() -> bool:
    """Whether Enter was pressed, but not in a field, on a button or in what is open over it."""
    is_ours = imgui.is_window_focused(imgui.FocusedFlags_.child_windows)
    context = imgui.get_current_context()
    had_field = context.active_id_previous_frame != 0 or context.nav_activate_id != 0
    is_new = imgui.is_window_appearing()  # the key of this frame opened it
    return is_ours and not had_field and not is_new and widgets.enter_pressed()
