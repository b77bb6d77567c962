"""The points of the ground tool: numbered marks on the surface, joined by lines."""

from itertools import pairwise

import numpy as np
from imgui_bundle import ImVec2, imgui

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_studio.features import measure
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.ui.kit import theme
from gaga_studio.ui.kit.theme import em

_NEAREST = 1e-6  # depth from which a point is in front of the camera, scene units
_FILLED, _LINE, _WANTED = 0.2, 0.95, 0.45  # opacities


def draw(session: Session, camera: Camera, corner: ImVec2, *, follows: bool) -> None:
    """The points as ``camera`` sees them; with ``follows`` the lines go on to the mouse."""
    points = measure.clicked(session).points
    if session.tool is ToolName.GROUND and points:
        draw_points(np.array(points), camera, corner, follows=follows, fills=True)


def draw_points(
    points: DoubleArray, camera: Camera, corner: ImVec2, *, follows: bool, fills: bool = False
) -> bool:
    """Points (K, 3), world, as numbered marks joined by lines; False where one is not in front.

    ``fills``: with two points and the mouse they are the corners of a plane.
    """
    if len(points) == 0 or (camera.project(points)[1] < _NEAREST).any():
        return False  # behind the camera: a line there would go astray
    marks = on_screen(points, camera, corner)
    _lines(marks, imgui.get_io().mouse_pos if follows else None, fills=fills)
    for number, mark in enumerate(marks, 1):
        _mark(mark, str(number))
    return True


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
            fill = theme.u32(theme.ACCENT, _FILLED)
            drawing.add_triangle_filled(marks[0], marks[1], mouse, fill)
        for mark in marks if fills else marks[-1:]:
            drawing.add_line(mark, mouse, wanted, theme.scaled(1.5))
    for one, two in pairwise(marks):
        drawing.add_line(one, two, line, theme.scaled(2))


def _mark(at: ImVec2, number: str) -> None:
    """A disk with two rims, so that it is seen on dark and on bright."""
    drawing, radius = imgui.get_window_draw_list(), em(0.55)
    drawing.add_circle_filled(at, radius + theme.scaled(1.5), theme.u32(theme.BACK, _LINE))
    drawing.add_circle_filled(at, radius, theme.u32(theme.ACCENT, 1.0))
    with theme.face(strong=True, scale=0.75):
        extent = imgui.calc_text_size(number)
        place = ImVec2(at.x - extent.x / 2, at.y - extent.y / 2)
        drawing.add_text(place, theme.u32(theme.BACK, 1.0), number)
