"""Small pieces that every panel uses: buttons that say why they are off, rows, empty states."""

import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import PurePath
from types import MappingProxyType
from typing import TypeVar

from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_studio.ui.kit import theme
from gaga_studio.ui.kit.number_fields import as_typed
from gaga_studio.ui.kit.picture_area import Rect
from gaga_studio.ui.kit.theme import em, visual

T = TypeVar("T", bound=Hashable)


@dataclass(frozen=True)
class Face:
    """How a button looks: text (else its name), icon, width, and whether it is the one to press."""

    text: str = ""
    icon: str = ""
    width: float = 0.0
    primary: bool = False


_PLAIN = Face()
_MORE_LIT = 1.4  # times the opacity of a selected line that the mouse is over
_LOW = 0.5  # share of the panel's height below which a section that opens comes to the top


def tooltip(text: str, shortcut: str = "", *, of_row: bool = False) -> None:
    """Explain the item drawn last when the mouse rests on it, also when it is disabled.

    That of a row of a list stands next to the list, where it covers no other row. An item that the
    mouse holds has none: what it does is looked at.
    """
    flags = imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled
    is_held = imgui.is_item_active() and imgui.is_mouse_down(imgui.MouseButton_.left)
    if not text or is_held or not imgui.is_item_hovered(flags):
        return
    _place_tooltip(text, bool(shortcut), of_row=of_row)
    if imgui.begin_tooltip():
        imgui.push_text_wrap_pos(em(24))
        paragraph(text)
        if shortcut:
            with theme.text_color(theme.DIM):
                imgui.text_unformatted(shortcut)
        imgui.pop_text_wrap_pos()
        imgui.end_tooltip()


_TALL = 4.0  # height of an item from which its tooltip is at the mouse, ems


def _place_tooltip(text: str, has_shortcut: bool, *, of_row: bool) -> None:
    """The tooltip of the item drawn last goes under it, or above it: never over it.

    That ``of_row`` goes to the side of its window that is nearest to the mouse and has room.
    """
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    if high.y - low.y > em(_TALL):
        return
    pad, gap, screen = imgui.get_style().window_padding, em(0.3), imgui.get_main_viewport()
    size = imgui.calc_text_size("\n".join(_lines(text, em(24))), wrap_width=em(24))
    tall = size.y + 2 * pad.y + has_shortcut * imgui.get_text_line_height_with_spacing()
    right, foot = screen.pos.x + screen.size.x, screen.pos.y + screen.size.y
    mouse, wide = imgui.get_io().mouse_pos, size.x + 2 * pad.x
    left = max(min(max(low.x, mouse.x - em(2)), right - wide), screen.pos.x)
    top = high.y + gap if high.y + gap + tall <= foot else low.y - gap - tall
    if of_row:
        corner, extent = imgui.get_window_pos(), imgui.get_window_size()
        begin, end = corner.x - gap - wide, corner.x + extent.x + gap
        above, below = corner.y - gap - tall, corner.y + extent.y + gap
        sides = (  # distance from the mouse, whether there is room, place
            (mouse.x - corner.x, begin >= screen.pos.x, (begin, min(low.y, foot - tall))),
            (end - mouse.x, end + wide <= right, (end, min(low.y, foot - tall))),
            (mouse.y - corner.y, above >= screen.pos.y, (left, above)),
            (below - mouse.y, below + tall <= foot, (left, below)),
        )
        left, top = min((side for side in sides if side[1]), default=(0, True, (left, top)))[2]
    imgui.set_next_window_pos(ImVec2(left, top))


def button(
    label: str, face: Face = _PLAIN, *, why_not: str = "", hint: str = "", shortcut: str = ""
) -> bool:
    """A text button named ``label``; ``why_not`` disables it and is what its tooltip says."""
    if face.primary:
        imgui.push_style_color(imgui.Col_.button, theme.ACCENT_STRONG)
        imgui.push_style_color(imgui.Col_.button_hovered, theme.ACCENT)
        imgui.push_style_color(imgui.Col_.button_active, theme.ACCENT)
        imgui.push_style_color(imgui.Col_.text, theme.ON_ACCENT)
    imgui.begin_disabled(bool(why_not))
    text = theme.plain(face.text or label)
    text = f"{face.icon}  {text}" if face.icon else text
    clicked = imgui.button(f"{text}###{label}", ImVec2(face.width, 0))
    imgui.end_disabled()
    if face.primary:
        imgui.pop_style_color(4)
    tooltip(why_not or hint, shortcut)
    return clicked and not why_not


def next_to(text: str, gap: float = 0.0, extra: float = 0.0) -> None:
    """What is drawn next stands next to the last item where it fits, else below it.

    It is a button that says ``text``, and ``extra`` pixels wider.
    """
    style = imgui.get_style()
    gap = gap or style.item_spacing.x
    width = imgui.calc_text_size(text).x + 2 * style.frame_padding.x + extra
    right = imgui.get_cursor_screen_pos().x + imgui.get_content_region_avail().x
    if imgui.get_item_rect_max().x + gap + width <= right:
        imgui.same_line(0, gap)


def icon_button(
    name: str,
    icon: str,
    *,
    hint: str = "",
    why_not: str = "",
    on: bool = False,
    shortcut: str = "",
    size: float = 0.0,
) -> bool:
    """A square button; ``name`` is its identity for tests, ``hint`` its tooltip."""
    side = size or imgui.get_frame_height()
    imgui.push_style_var(imgui.StyleVar_.frame_border_size, 0.0)
    _push_flat(on)
    imgui.begin_disabled(bool(why_not))
    clicked = imgui.button(f"{icon}###{name}", ImVec2(side * 1.12, side))
    imgui.end_disabled()
    imgui.pop_style_color(4)
    imgui.pop_style_var()
    tooltip(f"{hint or name}: {why_not}" if why_not else hint or name, shortcut)
    return clicked and not why_not


def toggle(label: str, on: bool, *, hint: str, why_not: str = "") -> bool:
    """A text button that stays lit while it is on; whether it was clicked."""
    _push_flat(on, theme.RAISED)  # that it is a button is seen while it is off, too
    imgui.begin_disabled(bool(why_not))
    clicked = imgui.button(label)
    imgui.end_disabled()
    imgui.pop_style_color(4)
    tooltip(why_not or hint)
    return clicked and not why_not


def small_icon(
    name: str, icon: str, *, hint: str = "", color: ImVec4 | None = None, height: float = 0.0
) -> bool:
    """A borderless icon of text height, for table rows; ``height`` 0 is the usual one."""
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(2, 0))
    imgui.push_style_var(imgui.StyleVar_.frame_border_size, 0.0)
    _push_flat(False)
    imgui.push_style_color(imgui.Col_.text, color or theme.DIM)
    clicked = imgui.button(f"{icon}###{name}", ImVec2(em(1.35), height or em(1.25)))
    imgui.pop_style_color(5)
    imgui.pop_style_var(2)
    tooltip(hint)
    return clicked


def segmented(
    name: str,
    choices: Sequence[tuple[T, str, str, str]],
    current: T,
    *,
    why_not: Mapping[T, str],
    with_text: bool = True,
    wraps: bool = False,
) -> T:
    """One choice of several in one control; each choice is (value, icon, label, hint).

    One that ``wraps`` goes on in another line where the window ends.
    """
    imgui.push_id(name)
    picked = current
    left, right = imgui.get_cursor_pos_x(), imgui.get_content_region_avail().x
    right += imgui.get_cursor_screen_pos().x
    for position, (value, icon, label, hint) in enumerate(choices):
        text = f"{icon}  {label}" if icon and with_text else icon or label
        if position:
            width = imgui.calc_text_size(text).x + 2 * imgui.get_style().frame_padding.x
            if wraps and imgui.get_item_rect_max().x + theme.scaled(1) + width > right:
                imgui.set_cursor_pos_x(left)
            else:
                imgui.same_line(0, theme.scaled(1))
        reason = why_not.get(value, "")
        _push_flat(value == current, rest=theme.RAISED)
        imgui.begin_disabled(bool(reason))
        if imgui.button(f"{text}###{label}"):
            picked = value
        imgui.end_disabled()
        imgui.pop_style_color(4)
        tooltip(f"{label}: {reason}" if reason else hint)
    imgui.pop_id()
    return picked


def _push_flat(on: bool, rest: ImVec4 | None = None) -> None:
    """Push the four colors of a flat toggle."""
    imgui.push_style_color(imgui.Col_.button, theme.ACCENT_SOFT if on else rest or theme.CLEAR)
    imgui.push_style_color(imgui.Col_.button_hovered, theme.HOVER)
    imgui.push_style_color(imgui.Col_.button_active, theme.PRESSED)
    imgui.push_style_color(imgui.Col_.text, theme.CHOSEN if on else theme.TEXT)


def text(words: str, color: ImVec4, *, wrap: bool = False) -> None:
    """Text in a color; ``wrap``: in as many lines as the panel needs."""
    with theme.text_color(color):
        if wrap:
            paragraph(words)
        else:
            imgui.text_unformatted(theme.plain(words))


def paragraph(words: str) -> None:
    """Text in as many lines as the panel, or the position that was pushed to wrap at, needs.

    They end at spaces: the toolkit would part ".splat" after its dot. It parts what is too long.
    """
    edge = max(imgui.internal.get_current_window().dc.text_wrap_pos, 0.0)
    room = imgui.internal.calc_wrap_width_for_pos(imgui.get_cursor_screen_pos(), edge)
    imgui.push_text_wrap_pos(edge)
    imgui.text_unformatted("\n".join(map(visual, _lines(words, room))))
    imgui.pop_text_wrap_pos()


def dim(words: str, wrap: bool = False) -> None:
    """Secondary text."""
    text(words, theme.DIM, wrap=wrap)


def heading(text: str) -> None:
    """The title of a section of a panel."""
    imgui.dummy(ImVec2(0, em(0.15)))
    with theme.face(strong=True, scale=0.93), theme.text_color(theme.DIM):
        imgui.text_unformatted(text)


@contextmanager
def submenu(label: str, entries: Iterable[str], *, why_not: str = "") -> Iterator[bool]:
    """A menu next to its line in a menu; whether it is open. ``entries``: its words and keys.

    Grey, it says ``why_not`` in its tooltip.
    Where neither side has room for them it unfolds below its line: it would cover the menu.
    """
    pad = imgui.get_style().window_padding.x
    needed = max((imgui.calc_text_size(words).x for words in entries), default=0.0) + em(6)
    left, screen = imgui.get_window_pos().x, imgui.get_main_viewport()
    right = screen.pos.x + screen.size.x - left - imgui.get_window_width()
    if needed <= max(left - screen.pos.x, right) + pad:
        is_open = imgui.begin_menu(label, not why_not)
        if not is_open:
            tooltip(why_not, of_row=True)
        yield is_open
        if is_open:
            imgui.end_menu()
        return
    flags = imgui.TreeNodeFlags_.span_avail_width | imgui.TreeNodeFlags_.no_tree_push_on_open
    imgui.begin_disabled(bool(why_not))
    is_open = imgui.tree_node_ex(label.partition("  ")[2] or label, flags)  # an arrow for the icon
    imgui.end_disabled()
    tooltip(why_not, of_row=True)
    yield is_open


def section(label: str, was_open: bool | None = None) -> bool:
    """The heading of a section that opens and closes; whether it is open.

    ``was_open``: in the frame before, where the window does not keep it.
    """
    imgui.dummy(ImVec2(0, em(0.1)))
    imgui.separator()
    imgui.push_style_color(imgui.Col_.header, theme.CLEAR)
    imgui.push_style_color(imgui.Col_.header_hovered, theme.HOVER)
    imgui.push_style_color(imgui.Col_.header_active, theme.PRESSED)
    # The arrow stands under the words above it: half the panel's padding is the header's own.
    pad = ImVec2(imgui.get_style().window_padding.x / 2, imgui.get_style().frame_padding.y)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, pad)
    imgui.push_style_var(imgui.StyleVar_.frame_border_size, 0.0)
    if was_open is not None:
        imgui.set_next_item_open(was_open)
    shown, mark, name = label.partition("###")
    with theme.face(strong=True, scale=0.93), theme.text_color(theme.DIM):
        arrow = imgui.get_font_size() + 3 * pad.x
        shown = elided(shown, imgui.get_content_region_avail().x - arrow) if mark else shown
        opened = imgui.collapsing_header(f"{shown}{mark}{name}")
    low = imgui.get_item_rect_min().y - imgui.get_window_pos().y
    if imgui.is_item_toggled_open() and low > _LOW * imgui.get_window_height():
        imgui.set_scroll_here_y(0.0)  # what was asked for is seen
    imgui.pop_style_var(2)
    imgui.pop_style_color(3)
    return opened


def field_name(name: str, width: float, right: float = 0.0) -> None:
    """Name of the field that is drawn next, left of it, in a column of ``width`` pixels.

    The field takes the rest of the line, but ``right`` pixels; it is called ``##name``.
    """
    left = imgui.get_cursor_pos_x()
    imgui.align_text_to_frame_padding()
    dim(elided(name, width))
    imgui.same_line(left + width)
    imgui.set_next_item_width(-right if right else -1.0)


def under_fields(width: float) -> None:
    """What is drawn next, a box to tick say, begins where the fields do."""
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + width)


def checkbox(label: str, value: bool) -> tuple[bool, bool]:
    """A box to tick, with an edge that is seen while it is empty."""
    with _edge():
        return imgui.checkbox(label, value)


def tick(label: str, value: bool, hint: str = "", indent: float = 0.0) -> bool:
    """A box to tick with its tooltip, ``indent`` pixels from the left; its value."""
    under_fields(indent)
    _, value = checkbox(label, value)
    tooltip(hint)
    return value


def choice(
    name: str,
    named: Mapping[T, str],
    current: T,
    width: float,
    why_not: Mapping[T, str] | None = None,
    hint: str = "",
) -> T:
    """A field with a list to choose from, right of its name, ``width`` pixels; what is chosen."""
    field_name(name, width)
    return combo(name, named, current, why_not, hint)


def combo(
    name: str,
    named: Mapping[T, str],
    current: T,
    why_not: Mapping[T, str] | None = None,
    hint: str = "",
) -> T:
    """A list to choose from; a choice with a reason why not cannot be taken.

    While it is open, arrows move through it, Enter takes a choice and Escape closes it.
    """
    shown = current
    text = named.get(current) or next(iter(named.values()), "")
    if imgui.begin_combo(f"##{name}", theme.visual(text)):
        if imgui.is_window_appearing():
            imgui.set_nav_cursor_visible(True)  # what Enter chooses is seen
        for value, label in named.items():
            reason = why_not.get(value, "") if why_not else ""
            imgui.begin_disabled(bool(reason))
            if imgui.selectable(f"{theme.visual(label)}###{name} {value}", value == shown)[0]:
                current = value
            if value == shown:
                imgui.set_item_default_focus()
            imgui.end_disabled()
            tooltip(reason)
        imgui.end_combo()
    elif hint:
        tooltip(hint)
    return current


N = TypeVar("N", int, float)


def slider(
    label: str,
    value: N,
    low: N,
    high: N,
    form: str = "%.2f",
    flags: int = imgui.SliderFlags_.always_clamp,
    *,
    ticks: Sequence[float] = (),
    words: Mapping[N, str] = MappingProxyType({}),
) -> tuple[bool, N]:
    """A slider whose number stands right of it, where no knob covers it.

    ``ticks`` are values that get a mark under the middle of the knob that stands there; ``words``
    stand instead of the numbers that they are of.
    """

    def said(at: N) -> str:
        return words.get(at) or form % at

    gap = imgui.get_style().item_inner_spacing.x
    room = max(imgui.calc_text_size(said(end)).x for end in (low, high, value))
    is_typed = imgui.internal.temp_input_is_active(imgui.get_id(label))
    imgui.set_next_item_width(max(imgui.calc_item_width() - room - gap, em(2)))
    imgui.begin_group()
    imgui.push_style_color(imgui.Col_.text, theme.TEXT if is_typed else theme.CLEAR)
    drawn = imgui.slider_int if isinstance(value, int) else imgui.slider_float
    before = value
    changed, value = drawn(label, value, low, high, form, flags)  # type: ignore[arg-type]
    changed, at = as_typed(label, before, (changed, value), form, (low, high))
    value = round(at) if isinstance(value, int) else at
    imgui.pop_style_color()
    top, foot = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    for tick in ticks:
        x = knob_at(top.x, foot.x, (tick - low) / (high - low))
        a, b = ImVec2(x, foot.y - em(0.25)), ImVec2(x, foot.y)
        imgui.get_window_draw_list().add_line(a, b, theme.u32(theme.ACCENT), theme.scaled(2))
    imgui.same_line(0, gap)
    left = imgui.get_cursor_pos_x()
    shown = said(value)
    imgui.set_cursor_pos_x(left + room - imgui.calc_text_size(shown).x)
    imgui.text_unformatted(shown)
    imgui.end_group()
    return changed, value


_GRAB_PADDING = 2.0  # pixels between a slider's frame and its knob, whatever the style: of ImGui


def knob_at(left: float, right: float, share: float) -> float:
    """Where the middle of the knob of a slider from ``left`` to ``right`` stands at a share of its
    range, pixels."""
    pad = _GRAB_PADDING + imgui.get_style().grab_min_size / 2
    return left + pad + (right - left - 2 * pad) * share


def radio_button(label: str, is_chosen: bool) -> bool:
    """One of several, with an edge that is seen while it is empty."""
    with _edge():
        return imgui.radio_button(label, is_chosen)


@contextmanager
def _edge() -> Iterator[None]:
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    imgui.push_style_var(imgui.StyleVar_.frame_border_size, theme.scaled(1))
    try:
        yield
    finally:
        imgui.pop_style_var()
        imgui.pop_style_color()


def number(text: str, color: ImVec4 | None = None) -> None:
    """Text at the right edge of the room left in this column."""
    room = imgui.get_content_region_avail().x
    width = imgui.calc_text_size(text).x
    if room > width:
        imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + room - width)
    with theme.text_color(color or theme.TEXT):
        imgui.text_unformatted(text)


def elided(text: str, width: float) -> str:
    """``text`` as it is drawn, cut with an ellipsis so that it fits ``width`` pixels.

    A path is cut in its folders: the name of the file, and what is said after it, stay.
    """
    return _cut(visual(text), lambda shorter: imgui.calc_text_size(shorter).x <= width)


def few_lines(text: str, width: float, most: int = 2) -> list[str]:
    """``text`` on at most so many lines of ``width`` pixels, parted at spaces, cut as `elided`."""

    def fits(shorter: str) -> bool:
        lines = _lines(shorter, width)
        return len(lines) <= most and all(imgui.calc_text_size(x).x <= width for x in lines)

    text = theme.plain(text).replace("\n", r"\n")
    return [visual(part) for part in _lines(_cut(text, fits), width)]


# The folders of a path in a sentence, or of one that is all there is; what follows is its end.
_FOLDERS = re.compile(
    r"(?:(?:^|\s)(?:~|\w:)?[/\\](?=\S).*(?=[/\\]\S)|^\S*(?=[/\\]\S+$))", re.DOTALL
)


def _cut(text: str, fits: Callable[[str], bool]) -> str:
    """``text`` if it ``fits``, else with an ellipsis for as few letters as need be."""
    if fits(text):
        return text
    folders = _FOLDERS.search(text)
    end = text[folders.end() :] if folders is not None else ""
    if end and not fits(f"…{end}"):
        text, end = f"…{end}", ""
    low, high = 0, len(text) - len(end)
    while low < high:
        middle = (low + high + 1) // 2
        if fits(f"{text[:middle]}…{end}"):
            low = middle
        else:
            high = middle - 1
    return f"{text[:low]}…{end}"


def hint_of_field(*hints: str) -> str:
    """The first hint that the text field drawn next has room for, else the last one, cut."""
    room = imgui.calc_item_width() - 2 * imgui.get_style().frame_padding.x
    fits = (hint for hint in hints if imgui.calc_text_size(hint).x <= room)
    return next(fits, "") or elided(hints[-1], room)


def elided_name(name: str, width: float) -> str:
    """The name of a file or a folder as it is drawn, cut in the middle to ``width`` pixels."""
    return cut_middle(visual(name), lambda shorter: imgui.calc_text_size(shorter).x <= width)


def cut_middle(name: str, fits: Callable[[str], bool]) -> str:
    """``name`` if it ``fits``, else its two ends: names in one place differ at either.

    What says of which kind a file is stays.
    """
    if fits(name):
        return name
    ending = len(PurePath(name).suffix)

    def shown(n: int) -> str:
        n_last = min(max(n // 2, ending), n)
        return f"{name[: n - n_last]}…{name[len(name) - n_last :]}"

    low, high = 0, len(name) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if fits(shown(middle)):
            low = middle
        else:
            high = middle - 1
    return shown(low)


def line(text: str, color: ImVec4 | None = None, width: float = 0.0) -> None:
    """One line of text that is whole in its tooltip where it is cut.

    That is at the edge of the panel, or at ``width`` pixels.
    """
    shown = elided(text, width or imgui.get_content_region_avail().x)
    with theme.text_color(color or theme.TEXT):
        imgui.text_unformatted(shown)
    if shown != visual(text):
        tooltip(text)


def rgba(color: Sequence[float], alpha: float = 1.0) -> ImVec4:
    """A color (3,), 0..1, for the toolkit."""
    return ImVec4(float(color[0]), float(color[1]), float(color[2]), alpha)


def dot(centre: ImVec2, radius: float, color: Sequence[float], alpha: float = 1.0) -> None:
    """A dot in the color (3,) of an object, with a rim where the panel hides that color."""
    drawing = imgui.get_window_draw_list()
    drawing.add_circle_filled(centre, radius, imgui.get_color_u32(rgba(color, alpha)), 20)
    rim = theme.rim(color)
    if rim is not None:
        drawing.add_circle(centre, radius, theme.u32(rim, alpha), 20, theme.scaled(1.2))


_CARD = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.always_auto_resize
    | imgui.WindowFlags_.no_docking
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_focus_on_appearing
    | imgui.WindowFlags_.no_nav
    | imgui.WindowFlags_.no_move
)


def card(name: str, width: float, draw: Callable[[], object]) -> None:
    """A part of a panel with a ground and an edge of its own, as high as what ``draw`` shows."""
    imgui.push_style_color(imgui.Col_.child_bg, theme.POPUP)
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    flags = imgui.ChildFlags_.borders | imgui.ChildFlags_.always_use_window_padding
    flags |= imgui.ChildFlags_.auto_resize_y
    flags |= imgui.ChildFlags_.none if width else imgui.ChildFlags_.auto_resize_x
    if imgui.begin_child(name, ImVec2(width, 0), flags):
        draw()
    imgui.end_child()
    imgui.pop_style_color(2)


def item_rect() -> Rect:
    """Where the item is that was drawn last."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    return low.x, low.y, high.x, high.y


def floating_card(name: str, draw: Callable[[], object], *, scrolls: bool = False) -> None:
    """A small window over the picture, where it was placed before, without a title."""
    imgui.push_style_color(imgui.Col_.window_bg, theme.POPUP)
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    imgui.push_style_var(imgui.StyleVar_.window_border_size, theme.scaled(1))
    imgui.push_style_var(imgui.StyleVar_.window_rounding, theme.scaled(6))
    bar = imgui.WindowFlags_.always_vertical_scrollbar if scrolls else 0
    imgui.begin(name, None, _CARD | bar)
    draw()
    imgui.end()
    imgui.pop_style_var(2)
    imgui.pop_style_color(2)


def popup(
    name: str,
    draw: Callable[[], object],
    *,
    of_item: bool = False,
    of_button: bool = False,
    of_panel: bool = False,
) -> None:
    """What ``draw`` shows while a popup is open; ``of_item``: the menu of the item drawn last.

    ``of_button``: it is opened by that item and does not cover it. ``of_panel``: nor the picture
    next to the panel, from whose outer edge it begins.
    """
    if of_button or of_panel:
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        if of_panel:
            panel = imgui.internal.get_current_window().root_window.rect()
            low, high = ImVec2(panel.min.x, low.y), ImVec2(panel.max.x, high.y)
        middle = imgui.get_main_viewport().get_center()
        is_low = high.y > middle.y
        is_right = (low.x + high.x) / 2 > middle.x if of_panel else low.x > middle.x
        gap = theme.scaled(2)
        at = ImVec2(high.x if is_right else low.x, low.y - gap if is_low else high.y + gap)
        imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(float(is_right), float(is_low)))
        screen = imgui.get_main_viewport()
        room = at.y - screen.pos.y if is_low else screen.pos.y + screen.size.y - at.y
        imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(screen.size.x, room - gap))
    if imgui.begin_popup_context_item(name) if of_item else imgui.begin_popup(name):
        draw()
        imgui.end_popup()


@contextmanager
def lit_while_hovered(is_selected: bool) -> Iterator[None]:
    """A selected line inside the block looks selected under the mouse, too."""
    color = imgui.get_style_color_vec4(
        imgui.Col_.header if is_selected else imgui.Col_.header_hovered
    )
    alpha = min(color.w * _MORE_LIT, 1.0) if is_selected else color.w
    imgui.push_style_color(imgui.Col_.header_hovered, ImVec4(color.x, color.y, color.z, alpha))
    try:
        yield
    finally:
        imgui.pop_style_color()


def enter_pressed() -> bool:
    """Whether Enter, of the letters or of the numbers, went down in this frame."""
    keys = (imgui.Key.enter, imgui.Key.keypad_enter)
    return any(imgui.is_key_pressed(key, False) for key in keys)


def empty_state(icon: str, title: str, detail: str) -> None:
    """What a panel shows while it has nothing: a sign, what is missing, what to do."""
    room = imgui.get_content_region_avail()
    roomy = room.y > em(8)
    if roomy:
        imgui.dummy(ImVec2(0, min(room.y * 0.16, em(2.2))))
        with theme.face(scale=1.7), theme.text_color(theme.FAINT):
            _centred(icon)
    with theme.face(strong=True):
        wrapped(title, theme.TEXT)
    if detail:
        wrapped(detail, theme.DIM)


def wrapped(text: str, color: ImVec4) -> None:
    """Text in centred lines that fit the panel."""
    width = imgui.get_content_region_avail().x - em(0.5)
    with theme.text_color(color):
        for part in _lines(text, width):
            _centred(visual(part))


def _lines(text: str, width: float) -> list[str]:
    """The lines of ``text``, those wider than ``width`` pixels parted at spaces."""
    lines: list[str] = []
    for whole in theme.plain(text).split("\n"):
        if imgui.calc_text_size(whole).x <= width:
            lines.append(whole)
            continue
        words = whole.split()
        lines += words[:1]
        for word in words[1:]:
            joined = f"{lines[-1]} {word}"
            if imgui.calc_text_size(joined).x <= width:
                lines[-1] = joined
            else:
                lines.append(word)
    return lines


def _centred(text: str) -> None:
    room = imgui.get_content_region_avail().x
    offset = (room - imgui.calc_text_size(text).x) / 2
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(offset, 0.0))
    imgui.text_unformatted(text)
