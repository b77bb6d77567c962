"""Colors, spacing and fonts: neutral, one accent; the splats are the color in the picture.

Sizes are in ems (``em``), so that one layout serves 96 dpi and 4K alike.
"""

import logging
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from pathlib import Path
from typing import ClassVar

from imgui_bundle import ImVec2, ImVec4, hello_imgui, imgui

from gaga_core.color import luminance
from gaga_core.errors import LONGEST_LINE, plain_text
from gaga_core.io.files import assets
from gaga_studio.system.fonts import fonts_with, foreign_letters

# --- Names in Arabic and Hebrew script, in the order and the shapes in which they are read.
# The toolkit draws letters from left to right as they are stored. Here runs of right-to-left
# letters are turned around, and Arabic letters take the form that their neighbours ask for.
# Numbers and Latin words inside keep their direction. That is enough for names, not for paragraphs
# (UAX 9 has more).

_NO_ICONS = re.compile("[^\n\ue000-\uf8ff]+")
_RIGHT = ("R", "AL")
_MARKS = ("NSM",)
_MIRRORED = str.maketrans("()[]{}<>«»", ")(][}{><»«")
# Presentation forms: isolated, final, initial, medial.
_FORMS = ("<isolated>", "<final>", "<initial>", "<medial>")


def plain(text: str) -> str:
    """Lines that may quote a file, as notices and the command show them; icons stay."""
    if text.isascii() and text.isprintable():
        return text
    if not text.isprintable():
        text = _NO_ICONS.sub(lambda found: plain_text(found[0], LONGEST_LINE), text)
    return noted(text).translate(_Loaded.codes)


def visual(text: str) -> str:
    """``text`` as it is drawn: on one line, left to right, control characters as escapes."""
    text = plain(text).replace("\n", r"\n")
    return text if text.isascii() else noted(_turned(text))


def noted(text: str) -> str:
    """``text``, whose letters have glyphs from the next frame on where any font has them."""
    if not text.isascii():
        _Loaded.shown |= foreign_letters((text,)) - _Loaded.looked_for
    return text


@lru_cache(maxsize=4096)
def _turned(text: str) -> str:
    if not any(unicodedata.bidirectional(c) in _RIGHT for c in text):
        return text
    kinds = (unicodedata.bidirectional(letter) for letter in text)
    is_right = next(kind in _RIGHT for kind in kinds if kind in (*_RIGHT, "L"))
    runs = _runs(_shaped(text), is_right)
    drawn = [run[::-1].translate(_MIRRORED) if turns else run for run, turns in runs]
    return "".join(reversed(drawn) if is_right else drawn)


def _runs(text: str, whole_is_right: bool) -> list[tuple[str, bool]]:
    """Parts of one direction, and whether that is from the right; what is neutral takes that of
    both its sides, where they differ that of the whole."""
    runs: list[tuple[str, bool]] = []
    for i, letter in enumerate(text):
        kind = unicodedata.bidirectional(letter)
        before = runs[-1][1] if runs else whole_is_right
        if kind in _RIGHT:
            is_right = True
        elif kind in ("L", "EN", "AN"):
            is_right = False
        elif kind in _MARKS:
            is_right = before
        else:
            after = _next_is_right(text, i, whole_is_right)
            is_right = before if before == after else whole_is_right
        if runs and runs[-1][1] == is_right:
            runs[-1] = (runs[-1][0] + letter, is_right)
        else:
            runs.append((letter, is_right))
    return runs


def _next_is_right(text: str, at: int, at_end: bool) -> bool:
    kinds = (unicodedata.bidirectional(letter) for letter in text[at:])
    return next((kind in _RIGHT for kind in kinds if kind in (*_RIGHT, "L", "EN", "AN")), at_end)


def _shaped(text: str) -> str:
    """Arabic letters in the form for their place in the word."""
    forms, shaped = _forms(), []
    for i, letter in enumerate(text):
        if letter not in forms:
            shaped.append(letter)
            continue
        joins_before = i > 0 and "<initial>" in forms.get(text[i - 1], {})
        joins_after = i + 1 < len(text) and "<final>" in forms.get(text[i + 1], {})
        place = _FORMS[2 * joins_after + joins_before]
        own = forms[letter]
        shaped.append(own.get(place) or own.get(_FORMS[int(joins_before)]) or letter)
    return "".join(shaped)


@cache
def _forms() -> dict[str, dict[str, str]]:
    """Presentation forms of Arabic letters (U+FB50 to U+FEFF) by letter and place."""
    forms: dict[str, dict[str, str]] = {}
    for code in (*range(0xFB50, 0xFBC2), *range(0xFE80, 0xFEFD)):
        parts = unicodedata.decomposition(chr(code)).split()
        if len(parts) == 2 and parts[0] in _FORMS:
            forms.setdefault(chr(int(parts[1], 16)), {})[parts[0]] = chr(code)
    return forms


_LOG = logging.getLogger(__name__)

BASE_SIZE = 15.0  # pixels of a line of text at 96 dpi
_SEEN = 3.0  # contrast of a dot with what is behind it (WCAG 2.2, 1.4.11)

Rgba = tuple[float, float, float, float]


_BOTH: list[tuple[ImVec4, Rgba, Rgba]] = []  # every color with its dark and its light value


def _both(dark: str, light: str, alpha: float = 1.0) -> ImVec4:
    """A color of both themes; it changes in place, so that no code holds an old one."""
    values = [
        (int(code[:2], 16) / 255, int(code[2:4], 16) / 255, int(code[4:], 16) / 255, alpha)
        for code in (dark, light)
    ]
    color = ImVec4(*values[0])
    _BOTH.append((color, values[0], values[1]))
    return color


ACCENT = _both("5B9DF5", "2F74D0")
ACCENT_STRONG = _both("3F7FD8", "2F74D0")
ACCENT_SOFT = _both("5B9DF5", "2F74D0", 0.28)
TEXT = _both("DFE1E6", "1E2126")
DIM = _both("9DA2AC", "5A606B")
FAINT = _both("6C717B", "7C828E")
GOOD = _both("6BBF8A", "1D7038")
WARN = _both("E3B34F", "855B00")
BAD = _both("EA7068", "B8342C")
PANEL = _both("212328", "F4F5F7")
BACK = _both("1A1B1F", "E6E8EC")
RAISED = _both("2C2F36", "FFFFFF")
HOT = _both("343842", "E1E5EC")
LINE = _both("33363D", "D5D8DE")
LINE_STRONG = _both("474B54", "B4B9C2")
HOVER = _both("FFFFFF", "000000", 0.10)
PRESSED = _both("FFFFFF", "000000", 0.16)
CLEAR = _both("000000", "000000", 0.0)
ON_ACCENT = _both("FFFFFF", "FFFFFF")  # text on the accent
CHOSEN = _both("FFFFFF", "123A70")  # text of what is switched on
POPUP = _both("26282E", "FBFBFC")
FIELD = _both("2C2F36", "FFFFFF")  # ground of what is typed or dragged
SLIDER_GRAB = _both("5B9DF5", "2F74D0", 0.38)  # values are read through it
SLIDER_GRAB_HELD = _both("2F62AD", "8FB8F0")  # and over it while it is dragged
DIMMED = _both("0C0D0F", "40444C", 0.8)  # laid over the window behind a sheet

_COLORS = {
    "text": TEXT,
    "text_disabled": FAINT,
    "text_selected_bg": ACCENT_SOFT,
    "text_link": ACCENT,
    "window_bg": PANEL,
    "child_bg": _both("212328", "F4F5F7", 0.0),
    "popup_bg": POPUP,
    "modal_window_dim_bg": DIMMED,
    "menu_bar_bg": BACK,
    "border": LINE,
    "border_shadow": _both("000000", "000000", 0.0),
    "frame_bg": FIELD,
    "frame_bg_hovered": _both("353941", "E9EDF4"),
    "frame_bg_active": _both("3D424C", "DCE3EE"),
    "title_bg": BACK,
    "title_bg_active": BACK,
    "title_bg_collapsed": BACK,
    "tab": BACK,
    "tab_hovered": _both("353941", "E9EDF4"),
    "tab_selected": PANEL,
    "tab_selected_overline": _both("5B9DF5", "2F74D0", 0.0),
    "tab_dimmed": BACK,
    "tab_dimmed_selected": PANEL,
    "tab_dimmed_selected_overline": _both("5B9DF5", "2F74D0", 0.0),
    "docking_preview": _both("5B9DF5", "2F74D0", 0.5),
    "docking_empty_bg": BACK,
    "button": _both("2F333B", "FFFFFF"),
    "button_hovered": _both("3A3F49", "EDF1F7"),
    "button_active": _both("454B57", "DEE5F0"),
    "header": _both("5B9DF5", "2F74D0", 0.26),
    "header_hovered": _both("FFFFFF", "000000", 0.07),
    "header_active": _both("5B9DF5", "2F74D0", 0.38),
    "check_mark": ACCENT,
    "checkbox_selected_bg": ACCENT_SOFT,
    "slider_grab": SLIDER_GRAB,
    "slider_grab_active": SLIDER_GRAB_HELD,
    "separator": LINE,
    "separator_hovered": _both("5B9DF5", "2F74D0", 0.6),
    "separator_active": ACCENT,
    "resize_grip": _both("000000", "000000", 0.0),
    "resize_grip_hovered": _both("5B9DF5", "2F74D0", 0.4),
    "resize_grip_active": ACCENT,
    "scrollbar_bg": _both("000000", "000000", 0.0),
    "scrollbar_grab": _both("3D424C", "C3C8D0"),
    "scrollbar_grab_hovered": _both("4B515D", "A9AFB9"),
    "scrollbar_grab_active": _both("5B6270", "8F96A2"),
    "plot_lines": ACCENT,
    "plot_lines_hovered": ACCENT,
    "tree_lines": LINE,
    "plot_histogram": ACCENT,
    "plot_histogram_hovered": ACCENT,
    "table_header_bg": _both("26282E", "FBFBFC"),
    "table_border_strong": LINE,
    "table_border_light": _both("2A2D33", "E0E3E8"),
    "table_row_bg": _both("000000", "000000", 0.0),
    "table_row_bg_alt": _both("FFFFFF", "000000", 0.018),
    "drag_drop_target": ACCENT,
    "drag_drop_target_bg": ACCENT_SOFT,
    "unsaved_marker": ACCENT,
    "nav_cursor": ACCENT,
    "nav_windowing_highlight": ACCENT,
    "nav_windowing_dim_bg": _both("0C0D0F", "40444C", 0.3),
    "input_text_cursor": TEXT,
}


class _Loaded:
    """The loaded faces, filled once per window by ``load_fonts``, and the theme in use."""

    regular: imgui.ImFont | None = None
    strong: imgui.ImFont | None = None
    theme: str = "dark"
    looked_for: ClassVar[set[str]] = set()  # letters, with or without success
    merged: ClassVar[set[Path]] = set()  # fonts of the system
    shown: ClassVar[set[str]] = set()  # letters that were drawn and not looked for yet
    codes: ClassVar[dict[int, str]] = {}  # of letters that no font has: what is drawn for them


def load_fonts() -> None:
    """Load the text font with the icons merged in, and its heavier face for headings."""
    _Loaded.looked_for.clear()
    _Loaded.merged.clear()
    _Loaded.codes.clear()
    _Loaded.regular = _load("Inter-Regular.otf")
    _Loaded.strong = _load("Inter-SemiBold.otf")


def load_letters(texts: Iterable[str] = ()) -> bool:
    """Add fonts of the system for letters of ``texts``, and of what was drawn, that are lacking.

    Between frames only. Letters that no font has are drawn as their code: "[1F600]". Whether there
    were new letters: what was drawn is drawn again.
    """
    if _Loaded.regular is None:
        return False
    for text in texts:
        visual(text)
    new = sorted(_Loaded.shown - _Loaded.looked_for)
    _Loaded.shown.clear()
    for letter in new:
        _Loaded.looked_for.add(letter)
        if not _has_glyph(letter):
            # What only joins or styles others needs no sign of its own.
            is_mark = unicodedata.category(letter) in ("Cf", "Mn")
            _Loaded.codes[ord(letter)] = "" if is_mark else f"[{ord(letter):X}]"
    return bool(new)


def _has_glyph(letter: str) -> bool:
    """Whether a loaded font has ``letter``, or one of the system that is loaded for it."""
    assert _Loaded.regular is not None
    if _Loaded.regular.is_glyph_in_font(ord(letter)):
        return True
    for path in fonts_with(letter):
        new = path not in _Loaded.merged and _merge(path)
        if new and _Loaded.regular.is_glyph_in_font(ord(letter)):
            return True
    return False


def _merge(path: Path) -> bool:
    """Merge a font file into both faces; whether it can be read."""
    _Loaded.merged.add(path)
    for face_font in (_Loaded.regular, _Loaded.strong):
        config = imgui.ImFontConfig()
        config.merge_mode = True
        assert face_font is not None
        config.dst_font = face_font
        try:
            imgui.get_io().fonts.add_font_from_file_ttf(str(path), BASE_SIZE, config)
        except RuntimeError as error:
            _LOG.warning("%s cannot be used: %s", path, error)
            return False
    return True


def _load(name: str) -> imgui.ImFont:
    folder = assets() / "fonts"
    text = hello_imgui.FontLoadingParams(inside_assets=False)
    font = hello_imgui.load_font(str(folder / name), BASE_SIZE, text)
    icons = hello_imgui.FontLoadingParams(inside_assets=False, merge_to_last_font=True)
    icons.font_config.glyph_offset = ImVec2(0.0, BASE_SIZE * 0.19)
    icons.font_config.glyph_min_advance_x = BASE_SIZE
    hello_imgui.load_font(str(folder / "lucide.ttf"), BASE_SIZE, icons)
    return font


def use(name: str) -> bool:
    """Take the theme "dark" or "light"; whether that changed anything. Needs a window."""
    if _Loaded.theme == name:
        return False
    _Loaded.theme = name
    for color, dark, light in _BOTH:
        color.x, color.y, color.z, color.w = light if name == "light" else dark
    _apply_colors()
    _apply_edges()
    return True


def _apply_edges() -> None:
    """White fields on a bright ground need a line around them."""
    imgui.get_style().frame_border_size = 1 if _Loaded.theme == "light" else 0


def resize(scale: float) -> bool:
    """Take the user's scale of text, distances and corners; whether it was another one."""
    style = imgui.get_style()
    if style.font_scale_main == scale:
        return False
    apply_style()
    _apply_edges()
    style.scale_all_sizes(scale)
    style.font_scale_main = scale
    return True


def dim_behind(is_dimmed: bool) -> None:
    """Dim the window behind the open sheet, or show it in its own colors."""
    color = DIMMED if is_dimmed else CLEAR
    imgui.get_style().set_color_(imgui.Col_.modal_window_dim_bg, color)


def _apply_colors() -> None:
    style = imgui.get_style()
    for name, color in _COLORS.items():
        index = getattr(imgui.Col_, name, None)
        if index is not None:
            style.set_color_(index, color)


_WHOLE = 1000.0  # pixels: wider than the title of any panel


def apply_style() -> None:
    """Set every color and distance of the window."""
    _apply_colors()
    style = imgui.get_style()
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
    style.tab_min_width_shrink = _WHOLE  # titles are never cut: tabs without room are scrolled to
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


def rim(color: Sequence[float]) -> ImVec4 | None:
    """What a dot of ``color`` (3,) needs around it to be seen on a panel; None: nothing."""
    r, g, b = (float(c) for c in color)
    low, high = sorted((_luminance(r, g, b), _luminance(PANEL.x, PANEL.y, PANEL.z)))
    return DIM if (high + 0.05) / (low + 0.05) < _SEEN else None


@lru_cache(maxsize=1024)  # asked for every dot in every frame
def _luminance(r: float, g: float, b: float) -> float:
    return luminance((r, g, b))


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
    imgui.push_font(_Loaded.strong if strong else _Loaded.regular, BASE_SIZE * scale)
    try:
        yield
    finally:
        imgui.pop_font()
