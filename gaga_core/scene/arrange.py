"""Maps (3, 4) of the world that arrange things: mirror, align to the ground."""

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, check_shape
from gaga_core.errors import GagaError

_FLAT = 0.02  # height of a triangle over its longest side, below which it counts as a line


def mirror_map(axis: int, about: AnyArray) -> DoubleArray:
    """Mirror in the plane through ``about`` (3,) whose normal is world axis 0, 1 or 2."""
    if axis not in (0, 1, 2):
        raise ValueError(f"axis: expected 0, 1 or 2, got {axis}")
    centre = np.asarray(about, np.float64)
    check_shape("about", centre, (3,))
    linear = np.eye(3)
    linear[axis, axis] = -1
    return np.column_stack([linear, centre - linear @ centre])


def ground_map(points: AnyArray, up: AnyArray, seen_from: AnyArray) -> DoubleArray:
    """The rigid map that lays the plane through three ``points`` (3, 3) on the ground.

    The plane's normal that points to ``seen_from`` (3,), a place above the ground, becomes ``up``
    (3,), and the plane goes through the origin's height; the middle of the points stays over its
    place. Raises ``GagaError`` when the points lie on a line, or so nearly that they do not say how
    the plane lies.
    """
    corners = np.asarray(points, np.float64)
    check_shape("points", corners, (3, 3))
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    size = np.linalg.norm(normal)  # longest side times height
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max()
    if not size > _FLAT * longest**2:
        raise GagaError(
            "The three points lie nearly on a line. Choose three corners of the ground, far apart."
        )
    normal /= size
    middle = corners.mean(axis=0)
    if normal @ (np.asarray(seen_from, np.float64) - middle) < 0:
        normal = -normal
    top = np.asarray(up, np.float64) / np.linalg.norm(up)
    turn = turn_between(normal, top)
    target = middle - top * (top @ middle)
    return np.column_stack([turn, target - turn @ middle])


def turn_between(start: DoubleArray, stop: DoubleArray) -> DoubleArray:
    """The smallest rotation (3, 3) that takes unit vector ``start`` to ``stop`` (Rodrigues)."""
    axis, cosine = np.cross(start, stop), float(start @ stop)
    if cosine < -1 + 1e-12:
        # Opposite: half a turn about any axis across.
        across = np.eye(3)[np.argmin(np.abs(start))]
        side = np.cross(start, across)
        side /= np.linalg.norm(side)
        return 2 * np.outer(side, side) - np.eye(3)
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: DoubleArray = np.eye(3) + skew + skew @ skew / (1 + cosine)
    return turn
