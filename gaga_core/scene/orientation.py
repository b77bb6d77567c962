"""What the training cameras say about a scene: which way is up, and what they look at."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera

_SNAP = np.cos(np.radians(3.0))  # an up this near to a world axis is that axis
_FLATTEST = 0.15  # the cameras' right axes must spread over a plane this much better than along up
_COLMAP_UP = np.array([0.0, -1.0, 0.0])  # of models without cameras: OpenCV axes, y down


def estimate_up(cameras: Sequence[Camera]) -> DoubleArray:
    """The scene's up direction (3,), unit, world.

    People hold cameras level: up is what the pictures' right axes have least of, on the side to
    which their tops point. When all look the same way that is no direction, and the mean of the
    pictures' tops is taken. Without cameras: -y, as in the world of most single models.
    """
    if not cameras:
        return _COLMAP_UP.copy()
    tops = np.mean([-c.cam_from_world[1, :3] for c in cameras], axis=0)
    rights = np.stack([c.cam_from_world[0, :3] for c in cameras])
    values, vectors = np.linalg.eigh(rights.T @ rights / len(rights))
    up: DoubleArray = np.array(tops, np.float64)
    if values[0] < _FLATTEST * values[1]:
        up = vectors[:, 0] * (1.0 if vectors[:, 0] @ tops >= 0 else -1.0)
    length = float(np.linalg.norm(up))
    if length < 1e-6:
        return _COLMAP_UP.copy()
    up /= length
    axis = int(np.abs(up).argmax())
    if abs(up[axis]) > _SNAP:
        up = np.eye(3)[axis] * np.sign(up[axis])
    return up


def upright_basis(up: DoubleArray) -> DoubleArray:
    """Rotation (3, 3) from world to a frame whose z axis is ``up``; the identity for +z."""
    z = up / np.linalg.norm(up)
    helper = np.eye(3)[0] if abs(z[0]) < 0.9 else np.eye(3)[1]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def common_target(cameras: Sequence[Camera]) -> DoubleArray | None:
    """The point (3,) nearest to all optical axes; None when they do not meet before the cameras."""
    if len(cameras) < 2:
        return None
    matrix, right_side = np.zeros((3, 3)), np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        matrix += across
        right_side += across @ camera.position
    if np.linalg.eigvalsh(matrix)[0] < 0.01 * len(cameras):
        return None
    point = np.asarray(np.linalg.solve(matrix, right_side), np.float64)
    n_before = sum(float((point - c.position) @ c.forward) > 0 for c in cameras)
    return point if n_before > len(cameras) / 2 else None
