"""The one stage that the open scene lacks next, as one button on the picture."""

from imgui_bundle import ImVec2, imgui

from gaga_studio.session import Session
from gaga_studio.ui import actions, icons, theme, widgets
from gaga_studio.ui.state import UiState
from gaga_studio.ui.theme import em
from gaga_studio.ui.widgets import Face


def draw(session: Session, ui: UiState, corner: ImVec2, size: ImVec2) -> None:
    """A card at the foot of the picture; nothing when nothing is missing or it was closed."""
    offer = session.stage_offer()
    if offer is None or session.document is None or ui.closed_offer == id(session.document):
        return
    width = min(em(34), size.x - em(2))
    if width < em(12):
        return
    at = ImVec2(corner.x + (size.x - width) / 2, corner.y + size.y - em(1))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 1))
    imgui.push_style_color(imgui.Col_.child_bg, theme.POPUP)
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    flags = imgui.ChildFlags_.borders | imgui.ChildFlags_.auto_resize_y
    flags |= imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("Offer", ImVec2(width, 0), flags):
        _content(session, ui, width)
    imgui.end_child()
    imgui.pop_style_color(2)


def _content(session: Session, ui: UiState, width: float) -> None:
    offer = session.stage_offer()
    if offer is None:
        return
    has_button = bool(offer.command)
    label = f"{offer.action}, {offer.duration}" if offer.duration else offer.action
    button = imgui.calc_text_size(label).x + em(4.4) if has_button else 0.0
    imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + width - button - em(4))
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted(offer.reason)
    imgui.pop_text_wrap_pos()
    if has_button:
        imgui.same_line(width - button - em(1.9))
        face = Face(label, icons.RUN, primary=True)
        actions.command_button(session, offer.command, offer.action, face)
    imgui.same_line(width - em(2.3))
    if widgets.icon_button("Not now", icons.CLOSE):
        ui.closed_offer = id(session.document)
