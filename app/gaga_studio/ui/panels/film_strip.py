"""The film strip: photos of the scene with their masks; a click flies to where one was taken."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import accumulate

from imgui_bundle import ImVec2, imgui

from gaga_core.camera import Camera
from gaga_core.errors import counted
from gaga_studio.features import camera as navigation
from gaga_studio.features import reconstruction, split_view
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, textures, theme, widgets
from gaga_studio.ui.kit.theme import em

_NARROW = 1.5  # times its height: in a panel less wide, photos are in rows below one another
_FROM_CAMERA = "click to view the scene from this camera"


@dataclass
class FilmStripState:
    """What the strip shows, and where it was scrolled to."""

    shows_masks: bool = False  # over the photos
    seen: int | None = None  # photo that the strip was last scrolled to


def draw(session: Session, state: FilmStripState) -> None:
    """The whole panel."""
    document = session.document
    if document is None or not session.cameras:
        what = "This file comes without photos." if document is not None else ""
        if session.photos is not None and document is None:
            _photos(session)
        else:
            widgets.empty_state(icons.IMAGES, "No photos", what)
        return
    room = imgui.get_content_region_avail()
    is_narrow = room.x < _NARROW * room.y
    imgui.begin_group()
    _head(session, state, is_narrow=is_narrow)
    imgui.end_group()
    flags = imgui.WindowFlags_.none
    if not is_narrow:
        imgui.same_line(0, em(0.8))
        flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
    if imgui.begin_child("Strip", ImVec2(0, 0), imgui.ChildFlags_.none, flags):
        (_grid if is_narrow else _strip)(session, document, state)
    imgui.end_child()


def _photos(session: Session) -> None:
    """Photos that have no splats yet: only what is visible is drawn and loaded."""
    files, io = reconstruction.photo_files(session), imgui.get_io()
    width, height = session.photos.size if session.photos is not None else (4, 3)
    aspect = width / height
    if not files:
        widgets.empty_state(icons.IMAGES, "A film", "Its pictures are here when they are chosen.")
        return
    flags = imgui.WindowFlags_.horizontal_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse
    room = ImVec2(0, imgui.get_content_region_avail().y)
    if imgui.begin_child("Photos", room, imgui.ChildFlags_.none, flags):
        if io.mouse_wheel and imgui.is_window_hovered():
            imgui.set_scroll_x(imgui.get_scroll_x() - io.mouse_wheel * em(7))
        bar = imgui.get_style().scrollbar_size
        high = max(imgui.get_window_height() - bar, em(2))
        step = high * aspect + em(0.5)
        start, left = imgui.get_cursor_pos(), imgui.get_scroll_x()
        cameras = reconstruction.photo_cameras(session)
        first = max(int(left / step), 0)
        last = min(int((left + imgui.get_window_width()) / step) + 1, len(files))
        for at in range(first, last):
            imgui.set_cursor_pos(ImVec2(start.x + at * step, start.y))
            textures.place(textures.photo_file(session, files[at]), high * aspect, aspect)
            taken_from = cameras[at]
            hint = ""
            if taken_from is not None:
                hint = f": {_FROM_CAMERA}"
                imgui.set_cursor_pos(ImVec2(start.x + at * step, start.y))
                if imgui.invisible_button(f"View {files[at].name}", ImVec2(high * aspect, high)):
                    session.rig.go_to(taken_from)
            widgets.tooltip(f"{files[at].name}{hint}")
        imgui.set_cursor_pos(ImVec2(start.x + len(files) * step - em(0.5), start.y))
        imgui.dummy(ImVec2(1, 1))
    imgui.end_child()


def _head(session: Session, state: FilmStripState, *, is_narrow: bool) -> None:
    """Left of the photos, or above them: how many there are, and whether masks are shown over
    them."""
    folder = session.project.folder if session.project is not None else None
    n_test = len(folder.test) if folder is not None else 0
    use = f"{n_test} for testing" if n_test else "all for training"
    if is_narrow:
        imgui.align_text_to_frame_padding()
    imgui.text_unformatted(counted(len(session.cameras), "photo"))
    if is_narrow:
        widgets.tooltip(use)
        imgui.same_line(0, em(0.8))
    else:
        widgets.dim(use)
    why_not = "" if len(session.masks) else "There are no masks here."
    hint = "Show the masks over the photos"
    label = f"{icons.MASK}  Masks###Masks"
    if widgets.toggle(label, state.shows_masks, hint=hint, why_not=why_not):
        state.shows_masks = not state.shows_masks


def _strip(session: Session, document: Document, state: FilmStripState) -> None:
    """Only what is visible is drawn and loaded."""
    io = imgui.get_io()
    if io.mouse_wheel and imgui.is_window_hovered():
        imgui.set_scroll_x(imgui.get_scroll_x() - io.mouse_wheel * em(7))
    scroll, room = imgui.get_scroll_x(), imgui.get_content_region_avail()
    bar = imgui.get_style().scrollbar_size
    gap = em(0.5)
    height = max(imgui.get_window_height() - em(1.3) - bar, em(2))
    widest = max(camera.width / camera.height for camera in session.cameras)
    height = min(height, max((room.x - 2 * gap) / 2 / widest, em(3)))  # two fit side by side
    widths = [height * camera.width / camera.height for camera in session.cameras]
    ends = list(accumulate(width + gap for width in widths))
    first = max(bisect_left(ends, scroll) - 1, 0)
    last = min(bisect_right(ends, scroll + room.x + gap) + 1, len(widths))
    start = imgui.get_cursor_pos()
    _follow(session, state, widths, ends)
    in_view = split_view.photo_in_view(session)
    for index in range(first, last):
        imgui.set_cursor_pos(ImVec2(start.x + ends[index] - widths[index] - gap, start.y))
        size = ImVec2(widths[index], height)
        _thumbnail(session, document, state, index, size, is_active=index == in_view)
    imgui.set_cursor_pos(ImVec2(start.x + ends[-1] - gap, start.y + height))
    imgui.dummy(ImVec2(1, 1))


def _grid(session: Session, document: Document, state: FilmStripState) -> None:
    """Two photos in a row; only the rows in sight are drawn and loaded."""
    gap, start, width = em(0.5), imgui.get_cursor_pos(), imgui.get_content_region_avail().x
    cell = (width - gap) / 2
    narrowest = min(camera.width / camera.height for camera in session.cameras)
    high = min(cell / narrowest, max(imgui.get_window_height() - em(1.3) - gap, em(3)))
    step, n = high + em(1.3) + gap, len(session.cameras)
    active = session.active_view
    if active is not None and active != state.seen and active < n:
        state.seen = active
        imgui.set_scroll_y(max(active // 2 * step - (imgui.get_window_height() - step) / 2, 0.0))
    in_view, first = split_view.photo_in_view(session), int(imgui.get_scroll_y() / step)
    last = int((imgui.get_scroll_y() + imgui.get_window_height()) / step) + 1
    for index in range(2 * first, min(2 * last, n)):
        aspect = session.cameras[index].width / session.cameras[index].height
        size = ImVec2(min(cell, high * aspect), min(high, cell / aspect))
        x = index % 2 * (cell + gap) + (cell - size.x) / 2
        imgui.set_cursor_pos(ImVec2(start.x + x, start.y + index // 2 * step))
        _thumbnail(session, document, state, index, size, is_active=index == in_view)
    imgui.set_cursor_pos(ImVec2(start.x, start.y + -(-n // 2) * step - gap))
    imgui.dummy(ImVec2(1, 1))


def _follow(
    session: Session, state: FilmStripState, widths: list[float], ends: list[float]
) -> None:
    """Scroll to the photo that the camera went to."""
    active = session.active_view
    if active == state.seen or active is None or active >= len(widths):
        return
    state.seen = active
    middle = ends[active] - widths[active] / 2
    imgui.set_scroll_x(max(middle - imgui.get_window_width() / 2, 0.0))


def _thumbnail(
    session: Session,
    document: Document,
    state: FilmStripState,
    index: int,
    size: ImVec2,
    *,
    is_active: bool,
) -> None:
    camera = session.cameras[index]
    corner = imgui.get_cursor_screen_pos()
    high = ImVec2(corner.x + size.x, corner.y + size.y)
    if imgui.invisible_button(f"View {camera.name}", size):
        navigation.go_to_view(session, index)
    is_hot = imgui.is_item_hovered()
    widgets.tooltip(f"{camera.name}: {_FROM_CAMERA}")
    drawing = imgui.get_window_draw_list()
    if state.shows_masks:
        bank = document.scene.bank if session.live is None else session.live.bank
        texture = textures.photo_with_masks(session, camera.name, bank)
    else:
        texture = textures.photo(session, camera.name)
    if texture is None:
        drawing.add_rect_filled(corner, high, theme.u32(theme.RAISED), em(0.2))
    else:
        picture = imgui.ImTextureRef(texture[0])
        drawing.add_image_rounded(
            picture, corner, high, ImVec2(0, 0), ImVec2(1, 1), 0xFFFFFFFF, em(0.2)
        )
    if is_active or is_hot:
        color = theme.ACCENT if is_active else theme.LINE_STRONG
        drawing.add_rect(corner, high, theme.u32(color), em(0.2), theme.scaled(2))
    _caption(session, camera, corner, size, is_active)


def _caption(
    session: Session, camera: Camera, corner: ImVec2, size: ImVec2, is_active: bool
) -> None:
    folder = session.project.folder if session.project is not None else None
    is_test = folder is not None and camera.name in folder.test
    mark = imgui.calc_text_size("test").x + em(0.4) if is_test else 0.0
    at = ImVec2(corner.x, corner.y + size.y + em(0.1))
    drawing = imgui.get_window_draw_list()
    with theme.face(scale=0.87):
        shown = widgets.elided(camera.name, size.x - mark)
        color = theme.TEXT if is_active else theme.DIM
        drawing.add_text(at, theme.u32(color), shown)
        if is_test:
            edge = ImVec2(corner.x + size.x - imgui.calc_text_size("test").x, at.y)
            drawing.add_text(edge, theme.u32(theme.ACCENT), "test")
