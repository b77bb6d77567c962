"""Solids that physics engines take in place of an object: a convex hull, and its oriented box."""

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, LongArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.io.meshes import TriangleMesh
from gaga_core.scene.selection.bounds import OrientedBox, oriented_box

MOST_TRIANGLES = 255  # that PhysX, and the engines on it, take of a convex hull
# Rows of `OrientedBox.corners`, counter-clockwise seen from outside.
_BOX_FACES = np.array(
    [
        [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5], [0, 1, 5], [0, 5, 4],
        [2, 6, 7], [2, 7, 3], [0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6],
    ],
    np.int32,
)  # fmt: skip
_PLANES = 64  # of a hull that is simplified: 4 * 64 - 12 triangles at most


def convex_collider(points: DoubleArray) -> TriangleMesh:
    """A convex solid around points (N, 3), of at most 255 triangles.

    It is their convex hull where that has so few, else the hull of 64 planes around them: the faces
    of the oriented box, and the rest evenly around it. Raises ``GagaError`` when the points
    lie in a plane.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    check_shape("points", points, ("N", 3))
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    try:
        hull = ConvexHull(finite)
        corners = finite[hull.vertices]
        if len(hull.simplices) > MOST_TRIANGLES:
            normals = _normals(oriented_box(corners, share=1.0))
            planes = np.column_stack([normals, -(corners @ normals.T).max(axis=0)])
            corners = HalfspaceIntersection(planes, corners.mean(axis=0)).intersections
        return _hull_mesh(corners)
    except (QhullError, ValueError) as error:
        raise GagaError("An object that is flat or of a few points has no convex solid.") from error


def box_mesh(box: OrientedBox) -> TriangleMesh:
    """The oriented box as twelve triangles; sides without a length get one that float32 tells."""
    least = 1e-6 * max(float(box.size.max()), float(np.abs(box.centre).max()), 1e-12)
    corners = OrientedBox(box.centre, box.axes, np.maximum(box.size, least)).corners()
    faces = _BOX_FACES if np.linalg.det(box.axes) > 0 else _BOX_FACES[:, ::-1]
    return TriangleMesh(corners.astype(np.float32), np.ascontiguousarray(faces))


def _normals(box: OrientedBox | None) -> DoubleArray:
    """Unit directions (P, 3) of the planes of a simplified hull."""
    sides = np.zeros((0, 3)) if box is None else np.vstack([box.axes.T, -box.axes.T])
    n = _PLANES - len(sides)
    height = 1 - 2 * (np.arange(n) + 0.5) / n
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(n)  # the golden angle: evenly over the sphere
    across = np.sqrt(1 - height**2)
    even = np.column_stack([across * np.cos(turn), across * np.sin(turn), height])
    if box is not None:  # even where the box is a cube: long things are wrapped as tightly
        even = even / np.maximum(box.size, 1e-6 * box.size.max()) @ box.axes.T
        even /= np.linalg.norm(even, axis=1, keepdims=True)
    return np.vstack([sides, even])


def _hull_mesh(corners: DoubleArray) -> TriangleMesh:
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    faces = _outwards(corners, hull.simplices, hull.equations[:, :3])
    used, rows = np.unique(faces, return_inverse=True)
    return TriangleMesh(
        np.ascontiguousarray(corners[used], np.float32),
        np.ascontiguousarray(rows.reshape(-1, 3), np.int32),
    )


def _outwards(
    corners: DoubleArray, triangles: IntArray | LongArray, normals: DoubleArray
) -> IntArray | LongArray:
    """``triangles`` (F, 3), counter-clockwise seen from outside."""
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * normals).sum(axis=1) < 0
    turned = triangles.copy()
    turned[inward] = turned[inward][:, ::-1]
    return turned
