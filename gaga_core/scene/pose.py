"""Where splats stand as one: position, rotation and scale, absolute, and the motion between two.

Rotation and scale count from how the file was opened or added, carried along when the scene is
moved as a whole. A map that shears keeps its shear when its rotation or scale is changed.
"""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.scene.frame import scale_of
from gaga_core.scene.scene import Scene

_SAME = 1e-9  # how far placements of one object may differ, absolute


@dataclass(frozen=True, eq=False)
class Pose:
    """A position, a rotation and a scale."""

    centre: DoubleArray  # (3,) world
    turn: DoubleArray  # (3, 3) rotation, world, since the file came
    scale: DoubleArray  # (3,) along its own axes; one is negative where it is mirrored
    base: DoubleArray  # (3, 3) rotation of the scene as a whole: the file's axes, world
    is_one: bool = True  # False: of several placements; rotation and scale are of the first

    @property
    def axes(self) -> DoubleArray:
        """The object's own axes as columns (3, 3), world: those of the file, turned."""
        return self.turn @ self.base


def pose_of(scene: Scene, splats: IntArray, centre: DoubleArray) -> Pose:
    """The pose of splats (K,), at least one, about their ``centre`` (3,), world."""
    rows = np.unique(scene.placement[splats])
    table = scene.placements.matrix[rows]
    is_one = bool(np.abs(table - table[:1]).max() <= _SAME)
    motion = scene.motion_of(int(scene.source[splats[0]]))
    whole = scale_of(motion)
    base = motion[:3, :3] / whole
    linear = scene.placements.matrix[scene.placement[splats[0]]][:, :3] / whole
    mirror = np.diag([1.0 if np.linalg.det(linear) > 0 else -1.0, 1.0, 1.0])
    u, _, vt = np.linalg.svd(linear @ mirror)
    axes: DoubleArray = u @ vt
    return Pose(centre, axes @ base.T, np.diag(axes.T @ linear).copy(), base, is_one)


def motion_between(start: Pose, stop: Pose) -> DoubleArray:
    """The world map (3, 4) that takes splats from ``start`` to ``stop``.

    Raises ``ValueError`` when a scale is 0 or not finite.
    """
    factor = stop.scale / start.scale
    if not (np.isfinite(factor).all() and factor.all()):
        raise ValueError(f"scale: expected three numbers other than 0, got {stop.scale}")
    linear = stop.axes @ np.diag(factor) @ start.axes.T
    return np.column_stack([linear, stop.centre - linear @ start.centre])


def with_degrees(pose: Pose, degrees: DoubleArray, *, local: bool) -> Pose:
    """``pose`` turned to these angles (3,), see `degrees_of`."""
    x, y, z = (_about(axis, float(angle)) for axis, angle in enumerate(np.radians(degrees)))
    turn = pose.base @ x @ y @ z @ pose.base.T if local else z @ y @ x
    return replace(pose, turn=turn)


def degrees_of(pose: Pose, *, local: bool) -> DoubleArray:
    """Angles (3,) about x, then y, then z, degrees: of the world, or the object's own axes."""
    turn = pose.base.T @ pose.turn @ pose.base if local else pose.turn.T
    sine = float(np.clip(turn[0, 2], -1, 1))
    y = np.arcsin(sine)
    if abs(sine) < 1 - 1e-9:
        x, z = np.arctan2(-turn[1, 2], turn[2, 2]), np.arctan2(-turn[0, 1], turn[0, 0])
    else:  # x and z are about one axis: all of it is x
        x, z = np.arctan2(turn[2, 1], turn[1, 1]), 0.0
    angles = np.degrees([x, y, z])
    result: DoubleArray = (angles if local else -angles) + 0.0
    return result


def _about(axis: int, angle: float) -> DoubleArray:
    """The rotation (3, 3) about a world axis, radians."""
    matrix = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[i, j], matrix[j, i] = -np.sin(angle), np.sin(angle)
    return matrix
