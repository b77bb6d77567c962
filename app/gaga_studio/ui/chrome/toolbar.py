"""The tool bar: tools, undo, how the picture is colored, and the search."""

from imgui_bundle import imgui

from gaga_studio.features import commands
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, SplatLook
from gaga_studio.ui.chrome import command_buttons, tool_options
from gaga_studio.ui.chrome.tool_options import rule
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em

_MODES = (
    (Mode.COLOR, icons.COLOR, "Color", "The scene in its own colors"),
    (Mode.GROUPS, icons.GROUPS, "Groups", "Every object in its list color"),
    (Mode.DEPTH, icons.DEPTH, "Depth", "Near is bright, far is dark"),
)
_SELECTING = ("pick", "object", "rect", "lasso", "polygon", "brush", "sphere")
_MOVING = ("move", "rotate", "scale")


def draw(session: Session, area: PictureArea) -> None:
    """The whole bar, left to right; what does not fit a small window is left to the menus.

    Options of the tool that do not fit are drawn over the picture.
    """
    _paint()
    width = imgui.get_content_region_avail().x
    left = imgui.get_cursor_screen_pos().x
    for position, tool in enumerate(_SELECTING):
        _next(position)
        command_buttons.command_icon(session, f"tool.{tool}")
    rule()
    for position, tool in enumerate(_MOVING):
        _next(position)
        command_buttons.command_icon(session, f"tool.{tool}")
    rule()
    command_buttons.command_icon(session, "edit.undo")
    _next()
    command_buttons.command_icon(session, "edit.redo")
    rule()
    _modes(session, with_text=width > em(58))
    imgui.same_line()
    if width - (imgui.get_cursor_screen_pos().x - left) < 3 * imgui.get_frame_height() + em(3):
        imgui.new_line()
        area.has_options = True
        return
    rule()
    command_buttons.command_icon(session, "view.frusta")
    _next()
    command_buttons.command_icon(session, "view.fly")
    _next()
    command_buttons.command_icon(session, "view.frame_all")
    used = imgui.get_item_rect_max().x - left
    area.has_options = not tool_options.fits(session, width - used)
    if not area.has_options:
        tool_options.draw(session)
    imgui.same_line()
    used = imgui.get_cursor_screen_pos().x - left
    _search(session, width, used)


def _paint() -> None:
    """The ground of the bar, and of what no panel covers: round corners, the last line of pixels.

    The window's own color does not follow the theme.
    """
    corner, size = imgui.get_window_pos(), imgui.get_window_size()
    end = imgui.ImVec2(corner.x + size.x, corner.y + size.y)
    imgui.get_window_draw_list().add_rect_filled(corner, end, theme.u32(theme.BACK))
    whole = imgui.get_main_viewport()
    far = imgui.ImVec2(whole.pos.x + whole.size.x, whole.pos.y + whole.size.y)
    imgui.get_background_draw_list().add_rect_filled(whole.pos, far, theme.u32(theme.BACK))


def _modes(session: Session, *, with_text: bool) -> None:
    shown = [mode for mode, *_ in _MODES]
    why_not = {mode: commands.command(f"view.{mode}").enabled(session) for mode in shown}
    picked = widgets.segmented(
        "Render mode", _MODES, session.view.mode, why_not=why_not, with_text=with_text
    )
    if picked is not session.view.mode:
        commands.run(f"view.{picked}", session)
    imgui.same_line(0, theme.scaled(1))
    if widgets.icon_button(
        "More render modes",
        icons.MORE,
        hint="Confidence, centres, rings, a mask, and the look of small splats",
        on=session.view.mode not in shown,
    ):
        imgui.open_popup("More modes")
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    imgui.set_next_window_pos(imgui.ImVec2(low.x, high.y + theme.scaled(2)))
    if imgui.begin_popup("More modes"):
        for mode in Mode:
            if mode not in shown:
                command_buttons.command_item(session, f"view.{mode}")
        command_buttons.command_item(session, "view.folder_colors")
        imgui.separator()
        for look in SplatLook:
            command_buttons.command_item(session, f"view.look_{look}")
        imgui.separator()
        command_buttons.command_item(session, "view.background")
        imgui.end_popup()


def _search(session: Session, width: float, used: float) -> None:
    """Looks like a text field; opens the list of all commands."""
    room = width - used - em(0.3)
    size = min(em(15), room)
    if size < em(3):
        imgui.new_line()
        return
    imgui.same_line(imgui.get_cursor_pos_x() + room - size)
    text = f"{icons.SEARCH}  Find a command" if size > em(11) else icons.SEARCH
    imgui.push_style_var(imgui.StyleVar_.button_text_align, imgui.ImVec2(0.0, 0.5))
    imgui.push_style_color(imgui.Col_.text, theme.DIM)
    imgui.push_style_color(imgui.Col_.button, theme.RAISED)
    if imgui.button(f"{text}###Find a command", imgui.ImVec2(size, 0)):
        session.request = Request.COMMAND_LIST
    imgui.pop_style_color(2)
    imgui.pop_style_var()
    widgets.tooltip("Every command by its name", "Ctrl+P")


def _next(position: int = 1) -> None:
    if position:
        imgui.same_line(0, em(0.15))
