"""The cube in a corner of the picture: a click on a side looks from there, a drag orbits."""

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui

from gaga_core.arrays import DoubleArray
from gaga_studio.session.session import Session
from gaga_studio.ui.kit import theme
from gaga_studio.ui.kit.theme import em

_EDGE = 0.62  # from here to the rim of a face its edge, or corner, is meant
_REACH = 2.9  # of the cube's area, from its middle, ems
_DRAG_PIXELS = 4.0
_DRAG_GAIN = 2.5  # of an orbit, against a drag in the picture
_SIDES: tuple[tuple[str, tuple[int, int, int]], ...] = (
    ("front", (0, -1, 0)),
    ("back", (0, 1, 0)),
    ("left", (-1, 0, 0)),
    ("right", (1, 0, 0)),
    ("top", (0, 0, 1)),
    ("bottom", (0, 0, -1)),
)
Side = tuple[int, int, int]  # right, back, up, each -1, 0 or 1


def height(session: Session, size: ImVec2) -> float:
    """Of the part that the cube takes of a picture of ``size``; 0 when it is not shown."""
    reach = em(_REACH)
    fits = size.x >= 7 * reach and size.y >= 4 * reach
    is_shown = session.view.show_cube and session.shown is not None and fits
    return 2 * reach + em(0.6) if is_shown else 0.0


@dataclass
class ViewCube:
    """Keeps the drag that is under way."""

    is_dragging: bool = False
    pressed: Side | None = None

    def draw(self, session: Session, corner: ImVec2, size: ImVec2) -> bool:
        """Draw the cube in the upper right; whether the mouse belongs to it."""
        reach = em(_REACH)
        if not height(session, size):
            self.is_dragging, self.pressed = False, None
            return False
        middle = ImVec2(corner.x + size.x - reach - em(0.6), corner.y + reach + em(0.6))
        imgui.set_cursor_screen_pos(ImVec2(middle.x - reach, middle.y - reach))
        clicked = imgui.invisible_button("View cube", ImVec2(2 * reach, 2 * reach))
        is_over, is_held = imgui.is_item_hovered(), imgui.is_item_active()
        scale, cube = reach / 1.9, session.rig.cube
        mouse = imgui.get_io().mouse_pos
        at = ((mouse.x - middle.x) / scale, (mouse.y - middle.y) / scale)
        meant = hit(cube, *at) if is_over or is_held else None
        self._drag(session, is_held, meant, size)
        if clicked and not self.is_dragging and self.pressed is not None:
            session.rig.look_from(self.pressed)
        _faces(cube, middle, scale, None if self.is_dragging else meant)
        if is_over and meant is not None and not is_held:
            imgui.set_tooltip(f"Look from the {name_of(meant)}; drag to orbit")
        if not is_held:
            self.is_dragging, self.pressed = False, None
        return is_over or is_held

    def _drag(self, session: Session, is_held: bool, meant: Side | None, size: ImVec2) -> None:
        if not is_held:
            return
        if imgui.is_item_activated():
            self.pressed = meant
        delta = imgui.get_mouse_drag_delta(imgui.MouseButton_.left, _DRAG_PIXELS)
        self.is_dragging = self.is_dragging or bool(delta.x or delta.y)
        moved, density = imgui.get_io().mouse_delta, imgui.get_io().display_framebuffer_scale
        if self.is_dragging and (moved.x or moved.y):
            gain = _DRAG_GAIN * density.y
            session.rig.orbit(gain * moved.x, gain * moved.y)


def hit(cube: DoubleArray, u: float, v: float) -> Side | None:
    """The face, edge or corner of the cube at (u, v) of its picture (right, down; a face's middle
    is 1 from the cube's). ``cube`` (3, 3): see `CameraRig.cube`."""
    for _, side in _SIDES:
        normal = np.array(side)
        if (cube @ normal)[2] >= -1e-6:
            continue
        axes = [i for i in range(3) if side[i] == 0]
        plane = cube[:2, axes]
        if abs(np.linalg.det(plane)) < 1e-9:
            continue
        place = np.linalg.solve(plane, np.array([u, v]) - cube[:2] @ normal)
        if np.abs(place).max() > 1:
            continue
        for i, where in zip(axes, place, strict=True):
            normal[i] = 0 if abs(where) < _EDGE else int(np.sign(where))
        return int(normal[0]), int(normal[1]), int(normal[2])
    return None


def name_of(side: Side) -> str:
    """ "front", "front right", "top back left"."""
    names = [name for name, normal in reversed(_SIDES) if np.dot(normal, side) > 0]
    return " ".join(names)


def _faces(cube: DoubleArray, middle: ImVec2, scale: float, meant: Side | None) -> None:
    drawing = imgui.get_window_draw_list()
    for name, side in _SIDES:
        normal = np.array(side)
        facing = -float((cube @ normal)[2])
        if facing <= 1e-6:
            continue
        axes = [i for i in range(3) if side[i] == 0]
        shade = 0.35 + 0.65 * facing
        fill = theme.u32(_mixed(theme.BACK, theme.TEXT, 0.08 + 0.2 * shade), 0.92)
        _cell(cube, middle, scale, (side, axes, (-1, 1), (-1, 1)), fill)
        if meant is not None and _is_on(side, meant):
            spans = [_span(meant[i]) for i in axes]
            color = theme.u32(theme.ACCENT, 0.75)
            _cell(cube, middle, scale, (side, axes, spans[0], spans[1]), color)
        a, b, c, d = _corners(cube, middle, scale, (side, axes, (-1, 1), (-1, 1)))
        drawing.add_quad(a, b, c, d, theme.u32(theme.LINE_STRONG), theme.scaled(1))
        if facing > 0.45:
            with theme.face(strong=True, scale=0.62):
                text = name.upper()
                extent = imgui.calc_text_size(text)
                at = cube @ normal
                x = middle.x + scale * at[0] - extent.x / 2
                y = middle.y + scale * at[1] - extent.y / 2
                drawing.add_text(ImVec2(x, y), theme.u32(theme.TEXT, min(1.0, facing)), text)


_Cell = tuple[Side, list[int], tuple[float, float], tuple[float, float]]


def _cell(cube: DoubleArray, middle: ImVec2, scale: float, cell: _Cell, color: int) -> None:
    a, b, c, d = _corners(cube, middle, scale, cell)
    imgui.get_window_draw_list().add_quad_filled(a, b, c, d, color)


def _corners(cube: DoubleArray, middle: ImVec2, scale: float, cell: _Cell) -> list[ImVec2]:
    side, axes, across, along = cell
    corners = []
    for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)):
        point = np.array(side, np.float64)
        point[axes[0]], point[axes[1]] = across[p], along[q]
        at = cube @ point
        corners.append(ImVec2(middle.x + scale * at[0], middle.y + scale * at[1]))
    return corners


def _is_on(face: Side, meant: Side) -> bool:
    """Whether the part that is meant lies on this face."""
    return bool(np.dot(face, meant) > 0)


def _span(where: int) -> tuple[float, float]:
    return (-_EDGE, _EDGE) if where == 0 else (_EDGE, 1.0) if where > 0 else (-1.0, -_EDGE)


def _mixed(a: ImVec4, b: ImVec4, t: float) -> ImVec4:
    return ImVec4(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.z + t * (b.z - a.z), 1.0)
