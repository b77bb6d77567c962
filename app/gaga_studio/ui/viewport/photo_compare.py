"""Two sides of a split view with a line that is dragged; a photo whole, or as a difference."""

from collections.abc import Callable
from functools import partial

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.evaluate.photo_film import truth_picture
from gaga_core.scene.scene import Scene
from gaga_studio.features import split_view
from gaga_studio.features.split_view import PhotoPlacement
from gaga_studio.session.session import Session
from gaga_studio.session.view import PhotoCompareMode, Side
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.theme import em
from gaga_studio.ui.viewport import gizmo

_SIDE = 2048  # longest side of the photo, pixels
_ERROR_SIDE = 1024
_NAMES = {
    Side.PHOTO: "Photo",
    Side.PICTURE: "Picture",
    Side.GROUPS: "Groups",
    Side.TRUTH: "Truth",
    Side.ERRORS: "Errors",
    Side.BEFORE: "Before the last edit",
    Side.VERSION: "Chosen version",
    Side.PRESET: "Other preset",
}
_SHORT = {Side.BEFORE: "Before", Side.PRESET: "Preset"}  # where there is no room
_FIELD = 9.0  # em: width of a field whose name is short
_NO_MAP = "There is no true map of this photo that can be read"
_HELP = "Split view: click a photo to view the scene from its camera"


def draw(
    session: Session,
    compared: dict[str, float],
    corner: ImVec2,
    size: ImVec2,
    camera: Camera,
    render_left: Callable[[Camera], int],
) -> bool:
    """What is compared; whether the mouse belongs to the line or the choices."""
    view, io = session.view, imgui.get_io()
    if view.holds_photo and not (imgui.is_key_down(imgui.Key.g) and io.key_shift):
        view.holds_photo = False
    if view.compare is PhotoCompareMode.OFF and not view.holds_photo:
        return False
    if split_view.end_without_version(session):
        return False
    is_divided = is_split(session)
    needs_photo = not is_divided or bool(split_view.AT_A_PHOTO & set(view.sides))
    photo = split_view.compared_photo(session) if needs_photo else None
    if needs_photo and photo is None:
        if is_divided:
            return _choices(session, corner, size, "" if session.rig.is_moving else _HELP)
        if not session.rig.is_moving:
            _note("Click a photo to view the scene from its camera", corner, size)
        return False
    whole = PhotoPlacement(corner.x, corner.y, size.x, size.y)
    place = whole if photo is None else _placement(photo, camera, corner)
    imgui.push_clip_rect(corner, ImVec2(corner.x + size.x, corner.y + size.y), True)
    owns, text = False, ""
    if is_divided:
        text = _sides(session, compared, photo, place, whole, render_left(camera))
        owns = _line(session, place, corner, size)
    elif photo is not None and view.holds_photo:
        _image(textures.photo(session, photo.name, _SIDE), place)
        text = f"Photo {photo.name}"
    elif photo is not None:
        text = _difference(session, compared, photo, place)
    imgui.pop_clip_rect()
    if is_divided:
        return _choices(session, corner, size, text) or owns
    _note(text, corner, size)
    return owns


def is_split(session: Session) -> bool:
    """Whether the picture is divided by the line."""
    view = session.view
    return view.compare is PhotoCompareMode.SWIPE and not view.holds_photo


def bar_height(session: Session) -> float:
    """What the choices of a split view take of the head of the picture; 0 without them."""
    return imgui.get_frame_height() + em(1.1) if is_split(session) else 0.0


def _placement(photo: Camera, camera: Camera, corner: ImVec2) -> PhotoPlacement:
    """Placement of the photo on the screen."""
    density = imgui.get_io().display_framebuffer_scale
    on_picture = split_view.place_photo(photo, camera)
    return PhotoPlacement(
        corner.x + on_picture.x / density.x,
        corner.y + on_picture.y / density.y,
        on_picture.width / density.x,
        on_picture.height / density.y,
    )


def _sides(
    session: Session,
    compared: dict[str, float],
    photo: Camera | None,
    place: PhotoPlacement,
    whole: PhotoPlacement,
    drawn: int,
) -> str:
    """Both sides, each up to the line; a sentence on what they show, "" if there is none."""
    view = session.view
    at = place.x + view.swipe * place.width
    bottom = whole.y + whole.height
    spans = ((whole.x, at), (at, whole.x + whole.width))
    sentence = ""
    for side, (low, high) in zip(view.sides, spans, strict=True):
        imgui.push_clip_rect(ImVec2(low, whole.y), ImVec2(high, bottom), True)
        if side in split_view.AT_A_PHOTO and photo is not None:
            # A photo may cover less than the picture: the other side is not seen next to it.
            drawing = imgui.get_window_draw_list()
            ground = theme.u32(theme.BACK)
            drawing.add_rect_filled(ImVec2(low, whole.y), ImVec2(high, bottom), ground)
            sentence = _photo_side(session, compared, photo, place, side) or sentence
        elif low == whole.x and drawn:  # the right side is the picture itself
            if side is Side.PRESET:
                sentence = split_view.found_text(session)
            corner, end = ImVec2(whole.x, whole.y), ImVec2(whole.x + whole.width, bottom)
            texture = imgui.ImTextureRef(drawn)
            imgui.get_window_draw_list().add_image(texture, corner, end, ImVec2(0, 1), ImVec2(1, 0))
        elif low == whole.x and side is Side.PRESET:
            sentence = split_view.missing_text(session)
        imgui.pop_clip_rect()
    return sentence


def _photo_side(
    session: Session, compared: dict[str, float], photo: Camera, place: PhotoPlacement, side: Side
) -> str:
    """A side that is a picture of the photo's size; what it says in words."""
    if side is Side.PHOTO:
        is_there = _image(textures.photo(session, photo.name, _SIDE), place)
        return "" if is_there else "Reading the photo…"
    truth, scene, images = split_view.truth_folder(session), session.scene, session.images
    path = textures.photo_path(session, photo.name)
    if truth is None or scene is None or images is None:
        return "There are no true maps"
    if side is Side.TRUTH:
        key = f"truth {truth} {photo.name}"
        load = partial(truth_picture, truth, photo.name, _SIDE)
        if _image(images.texture(key, load), place):
            return ""
        return _NO_MAP if images.cannot_read(key) else "Reading the true map…"
    if path is None:
        return "This photo cannot be read"
    mark = f"{split_view.content_mark(scene)} {scene.revision.labels}"
    key = f"errors {path} {mark}"
    frozen: Scene = split_view.snapshot(scene)

    def errors() -> UInt8Array:
        found = split_view.errors_of(frozen, photo, path, truth, _ERROR_SIDE)
        compared[key] = found[1]
        return found[0]

    if images.cannot_read(key):
        return _NO_MAP
    if not _image(images.texture(key, errors), place) or key not in compared:
        return "Comparing groups and truth…"
    return f"{100 * compared[key]:.1f} % right (blue); red: another group, yellow: none"


def _image(texture: tuple[int, int, int] | None, place: PhotoPlacement) -> bool:
    if texture is None:
        return False
    low = ImVec2(place.x, place.y)
    high = ImVec2(place.x + place.width, place.y + place.height)
    imgui.get_window_draw_list().add_image(imgui.ImTextureRef(texture[0]), low, high)
    return True


def _line(session: Session, place: PhotoPlacement, corner: ImVec2, size: ImVec2) -> bool:
    view = session.view
    at = place.x + view.swipe * place.width
    top, end = corner.y, corner.y + size.y
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


def _choices(session: Session, corner: ImVec2, size: ImVec2, text: str) -> bool:
    """Names left and right of the line, at the upper edge; whether the mouse is there."""
    view = session.view
    high, gap, pad = imgui.get_frame_height(), imgui.get_style().item_spacing.x, em(0.4)
    free = size.x - gizmo.height(session, size)  # the view cube, as wide, stands at the right
    widths = _widths(session, free - 1.12 * high - 2 * gap - 4 * pad)
    total = sum(widths) + 1.12 * high + 2 * gap
    middle = min((size.x - total) / 2, free - total - pad)
    low = ImVec2(corner.x + max(middle, pad), corner.y + em(0.7))
    drawing = imgui.get_window_draw_list()
    back = theme.u32(theme.BACK, 0.85)
    end = ImVec2(low.x + total + pad, low.y + high + pad)
    drawing.add_rect_filled(ImVec2(low.x - pad, low.y - pad), end, back, em(0.3))
    imgui.set_cursor_screen_pos(low)
    left, right = view.sides
    left = _side("Left side", session, left, split_view.LEFT, widths[0])
    imgui.same_line(0, gap)
    right = _side("Right side", session, right, split_view.RIGHT, widths[1])
    if (left, right) != view.sides:
        split_view.show(session, left, right)
    imgui.same_line(0, gap)
    if widgets.icon_button("Close split view", icons.CLOSE, hint="One picture again"):
        view.compare = PhotoCompareMode.OFF
    if text:
        _note(text, ImVec2(corner.x, low.y + high), size)
    return imgui.is_mouse_hovering_rect(ImVec2(low.x - pad, low.y - pad), end)


def _widths(session: Session, room: float) -> tuple[float, float]:
    """Widths of both fields within ``room``: each holds its name, in short where it must; where
    that is not enough the longer one is cut."""
    left, right = (
        max(imgui.calc_text_size(_name(session, side)).x + _frame(), em(_FIELD))
        for side in session.view.sides
    )
    if left + right <= room:
        return left, right
    left, right = (
        imgui.calc_text_size(_SHORT.get(side, _name(session, side))).x + _frame()
        for side in session.view.sides
    )
    if left + right <= room:
        spare = (room - left - right) / 2
        return left + spare, right + spare
    room = max(room, em(6))
    short = min(left, right, room / 2)
    return (short, room - short) if left < right else (room - short, short)


def _frame() -> float:
    """What a field has next to its text: padding and its arrow."""
    return 2 * imgui.get_style().frame_padding.x + imgui.get_frame_height()


def _name(session: Session, side: Side) -> str:
    named = split_view.name_of_version(session) if side is Side.VERSION else ""
    return named or _NAMES[side]


def _side(
    name: str, session: Session, current: Side, choices: tuple[Side, ...], width: float
) -> Side:
    """A drop-down of what a side can show; what cannot be shown says why."""
    imgui.set_next_item_width(width)
    why_not = {side: split_view.why_not(session, side) for side in choices}
    shown = {side: _name(session, side) for side in (*choices, current)}
    whole, room = shown[current], width - _frame()
    if imgui.calc_text_size(whole).x > room:
        shown[current] = widgets.elided(_SHORT.get(current, whole), room)
    return widgets.combo(name, shown, current, why_not, whole if shown[current] != whole else "")


def _difference(
    session: Session, differences: dict[str, float], photo: Camera, place: PhotoPlacement
) -> str:
    """The heat map, once it is there; what it says in words."""
    path = textures.photo_path(session, photo.name)
    if path is None or session.scene is None or session.images is None:
        return "This photo cannot be read"
    key = f"difference {path} {split_view.content_mark(session.scene)}"
    scene: Scene = split_view.snapshot(session.scene)

    def load() -> UInt8Array:
        picture, differences[key] = split_view.difference(scene, photo, path)
        return picture

    if not _image(session.images.texture(key, partial(load)), place) or key not in differences:
        return "Comparing photo and picture…"
    return f"Difference of photo and picture: {255 * differences[key]:.1f} of 255 on average"


def _note(text: str, corner: ImVec2, size: ImVec2) -> None:
    """A line at the upper edge of the picture, in the middle."""
    pad = ImVec2(em(0.6), em(0.3))
    room = max(size.x - 4 * pad.x, em(8))
    extent = imgui.calc_text_size(text, wrap_width=room)
    low = ImVec2(corner.x + (size.x - extent.x) / 2 - pad.x, corner.y + em(0.7))
    high = ImVec2(low.x + extent.x + 2 * pad.x, low.y + extent.y + 2 * pad.y)
    drawing = imgui.get_window_draw_list()
    drawing.add_rect_filled(low, high, theme.u32(theme.BACK, 0.8), em(0.3))
    at, color = ImVec2(low.x + pad.x, low.y + pad.y), theme.u32(theme.TEXT)
    drawing.add_text(imgui.get_font(), imgui.get_font_size(), at, color, text, wrap_width=room)
