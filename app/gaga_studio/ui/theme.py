"""Colors, spacing and fonts: dark, neutral, one accent; the splats are the color in the picture.

Sizes are in ems (``em``), so that one layout serves 96 dpi and 4K alike.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui

from gaga_studio import paths

BASE_SIZE = 15.0  # pixels of a line of text at 96 dpi

Rgba = tuple[float, float, float, float]


def _hex(code: str, alpha: float = 1.0) -> ImVec4:
    red, green, blue = (int(code[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return ImVec4(red, green, blue, alpha)


ACCENT = _hex("5B9DF5")
ACCENT_STRONG = _hex("3F7FD8")
ACCENT_SOFT = _hex("5B9DF5", 0.28)
TEXT = _hex("DFE1E6")
DIM = _hex("9DA2AC")
FAINT = _hex("6C717B")
GOOD = _hex("6BBF8A")
WARN = _hex("E3B34F")
BAD = _hex("EA7068")
PANEL = _hex("212328")
BACK = _hex("1A1B1F")
RAISED = _hex("2C2F36")
HOT = _hex("343842")
LINE = _hex("33363D")
LINE_STRONG = _hex("474B54")
POPUP = _hex("26282E", 0.99)

_COLORS = {
    "text": TEXT,
    "text_disabled": FAINT,
    "text_selected_bg": ACCENT_SOFT,
    "text_link": ACCENT,
    "window_bg": PANEL,
    "child_bg": _hex("212328", 0.0),
    "popup_bg": POPUP,
    "modal_window_dim_bg": _hex("0C0D0F", 0.6),
    "menu_bar_bg": BACK,
    "border": LINE,
    "border_shadow": _hex("000000", 0.0),
    "frame_bg": _hex("2C2F36"),
    "frame_bg_hovered": _hex("353941"),
    "frame_bg_active": _hex("3D424C"),
    "title_bg": BACK,
    "title_bg_active": BACK,
    "title_bg_collapsed": BACK,
    "tab": BACK,
    "tab_hovered": _hex("353941"),
    "tab_selected": PANEL,
    "tab_selected_overline": _hex("5B9DF5", 0.0),
    "tab_dimmed": BACK,
    "tab_dimmed_selected": PANEL,
    "tab_dimmed_selected_overline": _hex("5B9DF5", 0.0),
    "docking_preview": _hex("5B9DF5", 0.5),
    "docking_empty_bg": BACK,
    "button": _hex("2F333B"),
    "button_hovered": _hex("3A3F49"),
    "button_active": _hex("454B57"),
    "header": _hex("5B9DF5", 0.26),
    "header_hovered": _hex("FFFFFF", 0.07),
    "header_active": _hex("5B9DF5", 0.38),
    "check_mark": ACCENT,
    "slider_grab": _hex("7C828E"),
    "slider_grab_active": ACCENT,
    "separator": LINE,
    "separator_hovered": _hex("5B9DF5", 0.6),
    "separator_active": ACCENT,
    "resize_grip": _hex("000000", 0.0),
    "resize_grip_hovered": _hex("5B9DF5", 0.4),
    "resize_grip_active": ACCENT,
    "scrollbar_bg": _hex("000000", 0.0),
    "scrollbar_grab": _hex("3D424C"),
    "scrollbar_grab_hovered": _hex("4B515D"),
    "scrollbar_grab_active": _hex("5B6270"),
    "plot_histogram": ACCENT,
    "plot_histogram_hovered": ACCENT,
    "table_header_bg": _hex("26282E"),
    "table_border_strong": LINE,
    "table_border_light": _hex("2A2D33"),
    "table_row_bg": _hex("000000", 0.0),
    "table_row_bg_alt": _hex("FFFFFF", 0.018),
    "drag_drop_target": ACCENT,
    "nav_cursor": ACCENT,
    "input_text_cursor": TEXT,
}


class _Fonts:
    """The loaded faces; filled once per window by ``load_fonts``."""

    regular: imgui.ImFont | None = None
    strong: imgui.ImFont | None = None


def load_fonts() -> None:
    """Load the text font with the icons merged in, and its heavier face for headings."""
    _Fonts.regular = _load("Inter-Regular.otf")
    _Fonts.strong = _load("Inter-SemiBold.otf")


def _load(name: str) -> imgui.ImFont:
    folder = paths.assets() / "fonts"
    text = hello_imgui.FontLoadingParams(inside_assets=False)
    font = hello_imgui.load_font(str(folder / name), BASE_SIZE, text)
    icons = hello_imgui.FontLoadingParams(inside_assets=False, merge_to_last_font=True)
    icons.font_config.glyph_offset = ImVec2(0.0, BASE_SIZE * 0.19)
    icons.font_config.glyph_min_advance_x = BASE_SIZE
    hello_imgui.load_font(str(folder / "lucide.ttf"), BASE_SIZE, icons)
    return font


def apply_style() -> None:
    """Set every color and distance of the window."""
    style = imgui.get_style()
    for name, color in _COLORS.items():
        index = getattr(imgui.Col_, name, None)
        if index is not None:
            style.set_color_(index, color)
    style.window_padding = ImVec2(10, 9)
    style.frame_padding = ImVec2(8, 4)
    style.cell_padding = ImVec2(3, 3)
    style.item_spacing = ImVec2(8, 6)
    style.item_inner_spacing = ImVec2(6, 4)
    style.indent_spacing = 16
    style.scrollbar_size = 11
    style.grab_min_size = 10
    style.window_border_size = 0
    style.child_border_size = 1
    style.popup_border_size = 1
    style.frame_border_size = 0
    style.tab_border_size = 0
    style.tab_bar_border_size = 0
    style.tab_bar_overline_size = 0
    style.docking_separator_size = 2
    style.window_rounding = 0
    style.child_rounding = 5
    style.frame_rounding = 4
    style.popup_rounding = 6
    style.scrollbar_rounding = 6
    style.grab_rounding = 4
    style.tab_rounding = 4
    style.window_title_align = ImVec2(0.0, 0.5)
    style.window_menu_button_position = imgui.Dir.none
    style.hover_delay_short = 0.35
    style.disabled_alpha = 0.45
    style.separator_text_border_size = 1
    style.separator_text_padding = ImVec2(0, 4)


def em(size: float = 1.0) -> float:
    """``size`` lines of text in pixels of this screen."""
    return imgui.get_font_size() * size


def scaled(pixels: float) -> float:
    """Pixels at 96 dpi in pixels of this screen, whatever font is pushed."""
    style = imgui.get_style()
    return pixels * style.font_scale_dpi * style.font_scale_main


def u32(color: ImVec4, alpha: float = 1.0) -> int:
    """A color for draw lists."""
    return imgui.get_color_u32(ImVec4(color.x, color.y, color.z, color.w * alpha))


@contextmanager
def text_color(color: ImVec4) -> Iterator[None]:
    """Draw text in ``color`` inside the block."""
    imgui.push_style_color(imgui.Col_.text, color)
    try:
        yield
    finally:
        imgui.pop_style_color()


@contextmanager
def face(strong: bool = False, scale: float = 1.0) -> Iterator[None]:
    """Another weight or size of the text font inside the block."""
    imgui.push_font(_Fonts.strong if strong else _Fonts.regular, BASE_SIZE * scale)
    try:
        yield
    finally:
        imgui.pop_font()
