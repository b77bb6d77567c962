"""Which discs see the light from a direction: a height map of all occluders along it."""

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.demo.surface import Surface

# Where in a disc its occluder points lie, in steps along u and v.
_SPREAD = np.array([[0, 0], [0.33, 0.33], [-0.33, 0.33], [0.33, -0.33], [-0.33, -0.33]])


def occluders(surface: Surface) -> FloatArray:
    """Points (M, 3) that stand for the discs of all objects (the room is handled by its planes)."""
    chosen = surface.labels > 0
    points, sizes = surface.points[chosen], surface.sizes[chosen]
    along = surface.tangents[chosen] * sizes[:, :1]
    across = np.cross(surface.normals[chosen], surface.tangents[chosen]) * sizes[:, 1:]
    cloud = [points + a * along + b * across for a, b in _SPREAD]
    return np.concatenate(cloud).astype(np.float32)


def lit_share(
    points: FloatArray,  # (N, 3) already lifted off their surface
    cloud: FloatArray,  # (M, 3)
    towards: DoubleArray,  # (3,) unit
    cell: float,
    rng: np.random.Generator,
) -> FloatArray:
    """1 where nothing stands between a point and a far light ``towards`` it, 0 where something
    does; between the two at the fringe of a shadow (four cells are blended)."""
    a, b = _plane(towards)
    axes = np.stack([a, b, towards]).astype(np.float32)
    px, py, pz = axes @ points.T
    qx, qy, qz = axes @ cloud.T
    left, low = qx.min() - cell * (1 + rng.random()), qy.min() - cell * (1 + rng.random())
    width, height = int((qx.max() - left) / cell) + 3, int((qy.max() - low) / cell) + 3
    column = ((qx - np.float32(left)) / np.float32(cell)).astype(np.int32)
    row = ((qy - np.float32(low)) / np.float32(cell)).astype(np.int32)
    nearest = np.full(width * height, -np.inf, np.float32)
    np.maximum.at(nearest, row * width + column, qz)
    x = np.clip((px - np.float32(left)) / np.float32(cell) - 0.5, 0, width - 2)
    y = np.clip((py - np.float32(low)) / np.float32(cell) - 0.5, 0, height - 2)
    i, j = x.astype(np.int32), y.astype(np.int32)
    fx, fy = x - i, y - j
    at = j * width + i
    depth = pz + np.float32(0.6 * cell)
    free = [(nearest[at + k] < depth).astype(np.float32) for k in (0, 1, width, width + 1)]
    top = free[0] * (1 - fx) + free[1] * fx
    bottom = free[2] * (1 - fx) + free[3] * fx
    result: FloatArray = (top * (1 - fy) + bottom * fy).astype(np.float32)
    return result


def cone(axis: DoubleArray, half_angle: float, n: int) -> DoubleArray:
    """``n`` directions (n, 3) spread evenly over a cone: an area light."""
    k = np.arange(n) + 0.5
    cosine = 1 - k / n * (1 - np.cos(half_angle))
    sine = np.sqrt(1 - cosine**2)
    angle = k * np.pi * (3 - np.sqrt(5))
    a, b = _plane(axis)
    spread = (sine * np.cos(angle))[:, None] * a + (sine * np.sin(angle))[:, None] * b
    result: DoubleArray = cosine[:, None] * axis + spread
    return result


def sphere(n: int) -> DoubleArray:
    """``n`` directions (n, 3) spread evenly over the sphere (Fibonacci lattice)."""
    return cone(np.array([0.0, 0.0, 1.0]), np.pi, n)


def _plane(axis: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    helper = np.array([1.0, 0, 0]) if abs(axis[0]) < 0.8 else np.array([0, 1.0, 0])
    a = np.cross(axis, helper)
    a /= np.linalg.norm(a)
    return a, np.cross(axis, a)
