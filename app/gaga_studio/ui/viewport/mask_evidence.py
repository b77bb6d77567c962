"""A photo and its mask side by side: why this mask joined this group, and its menu."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.errors import counted
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.scene.objects import group_indices
from gaga_core.scene.selection.algebra import world_means
from gaga_studio.features import commands, selection
from gaga_studio.features.find import memory_bank
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, object_menu, textures, theme, widgets
from gaga_studio.ui.kit.object_menu import MASK_DRAG, ObjectMenuState
from gaga_studio.ui.kit.picture_area import PictureArea
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.kit.widgets import Face

# --- Actions on one mask of the memory bank: move it to the right object.


@dataclass
class MaskMenuState:
    """The mask on its way to an object, and what the open menu found."""

    dragged: Decision | None = None
    overlaps: tuple[str, dict[int, float]] = ("", {})  # of the mask whose menu is open: its key
    objects: ObjectMenuState = field(default_factory=ObjectMenuState)


def popup(session: Session, document: Document, state: MaskMenuState, decision: Decision) -> None:
    """The context menu of the item drawn last."""
    name = f"Mask menu {decision.view} {decision.mask}"
    widgets.popup(name, lambda: items(session, document, state, decision), of_item=True)


def items(session: Session, document: Document, state: MaskMenuState, decision: Decision) -> None:
    """The items of the menu; from the mask's view on the association is redone."""
    widgets.dim(f"Mask {decision.mask} of {decision.view}")
    imgui.separator()
    why_not = why_not_moved(session)
    imgui.begin_disabled(bool(why_not))
    if imgui.begin_menu(f"{icons.JOINED}  Move to###Move to"):
        _objects(session, document, state, decision)
        imgui.end_menu()
    _elsewhere(session, decision)
    imgui.end_disabled()
    widgets.tooltip(why_not)
    imgui.separator()
    if decision.runner_up and imgui.menu_item_simple(
        f"{icons.BOX}  Select {document.name_of(decision.runner_up)}, next best###Select next best"
    ):
        selection.select_groups(session, (decision.runner_up,))
    if imgui.menu_item_simple(f"{icons.CAMERA}  Go to view###Go to view"):
        command_buttons.fly_to(session, decision.view)


def _move_button(
    session: Session,
    document: Document,
    state: MaskMenuState,
    decision: Decision,
    *,
    has_text: bool = True,
) -> None:
    """A button that moves the mask to its object, or out of all."""
    name = f"Move mask {decision.view} {decision.mask}"
    face = Face(f"Move to {icons.LATER}" if has_text else icons.LATER, icons.JOINED)
    hint = "Put this mask where it belongs; the association is redone from its view on"
    if widgets.button("Move mask", face, why_not=why_not_moved(session), hint=hint):
        imgui.open_popup(name)
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    is_high = low.y < imgui.get_main_viewport().get_center().y  # the menu has more room below
    at = ImVec2(low.x, high.y if is_high else low.y)
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 0 if is_high else 1))

    def draw() -> None:
        _objects(session, document, state, decision)
        imgui.separator()
        _elsewhere(session, decision)

    widgets.popup(name, draw)


def _elsewhere(session: Session, decision: Decision) -> None:
    if imgui.menu_item_simple(f"{icons.NEW}  New object###New object"):
        memory_bank.move_mask(session, decision, memory_bank.NEW)
    if imgui.menu_item_simple(f"{icons.CLOSE}  No object###No object"):
        memory_bank.move_mask(session, decision, memory_bank.NONE)


def drag_source(state: MaskMenuState, document: Document, decision: Decision) -> None:
    """The item drawn last can be dragged onto an object of the list."""
    if imgui.begin_drag_drop_source():
        state.dragged = decision
        imgui.set_drag_drop_payload_py_id(MASK_DRAG, decision.mask)
        widgets.dim(f"Mask {decision.mask} of {decision.view}: drop it on its object")
        imgui.end_drag_drop_source()


def why_not_moved(session: Session) -> str:
    """Why no mask can be moved now; "" when one can be."""
    return commands.command("object.quality").enabled(session)


def _objects(
    session: Session, document: Document, state: MaskMenuState, decision: Decision
) -> None:
    """The other objects: those that hold a share of the mask first, with that."""
    key = f"{decision.view} {decision.mask} {document.read.labels_digest()}"
    if state.overlaps[0] != key:
        found = memory_bank.mask_overlaps(session, decision)
        if found is not None:
            state.overlaps = (key, {group: share for group, share in found.items() if group})
    is_known = state.overlaps[0] == key
    shares = dict(state.overlaps[1]) if is_known else {}
    first = list(shares)
    first += [decision.runner_up] if decision.runner_up not in (0, *first) else []
    widgets.dim(what_is_shared(document) if is_known else "Looking at the view …")
    to = object_menu.objects(
        state.objects, session.objects(), first=first, without=(decision.group,), shares=shares
    )
    if to is not None:
        memory_bank.move_mask(session, decision, to)


def what_is_shared(document: Document, *, has_gate: bool = True) -> str:
    """What the shares of `memory_bank.mask_overlaps` are of."""
    if memory_bank.shows_pixels(document, has_gate=has_gate):
        return "What the mask shows"
    return "Share of the splats behind the mask"


_MOST_HIGH, _HEAD = 0.45, 4.6  # share of the picture's height; em above the pictures of a card
_LEAST, _NARROW = 20.5, 25.0  # em: least width of a card; below this a button has no text
_LOW = 14.0  # em: in a lower picture the card has its buttons and pictures alone
_MOST_GROWING = 0.42  # share of the picture's width that the current view takes
_HIGH_GROWING = 0.34  # share of its height
_LEAST_GROWING = 5.0  # em: a photo as wide as the words under it
_ABOVE = 0.4  # share of the height: an object below it has the card above


@dataclass
class EvidenceState:
    """Which mask of the memory bank is shown on its photo."""

    decision: Decision | None = None
    live_view: str = ""  # last view of a running association whose picture was there
    live_bank: MemoryBank | None = None
    menu: MaskMenuState = field(default_factory=MaskMenuState)
    in_sight: tuple[Decision, float] | None = None  # row shown, and the height of its table then
    selected: tuple[int, ...] = ()  # objects, in the frame before
    placed_for: Decision | None = None  # mask for which the card was given its place
    is_above: bool = False  # the card lies over the upper half of the picture


def draw(session: Session, state: EvidenceState, area: PictureArea) -> None:
    """A card over the left of the picture: the chosen mask, or the current view.

    It keeps off the object that the mask joined where the picture has room for that.
    """
    area.card_bottom = 0.0
    document = session.document
    if document is not None and state.decision is not None and session.live is None:
        was = state.decision  # the mask may have been moved, or that undone
        state.decision = document.read.decision_of(was.view, was.mask) or was
    _follow_selection(session, state)
    decision = state.decision
    if document is None or (decision is None and session.live is None):
        return
    top = max(area.head_bottom, area.chip_bottom + em(0.4))
    width = _growing_width(session, area, top)
    if decision is None and width < em(_LEAST_GROWING):
        return
    if decision is not None:
        width = _width(textures.aspect(session, decision.view), area)
        if state.placed_for is not decision:
            state.placed_for = decision
            state.is_above = _is_low(session, document, decision.group, area)
    # To its right a card at the top leaves room for the view cube.
    room = area.width - em(1.6) - area.cube_height
    is_above = decision is not None and state.is_above and room >= em(_LEAST)
    width = min(width, room) if is_above else width
    at = ImVec2(area.left + em(0.8), top if is_above else area.bottom - em(0.8))
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 0 if is_above else 1))

    def shown() -> None:
        if decision is not None:
            _head(session, document, state, decision, is_low=area.height < em(_LOW))
            _pictures(session, document, state, decision)
        elif session.live is not None:
            _growing(session, state, session.live)

    widgets.card("Mask in its photo", width, shown)
    if is_above:
        area.card_bottom = imgui.get_item_rect_max().y


def _width(aspect: float, area: PictureArea) -> float:
    """Of the card of a mask: its pictures leave more than half of the height free."""
    high = _MOST_HIGH * area.height - em(_HEAD)
    return min(max(2 * high * aspect + em(2), em(_LEAST)), em(36), area.width - em(1.6))


def _growing_width(session: Session, area: PictureArea, top: float) -> float:
    """Of the card of a running association: it leaves most of the picture free, and all above
    ``top``."""
    aspect = textures.aspect(session, session.live.view) if session.live else 1.0
    most = min(_MOST_GROWING * area.width, _HIGH_GROWING * area.height * aspect + em(2))
    pad, line = imgui.get_style().window_padding, imgui.get_text_line_height_with_spacing()
    free = area.bottom - em(0.8) - top - 2 * pad.y - line - imgui.get_style().item_spacing.y
    fits = free * aspect + 2 * pad.x
    return min(em(17), max(most, em(9)), area.width - em(1.6), fits)


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
    picture = textures.photo_with_masks(session, live.view, live.bank)
    if picture is not None or not state.live_view:
        state.live_view, state.live_bank = live.view, live.bank
    shown = textures.photo_with_masks(session, state.live_view, state.live_bank)
    width = imgui.get_content_region_avail().x
    textures.place(shown, width, textures.aspect(session, state.live_view))
    widgets.line(f"{live.view}  ·  {counted(live.n_groups, 'group')}", theme.DIM)


def _head(
    session: Session,
    document: Document,
    state: EvidenceState,
    decision: Decision,
    *,
    is_low: bool,
) -> None:
    """Which mask it is, and its buttons; in a low picture its tooltip says why it joined."""
    room = imgui.get_content_region_avail().x
    is_narrow = is_low or room < em(_NARROW)
    button = em(6.2 if is_low else 9.6 if is_narrow else 14.4)
    imgui.align_text_to_frame_padding()
    wide = room - button - em(1.2)
    with theme.face(strong=True):
        mask = f"mask {decision.mask}"
        names = f"{decision.view}, {mask}", f"{Path(decision.view).stem}, {mask}"
        fits = (name for name in names if imgui.calc_text_size(name).x <= wide)
        imgui.text_unformatted(next(fits, "") or widgets.elided(mask if is_low else names[1], wide))
    said = explanation(document, decision)
    widgets.tooltip(f"{decision.view}: {said}" if is_low else "")
    imgui.same_line(room - button - em(0.6))
    _move_button(session, document, state.menu, decision, has_text=not is_low)
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
    if not is_low:
        widgets.dim(said, wrap=True)


def _pictures(
    session: Session, document: Document, state: EvidenceState, decision: Decision
) -> None:
    spacing = imgui.get_style().item_spacing.x
    width = (imgui.get_content_region_avail().x - spacing) / 2
    shown = textures.photo_and_mask(session, document, decision)
    for position, picture in enumerate(shown):
        if position:
            imgui.same_line()
        textures.place(picture, width, textures.aspect(session, decision.view))
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
        mask = textures.mask_at(session, decision.view, u, v)
        found = document.read.decision_of(decision.view, mask)
        state.decision = found or decision
        if found is not None and found.group and found.group != session.focus:
            selection.select_groups(session, (found.group,))
        if found is not None and is_right:
            imgui.open_popup(f"Mask menu {position}")
    widgets.tooltip("Click takes the mask here. Right-click: move it to its object.")
    chosen = state.decision or decision
    widgets.popup(f"Mask menu {position}", lambda: items(session, document, state.menu, chosen))


def _follow_selection(session: Session, state: EvidenceState) -> None:
    """Close the card of a mask once other objects than its own are selected."""
    before, state.selected = state.selected, tuple(session.selected_groups())
    is_other = state.selected not in ((), before)
    if is_other and state.decision is not None and state.decision.group not in state.selected:
        state.decision = None


def explanation(document: Document, decision: Decision) -> str:
    """The decision as a sentence."""
    if decision.group == 0 and decision.by_hand:
        return "Put into no object by hand."
    if decision.group == 0:
        return "There is no splat behind this mask at the surface, so it joined no group."
    name = document.name_of(decision.group)
    if decision.by_hand:
        return f"In {name} by hand: the mask was moved, or objects were merged or split."
    share = f"{100 * decision.overlap:.0f} %"
    if decision.is_new:
        return f"This mask opened {name} with {counted(decision.n_gaussians, 'splat')}."
    text = f"Joined {name}, which held {share} of its {counted(decision.n_gaussians, 'splat')}"
    if document.read.overlap_is_of_points():
        text = f"Joined {name} by {share} of its surface points"
    if decision.runner_up:
        rival = document.name_of(decision.runner_up)
        text += f"; next came {rival} with {100 * decision.runner_up_overlap:.0f} %"
    return text + "."
