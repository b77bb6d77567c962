"""The filter of the object list: ranges of size, splats, confidence and quality."""

import numpy as np
from imgui_bundle import imgui

from gaga_core.arrays import DoubleArray
from gaga_core.scene.objects import ObjectTable
from gaga_studio.features import object_list
from gaga_studio.features.find.search import SearchState
from gaga_studio.features.object_list import ListFilter, Measure, ObjectListView, Range
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em

_POPUP = "Filter of the list"
_ROWS: tuple[tuple[Measure, str, str], ...] = (
    ("size", "Size", "Diameter, scene units"),
    ("splats", "Splats", "Number of splats"),
    ("confidence", "Confidence", "How sure the vote of the masks was, on average"),
    ("quality", "Quality", "Agreement of its picture with its masks"),
)
_UNKNOWN = {
    "confidence": "The confidence of the groups is not known. Use Find objects.",
    "quality": "Nothing is measured. Use Find, Measure the quality of the objects.",
}


def button(session: Session) -> None:
    """The button next to the search box, and what it opens."""
    is_on = session.need().feature(ObjectListView).filter.is_on
    hint = "List only objects of some size, confidence or quality"
    if widgets.icon_button("Filter", icons.FILTER, hint=hint, on=is_on):
        imgui.open_popup(_POPUP)
    if imgui.begin_popup(_POPUP):
        _ranges(session)
        widgets.escape_closes()
        imgui.end_popup()


def foot(session: Session, table: ObjectTable) -> bool:
    """How many objects the filter lists, of what is looked for, and its end; False while off."""
    listing = session.need().feature(ObjectListView)
    kept = object_list.kept_rows(session, table)
    if kept is None:
        return False
    n_kept, n = int(np.count_nonzero(kept)), int(np.count_nonzero(table.ids > 0))
    text, search = f"{n_kept:,} of {n:,} objects", session.need().feature(SearchState)
    if search.text.strip():
        n_kept = len(search.meant)
        text = f"{n_kept:,} of {n_kept + search.n_left_out:,} that fit"
    with theme.text_color(theme.ACCENT if n_kept else theme.WARN):
        imgui.text_unformatted(text)
    imgui.same_line()
    if widgets.small_icon("Clear filter", icons.CLOSE, hint="List all objects again"):
        listing.filter = ListFilter()
    return True


def _ranges(session: Session) -> None:
    """A range for each measure; what nothing is known of says why."""
    table = session.objects()
    measures = object_list.measures(session, table)
    widgets.heading("List only objects with")
    for measure, name, hint in _ROWS:
        _range(session, table, (measure, name, hint), measures[measure])
    imgui.dummy(imgui.ImVec2(0, em(0.2)))
    listing = session.need().feature(ObjectListView)
    why_not = "" if listing.filter.is_on else "Nothing is left out."
    if widgets.button("Clear", why_not=why_not):
        listing.filter = ListFilter()
    imgui.same_line()
    kept = int(np.count_nonzero(listing.filter.keeps(table, measures)))
    widgets.dim(f"{kept:,} of {int((table.ids > 0).sum()):,} objects")


def _range(
    session: Session, table: ObjectTable, row: tuple[Measure, str, str], values: DoubleArray
) -> None:
    measure, name, hint = row
    listing = session.need().feature(ObjectListView)
    whole = object_list.whole_range(table, measure, values)
    why_not = _UNKNOWN.get(measure, "") if whole is None else ""
    imgui.align_text_to_frame_padding()
    widgets.dim(name)
    imgui.same_line(em(6.5))
    imgui.set_next_item_width(em(13))
    imgui.begin_disabled(bool(why_not))
    low, high = whole or (0.0, 1.0)
    now = listing.filter.ranges.get(measure, (low, high))
    wanted = _drag(measure, now, (low, high))
    imgui.end_disabled()
    widgets.tooltip(why_not or f"{hint}: drag, or double click and type")
    if wanted is not None and not why_not:
        listing.filter = listing.filter.within(measure, wanted, (low, high))


def _drag(measure: Measure, now: Range, whole: Range) -> Range | None:
    """Two numbers that are dragged; None while they stay."""
    flags = imgui.SliderFlags_.always_clamp
    low, high = whole
    if measure == "splats":
        speed = max((high - low) / 200, 0.2)
        whole_numbers = imgui.drag_int_range2(
            f"##{measure}", int(now[0]), int(now[1]), speed, int(low), int(high), "from %d",
            "to %d", flags,
        )  # fmt: skip
        is_new, first, last = whole_numbers
        return (float(first), float(last)) if is_new else None
    is_share = measure in ("confidence", "quality")
    scale, form = (100.0, "%.0f %%") if is_share else (1.0, "%.3g")
    speed = max((high - low) * scale / 200, 1e-6)
    found = imgui.drag_float_range2(
        f"##{measure}", now[0] * scale, now[1] * scale, speed, low * scale, high * scale,
        f"from {form}", f"to {form}", flags,
    )  # fmt: skip
    return (found[1] / scale, found[2] / scale) if found[0] else None
