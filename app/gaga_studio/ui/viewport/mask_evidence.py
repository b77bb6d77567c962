"""A photo and its mask side by side: why this mask joined this group."""

from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_studio.actions import selection
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, photo_textures, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.viewport import mask_menu
from gaga_studio.ui.viewport.mask_menu import MaskMenuState


@dataclass
class EvidenceState:
    """Which mask of the memory bank is shown on its photo."""

    decision: Decision | None = None
    live_view: str = ""  # last view of a running association whose picture was there
    live_bank: MemoryBank | None = None
    menu: MaskMenuState = field(default_factory=MaskMenuState)


def draw(session: Session, state: EvidenceState, corner: ImVec2, size: ImVec2) -> None:
    """A card over the lower left of the picture: the chosen mask, or the view of the moment."""
    document = session.document
    if document is not None and state.decision is not None and session.live is None:
        was = state.decision  # the mask may have been moved, or that undone
        state.decision = document.read.decision_of(was.view, was.mask) or was
    decision = state.decision
    if document is None or (decision is None and session.live is None):
        return
    width = min(em(36 if decision is not None else 17), size.x - em(1.6))
    at = ImVec2(corner.x + em(0.8), corner.y + size.y - em(0.8))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 1))
    imgui.push_style_color(imgui.Col_.child_bg, theme.POPUP)
    imgui.push_style_color(imgui.Col_.border, theme.LINE_STRONG)
    flags = imgui.ChildFlags_.borders | imgui.ChildFlags_.auto_resize_y
    flags |= imgui.ChildFlags_.always_use_window_padding
    if imgui.begin_child("Mask in its photo", ImVec2(width, 0), flags):
        if decision is not None:
            _head(session, document, state, decision)
            _pictures(session, document, state, decision)
        elif session.live is not None:
            _growing(session, state, session.live)
    imgui.end_child()
    imgui.pop_style_color(2)


def _growing(session: Session, state: EvidenceState, live: BankSnapshot) -> None:
    """The view that the association is at, its masks in the colors of their groups."""
    picture = photo_textures.photo_with_masks(session, live.view, live.bank)
    if picture is not None or not state.live_view:
        state.live_view, state.live_bank = live.view, live.bank
    shown = photo_textures.photo_with_masks(session, state.live_view, state.live_bank)
    width = imgui.get_content_region_avail().x
    photo_textures.place(shown, width, photo_textures.aspect(session, state.live_view))
    widgets.line(f"{live.view}  ·  {live.n_groups} groups", theme.DIM)


def _head(session: Session, document: Document, state: EvidenceState, decision: Decision) -> None:
    room = imgui.get_content_region_avail().x
    button = em(14.4)
    imgui.align_text_to_frame_padding()
    text = f"{decision.view}, mask {decision.mask}"
    with theme.face(strong=True):
        shown = widgets.elided(text, room - button - em(3))
        imgui.text_unformatted(shown)
    imgui.same_line(room - button - em(0.6))
    mask_menu.button(session, document, state.menu, decision)
    imgui.same_line()
    face = Face(icon=icons.CAMERA)
    if widgets.button("Go to view", face, hint="Fly to where the photo was taken"):
        command_buttons.fly_to(session, decision.view)
    imgui.same_line()
    if widgets.icon_button("Close photo", icons.CLOSE, hint="Close (Esc)"):
        state.decision = None
    widgets.dim(explanation(document, decision), wrap=True)


def _pictures(
    session: Session, document: Document, state: EvidenceState, decision: Decision
) -> None:
    spacing = imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - spacing) / 2
    shown = photo_textures.photo_and_mask(session, document, decision)
    for position, picture in enumerate(shown):
        if position:
            imgui.same_line()
        photo_textures.place(picture, width, photo_textures.aspect(session, decision.view))
        _pointing(session, document, state, decision, position)


def _pointing(
    session: Session, document: Document, state: EvidenceState, decision: Decision, position: int
) -> None:
    """A click on the picture takes the mask there, a right click opens its menu."""
    if session.live is not None:
        return
    low, high, mouse = imgui.get_item_rect_min(), imgui.get_item_rect_max(), imgui.get_mouse_pos()
    is_left = imgui.is_item_clicked(imgui.MouseButton_.left)
    is_right = imgui.is_item_clicked(imgui.MouseButton_.right)
    if is_left or is_right:
        u = (mouse.x - low.x) / max(high.x - low.x, 1)
        v = (mouse.y - low.y) / max(high.y - low.y, 1)
        mask = photo_textures.mask_at(session, decision.view, u, v)
        found = document.read.decision_of(decision.view, mask)
        state.decision = found or decision
        if found is not None and found.group and found.group != session.focus:
            selection.select_groups(session, (found.group,))
        if found is not None and is_right:
            imgui.open_popup(f"Mask menu {position}")
    widgets.tooltip("Click takes the mask here. Right-click: move it to its object.")
    if imgui.begin_popup(f"Mask menu {position}"):
        mask_menu.items(session, document, state.menu, state.decision or decision)
        widgets.escape_closes()
        imgui.end_popup()


def explanation(document: Document, decision: Decision) -> str:
    """The decision as a sentence."""
    if decision.group == 0 and decision.by_hand:
        return "Put into no object by hand."
    if decision.group == 0:
        return "No splat lies behind this mask at the surface, so it joined no group."
    name = document.name_of(decision.group)
    if decision.by_hand:
        return f"Put into {name} by hand; what follows from that was redone from this view on."
    share = f"{100 * decision.overlap:.0f} %"
    if decision.is_new:
        return f"This mask opened {name} with {decision.n_gaussians:,} splats."
    text = f"Joined {name}, which held {share} of its {decision.n_gaussians:,} splats"
    if document.read.overlap_is_of_points():
        text = f"Joined {name}, to which {share} of the points on its surface belong"
    if decision.runner_up:
        rival = document.name_of(decision.runner_up)
        text += f"; next came {rival} with {100 * decision.runner_up_overlap:.0f} %"
    return text + "."
