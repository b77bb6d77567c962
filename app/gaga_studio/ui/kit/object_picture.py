"""The picture of an object, small in a row and larger in its tooltip."""

from imgui_bundle import ImVec2, imgui

from gaga_core.scene.objects import ObjectTable
from gaga_studio.features import object_list
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em

_ENDS = (ImVec2(0, 0), ImVec2(1, 1))
_HOVERED = 160  # pixels of the picture in the tooltip


def draw(
    session: Session, table: ObjectTable, row: int, corner: ImVec2, side: float, alpha: float = 1.0
) -> None:
    """Draw the object of a row into the square at ``corner``; grey until it is there."""
    drawing = imgui.get_window_draw_list()
    high = ImVec2(corner.x + side, corner.y + side)
    texture = _texture(session, table, row, object_list.SMALL)
    if texture is None:
        drawing.add_rect_filled(corner, high, theme.u32(theme.RAISED, alpha), em(0.2))
        return
    tint = imgui.get_color_u32(imgui.ImVec4(1, 1, 1, alpha))
    drawing.add_image_rounded(texture, corner, high, *_ENDS, tint, em(0.2))


def tooltip(session: Session, table: ObjectTable, row: int) -> None:
    """Show the picture larger while the mouse rests on the item that was drawn last."""
    if not imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip):
        return
    small = _texture(session, table, row, object_list.SMALL)
    if small is None or not imgui.begin_tooltip():
        return
    large = _texture(session, table, row, object_list.LARGE)
    side = theme.scaled(_HOVERED)
    imgui.image(large or small, ImVec2(side, side))
    imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + side)
    widgets.dim(table.names[row], wrap=True)
    imgui.pop_text_wrap_pos()
    imgui.end_tooltip()


def _texture(
    session: Session, table: ObjectTable, row: int, side: int
) -> imgui.ImTextureRef | None:
    wanted = object_list.picture_request(session, table, row, side)
    if wanted is None or session.images is None:
        return None
    texture = session.images.texture(*wanted)
    return None if texture is None else imgui.ImTextureRef(texture[0])
