"""The handles that move, turn or scale the selection, drawn over the picture."""

import numpy as np
from imgui_bundle import ImVec2, imguizmo

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.move import MoveTool

_guizmo = imguizmo.im_guizmo
_GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL cameras look along -z, y up
_OPERATIONS = {
    ToolName.MOVE: _guizmo.OPERATION.translate,
    ToolName.ROTATE: _guizmo.OPERATION.rotate,
    ToolName.SCALE: _guizmo.OPERATION.scale,
}


class Gizmo:
    """What is between the library's matrix and the tool's drag."""

    def __init__(self) -> None:
        self._matrix: DoubleArray | None = None  # (4, 4) world, while a handle is held
        self._ignored = False  # the drag was cancelled; wait until the button is up

    def draw(
        self, session: Session, tool: MoveTool, camera: Camera, corner: ImVec2, size: ImVec2
    ) -> bool:
        """Draw the handles, pass a drag on to ``tool``; whether the mouse belongs to them."""
        at = tool.handles(session) if self._matrix is None else self._matrix
        if at is None:
            return False
        values = _matrix16(at)
        _guizmo.begin_frame()  # nobody else calls it, and without it the mouse is not seen
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
        held = _guizmo.is_using()
        if held and not self._ignored:
            if not tool.is_dragging:
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
        self._matrix = None


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
