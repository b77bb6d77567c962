"""The photo over the picture: up to a line that is dragged, whole, or as a difference."""

from functools import partial

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.scene.scene import Scene
from gaga_studio.actions import photo_compare
from gaga_studio.actions.photo_compare import PhotoPlacement
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import PhotoCompareMode
from gaga_studio.ui.kit import photo_textures, theme
from gaga_studio.ui.kit.theme import em

_SIDE = 2048  # longest side of the photo, pixels


def draw(
    session: Session,
    differences: dict[str, float],
    corner: ImVec2,
    size: ImVec2,
    camera: Camera,
) -> bool:
    """What is compared, at the photo's own camera; whether the mouse belongs to the line."""
    view, io = session.view, imgui.get_io()
    if view.holds_photo and not (imgui.is_key_down(imgui.Key.g) and io.key_shift):
        view.holds_photo = False
    if view.compare is PhotoCompareMode.OFF and not view.holds_photo:
        return False
    photo = photo_compare.compared(session)
    if photo is None:
        if not session.rig.is_moving:
            _note("PhotoCompareMode: click a photo to stand where it was taken", corner, size)
        return False
    density = io.display_framebuffer_scale
    on_picture = photo_compare.place(photo, camera)
    place = PhotoPlacement(
        corner.x + on_picture.x / density.x,
        corner.y + on_picture.y / density.y,
        on_picture.width / density.x,
        on_picture.height / density.y,
    )
    imgui.push_clip_rect(corner, ImVec2(corner.x + size.x, corner.y + size.y), True)
    owns = False
    if view.holds_photo:
        _photo(session, photo, place, 1.0)
        text = f"Photo {photo.name}"
    elif view.compare is PhotoCompareMode.DIFFERENCE:
        text = _difference(session, differences, photo, place)
    else:
        shown = _photo(session, photo, place, view.swipe)
        owns = _line(session, place, corner, size)
        text = "Photo left of the line, picture right of it" if shown else "Reading the photo…"
    imgui.pop_clip_rect()
    _note(text, corner, size)
    return owns


def _photo(session: Session, photo: Camera, place: PhotoPlacement, share: float) -> bool:
    texture = photo_textures.photo(session, photo.name, _SIDE)
    if texture is None:
        return False
    low = ImVec2(place.x, place.y)
    high = ImVec2(place.x + share * place.width, place.y + place.height)
    picture = imgui.ImTextureRef(texture[0])
    imgui.get_window_draw_list().add_image(picture, low, high, ImVec2(0, 0), ImVec2(share, 1))
    return True


def _line(session: Session, place: PhotoPlacement, corner: ImVec2, size: ImVec2) -> bool:
    view = session.view
    at = place.x + view.swipe * place.width
    top, end = max(place.y, corner.y), min(place.y + place.height, corner.y + size.y)
    grip = em(0.9)
    imgui.set_cursor_screen_pos(ImVec2(at - grip, top))
    imgui.invisible_button("Swipe line", ImVec2(2 * grip, max(end - top, 1.0)))
    is_over, is_held = imgui.is_item_hovered(), imgui.is_item_active()
    if is_held:
        low, high = max(place.x, corner.x), min(place.x + place.width, corner.x + size.x)
        x = min(max(imgui.get_io().mouse_pos.x, low), high)
        view.swipe = float(np.clip((x - place.x) / place.width, 0, 1))
    if is_over or is_held:
        imgui.set_mouse_cursor(imgui.MouseCursor_.resize_ew)
    drawing = imgui.get_window_draw_list()
    color = theme.u32(theme.ACCENT if is_over or is_held else theme.TEXT)
    drawing.add_line(ImVec2(at, top), ImVec2(at, end), theme.u32(theme.BACK, 0.6), theme.scaled(4))
    drawing.add_line(ImVec2(at, top), ImVec2(at, end), color, theme.scaled(2))
    drawing.add_circle_filled(ImVec2(at, (top + end) / 2), em(0.5), color)
    return is_over or is_held


def _difference(
    session: Session, differences: dict[str, float], photo: Camera, place: PhotoPlacement
) -> str:
    """The heat map, once it is there; what it says in words."""
    folder = session.project.folder if session.project is not None else None
    path = folder.image_paths.get(photo.name) if folder is not None else None
    if path is None or session.scene is None or session.images is None:
        return "This photo cannot be read"
    key = f"difference {path} {photo_compare.content_mark(session.scene)}"
    scene: Scene = photo_compare.snapshot(session.scene)

    def load() -> UInt8Array:
        picture, differences[key] = photo_compare.difference(scene, photo, path)
        return picture

    texture = session.images.texture(key, partial(load))
    if texture is None or key not in differences:
        return "Comparing photo and picture…"
    low = ImVec2(place.x, place.y)
    high = ImVec2(place.x + place.width, place.y + place.height)
    imgui.get_window_draw_list().add_image(imgui.ImTextureRef(texture[0]), low, high)
    mean = differences[key]
    return f"Difference of photo and picture: {255 * mean:.1f} of 255 on average"


def _note(text: str, corner: ImVec2, size: ImVec2) -> None:
    """A line at the upper edge of the picture, in the middle."""
    pad = ImVec2(em(0.6), em(0.3))
    extent = imgui.calc_text_size(text)
    low = ImVec2(corner.x + (size.x - extent.x) / 2 - pad.x, corner.y + em(0.7))
    high = ImVec2(low.x + extent.x + 2 * pad.x, low.y + extent.y + 2 * pad.y)
    drawing = imgui.get_window_draw_list()
    drawing.add_rect_filled(low, high, theme.u32(theme.BACK, 0.8), em(0.3))
    drawing.add_text(ImVec2(low.x + pad.x, low.y + pad.y), theme.u32(theme.TEXT), text)
