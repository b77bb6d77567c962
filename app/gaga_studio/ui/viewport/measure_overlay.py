"""The points of the tool Measure with their lengths, and a card with the numbers and Set scale."""

from dataclasses import dataclass

from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.camera import Camera
from gaga_studio.features import measure
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.viewport import ground_overlay

_WIDTH = 15.0  # of the card, em


@dataclass
class MeasureState:
    """The known length as it is typed."""

    metres: float = 1.0


def draw_marks(session: Session, camera: Camera, corner: ImVec2, *, follows: bool) -> None:
    """The points as ``camera`` sees them, and the length of each way at its middle."""
    if session.tool is not ToolName.MEASURE:
        return
    places = measure.points(session)
    goes_on = follows and len(places) < 3
    if not ground_overlay.draw_points(places, camera, corner, follows=goes_on):
        return
    lengths = measure.reading(session).lengths
    for one, two, length in zip(places, places[1:], lengths, strict=False):
        (at,) = ground_overlay.on_screen((one + two)[None] / 2, camera, corner)
        _label(measure.length(session, length), at)


def draw_card(session: Session, state: MeasureState, corner: ImVec2, size: ImVec2) -> None:
    """What to click, the numbers, and the length that is known."""
    if session.tool is not ToolName.MEASURE or session.document is None:
        return
    imgui.set_cursor_screen_pos(ImVec2(corner.x + em(0.7), corner.y + em(0.7)))
    imgui.push_style_color(imgui.Col_.child_bg, _see_through(theme.BACK))
    width = min(em(_WIDTH), size.x - em(1.4))
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("Measure", ImVec2(width, 0), flags):
        widgets.line(measure.prompt(session))
        _numbers(session)
        _known_length(session, state)
    imgui.end_child()
    imgui.pop_style_color()


def _numbers(session: Session) -> None:
    found = measure.reading(session)
    for i, length in enumerate(found.lengths, 1):
        widgets.line(f"{i} to {i + 1}: {measure.length(session, length)}")
    if found.angle is not None:
        widgets.line(f"Angle at 2: {found.angle:.1f}°")
    for i, height in enumerate(found.heights, 1):
        widgets.dim(f"Height of {i}: {measure.length(session, height)}")
    if not found.heights:
        widgets.dim(measure.HELP, wrap=True)


def _known_length(session: Session, state: MeasureState) -> None:
    """Give the way from point 1 to point 2 a length: the scale of the scene."""
    if not measure.reading(session).lengths:
        return
    imgui.set_next_item_width(em(5))
    _, state.metres = imgui.input_float("##Known length", state.metres, 0, 0, "%.3f m")
    widgets.tooltip("The true length from point 1 to point 2")
    imgui.same_line()
    hint = "Scale the whole scene so that 1 to 2 has this length; lengths are metres then"
    if widgets.button("Set scale", hint=hint):
        measure.set_scale(session, state.metres)


def _label(text: str, at: ImVec2) -> None:
    drawing, extent = imgui.get_window_draw_list(), imgui.calc_text_size(text)
    pad = em(0.3)
    low = ImVec2(at.x - extent.x / 2 - pad, at.y - extent.y / 2 - pad / 2)
    high = ImVec2(at.x + extent.x / 2 + pad, at.y + extent.y / 2 + pad / 2)
    drawing.add_rect_filled(low, high, theme.u32(theme.BACK, 0.85), em(0.25))
    drawing.add_text(ImVec2(low.x + pad, low.y + pad / 2), theme.u32(theme.TEXT), text)


def _see_through(color: ImVec4) -> ImVec4:
    return ImVec4(color.x, color.y, color.z, 0.85)
