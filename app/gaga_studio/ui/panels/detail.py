"""The slider above the object list: how fine the objects are that no model made."""

from dataclasses import dataclass

from imgui_bundle import imgui

from gaga_studio.features import object_list, objects
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import widgets
from gaga_studio.ui.kit.theme import em


@dataclass
class DetailState:
    """The level that is being dragged to; None at rest."""

    dragged: int | None = None


def draw(session: Session, state: DetailState) -> None:
    """Draw the slider where the groups of the scene have levels."""
    levels = object_list.levels_of(session)
    if levels is None:
        state.dragged = None
        return
    shown = levels.chosen if state.dragged is None else state.dragged
    widgets.field_name("Detail", em(4))
    moved, level = imgui.slider_int(
        "##Detail", shown, 0, len(levels.labels) - 1, "", imgui.SliderFlags_.always_clamp
    )
    ended = imgui.is_item_deactivated()
    widgets.tooltip("Left: things together. Right: small pieces. Ctrl+Z takes a change back.")
    if moved and level != state.dragged:
        state.dragged = level
        objects.preview_level(session, level)
    if ended and state.dragged is not None:
        chosen, state.dragged = state.dragged, None
        objects.choose_level(session, chosen)
