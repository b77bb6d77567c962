"""A photo and its mask side by side: why this mask joined this group."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.scene.objects import group_indices
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import selection
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, photo_textures, theme, widgets
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face
from gaga_studio.ui.viewport import mask_menu
from gaga_studio.ui.viewport.mask_menu import MaskMenuState

_MOST_HIGH, _HEAD = 0.45, 4.6  # share of the picture's height; em above the pictures of a card
_LEAST, _NARROW = 20.5, 25.0  # em: least width of a card; below this a button has no text
_MOST_GROWING = 0.42  # share of the picture's width that the view of the moment takes
_HIGH_GROWING = 0.34  # share of its height
_ABOVE = 0.4  # share of the height: an object below it has the card above


@dataclass
class EvidenceState:
    """Which mask of the memory bank is shown on its photo."""

    decision: Decision | None = None
    live_view: str = ""  # last view of a running association whose picture was there
    live_bank: MemoryBank | None = None
    menu: MaskMenuState = field(default_factory=MaskMenuState)
    in_sight: tuple[Decision, float] | None = None  # row shown, and the height of its table then
    placed_for: Decision | None = None  # mask for which the card was given its place
    is_above: bool = False  # the card lies over the upper half of the picture


def draw(session: Session, state: EvidenceState, area: PictureArea) -> None:
    """A card over the left of the picture: the chosen mask, or the view of the moment.

    It keeps off the object that the mask joined where the picture has room for that.
    """
    area.card_bottom = 0.0
    document = session.document
    if document is not None and state.decision is not None and session.live is None:
        was = state.decision  # the mask may have been moved, or that undone
        state.decision = document.read.decision_of(was.view, was.mask) or was
    decision = state.decision
    if document is None or (decision is None and session.live is None):
        return
    width = _growing_width(session, area)
    if decision is not None:
        width = _width(photo_textures.aspect(session, decision.view), area)
        if state.placed_for is not decision:
            state.placed_for = decision
            state.is_above = _is_low(session, document, decision.group, area)
    room = area.width - _beside_cube(area)
    is_above = decision is not None and state.is_above and room >= em(_LEAST)
    width = min(width, room) if is_above else width
    top = max(area.head_bottom, area.chip_bottom + em(0.4))
    at = ImVec2(area.left + em(0.8), top if is_above else area.bottom - em(0.8))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 0 if is_above else 1))
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
    if is_above:
        area.card_bottom = imgui.get_item_rect_max().y
    imgui.pop_style_color(2)


def _width(aspect: float, area: PictureArea) -> float:
    """Of the card of a mask: its pictures leave more than half of the height free."""
    high = _MOST_HIGH * area.height - em(_HEAD)
    return min(max(2 * high * aspect + em(2), em(_LEAST)), em(36), area.width - em(1.6))


def _growing_width(session: Session, area: PictureArea) -> float:
    """Of the card of a running association: it leaves most of the picture free."""
    aspect = photo_textures.aspect(session, session.live.view) if session.live else 1.0
    most = min(_MOST_GROWING * area.width, _HIGH_GROWING * area.height * aspect + em(2))
    return min(em(17), max(most, em(9)), area.width - em(1.6))


def _beside_cube(area: PictureArea) -> float:
    """Room that a card at the top leaves to its right, for the view cube."""
    return area.cube_height + em(1.6) if area.cube_height else em(1.6)


def _is_low(session: Session, document: Document, group: int, area: PictureArea) -> bool:
    """Whether the middle of an object is nearer to the lower edge than to the upper one."""
    splats = group_indices(document.scene, group) if group else np.zeros(0, np.int32)
    if len(splats) == 0:
        return False
    middle = np.median(world_means(document.scene, splats), axis=0).astype(np.float64)
    pixels, depth = session.rig.camera(*area.size).project(middle[None])
    return bool(depth[0] > 0 and _ABOVE * area.height < pixels[0, 1] < area.height)


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
    is_narrow = room < em(_NARROW)
    button = em(9.6 if is_narrow else 14.4)
    imgui.align_text_to_frame_padding()
    wide = room - button - em(1.2)
    with theme.face(strong=True):
        text = f"{decision.view}, mask {decision.mask}"
        if imgui.calc_text_size(text).x > wide:
            text = f"{Path(decision.view).stem}, mask {decision.mask}"
        imgui.text_unformatted(widgets.elided(text, wide))
    imgui.same_line(room - button - em(0.6))
    mask_menu.button(session, document, state.menu, decision)
    imgui.same_line()
    name, hint = "Go to view", "Go to view: fly to where the photo was taken"
    if is_narrow:
        goes = widgets.icon_button(name, icons.CAMERA, hint=hint)
    else:
        goes = widgets.button(name, Face(icon=icons.CAMERA), hint=hint)
    if goes:
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
