"""The eye, the lock and the circle at the end of a row of the object list."""

from dataclasses import dataclass
from typing import Literal

from imgui_bundle import imgui

from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em

Switched = Literal["", "hide", "lock", "alone"]


@dataclass(frozen=True)
class Switches:
    """How the switches of a row stand."""

    what: str  # that the row shows: "object", "folder"
    is_hidden: bool
    is_locked: bool
    is_alone: bool  # nothing else is shown


def draw(switches: Switches, height: float, is_roomy: bool) -> Switched:
    """Draw the switches of a row; which one was clicked. Alt and the eye are the circle."""
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + (height - em(1.25)) / 2)
    clicked: Switched = ""
    if _eye(switches):
        clicked = "alone" if imgui.get_io().key_alt else "hide"
    imgui.same_line(0, 0)
    if _lock(switches):
        clicked = "lock"
    if is_roomy:
        imgui.same_line(0, 0)
        if _alone(switches):
            clicked = "alone"
    return clicked


def _eye(switches: Switches) -> bool:
    is_off, what = switches.is_hidden, switches.what
    icon = icons.EYE_OFF if is_off else icons.EYE
    hint = f"Show this {what}" if is_off else f"Hide this {what} (Alt: show only this)"
    return widgets.small_icon("Shown", icon, hint=hint, color=theme.TEXT if is_off else theme.FAINT)


def _lock(switches: Switches) -> bool:
    is_on = switches.is_locked
    icon = icons.LOCK if is_on else icons.UNLOCK
    hint = "Unlock: it can be selected again" if is_on else "Lock: clicks pass it by"
    return widgets.small_icon("Locked", icon, hint=hint, color=theme.TEXT if is_on else theme.FAINT)


def _alone(switches: Switches) -> bool:
    is_on = switches.is_alone
    hint = "Show everything again" if is_on else f"Show only this {switches.what}"
    color = theme.TEXT if is_on else theme.FAINT
    return widgets.small_icon("Alone", icons.ISOLATE, hint=hint, color=color)
