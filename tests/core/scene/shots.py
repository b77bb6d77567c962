"""Shots of the camera path, by what they look at."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.geometry import look_at, matrices_to_quats
from gaga_core.scene.camera_path import Shot


def shot_towards(eye: DoubleArray, target: DoubleArray, up: DoubleArray, fov: float) -> Shot:
    """A shot from ``eye`` (3,) at ``target`` (3,) with ``up`` (3,) on top; ``fov`` radians."""
    matrix = look_at(eye, target, up)
    quat = matrices_to_quats(matrix[None, :3, :3])[0]
    distance = float(np.linalg.norm(np.asarray(target) - eye))
    four = (float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3]))
    return Shot((float(eye[0]), float(eye[1]), float(eye[2])), four, fov, fov, distance)
