"""The one stage that the open scene lacks next, as one button on the picture."""

from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui

from gaga_studio.features import cleanup, commands, fill
from gaga_studio.features.find import association
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face


@dataclass
class OfferState:
    """Whether the offer was put away."""

    is_closed: bool = False


def draw(session: Session, state: OfferState, area: PictureArea) -> None:
    """A card at the foot of the picture; nothing when nothing is missing or it was closed.

    What lacks a button to run is said until objects are made by hand.
    """
    offer = association.stage_offer(session)
    area.offer_top = float("inf")
    document = session.document
    if offer is None or document is None or state.is_closed:
        return
    if cleanup.shown(session) is not None or fill.shown(session) is not None:
        return  # it would cover a preview that is to be looked at
    if not offer.command and session.tool is ToolName.OBJECT:
        return  # it only advises what is being done
    width = min(em(34), area.width - em(2))
    if width < em(12):
        return
    at = ImVec2(area.left + (area.width - width) / 2, area.bottom - em(1))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 1))
    imgui.push_style_color(imgui.Col_.child_bg, theme.POPUP)
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    flags = imgui.ChildFlags_.borders | imgui.ChildFlags_.auto_resize_y
    flags |= imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("Offer", ImVec2(width, 0), flags):
        _content(session, state, width)
    area.offer_top = imgui.get_window_pos().y
    imgui.end_child()
    imgui.pop_style_color(2)


def _content(session: Session, state: OfferState, width: float) -> None:
    offer = association.stage_offer(session)
    if offer is None:
        return
    first = Face(offer.label, icons.RUN, primary=True)
    buttons = [(offer.command, offer.action, first)] if offer.command else []
    for text, command in offer.more:
        shown = text or commands.command(command).title_now(session)
        buttons.append((command, shown.rstrip("…"), Face(shown)))
    padding = 2 * imgui.get_style().frame_padding.x
    widths = [
        imgui.calc_text_size(f"{face.icon}  {face.text}" if face.icon else face.text).x + padding
        for _, _, face in buttons
    ]
    used = sum(widths) + em(0.4) * len(widths)
    room = width - em(3.5)  # left of the cross
    is_wide = room - used > em(9) or not buttons
    reason = room - (used + em(0.4) if is_wide and buttons else 0)
    imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + reason)
    imgui.align_text_to_frame_padding()
    imgui.text_unformatted(offer.reason)
    imgui.pop_text_wrap_pos()
    imgui.same_line(width - em(2.3))
    if widgets.icon_button("Not now", icons.CLOSE):
        state.is_closed = True
    if is_wide and buttons:
        imgui.same_line(width - em(2.6) - used)
    for at, (command, name, face) in enumerate(buttons):
        if at and is_wide:
            imgui.same_line(0, em(0.4))
        elif at:
            widgets.next_to(face.text, em(0.4))
        command_buttons.command_button(session, command, name, face)
