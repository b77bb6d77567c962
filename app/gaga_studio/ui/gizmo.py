"""The handles that move the selected objects, drawn over the picture."""

from dataclasses import dataclass

import numpy as np
from imgui_bundle import imguizmo

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera

_guizmo = imguizmo.im_guizmo
_GL_FROM_CV = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL cameras look along -z, y up


@dataclass
class Gizmo:
    """A drag of the handles: where it started and where it is."""

    start: DoubleArray | None = None  # (4, 4) world, when the drag began
    matrix: DoubleArray | None = None  # (4, 4) world, now

    @property
    def is_dragging(self) -> bool:
        """Whether the user holds a handle."""
        return self.start is not None

    def drag(
        self, camera: Camera, corner: tuple[float, float], size: tuple[float, float], at: DoubleArray
    ) -> tuple[DoubleArray | None, bool]:
        """Draw the handles at ``at`` (3,) world; ``corner`` and ``size`` in screen pixels.

        Returns the motion since the drag began, (3, 4) world, or None when nothing is dragged,
        and whether the drag ended with this frame.
        """
        if self.matrix is None or not self.is_dragging:
            self.matrix = np.eye(4)
            self.matrix[:3, 3] = at
        values = _guizmo.Matrix16(self.matrix.T.ravel().tolist())
        _guizmo.set_drawlist()
        _guizmo.set_rect(*corner, *size)
        _guizmo.set_gizmo_size_clip_space(0.17)
        _guizmo.manipulate(
            _matrix16(_GL_FROM_CV @ camera.cam_from_world),
            _matrix16(projection(camera, *_clip_range(camera, at))),
            _guizmo.OPERATION.translate,
            _guizmo.MODE.world,
            values,
        )
        if not _guizmo.is_using():
            was_dragging = self.is_dragging
            motion = self._motion() if was_dragging else None
            self.start = None
            return motion, was_dragging
        if self.start is None:
            self.start = self.matrix.copy()
        self.matrix = np.array(values.values, np.float64).reshape(4, 4).T
        return self._motion(), False

    def cancel(self) -> None:
        """Forget the drag."""
        self.start = self.matrix = None

    def _motion(self) -> DoubleArray | None:
        if self.start is None or self.matrix is None:
            return None
        motion: DoubleArray = (self.matrix @ np.linalg.inv(self.start))[:3]
        return motion


def is_under_mouse() -> bool:
    """Whether the mouse is over a handle, so that a click belongs to it."""
    return bool(_guizmo.is_over()) or bool(_guizmo.is_using())


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
