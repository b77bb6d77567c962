"""What the picture shows while nothing is open: three ways to begin, and recent scenes."""

from pathlib import Path

from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_studio.features import commands
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import icons, theme, widgets
from gaga_studio.ui.kit.theme import em

_CHOICES = (
    ("file.open_folder", icons.FOLDER, "Open a scene folder", "Photos, cameras, splats, masks"),
    ("file.open_file", icons.FILE, "Open a splat file", "PLY, SPZ, SOG, .splat, project"),
    ("file.demo", icons.DEMO, "Try the demo", "A furnished room, ready to edit"),
)
_MOST_RECENT = 5
_CARD_EDGE = 12.0  # of a card that no text comes near, both sides together, pixels at 96 dpi


def draw(session: Session, steps_height: float) -> None:
    """Three large choices in the middle; below them what was open lately."""
    room = imgui.get_content_region_avail()
    room.y -= steps_height
    corner = imgui.get_cursor_screen_pos()
    if session.jobs.running is not None:
        _opening(session, room)
        return
    recent = session.settings.recent[:_MOST_RECENT] if room.y > em(24) else ()
    card = ImVec2(min(em(14.5), (room.x - em(4)) / 3), em(8.6))
    is_wide = room.x > em(40) and _widest_detail() <= card.x - theme.scaled(_CARD_EDGE)
    if not is_wide:
        card = ImVec2(min(room.x - em(3), em(24)), em(3.5))
    height = card.y + em(3.6) if is_wide else 3 * card.y + em(4.2)
    height += (len(recent) + 2) * imgui.get_text_line_height_with_spacing() if recent else em(2)
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + max((room.y - height) * 0.45, em(0.5)))
    with theme.face(strong=True, scale=1.35):
        widgets.wrapped("Open a scene to begin", theme.TEXT)
    imgui.dummy(ImVec2(0, em(0.5)))
    left = (room.x - (3 * card.x + em(1.6) if is_wide else card.x)) / 2
    for position, (command, icon, title, detail) in enumerate(_CHOICES):
        if position == 0 or not is_wide:
            imgui.set_cursor_pos_x(left)
        if _card(title, icon, detail, card, is_wide):
            commands.run(command, session)
        if is_wide and position < 2:
            imgui.same_line(0, em(0.8))
    imgui.dummy(ImVec2(0, em(0.3)))
    widgets.wrapped("or drop a folder or a file into the window", theme.DIM)
    if recent:
        _recent(session, recent, corner.x + left, room.x - 2 * left)


def _widest_detail() -> float:
    """Width of the longest line under a title, pixels."""
    return max(imgui.calc_text_size(detail).x for *_, detail in _CHOICES)


def _card(title: str, icon: str, detail: str, size: ImVec2, is_wide: bool) -> bool:
    corner = imgui.get_cursor_screen_pos()
    clicked = imgui.invisible_button(title, size)
    is_hot = imgui.is_item_hovered()
    drawing = imgui.get_window_draw_list()
    high = ImVec2(corner.x + size.x, corner.y + size.y)
    drawing.add_rect_filled(corner, high, theme.u32(theme.HOT if is_hot else theme.RAISED), em(0.5))
    edge = theme.ACCENT if is_hot else theme.LINE_STRONG
    drawing.add_rect(corner, high, theme.u32(edge), em(0.5), theme.scaled(1))
    if is_wide:
        with theme.face(scale=2.1):
            extent = imgui.calc_text_size(icon)
            at = ImVec2(corner.x + (size.x - extent.x) / 2, corner.y + em(0.75))
            drawing.add_text(at, theme.u32(theme.ACCENT), icon)
        _text_centred(drawing, title, corner, size.x, em(5.1), strong=True)
        _text_centred(drawing, detail, corner, size.x, em(6.5), strong=False)
    else:
        with theme.face(scale=1.4):
            at = ImVec2(corner.x + em(0.8), corner.y + em(0.75))
            drawing.add_text(at, theme.u32(theme.ACCENT), icon)
        with theme.face(strong=True):
            at = ImVec2(corner.x + em(3.4), corner.y + em(0.5))
            drawing.add_text(at, theme.u32(theme.TEXT), title)
        shown = widgets.elided(detail, size.x - em(4))
        drawing.add_text(
            ImVec2(corner.x + em(3.4), corner.y + em(1.85)), theme.u32(theme.DIM), shown
        )
    return clicked


def _text_centred(
    drawing: imgui.ImDrawList,
    text: str,
    corner: ImVec2,
    width: float,
    top: float,
    *,
    strong: bool,
) -> None:
    color: ImVec4 = theme.TEXT if strong else theme.DIM
    with theme.face(strong=strong):
        shown = widgets.elided(text, width - theme.scaled(_CARD_EDGE))
        extent = imgui.calc_text_size(shown)
        at = ImVec2(corner.x + (width - extent.x) / 2, corner.y + top)
        drawing.add_text(at, theme.u32(color), shown)


def _recent(session: Session, recent: tuple[str, ...], left: float, width: float) -> None:
    imgui.dummy(ImVec2(0, em(0.4)))
    imgui.set_cursor_screen_pos(ImVec2(left, imgui.get_cursor_screen_pos().y))
    with theme.face(strong=True), theme.text_color(theme.DIM):
        imgui.text_unformatted("Recent")
    for position, name in enumerate(recent):
        path = Path(name)
        imgui.set_cursor_screen_pos(ImVec2(left, imgui.get_cursor_screen_pos().y))
        icon = icons.FILE_PLAIN if path.suffix else icons.FOLDER_PLAIN
        shown = widgets.elided(f"{path.name}   {path.parent}", width - em(3))
        label = f"{icon}  {shown}###Recent {position}"
        clicked, _ = imgui.selectable(label, False, 0, ImVec2(width, 0))
        if clicked:
            session.open(path)
        widgets.tooltip(name)


def _opening(session: Session, room: ImVec2) -> None:
    job = session.jobs.running
    if job is None:
        return
    imgui.set_cursor_pos_y(imgui.get_cursor_pos_y() + room.y * 0.4)
    with theme.face(strong=True, scale=1.2):
        widgets.wrapped(f"{job.title} …", theme.TEXT)
    if job.message:
        widgets.wrapped(job.message, theme.DIM)
    width = min(em(22), room.x * 0.7)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + (room.x - width) / 2)
    fraction = job.fraction if job.fraction >= 0 else -imgui.get_time()
    imgui.progress_bar(fraction, ImVec2(width, em(0.35)), "")
