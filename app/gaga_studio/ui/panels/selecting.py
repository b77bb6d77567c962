"""Select by: the histogram of any number, a color, a box, and the selections that were kept."""

from dataclasses import dataclass, field

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.scene.edits import How
from gaga_core.scene.selection.by_value import LENGTHS, Histogram, column_names
from gaga_studio.features import measure, selection, transform
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.number_fields import drag_point, drag_range
from gaga_studio.ui.kit.theme import em

_NAMES = 5.5  # width of the names of fields, ems
_THREE_NUMBERS = 18.0  # width from which on a color's numbers stand next to it, ems
_FORGET = 1.5  # width of what forgets a named selection, ems
_HOWS: tuple[tuple[str, How], ...] = (("Select", "set"), ("Add", "add"), ("Remove", "remove"))


@dataclass
class SelectBy:
    """What the panel holds until a button is pressed."""

    histograms: selection.Histograms = field(default_factory=selection.Histograms)
    column: str = ""
    low: float = 0.0
    high: float = 1.0
    color: tuple[float, float, float] = (0.5, 0.5, 0.5)
    tolerance: float = 0.1
    box: tuple[DoubleArray, DoubleArray] | None = None  # lo, hi (3,) world
    name: str = ""  # half typed


def draw(session: Session, held: SelectBy) -> None:
    """The whole panel."""
    if session.document is None:
        widgets.empty_state(icons.CHART, session.nothing_open_text, "")
        return
    _by_number(session, held)
    _by_color(session, held)
    _by_box(session, held)
    _kept(session, held)


def _by_number(session: Session, held: SelectBy) -> None:
    widgets.heading("A number of the splats")
    names = list(column_names(session.need().scene))
    before = held.column if held.column in names else names[0]
    imgui.set_next_item_width(-1)
    column = widgets.combo("Column", {name: name for name in names}, before)
    found = held.histograms.of(session, column)
    if column != held.column:
        held.column = column
        held.low, held.high = float(found.edges[0]), float(found.edges[-1])
    _bars(found, held.low, held.high)
    first, last = float(found.edges[0]), float(found.edges[-1])
    imgui.set_next_item_width(-1)
    speed = max(last - first, 1e-9) / 300
    form = measure.number_format(session) if column in LENGTHS else "%.3f"
    _, now = drag_range("##Range", (held.low, held.high), speed, (first, last), form)
    held.low, held.high = now
    how = _how_buttons("number")
    if how:
        # The outermost bins hold what lies beyond them.
        low = held.low if held.low > first else -np.inf
        high = held.high if held.high < last else np.inf
        selection.by_range(session, held.column, float(low), float(high), how)


def _bars(found: Histogram, low: float, high: float) -> None:
    """Counts as bars, the selection's in the accent; what is out of range is faint."""
    width, height = imgui.get_content_region_avail().x, em(4.2)
    corner = imgui.get_cursor_screen_pos()
    imgui.dummy(ImVec2(width, height))
    drawing = imgui.get_window_draw_list()
    # Square roots: a bin of ten is visible next to one of a million.
    tall = np.sqrt(found.counts / max(int(found.counts.max()), 1))
    own = np.sqrt(found.chosen / max(int(found.counts.max()), 1))
    step = width / len(found.counts)
    middles = (found.edges[1:] + found.edges[:-1]) / 2
    for i, middle in enumerate(middles):
        left, right = corner.x + i * step, corner.x + (i + 1) * step - theme.scaled(1)
        foot = corner.y + height
        color = theme.DIM if low <= middle <= high else theme.LINE_STRONG
        for share, shade in ((tall[i], color), (own[i], theme.ACCENT)):
            if share > 0:
                top = ImVec2(left, foot - float(share) * height)
                drawing.add_rect_filled(top, ImVec2(right, foot), theme.u32(shade))


def _by_color(session: Session, held: SelectBy) -> None:
    widgets.heading("A color")
    is_narrow = imgui.get_content_region_avail().x < em(_THREE_NUMBERS)
    flags = imgui.ColorEditFlags_.no_inputs if is_narrow else imgui.ColorEditFlags_.none
    imgui.set_next_item_width(-em(6))
    changed, picked = imgui.color_edit3("##Color to select", list(held.color), flags)
    if changed:
        held.color = (picked[0], picked[1], picked[2])
    imgui.same_line()
    why_not = "" if len(session.selected_indices()) else "Nothing is selected."
    if widgets.button("Take", why_not=why_not, hint="The mean color of the selection"):
        red, green, blue = transform.selected_color(session).tolist()
        held.color = (red, green, blue)
    widgets.field_name("Tolerance", em(_NAMES))
    _, held.tolerance = widgets.slider("##Tolerance", held.tolerance, 0.01, 0.5)
    how = _how_buttons("color")
    if how:
        selection.by_color(session, held.color, held.tolerance, how)


def _by_box(session: Session, held: SelectBy) -> None:
    widgets.heading("A box")
    if held.box is None:
        held.box = selection.box_around(session)
    lo, hi = held.box
    extent = max(float(np.abs(hi - lo).max()), 1e-6)
    widgets.field_name("From", em(_NAMES / 2))
    form = measure.number_format(session)
    _, first = drag_point("##From", tuple(lo.tolist()), extent / 300, form)
    widgets.field_name("To", em(_NAMES / 2))
    _, last = drag_point("##To", tuple(hi.tolist()), extent / 300, form)
    held.box = np.array(first), np.array(last)
    if widgets.button("Fit", hint="Around the selection, else around all that is shown"):
        held.box = selection.box_around(session)
    widgets.next_to("Crop")
    if widgets.button("Crop", hint="Delete everything outside the box"):
        selection.crop(session, *held.box)
    widgets.next_to(_HOWS[0][0])
    how = _how_buttons("box")
    if how:
        selection.in_box(session, *held.box, how)


def _kept(session: Session, held: SelectBy) -> None:
    widgets.heading("Named selections")
    imgui.set_next_item_width(-em(4))
    entered, held.name = imgui.input_text_with_hint(
        "##Name to keep",
        "Name",
        theme.noted(held.name),
        flags=imgui.InputTextFlags_.enter_returns_true,
    )
    imgui.same_line()
    nothing = "" if len(session.selected_indices()) else "Nothing is selected."
    why_not = nothing or ("" if held.name.strip() else "Type a name first.")
    if widgets.button("Keep", why_not=why_not) or entered:
        session.hint = why_not
        if not why_not and selection.keep_selection(session, held.name):
            held.name = ""
    named = session.need().scene.named_selections
    for name, splats in named.items():
        imgui.push_id(name)
        _kept_row(session, name, f"{splats.count:,}")
        imgui.pop_id()
    if not named:
        widgets.dim("None yet.")


def _kept_row(session: Session, name: str, count: str) -> None:
    """A name, what selects it, as wide as the panel has room next to its count and its end."""
    room, gap = imgui.get_content_region_avail().x, em(0.4)
    end = room - em(_FORGET)
    width = end - 2 * gap - imgui.calc_text_size(count).x
    shown = widgets.elided(name, width)
    if imgui.selectable(f"{shown}###Take", False, 0, ImVec2(width, 0))[0]:
        how: How = "add" if imgui.get_io().key_shift else "set"
        selection.select_named(session, name, how)
    whole = "" if shown == theme.visual(name) else f"{name}\n"
    widgets.tooltip(f"{whole}Click selects it, Shift adds it", of_row=True)
    left = imgui.get_item_rect_min().x - imgui.get_window_pos().x
    imgui.same_line(left + width + gap)
    widgets.dim(count)
    imgui.same_line(left + end)
    if widgets.small_icon("Forget", icons.CLOSE, hint="Forget this selection"):
        selection.forget_named(session, name)


def _how_buttons(what: str) -> How | None:
    """Select, add, remove; what was pressed."""
    pressed: How | None = None
    imgui.push_id(what)
    for position, (label, how) in enumerate(_HOWS):
        if position:
            widgets.next_to(label)
        if widgets.button(label):
            pressed = how
    imgui.pop_id()
    return pressed
