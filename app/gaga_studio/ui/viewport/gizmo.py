"""The handles that move, turn or scale the selection, and the cube that turns the view."""

from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, imguizmo

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_studio.features import split_view
from gaga_studio.features.measure import unit as length_unit
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.gestures import CLICK_PIXELS
from gaga_studio.tools.move import MoveTool
from gaga_studio.ui.kit import theme, widgets
from gaga_studio.ui.kit.theme import em

_guizmo = imguizmo.im_guizmo
_GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL cameras look along -z, y up
_OPERATIONS = {
    ToolName.MOVE: _guizmo.OPERATION.translate,
    ToolName.ROTATE: _guizmo.OPERATION.rotate,
    ToolName.SCALE: _guizmo.OPERATION.scale,
}


_MOVES = {  # which of x, y and z each handle moves, as the library names them next to it
    _guizmo.MOVETYPE.mt_move_x: (0,),
    _guizmo.MOVETYPE.mt_move_y: (1,),
    _guizmo.MOVETYPE.mt_move_z: (2,),
    _guizmo.MOVETYPE.mt_move_yz: (1, 2),
    _guizmo.MOVETYPE.mt_move_zx: (0, 2),
    _guizmo.MOVETYPE.mt_move_xy: (0, 1),
    _guizmo.MOVETYPE.mt_move_screen: (0, 1, 2),
}
_LABEL = 15.0  # pixels right of and below the handles, where the library writes


def label_of(handle: _guizmo.MOVETYPE, way: DoubleArray) -> str:
    """What the library writes next to a handle that has moved by ``way`` (3,), world; "" for one
    that does not move."""
    return " ".join(f"{'XYZ'[axis]} : {way[axis]:5.3f}" for axis in _MOVES.get(handle, ()))


class Gizmo:
    """What is between the library's matrix and the tool's drag."""

    def __init__(self) -> None:
        self._matrix: DoubleArray | None = None  # (4, 4) world, while a handle is held
        self._ignored = False  # the drag was cancelled; wait until the button is up
        self.is_shown = False  # in the frame that was drawn last

    def draw(
        self, session: Session, tool: MoveTool, camera: Camera, corner: ImVec2, size: ImVec2
    ) -> bool:
        """Draw the handles, pass a drag on to ``tool``; whether the mouse belongs to them.

        Where the left of the picture shows an earlier version, they are neither drawn nor taken.
        """
        at = tool.handles(session) if self._matrix is None else self._matrix
        self.is_shown = at is not None
        if at is None:
            return False
        values = _matrix16(at)
        _guizmo.begin_frame()  # needed here: without it the mouse is not seen
        line = split_view.earlier_to(session, camera.width, camera.height) / camera.width
        first = corner.x + line * size.x
        drawing = imgui.get_window_draw_list()
        drawing.push_clip_rect(ImVec2(first, corner.y), corner + size, True)
        is_taken = not line or self._matrix is not None or imgui.get_io().mouse_pos.x >= first
        _guizmo.enable(is_taken)  # gray otherwise
        _guizmo.set_drawlist()
        _guizmo.set_rect(corner.x, corner.y, size.x, size.y)
        _guizmo.set_gizmo_size_clip_space(0.16)
        _guizmo.manipulate(
            _matrix16(_GL_FROM_CV @ camera.cam_from_world),
            _matrix16(projection(camera, *_clip_range(camera, at[:3, 3]))),
            _OPERATIONS[tool.name],
            _guizmo.MODE.local if session.view.local_axes else _guizmo.MODE.world,
            values,
            None,
            _step(tool.name, camera, at) if session.view.snaps else None,
        )
        if self._matrix is not None and tool.start is not None:
            way = at[:3, 3] - tool.start[:3, 3]
            label = label_of(_guizmo.get_active_move_type(), way)
            (u, v), *_ = camera.project(at[None, :3, 3])[0]
            scale = size.x / camera.width
            after = u * scale + _LABEL + imgui.calc_text_size(label).x
            place = corner + ImVec2(after, v * scale + _LABEL)
            unit = length_unit(session) if label else ""
            drawing.add_text(place + ImVec2(1, 1), theme.u32(ImVec4(0, 0, 0, 1)), unit)
            drawing.add_text(place, theme.u32(ImVec4(1, 1, 1, 1)), unit)
        drawing.pop_clip_rect()
        held = _guizmo.is_using()
        if held and not self._ignored:
            if not tool.is_dragging:
                if not imgui.is_mouse_dragging(imgui.MouseButton_.left, CLICK_PIXELS):
                    return True  # a click moves nothing
                tool.begin(session)
            self._matrix = np.array(values.values, np.float64).reshape(4, 4).T
            tool.move_to(session, self._matrix)
        elif not held:
            if tool.is_dragging:
                tool.finish(session)
            self._matrix, self._ignored = None, False
        return held or bool(_guizmo.is_over())

    def cancel(self) -> None:
        """Forget the drag until the button is released (Escape)."""
        self._ignored = self._matrix is not None
        self._matrix, self.is_shown = None, False


def _step(tool: ToolName, camera: Camera, at: DoubleArray) -> _guizmo.Matrix3:
    """Steps of a drag: 15 degrees, tenths of a factor, a round length of some pixels."""
    if tool is ToolName.ROTATE:
        return _guizmo.Matrix3([15.0] * 3)
    if tool is ToolName.SCALE:
        return _guizmo.Matrix3([0.1] * 3)
    depth = float(camera.cam_from_world[2] @ np.append(at[:3, 3], 1.0))
    pixels = 20 * max(depth, 1e-9) / float(camera.K[0, 0])
    return _guizmo.Matrix3([10.0 ** np.floor(np.log10(pixels))] * 3)


def projection(camera: Camera, near: float, far: float) -> DoubleArray:
    """OpenGL projection (4, 4) of a pinhole camera: same pixels as ``Camera.project``."""
    K, w, h = camera.K, camera.width, camera.height
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2 * K[0, 0] / w, 1 - 2 * K[0, 2] / w
    matrix[1, 1], matrix[1, 2] = 2 * K[1, 1] / h, 2 * K[1, 2] / h - 1
    matrix[2, 2], matrix[2, 3] = -(far + near) / (far - near), -2 * far * near / (far - near)
    matrix[3, 2] = -1
    return matrix


def _clip_range(camera: Camera, at: DoubleArray) -> tuple[float, float]:
    """Near and far planes around the handles: lengths are scene units, of any scale."""
    distance = max(float(np.linalg.norm(at - camera.position)), 1e-9)
    return distance * 1e-3, distance * 1e3


def _matrix16(matrix: DoubleArray) -> _guizmo.Matrix16:
    """Column-major, as OpenGL wants it."""
    return _guizmo.Matrix16(matrix.T.ravel().tolist())


# --- The cube in a corner of the picture: a click on a side looks from there, a drag orbits.

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
        if meant is not None:
            widgets.tooltip(f"Look from the {name_of(meant)}; drag to orbit")
        self._drag(session, is_held, meant, size)
        if clicked and not self.is_dragging and self.pressed is not None:
            session.rig.look_from(self.pressed)
        _faces(cube, middle, scale, None if self.is_dragging else meant)
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
        if meant is not None and np.dot(side, meant) > 0:  # it lies on this face
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


def _span(where: int) -> tuple[float, float]:
    return (-_EDGE, _EDGE) if where == 0 else (_EDGE, 1.0) if where > 0 else (-1.0, -_EDGE)


def _mixed(a: ImVec4, b: ImVec4, t: float) -> ImVec4:
    return ImVec4(a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.z + t * (b.z - a.z), 1.0)
