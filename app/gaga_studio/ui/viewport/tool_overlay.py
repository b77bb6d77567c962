"""What a tool draws over the picture: rectangles, outlines, the brush."""

from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.scene.edits import How
from gaga_studio.tools.base import PathShape, RectShape
from gaga_studio.ui.kit import theme
from gaga_studio.ui.kit.theme import em

_FILLED = 0.12
_LINE = 0.9
_WIDE = 1.5  # of a line, pixels at 96 dpi


def rectangle(shape: RectShape, corner: ImVec2, density: ImVec2) -> None:
    """A rectangle, filled faintly."""
    a, b = _at(shape.u0, shape.v0, corner, density), _at(shape.u1, shape.v1, corner, density)
    low, high = ImVec2(min(a.x, b.x), min(a.y, b.y)), ImVec2(max(a.x, b.x), max(a.y, b.y))
    drawing, color = imgui.get_window_draw_list(), _color(shape.how)
    drawing.add_rect_filled(low, high, theme.u32(color, _FILLED))
    drawing.add_rect(low, high, theme.u32(color, _LINE), thickness=theme.scaled(1))


def path(shape: PathShape, corner: ImVec2, density: ImVec2) -> None:
    """An outline with its corners, or the circle of the brush."""
    points: list[ImVec2 | tuple[float, float] | list[float]] = [
        _at(u, v, corner, density) for u, v in shape.points
    ]
    drawing, color = imgui.get_window_draw_list(), _color(shape.how)
    if shape.radius and points:
        # Two lines, so that the brush is seen on dark and on bright.
        radius, line = shape.radius / density.x, theme.scaled(1)
        drawing.add_circle(points[-1], radius + line, theme.u32(theme.BACK, _LINE), 0, line)
        drawing.add_circle(points[-1], radius, theme.u32(color, 1.0), 0, line)
        return
    if shape.is_closed and len(points) > 2:
        drawing.add_concave_poly_filled(points, theme.u32(color, _FILLED))
    flags = imgui.ImDrawFlags_.closed if shape.is_closed else imgui.ImDrawFlags_.none
    drawing.add_polyline(points, theme.u32(color, _LINE), theme.scaled(_WIDE), flags)
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
    for color, wide in ((theme.u32(theme.BACK, _LINE), 4.0), (theme.u32(theme.TEXT, 1.0), _WIDE)):
        line = theme.scaled(wide)
        drawing.add_circle(at, radius, color, 0, line)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            near = ImVec2(at.x + x * gap, at.y + y * gap)
            drawing.add_line(near, ImVec2(at.x + x * arm, at.y + y * arm), color, line)


def _at(u: float, v: float, corner: ImVec2, density: ImVec2) -> ImVec2:
    return ImVec2(corner.x + u / density.x, corner.y + v / density.y)


def _color(how: How) -> ImVec4:
    return theme.BAD if how == "remove" else theme.ACCENT
