"""What can be done with one mask of the memory bank: put it where it belongs."""

from dataclasses import dataclass, field

from imgui_bundle import ImVec2, imgui

from gaga_core.grouping.memory_bank import Decision
from gaga_studio.features import commands, selection
from gaga_studio.features.find import memory_bank
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.kit import icons, object_menu, widgets
from gaga_studio.ui.kit.object_menu import MASK_DRAG, ObjectMenuState
from gaga_studio.ui.kit.widgets import Face


@dataclass
class MaskMenuState:
    """The mask on its way to an object, and what the open menu found."""

    dragged: Decision | None = None
    overlaps: tuple[str, dict[int, float]] = ("", {})  # of the mask whose menu is open: its key
    objects: ObjectMenuState = field(default_factory=ObjectMenuState)


def popup(session: Session, document: Document, state: MaskMenuState, decision: Decision) -> None:
    """The context menu of the item drawn last."""
    if imgui.begin_popup_context_item(f"Mask menu {decision.view} {decision.mask}"):
        items(session, document, state, decision)
        widgets.escape_closes()
        imgui.end_popup()


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


def button(session: Session, document: Document, state: MaskMenuState, decision: Decision) -> None:
    """A button that moves the mask to its object, or out of all."""
    name = f"Move mask {decision.view} {decision.mask}"
    face = Face(f"Move to {icons.LATER}", icons.JOINED)
    hint = "Put this mask where it belongs; the association is redone from its view on"
    if widgets.button("Move mask", face, why_not=why_not_moved(session), hint=hint):
        imgui.open_popup(name)
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    is_high = low.y < imgui.get_main_viewport().get_center().y  # the menu has more room below
    at = ImVec2(low.x, high.y if is_high else low.y)
    imgui.set_next_window_pos(at, imgui.Cond_.always, ImVec2(0, 0 if is_high else 1))
    if imgui.begin_popup(name):
        _objects(session, document, state, decision)
        imgui.separator()
        _elsewhere(session, decision)
        widgets.escape_closes()
        imgui.end_popup()


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
    """The other objects: those that hold splats behind the mask first, with their share."""
    key = f"{decision.view} {decision.mask} {document.read.labels_digest()}"
    if state.overlaps[0] != key:
        found = memory_bank.mask_overlaps(session, decision)
        if found is not None:
            state.overlaps = (key, {group: share for group, share in found.items() if group})
    is_known = state.overlaps[0] == key
    shares = dict(state.overlaps[1]) if is_known else {}
    if not is_known and decision.runner_up:
        shares = {decision.runner_up: decision.runner_up_overlap}
    first = list(shares)
    first += [decision.runner_up] if decision.runner_up not in (0, *first) else []
    widgets.dim("Share of the splats behind the mask" if is_known else "Looking at the view …")
    to = object_menu.objects(
        state.objects, session.objects(), first=first, without=(decision.group,), shares=shares
    )
    if to is not None:
        memory_bank.move_mask(session, decision, to)
