"""World maps from the numbers in the inspector's fields."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.geometry import quats_to_matrices


def motion(
    pivot: DoubleArray,
    move: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn_degrees: tuple[float, float, float] = (0.0, 0.0, 0.0),
    scale: float | tuple[float, float, float] = 1.0,
) -> DoubleArray:
    """Return the world map (3, 4): scale about ``pivot`` (3,), turn about x, y, z, then move."""
    linear = np.diag(np.broadcast_to(np.asarray(scale, np.float64), (3,)))
    for axis, degrees in enumerate(turn_degrees):
        half = np.radians(degrees) / 2
        quat = np.zeros((1, 4))
        quat[0, 0], quat[0, 1 + axis] = np.cos(half), np.sin(half)
        linear = quats_to_matrices(quat)[0] @ linear
    offset = np.asarray(move, np.float64) + pivot - linear @ pivot
    return np.column_stack([linear, offset])


def shift(by: DoubleArray) -> DoubleArray:
    """Return the world map (3, 4) that moves by ``by`` (3,)."""
    return np.column_stack([np.eye(3), by])
