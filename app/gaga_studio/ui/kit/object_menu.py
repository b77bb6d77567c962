"""Menus to choose an object as the target of a move."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.objects import ObjectTable
from gaga_studio.session.scene_cache import listed
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.modal import begin_part
from gaga_studio.ui.kit.theme import em

_SHOWN = 200  # objects; more are found by typing
_MANY = 8  # from here on there is a field to type in
MASK_DRAG, OBJECT_DRAG = "gaga mask", "gaga object"  # what can be dropped on an object
FOLDER_DRAG = "gaga folder"  # ... and with an object on a folder


@dataclass
class ObjectMenuState:
    """What is typed into an open menu of objects."""

    text: str = ""


def objects(
    state: ObjectMenuState,
    table: ObjectTable,
    *,
    first: Sequence[int] = (),
    without: Sequence[int] = (),
    shares: Mapping[int, float] | None = None,
) -> int | None:
    """Inside a menu: the objects as items, ``first`` ones on top; the one that was chosen.

    ``shares`` (0..1) by group stand at the right edge.
    """
    is_new = imgui.is_window_appearing()
    if is_new:
        state.text = ""
    if len(table) > _MANY:
        if is_new:
            imgui.set_keyboard_focus_here()
        imgui.set_next_item_width(em(15))
        _, state.text = imgui.input_text_with_hint("##Wanted object", "Find an object", state.text)
    found = [int(table.ids[row]) for row in listed(table, state.text, "name")]
    there = set(found)
    groups = [group for group in first if group in there]
    groups += [group for group in found if group not in set(first)]
    groups = [group for group in groups if group > 0 and group not in without]
    height = min(len(groups), 10) * imgui.get_text_line_height_with_spacing() + em(0.4)
    chosen = None
    if begin_part("Choices", ImVec2(em(15), max(height, em(1.4)))):
        for group in groups[:_SHOWN]:
            if _item(table, group, None if shares is None else shares.get(group, 0.0)):
                chosen = group
        if not groups:
            widgets.dim("There is no other object.")
    imgui.end_child()
    if chosen is not None:
        imgui.close_current_popup()
    return chosen


def _item(table: ObjectTable, group: int, share: float | None) -> bool:
    row = table.row(group)
    if row is None:
        return False
    widgets.text("●", widgets.rgba(table.colors[row]))
    imgui.same_line(0, em(0.4))
    left = imgui.get_cursor_pos_x()
    room = imgui.get_content_region_avail().x
    text = widgets.elided(table.names[row], room - em(3.2))
    clicked, _ = imgui.selectable(f"{text}###to {group}", False)
    if share:
        label = f"{100 * share:.0f} %" if share >= 0.01 else "< 1 %"
        imgui.same_line(left + room - imgui.calc_text_size(label).x - em(0.2))
        widgets.dim(label)
    return clicked
