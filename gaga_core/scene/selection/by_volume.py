"""Splats whose centres lie in a sphere or a box of the world."""

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, IntArray, check_shape
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import selectable, world_means


def in_sphere(scene: Scene, centre: AnyArray, radius: float) -> IntArray:
    """Splats (K,) that can be selected, at most ``radius`` from ``centre`` (3,), world."""
    check_shape("centre", np.asarray(centre), (3,))
    offsets = world_means(scene) - np.asarray(centre, np.float32)
    inside = np.einsum("nj,nj->n", offsets, offsets) <= np.float32(radius) ** 2
    return _rows(scene, inside)


def in_box(scene: Scene, world_from_box: DoubleArray) -> IntArray:
    """Splats (K,) that can be selected and lie in a box.

    ``world_from_box`` (4, 4) maps the cube -0.5..0.5 to the box: position, turn and lengths at
    once, as a gizmo holds them. Raises ``ValueError`` when it flattens space.
    """
    check_shape("world_from_box", world_from_box, (4, 4))
    if not np.linalg.det(world_from_box[:3, :3]):
        raise ValueError("world_from_box: a side of the box has no length")
    box_from_world = np.linalg.inv(world_from_box)
    inside = np.ones(len(scene), np.bool_)
    means = world_means(scene)
    for axis in range(3):
        row = box_from_world[axis].astype(np.float32)
        along = means @ row[:3] + row[3]
        inside &= np.abs(along) <= 0.5
    return _rows(scene, inside)


def _rows(scene: Scene, inside: BoolArray) -> IntArray:
    return np.flatnonzero(inside & selectable(scene)).astype(np.int32)
