"""Select by: the histogram of any number, a color, a box, and the selections that were kept."""

from dataclasses import dataclass, field

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.scene.edits import How
from gaga_core.scene.selection.by_value import Histogram, column_names
from gaga_studio.features import selection, transform
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em

_NAMES = 5.5  # width of the names of fields, ems
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
        widgets.empty_state(icons.CHART, "No scene is open", "")
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
    _, held.low, held.high = imgui.drag_float_range2(
        "##Range",
        held.low,
        held.high,
        max(last - first, 1e-9) / 300,
        first,
        last,
        "from %.3f",
        "to %.3f",
    )
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
    imgui.set_next_item_width(-em(6))
    changed, picked = imgui.color_edit3("##Color to select", list(held.color))
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
        held.box = _around(session)
    lo, hi = held.box
    extent = max(float(np.abs(hi - lo).max()), 1e-6)
    widgets.field_name("From", em(_NAMES / 2))
    _, first = imgui.drag_float3("##From", lo.tolist(), extent / 300, 0, 0, "%.3f")
    widgets.field_name("To", em(_NAMES / 2))
    _, last = imgui.drag_float3("##To", hi.tolist(), extent / 300, 0, 0, "%.3f")
    held.box = np.array(first), np.array(last)
    if widgets.button("Fit", hint="Around the selection, else around everything"):
        held.box = _around(session)
    imgui.same_line()
    if widgets.button("Crop", hint="Delete everything outside the box"):
        selection.crop(session, *held.box)
    imgui.same_line()
    how = _how_buttons("box")
    if how:
        selection.in_box(session, *held.box, how)


def _around(session: Session) -> "tuple[np.ndarray, np.ndarray]":
    from gaga_core.scene.selection.bounds import splat_box

    document = session.need()
    chosen = document.selected_box()
    return chosen if chosen is not None else splat_box(document.scene)


def _kept(session: Session, held: SelectBy) -> None:
    widgets.heading("Named selections")
    imgui.set_next_item_width(-em(4))
    _, held.name = imgui.input_text_with_hint("##Name to keep", "Name", theme.noted(held.name))
    imgui.same_line()
    nothing = "" if len(session.selected_indices()) else "Nothing is selected."
    why_not = nothing or ("" if held.name.strip() else "Type a name first.")
    if widgets.button("Keep", why_not=why_not) and selection.keep_selection(session, held.name):
        held.name = ""
    scene = session.need().scene
    for name, splats in scene.named_selections.items():
        imgui.push_id(name)
        room = imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x
        if imgui.selectable(f"{theme.visual(name)}###Take", False, 0, ImVec2(-em(7.5), 0))[0]:
            how: How = "add" if imgui.get_io().key_shift else "set"
            selection.select_named(session, name, how)
        widgets.tooltip("Click selects it, Shift adds it", of_row=True)
        imgui.same_line()
        widgets.dim(f"{splats.count:,}")
        imgui.same_line(room - em(1.8))
        if widgets.icon_button("Forget", icons.CLOSE, hint="Forget this selection"):
            selection.forget_named(session, name)
        imgui.pop_id()
    if not scene.named_selections:
        widgets.dim("None yet.")


def _how_buttons(what: str) -> How | None:
    """Select, add, remove; what was pressed."""
    pressed: How | None = None
    imgui.push_id(what)
    for position, (label, how) in enumerate(_HOWS):
        if position:
            imgui.same_line()
        if widgets.button(label):
            pressed = how
    imgui.pop_id()
    return pressed
