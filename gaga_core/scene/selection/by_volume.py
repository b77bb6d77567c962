"""Splats whose centres are in a sphere or a box of the world."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.geometry import axes_of_points
from gaga_core.scene.orientation import turn_between
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import rows_of, selectable, world_means


def in_sphere(scene: Scene, centre: AnyArray, radius: float) -> IntArray:
    """Splats (K,) that can be selected, at most ``radius`` from ``centre`` (3,), world."""
    check_shape("centre", np.asarray(centre), (3,))
    offsets = world_means(scene) - np.asarray(centre, np.float32)
    inside = np.einsum("nj,nj->n", offsets, offsets) <= np.float32(radius) ** 2
    return rows_of(inside & selectable(scene))


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
    return rows_of(inside & selectable(scene))


# --- Points of a surface with their normals, and maps from one to another: for a clone brush.


_N_NORMAL = 6  # splats that tell a normal


@dataclass(frozen=True, eq=False)
class SurfacePoint:
    """A point of a surface."""

    point: DoubleArray  # (3,) world
    normal: DoubleArray  # (3,) unit, towards the eye
    group: int  # of the surface; 0 = none


def surface_point(
    scene: Scene, point: DoubleArray, radius: float, eye: DoubleArray, group: int
) -> SurfacePoint:
    """The surface at ``point`` (3,), world, by the splats at most ``radius`` from it.

    The normal is the direction in which they extend least, and looks to ``eye`` (3,); with too few
    of them it is the direction to the eye.
    """
    near = world_means(scene)[in_sphere(scene, point, radius)].astype(np.float64)
    normal = eye - point
    if len(near) >= _N_NORMAL:
        thinnest = axes_of_points(near)[:, 0]
        normal = thinnest * (1.0 if thinnest @ normal >= 0 else -1.0)
    return SurfacePoint(point, normal / np.linalg.norm(normal), group)


def map_between(source: SurfacePoint, target: SurfacePoint) -> DoubleArray:
    """Rigid map (3, 4) of ``source`` onto ``target``: the least turn that lines up the normals."""
    turn = turn_between(source.normal, target.normal)
    return np.column_stack([turn, target.point - turn @ source.point])


def on_plane(at: SurfacePoint, camera: Camera, u: float, v: float) -> DoubleArray | None:
    """Where the ray through pixel (u, v) meets the plane at ``at``; None behind the camera."""
    eye = camera.position
    ray = camera.unproject(u, v, 1.0) - eye
    steep = float(ray @ at.normal)
    if abs(steep) < 1e-9:
        return None
    way = float((at.point - eye) @ at.normal) / steep
    result: DoubleArray = eye + way * ray
    return result if way > 0 else None


def in_stroke(
    scene: Scene, points: Sequence[DoubleArray], radius: float, world_from_stroke: DoubleArray
) -> IntArray:
    """Splats (K,) at most ``radius`` from any of the ``points`` (3,), mapped (3, 4) first."""
    found = np.zeros(0, np.int32)
    for point in points:
        centre = world_from_stroke[:, :3] @ point + world_from_stroke[:, 3]
        found = np.union1d(found, in_sphere(scene, centre, radius))
    return found.astype(np.int32)
