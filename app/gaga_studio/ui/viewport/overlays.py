"""Drawn over the picture: points of tools, the box of the selection, outlines, the brush."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.scene.edits import How
from gaga_core.scene.objects import group_colors
from gaga_studio.features import measure, simulate
from gaga_studio.features.find import click_object
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import PathShape, RectShape
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.picture_area import Rect, overlap
from gaga_studio.ui.kit.theme import em

_NEAREST = 1e-6  # depth from which a point is in front of the camera, scene units
_PLANE, _LINE, _WANTED = 0.2, 0.95, 0.45  # opacities
_RADIUS, _RIM = 0.55, 1.5  # of the mark of a point, ems, and of the rim around it, pixels at 96 dpi
_PAD = 0.3  # around the text of a label, ems
Point = tuple[float, float]  # on the screen


def ground(session: Session, camera: Camera, corner: ImVec2, *, follows: bool) -> None:
    """The points as ``camera`` sees them; with ``follows`` the lines go on to the mouse."""
    points = measure.clicked(session).points
    if session.tool is ToolName.GROUND and points:
        draw_points(np.array(points), camera, corner, follows=follows, fills=True)


def waiting_clicks(session: Session, camera: Camera, corner: ImVec2) -> None:
    """The clicks that are answered when the scene is analysed; those behind the camera not."""
    for click in click_object.waiting(session) if session.document is not None else ():
        point = np.array([click.point])
        if camera.project(point)[1][0] >= _NEAREST:
            _mark(on_screen(point, camera, corner)[0], "+" if click.is_on else "-")


def draw_points(
    points: DoubleArray,
    camera: Camera,
    corner: ImVec2,
    *,
    follows: bool,
    fills: bool = False,
    texts: Sequence[str] = (),
) -> tuple[Rect, ...]:
    """Points (K, 3), world, as numbered marks joined by lines; nothing where one is not in front.

    ``fills``: with two points and the mouse they are the corners of a plane. ``texts`` (K - 1) are
    said at the middle of the lines, see `label_places`; returns where.
    """
    if len(points) == 0 or (camera.project(points)[1] < _NEAREST).any():
        return ()  # behind the camera: a line there would go astray
    marks = on_screen(points, camera, corner)
    _lines(marks, imgui.get_io().mouse_pos if follows else None, fills=fills)
    n = len(texts)
    middles = on_screen((points[1:] + points[:-1])[:n] / 2, camera, corner)
    sizes = [imgui.calc_text_size(text) for text in texts]
    places = label_places(
        [(mark.x, mark.y) for mark in marks],
        [(at.x, at.y) for at in middles],
        [(size.x + 2 * em(_PAD), size.y + em(_PAD)) for size in sizes],
        em(_RADIUS) + theme.scaled(_RIM),
    )
    for text, place in zip(texts, places, strict=False):
        if place is not None:
            _label(text, place)
    for number, mark in enumerate(marks, 1):
        _mark(mark, str(number))
    return tuple(place for place in places if place is not None)


def label_places(
    marks: Sequence[Point], middles: Sequence[Point], sizes: Sequence[Point], radius: float
) -> list[Rect | None]:
    """Where labels of ``sizes`` stand on the ways from each of the ``marks`` to the next one.

    That is at the middle of the way; where a mark of this ``radius`` or an earlier label is there,
    below or above the two marks, else of all; None where there are labels, too.
    """
    taken = [(x - radius, y - radius, x + radius, y + radius) for x, y in marks]
    found: list[Rect | None] = []
    for (a, b), (x, y), (width, height) in zip(pairwise(marks), middles, sizes, strict=False):
        own, all_marks, away = (a[1], b[1]), [v for _, v in marks], radius + height
        lines = (y, max(own) + away, min(own) - away, max(all_marks) + away, min(all_marks) - away)
        rects = ((x - width / 2, v - height / 2, x + width / 2, v + height / 2) for v in lines)
        place = next((r for r in rects if not any(overlap(r, other) for other in taken)), None)
        found.append(place)
        taken += [place] if place is not None else []
    return found


def on_screen(points: DoubleArray, camera: Camera, corner: ImVec2) -> list[ImVec2]:
    """Places of points (K, 3), world, on the screen."""
    density = imgui.get_io().display_framebuffer_scale
    pixels, _ = camera.project(points)
    return [
        ImVec2(corner.x + float(u) / density.x, corner.y + float(v) / density.y) for u, v in pixels
    ]


def _lines(marks: list[ImVec2], mouse: ImVec2 | None, *, fills: bool) -> None:
    drawing = imgui.get_window_draw_list()
    wanted, line = theme.u32(theme.ACCENT, _WANTED), theme.u32(theme.ACCENT, _LINE)
    if mouse is not None:
        if fills and len(marks) == 2:
            fill = theme.u32(theme.ACCENT, _PLANE)
            drawing.add_triangle_filled(marks[0], marks[1], mouse, fill)
        for mark in marks if fills else marks[-1:]:
            drawing.add_line(mark, mouse, wanted, theme.scaled(1.5))
    for one, two in pairwise(marks):
        drawing.add_line(one, two, line, theme.scaled(2))


def _mark(at: ImVec2, number: str) -> None:
    """A disk with two rims, so that it is seen on dark and on bright."""
    drawing, radius = imgui.get_window_draw_list(), em(_RADIUS)
    drawing.add_circle_filled(at, radius + theme.scaled(_RIM), theme.u32(theme.BACK, _LINE))
    drawing.add_circle_filled(at, radius, theme.u32(theme.ACCENT, 1.0))
    with theme.face(strong=True, scale=0.75):
        extent = imgui.calc_text_size(number)
        place = ImVec2(at.x - extent.x / 2, at.y - extent.y / 2)
        drawing.add_text(place, theme.u32(theme.BACK, 1.0), number)


# --- The smallest box around the selection, as lines in the picture.

_EDGES = [(i, i | 1 << side) for side in range(3) for i in range(8) if not i >> side & 1]


def box(session: Session, camera: Camera, corner: ImVec2) -> None:
    """The box where *Box* is on and something is selected; not during a drag."""
    document = session.document
    if document is None or not session.view.show_box or session.is_previewing:
        return
    box = document.selected_oriented_box()
    if box is None:
        return
    corners = box.corners()
    if (camera.project(corners)[1] < _NEAREST).any():
        return  # behind the camera: a line there would go astray
    places = on_screen(corners, camera, corner)
    drawing = imgui.get_window_draw_list()
    for one, two in _EDGES:
        drawing.add_line(places[one], places[two], theme.u32(theme.BACK, 0.7), theme.scaled(3))
        drawing.add_line(places[one], places[two], theme.u32(theme.ACCENT, 0.95), theme.scaled(1.4))


def parts(session: Session, camera: Camera, corner: ImVec2) -> None:
    """The convex parts of bodies for simulators, each in a color, as lines in the picture."""
    shown = simulate.shown_parts(session)
    if shown is None or shown.edges is None or shown.parts is None or session.is_previewing:
        return
    depths = camera.project(shown.edges.reshape(-1, 3))[1].reshape(-1, 2)
    in_front = (depths >= _NEAREST).all(axis=1)
    palette = group_colors(np.arange(1, int(shown.parts.max(initial=0)) + 2, dtype=np.int32))
    colors = [theme.u32(widgets.rgba(rgb), 0.9) for rgb in palette]
    places = on_screen(shown.edges[in_front].reshape(-1, 3), camera, corner)
    drawing, width = imgui.get_window_draw_list(), theme.scaled(1.2)
    rows = shown.parts[in_front].tolist()
    for one, two, part in zip(places[::2], places[1::2], rows, strict=True):
        drawing.add_line(one, two, colors[part], width)


# --- The points of the tool Measure with their lengths, and a card with the numbers and Set scale.

_WIDTH = 15.0  # of the card, em
_LOW = 14.0  # em: in a lower picture the card has what is said neither there nor in the status bar
_LOW_NARROW, _NARROW = 19.0, 35.0  # em: the same where notices have no room next to it


@dataclass
class MeasureState:
    """The known length as it is typed."""

    typed: str = "1 m"


def draw_marks(
    session: Session, camera: Camera, corner: ImVec2, *, follows: bool
) -> tuple[Rect, ...]:
    """The points as ``camera`` sees them, and on each way what it is; returns where that stands."""
    if session.tool is not ToolName.MEASURE:
        return ()
    places = measure.points(session)
    goes_on = follows and len(places) < 3
    return draw_points(places, camera, corner, follows=goes_on, texts=measure.way_texts(session))


def draw_card(session: Session, state: MeasureState, at: ImVec2, size: ImVec2) -> Rect | None:
    """What to click, the numbers, and the length that is known; returns where that stands.

    ``at``: its upper left corner, in a picture of ``size``.
    """
    if session.tool is not ToolName.MEASURE or session.document is None:
        return None
    is_low = size.y < em(_LOW if size.x >= em(_NARROW) else _LOW_NARROW)
    if is_low and not measure.reading(session).lengths:
        return None
    imgui.set_cursor_screen_pos(at)
    back = theme.BACK
    imgui.push_style_color(imgui.Col_.child_bg, ImVec4(back.x, back.y, back.z, 0.85))
    width = 0.0 if is_low else min(em(_WIDTH), size.x - em(1.4))
    flags = imgui.ChildFlags_.auto_resize_y | imgui.ChildFlags_.always_use_window_padding
    flags |= imgui.ChildFlags_.auto_resize_x if is_low else 0
    if imgui.begin_child("Measure", ImVec2(width, 0), flags):
        if not is_low:
            widgets.line(measure.prompt(session))
            _numbers(session)
        elif (angle := measure.reading(session).angle) is not None:
            imgui.text_unformatted(_angle_text(angle))
        _known_length(session, state)
    imgui.end_child()
    imgui.pop_style_color()
    return widgets.item_rect()


def _numbers(session: Session) -> None:
    for text in measure.way_texts(session):
        widgets.line(text)
    if (angle := measure.reading(session).angle) is not None:
        widgets.line(_angle_text(angle))
    heights = measure.height_texts(session)
    widgets.dim(measure.HEIGHTS if heights else measure.HELP, wrap=True)
    if heights:
        widgets.tooltip(measure.HEIGHTS_HINT)
    for text in heights:
        widgets.dim(text)


def _angle_text(angle: float) -> str:
    return f"Angle at 2: {angle:.1f}°"


def _known_length(session: Session, state: MeasureState) -> None:
    """Give the way from point 1 to point 2 a length: the scale of the scene."""
    if not measure.reading(session).lengths:
        return
    points = measure.clicked(session)
    if points.asks_length:
        points.asks_length = False
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(em(5))
    flags = imgui.InputTextFlags_.auto_select_all
    _, state.typed = imgui.input_text("##Known length", state.typed, flags)
    is_typed = imgui.is_item_deactivated() and widgets.enter_pressed()
    widgets.tooltip("The true length from point 1 to point 2: 1.5 m, 80 cm, 12 in")
    imgui.same_line()
    hint = "Scale the whole scene so that 1 to 2 has this length; lengths are metres then"
    if widgets.button("Set scale", hint=hint) or is_typed:
        measure.set_typed_scale(session, state.typed)


def _label(text: str, place: Rect) -> None:
    drawing, pad, (left, top, right, bottom) = imgui.get_window_draw_list(), em(_PAD), place
    back = theme.u32(theme.BACK, 0.85)
    drawing.add_rect_filled(ImVec2(left, top), ImVec2(right, bottom), back, em(0.25))
    drawing.add_text(ImVec2(left + pad, top + pad / 2), theme.u32(theme.TEXT), text)


# --- Marks of a tool over the picture: rectangles, outlines, the brush.

_INSIDE = 0.12
_OUTLINE = 0.9
_WIDE = 1.5  # of a line, pixels at 96 dpi


def rectangle(shape: RectShape, corner: ImVec2, density: ImVec2) -> None:
    """A rectangle, filled faintly."""
    a, b = _at(shape.u0, shape.v0, corner, density), _at(shape.u1, shape.v1, corner, density)
    low, high = ImVec2(min(a.x, b.x), min(a.y, b.y)), ImVec2(max(a.x, b.x), max(a.y, b.y))
    drawing, color = imgui.get_window_draw_list(), _color(shape.how)
    drawing.add_rect_filled(low, high, theme.u32(color, _INSIDE))
    drawing.add_rect(low, high, theme.u32(color, _OUTLINE), thickness=theme.scaled(1))


def path(shape: PathShape, corner: ImVec2, density: ImVec2) -> None:
    """An outline with its corners, or the circle of the brush."""
    points: list[ImVec2 | tuple[float, float] | list[float]] = [
        _at(u, v, corner, density) for u, v in shape.points
    ]
    drawing, color = imgui.get_window_draw_list(), _color(shape.how)
    if shape.radius and points:
        # Two lines, so that the brush is seen on dark and on bright.
        radius, line = shape.radius / density.x, theme.scaled(1)
        drawing.add_circle(points[-1], radius + line, theme.u32(theme.BACK, _OUTLINE), 0, line)
        drawing.add_circle(points[-1], radius, theme.u32(color, 1.0), 0, line)
        return
    if shape.is_closed and len(points) > 2:
        drawing.add_concave_poly_filled(points, theme.u32(color, _INSIDE))
    flags = imgui.ImDrawFlags_.closed if shape.is_closed else imgui.ImDrawFlags_.none
    drawing.add_polyline(points, theme.u32(color, _OUTLINE), theme.scaled(_WIDE), flags)
    for point in points if shape.has_corners else ():
        drawing.add_circle_filled(point, em(0.18), theme.u32(color, 1.0))


def source_mark(point: DoubleArray | None, camera: Camera, corner: ImVec2) -> None:
    """A small cross with a ring at a point (3,), world, that a brush copies from."""
    if point is None:
        return
    pixels, depth = camera.project(point[None])
    if depth[0] <= 0:
        return
    u, v = (float(x) for x in pixels[0])
    at = _at(u, v, corner, imgui.get_io().display_framebuffer_scale)
    drawing, arm, gap, radius = imgui.get_window_draw_list(), em(0.95), em(0.2), em(0.55)
    # Two lines, so that it is seen on dark and on bright.
    for color, wide in (
        (theme.u32(theme.BACK, _OUTLINE), 4.0),
        (theme.u32(theme.TEXT, 1.0), _WIDE),
    ):
        line = theme.scaled(wide)
        drawing.add_circle(at, radius, color, 0, line)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            near = ImVec2(at.x + x * gap, at.y + y * gap)
            drawing.add_line(near, ImVec2(at.x + x * arm, at.y + y * arm), color, line)


def _at(u: float, v: float, corner: ImVec2, density: ImVec2) -> ImVec2:
    return ImVec2(corner.x + u / density.x, corner.y + v / density.y)


def _color(how: How) -> ImVec4:
    return theme.BAD if how == "remove" else theme.ACCENT
