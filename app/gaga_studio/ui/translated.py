"""The toolkit's functions that show a text, made to show it in the user's language.

Wrapped once, when the first other language than English is chosen: every panel speaks it without
knowing, and its controls keep their English identities (`words.label`).
"""

from collections.abc import Callable
from typing import TypeVar

from imgui_bundle import imgui

from gaga_studio.system import words

R = TypeVar("R")

# The first text is a label: its identity must stay.
_LABELS = [
    "begin_combo",
    "begin_menu",
    "begin_popup",
    "begin_popup_modal",
    "begin_tab_item",
    "button",
    "checkbox",
    "collapsing_header",
    "color_edit3",
    "color_edit4",
    "color_picker3",
    "combo",
    "drag_float",
    "drag_float2",
    "drag_float3",
    "drag_float_range2",
    "drag_int",
    "input_float",
    "input_float3",
    "input_int",
    "input_text",
    "input_text_multiline",
    "input_text_with_hint",
    "is_popup_open",
    "list_box",
    "menu_item",
    "menu_item_simple",
    "open_popup",
    "radio_button",
    "selectable",
    "slider_angle",
    "slider_float",
    "slider_float2",
    "slider_float3",
    "slider_int",
    "small_button",
    "table_setup_column",
    "tree_node",
    "tree_node_ex",
]
_TEXTS = [
    "bullet_text",
    "calc_text_size",
    "progress_bar",
    "separator_text",
    "set_item_tooltip",
    "set_tooltip",
    "text",
    "text_disabled",
    "text_unformatted",
    "text_wrapped",
]
_VALUES = {"input_text": 1, "input_text_multiline": 1, "input_text_with_hint": 2}  # the user's own


def install() -> None:
    """Wrap the functions, once."""
    if _Installed.done:
        return
    _Installed.done = True
    for name in (*_LABELS, *_TEXTS):
        setattr(imgui, name, _wrapped(getattr(imgui, name), name))
    drawn = _wrapped(imgui.ImDrawList.add_text, "add_text")
    imgui.ImDrawList.add_text = drawn  # type: ignore[method-assign]


class _Installed:
    done = False


def _wrapped(function: Callable[..., R], name: str) -> Callable[..., R]:
    first = words.label if name in _LABELS else words.tr
    kept = _VALUES.get(name, 0)

    def spoken(*args: object, **named: object) -> R:
        if words.is_english():
            return function(*args, **named)
        shown = [
            (first(a) if i == 0 else words.tr(a))
            if isinstance(a, str) and (not i or i != kept)
            # Choices of a drop-down.
            else [words.tr(b) if isinstance(b, str) else b for b in a]
            if isinstance(a, list)
            else a
            for i, a in enumerate(args)
        ]
        return function(*shown, **named)

    spoken.__name__ = name
    return spoken
