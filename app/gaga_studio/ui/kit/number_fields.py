"""Fields of numbers that are dragged, or typed with a unit ("80 cm") or a decimal comma.

Dear ImGui reads what is typed with ``sscanf``, which drops what follows the number. Here a field
reports nothing while it is typed in; when that ends, its text is read with the unit that the field
shows.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from imgui_bundle import imgui

from gaga_core.scene.frame import LENGTHS, metres_of, number_of

Limits = tuple[float, float]

# By the unit that a field shows: units that are understood in it, and how many of it each one is.
_UNITS: Mapping[str, Mapping[str, float]] = {
    "m": LENGTHS,
    "°": {"°": 1.0, "deg": 1.0, "degree": 1.0, "degrees": 1.0, "rad": math.degrees(1)},
    "kg": {"kg": 1.0, "g": 1e-3, "t": 1e3, "lb": 0.45359237},
    "kg/m³": {"kg/m³": 1.0, "kg/m3": 1.0, "g/cm³": 1e3, "g/cm3": 1e3},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0},
    "min": {"min": 1.0, "s": 1 / 60, "h": 60.0},
    "×": {"×": 1.0, "x": 1.0},
    "%%": {"%": 1.0},
    "MB": {"mb": 1.0, "gb": 1e3},
    "M": {"m": 1.0, "k": 1e-3},
}
_EXAMPLES = {"m": "a length as 1.5 m, 80 cm, 12 in or 5 ft", "°": "an angle as 45 or 0.5 rad"}
_NO_SCALE = "a number: lengths with a unit need a scene with a scale (Set scale)"
_SHOWN_UNIT = re.compile(r"%[.0-9]*[dfg] ?(%%|[^\s%]*)")  # of a format


@dataclass
class _Typing:
    """The field that is typed in: one at most, as Dear ImGui has it."""

    item: int = 0
    frame: int = 0  # in which it was last drawn
    before: str = ""  # its text when that began
    text: str = ""
    not_read: str = ""  # what to tell of a text that was no number, or none that can be


_typing = _Typing()


def take_not_read() -> str:
    """Return the sentence of a text that could not be taken since the last call, or nothing."""
    text, _typing.not_read = _typing.not_read, ""
    return text


def drag(
    label: str,
    value: float,
    speed: float,
    form: str,
    limits: Limits | None = None,
    *,
    empty: str = "",
    flags: int = 0,
) -> tuple[bool, float]:
    """A number that is dragged or typed; ``empty`` is shown instead of 0."""
    low, high = limits or (0.0, 0.0)
    flags |= imgui.SliderFlags_.none if limits is None else imgui.SliderFlags_.always_clamp
    shown = empty if empty and value == 0 else form
    dragged = imgui.drag_float(label, value, speed, low, high, shown, flags)
    return as_typed(label, value, dragged, form, limits)


def drag_point(
    label: str, point: tuple[float, ...], speed: float, form: str
) -> tuple[bool, tuple[float, ...]]:
    """Coordinates next to each other, as ``imgui.drag_float3`` draws them."""
    found = [(False, value) for value in point]
    imgui.begin_group()
    imgui.push_id(label)
    imgui.internal.push_multi_items_widths(len(point), imgui.calc_item_width())
    for axis, value in enumerate(point):
        if axis:
            imgui.same_line(0, imgui.get_style().item_inner_spacing.x)
        found[axis] = drag(f"##{axis}", value, speed, form)
        imgui.pop_item_width()
    imgui.pop_id()
    imgui.end_group()
    return any(is_new for is_new, _ in found), tuple(value for _, value in found)


def drag_range(
    label: str, now: Limits, speed: float, limits: Limits, form: str
) -> tuple[bool, Limits]:
    """Two numbers within ``limits``, the first at most the second, as
    ``imgui.drag_float_range2`` draws them."""
    (first, last), (low, high) = now, limits
    imgui.begin_group()
    imgui.push_id(label)
    imgui.internal.push_multi_items_widths(2, imgui.calc_item_width())
    is_new, first = drag("##from", first, speed, f"from {form}", (low, last))
    imgui.pop_item_width()
    imgui.same_line(0, imgui.get_style().item_inner_spacing.x)
    is_new_too, last = drag("##to", last, speed, f"to {form}", (first, high))
    imgui.pop_item_width()
    imgui.pop_id()
    imgui.end_group()
    return is_new or is_new_too, (first, last)


def typed_number(text: str, form: str) -> float | None:
    """Read a text that was typed into a field of this format; None where it is no number in it."""
    return number_of(text, _UNITS.get(_unit(form), MappingProxyType({})))


def as_typed(
    label: str, value: float, drawn: tuple[bool, float], form: str, limits: Limits | None
) -> tuple[bool, float]:
    """Return what the field that was just ``drawn`` gives: whether it changed, and its number.

    ``value`` is its number so far, which stays while it is typed in.
    """
    item = imgui.get_id(label)
    is_typed, frame = imgui.internal.temp_input_is_active(item), imgui.get_frame_count()
    if _typing.item == item and _typing.frame != frame - 1:
        _typing.item = 0  # it was gone meanwhile, and may be of another object now
        drawn = False, value
    was_typed = _typing.item == item
    if not (is_typed or was_typed):
        return drawn
    state = imgui.internal.get_input_text_state(item)
    if state is not None:
        _typing.text = state.text_src
    if not was_typed:
        _typing.item, _typing.before = item, _typing.text
    if _typing.text != _typing.before:  # to Dear ImGui "10 cm" is the 10 of "10.000 m": no edit
        imgui.internal.mark_item_edited(item)
    if is_typed:
        _typing.frame = frame
        return False, value
    _typing.item = 0
    if _typing.text == _typing.before:  # Escape brings that back, too
        return False, value
    number = typed_number(_typing.text, form)
    if number is None:
        is_length = not _unit(form) and metres_of(_typing.text) is not None
        example = _NO_SCALE if is_length else _EXAMPLES.get(_unit(form), "a number")
        _typing.not_read = f'"{_typing.text}" cannot be read here. Type {example}.'
        return False, value
    if limits is not None and not limits[0] <= number <= limits[1]:
        end = "least" if number < limits[0] else "most"
        number = limits[0] if end == "least" else limits[1]
        shown = (form % number).strip()
        _typing.not_read = f'"{_typing.text}" is out of range: it became {shown}, the {end} here.'
    return number != value, number


def _unit(form: str) -> str:
    found = _SHOWN_UNIT.search(form)
    return found[1] if found else ""
