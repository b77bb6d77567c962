"""Rigid bodies of objects: a closed mesh, convex parts, mass, centre of mass and inertia.

The world of a simulation has z up and lengths in metres where the scene's unit is known. The axes
of a body are those of that world; its origin is the middle of its box's underside.
"""

import importlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, cure_without
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import MeshConfig, convex_collider, proxy_mesh_stage
from gaga_core.gaussians import Gaussians
from gaga_core.io.meshes import TriangleMesh
from gaga_core.io.splats.glb import placed
from gaga_core.progress import Progress, Stage, threaded_stage
from gaga_core.raster import choose
from gaga_core.scene.orientation import upright_basis
from gaga_core.training.stereo import DepthView

UP = (0.0, 0.0, 1.0)  # of the world of a simulation
GRAVITY = 9.81  # m/s^2 downwards
_SOLID = 0.2  # opacity from which on a splat counts as a surface
_ASIDE, _NEAR = 0.5, 0.25  # of the object's size: how far around and above or below its lowest
# point its support is looked for; else it is below, of a layer with this share of the fullest.
_FULL = 0.5
# Share of its height in which an object is low, and of its low splats in the hull of another one
# that then holds it: of what stands on a thing all but a few are above.
_LOW, _HELD = 0.25, 0.5
_LAYER = 0.02  # of the object's size: height of the layer of splats that a plane is fitted to
_N_SUPPORT = 30  # splats: fewer are no surface
# Share of a surface on either side of any line under the middle of what stands on it. In the demo
# that of all objects that stand is 0.08 and more, that of a copy in the air next to flowers 0.001.
_LEAST_SHARE = 0.02
_STEEPEST = np.cos(np.radians(20.0))  # of a plane that something stands on
_GAP = 0.15  # of the object's height: a foot that ends higher over its support does not touch it
_CUT = 2.0  # voxels over the support from which on downwards the underside is made flat
_FOOT = 0.1  # of the object's size: how far its foot reaches around its centre of mass
_MOST_CORNERS = 64  # of a convex part: what PhysX takes on a graphics card
_COARSE, _MOST_TRIANGLES = 0.002, 1_500  # of the extent; what convex parts are searched in
_THICKNESS = 0.05  # of the longer side of a support: how thick its box is
_CELLS = 128  # of a height field along each side
_AROUND = 1.5  # of the size of all bodies: how far it reaches from their middle
_VIEW = np.radians(1.0)  # field of view of the heights: nearly parallel
_SHOWN = 0.5  # alpha from which on a pixel has a height
_COACD = threading.Lock()  # one search for convex parts at a time: all processors work for it
_BELOW = 0.005  # of the side of a height field: how far it stays under what else carries things
_APART = 2  # cells around a body in which nothing is higher than its underside


class MissingExtraError(GagaError):
    """An optional package is not installed."""


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane that something stands on, world of the simulation."""

    origin: DoubleArray  # (3,)
    normal: DoubleArray  # (3,) unit, upwards

    def heights(self, points: DoubleArray) -> DoubleArray:
        """Heights (N,) of points (N, 3) over the plane."""
        return (points - self.origin) @ self.normal


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass of a solid and how it is spread."""

    volume: float  # m^3
    mass: float  # kg
    centre: DoubleArray  # (3,) axes of the body
    inertia: DoubleArray  # (3, 3) kg m^2 about ``centre``, axes of the body


@dataclass(frozen=True, eq=False)
class Body:
    """An object that moves."""

    id: int  # group
    name: str
    stem: str  # of its files
    position: DoubleArray  # (3,) of its origin, world of the simulation
    gaussians: Gaussians  # from its origin
    mesh: TriangleMesh  # closed, with colors, from its origin
    parts: tuple[TriangleMesh, ...]  # convex, from its origin
    properties: MassProperties
    underside: str  # "assumed flat", or "as seen"
    turn: DoubleArray = field(default_factory=lambda: np.eye(3))  # (3, 3) world from its axes
    holds: tuple[str, ...] = ()  # names of objects that lie in it: it is hollow there
    copy_of: str = ""  # stem of the body whose splats, mesh, parts and mass it shares

    def moved(self, motion: DoubleArray, id: int, name: str, stem: str) -> "Body":
        """A copy where ``motion`` (4, 4), rigid, brings it."""
        position = motion[:3, :3] @ self.position + motion[:3, 3]
        turn, origin = motion[:3, :3] @ self.turn, self.copy_of or self.stem
        return replace(
            self, id=id, name=name, stem=stem, position=position, turn=turn, copy_of=origin
        )


@dataclass(frozen=True, eq=False)
class Box:
    """A box that stays: a support."""

    centre: DoubleArray  # (3,)
    axes: DoubleArray  # (3, 3) columns are the directions of its sides
    half: DoubleArray  # (3,) half of its sides

    def corners(self) -> DoubleArray:
        """Its corners (8, 3)."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return self.centre + (signs * self.half) @ self.axes.T


@dataclass(frozen=True, eq=False)
class HeightField:
    """How high what stays is, on a square grid seen from above."""

    corner: DoubleArray  # (3,) of the first cell's middle at height 0, world of the simulation
    cell: float  # side
    heights: FloatArray  # (R, C) 0 or more; rows along y, columns along x

    def mesh(self) -> TriangleMesh:
        """Its surface, facing upwards."""
        n_rows, n_columns = self.heights.shape
        y, x = np.mgrid[:n_rows, :n_columns]
        points = np.stack([self.cell * x, self.cell * y, self.heights], axis=-1).reshape(-1, 3)
        first = (y * n_columns + x)[:-1, :-1].reshape(-1, 1)
        corners = first + np.array([[0, 1, n_columns + 1, 0, n_columns + 1, n_columns]])
        return TriangleMesh(
            np.ascontiguousarray(points + self.corner, np.float32),
            np.ascontiguousarray(corners.reshape(-1, 3), np.int32),
        )


@dataclass(frozen=True, eq=False)
class Static:
    """What stays: splats, the boxes that things stand on, and the heights of all the rest."""

    gaussians: Gaussians | None  # world of the simulation; None: there are none
    boxes: tuple[Box, ...]
    ground: HeightField | None = None


@dataclass(frozen=True, eq=False)
class World:
    """All that a simulator takes."""

    bodies: tuple[Body, ...]
    static: Static
    is_metric: bool
    config: SimulationConfig
    left_out: tuple[str, ...] = ()  # names of objects without a surface
    without_support: tuple[str, ...] = ()  # names of objects that stand on nothing that is seen
    not_closed: tuple[str, ...] = ()  # names of objects whose mesh has holes


def upright_place(up: Sequence[float], scale: float) -> DoubleArray:
    """Place (4, 4) in the world of the simulation of a scene whose ``up`` (3,) is unit."""
    place = np.eye(4)
    place[:3, :3] = scale * upright_basis(np.array(up, np.float64))
    return place


def support_of(points: DoubleArray, others: DoubleArray) -> Plane | None:
    """The plane under an object with centres ``points`` (K, 3) among those of ``others`` (M, 3).

    World of the simulation. None: nothing level is there, or none of it under the middle of the
    object.
    """
    lo, hi = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    size = float((hi - lo).max())
    reach = _ASIDE * float((hi - lo)[:2].max())
    near = ((others[:, :2] > lo[:2] - reach) & (others[:, :2] < hi[:2] + reach)).all(axis=1)
    layer, foot = _LAYER * size, others[near]
    stands = foot[np.abs(foot[:, 2] - lo[2]) < _NEAR * size]
    middle = np.median(points, axis=0)
    plane, _ = _level_plane(stands, 1.0, layer, middle)
    below = foot[foot[:, 2] < lo[2]]
    while plane is None and len(below) >= _N_SUPPORT:
        # What hangs in the air falls on the highest of several surfaces that lie under it.
        plane, low = _level_plane(below, _FULL, layer, middle)
        below = below[below[:, 2] < low]
    return plane


def _level_plane(
    cloud: DoubleArray, share: float, layer: float, middle: DoubleArray
) -> tuple[Plane | None, float]:
    """The plane of the highest ``layer`` with this ``share`` of the points of the fullest one, and
    the height of its lowest points.

    None also where it does not lie around ``middle`` (3,).
    """
    if len(cloud) < _N_SUPPORT:
        return None, 0.0
    rows = np.sort(cloud[:, 2])
    in_layer = np.searchsorted(rows, rows + layer, side="right") - np.arange(len(rows))
    start = rows[np.flatnonzero(in_layer >= share * in_layer.max())[-1]]
    inside = (cloud[:, 2] >= start) & (cloud[:, 2] <= start + layer)
    corner, fit = cloud.min(axis=0), np.array([0.0, 0.0, start + layer / 2])
    for _ in range(3):
        if inside.sum() < _N_SUPPORT:
            return None, float(start)
        design = np.column_stack([cloud[:, :2] - corner[:2], np.ones(len(cloud))])
        fit = np.linalg.lstsq(design[inside], cloud[inside, 2], rcond=None)[0]
        inside = np.abs(design @ fit - cloud[:, 2]) < layer
    normal = np.array([-fit[0], -fit[1], 1.0]) / np.sqrt(fit[0] ** 2 + fit[1] ** 2 + 1)
    if normal[2] < _STEEPEST or _least_side(cloud[inside, :2] - middle[:2]) < _LEAST_SHARE:
        return None, float(start)
    at = np.median(cloud[inside], axis=0)
    on_it = fit[0] * (at[0] - corner[0]) + fit[1] * (at[1] - corner[1]) + fit[2]
    return Plane(np.array([at[0], at[1], on_it]), normal), float(start)


def _least_side(points: DoubleArray) -> float:
    """Share of ``points`` (K, 2) on the emptier side of the line through 0 that parts them most
    unevenly: 0 where they do not surround it (Tukey's depth)."""
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    half = np.searchsorted(np.r_[angles, angles + 2 * np.pi], angles + np.pi)
    return float((half - np.arange(len(angles)) - 1).min() / len(angles))


def _solid_of(mesh: TriangleMesh) -> Any:
    """``mesh`` as a solid; None when it has holes."""
    manifold = library("manifold3d")
    corners = mesh.vertices.copy()  # it takes none that is read-only
    solid = manifold.Manifold(manifold.Mesh(corners, mesh.faces.astype(np.uint32)))
    is_solid = solid.status() == manifold.Error.NoError and solid.volume() > 0
    return solid if is_solid else None


def closed_on(mesh: TriangleMesh, plane: Plane | None, voxel: float) -> tuple[TriangleMesh, bool]:
    """``mesh`` without holes, cut at ``plane`` and filled down to it; whether it stands there.

    Raises ``GagaError`` when it has holes that cannot be closed, or the extra is missing.
    """
    turn = np.eye(3) if plane is None else upright_basis(plane.normal)
    vertices = mesh.vertices.astype(np.float64)
    if plane is not None:
        vertices = (vertices - plane.origin) @ turn.T
    solid = _solid_of(replace(mesh, vertices=vertices.astype(np.float32)))
    if solid is None:
        raise GagaError("The surface of an object has holes that cannot be closed.")
    lowest = float(vertices[:, 2].min())
    stands = plane is not None and lowest < _GAP * float(np.ptp(vertices[:, 2]))
    if stands:  # what is under the cut is as wide as the cut
        cut = max(lowest, 0.0) + _CUT * voxel
        outline = solid.slice(cut)
        # They overlap by half a voxel: faces in one plane would leave seams.
        solid = solid.trim_by_plane((0, 0, 1), cut - voxel / 2) + outline.extrude(cut)
    # What is flat needs no triangle a voxel, nor the thin ones that the cut leaves.
    found = solid.simplify(voxel / 10).to_mesh()
    if len(found.tri_verts) == 0:
        raise GagaError("An object that ends under its support has no surface.")
    corners = np.asarray(found.vert_properties[:, :3], np.float64)
    if plane is not None:
        corners = corners @ turn + plane.origin
    _, nearest = cKDTree(mesh.vertices).query(corners)
    colors = None if mesh.colors is None else mesh.colors[nearest]
    faces = np.ascontiguousarray(found.tri_verts, np.int32)
    return TriangleMesh(np.ascontiguousarray(corners, np.float32), faces, colors), stands


def lies_in(points: DoubleArray, others: DoubleArray) -> bool:
    """Whether most of what is low of an object with centres ``points`` (K, 3), z upwards, is in the
    convex hull of another one with ``others`` (M, 3), as fruit in a bowl is."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        planes = ConvexHull(others).equations
    except (QhullError, ValueError):  # flat, or of a few points
        return False
    low, high = np.percentile(points[:, 2], [1, 99])
    foot = points[points[:, 2] <= low + _LOW * (high - low)]
    inside = (foot @ planes[:, :3].T + planes[:, 3] < 0).all(axis=1)
    return bool(inside.mean() > _HELD)


def without(mesh: TriangleMesh, held: Sequence[DoubleArray], gap: float) -> TriangleMesh:
    """The closed ``mesh`` less the convex hulls of ``held`` (K, 3) each, as much larger as ``gap``.

    Two bodies are never in one place, and what lies in a vessel hides that it is hollow there.
    The mesh as it is when it has holes, or nothing would be left.
    """
    solid = _solid_of(mesh)
    for other in held if solid is not None else ():
        away = other - other.mean(axis=0)
        reach = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
        solid = solid - library("manifold3d").Manifold.hull_points(other + gap * away / reach)
    if solid is None or solid.volume() <= 0:
        return mesh
    pieces = solid.decompose()
    return _mesh_of(max(pieces, key=lambda piece: piece.volume()), mesh)


def _mesh_of(solid: Any, like: TriangleMesh) -> TriangleMesh:
    """A solid as a mesh with the nearest colors of ``like``."""
    found = solid.to_mesh()
    corners = np.ascontiguousarray(found.vert_properties[:, :3], np.float32)
    _, nearest = cKDTree(like.vertices).query(corners)
    colors = None if like.colors is None else like.colors[nearest]
    return TriangleMesh(corners, np.ascontiguousarray(found.tri_verts, np.int32), colors)


def convex_parts(mesh: TriangleMesh, config: SimulationConfig) -> tuple[TriangleMesh, ...]:
    """Convex solids that together are nearly the closed ``mesh`` (CoACD, Wei et al. 2022).

    Raises ``GagaError`` when the extra is missing.
    """
    if config.parts == 1:
        return (convex_collider(mesh.vertices.astype(np.float64)),)
    coacd = library("coacd")
    coacd.set_log_level("error")
    solid, given = _solid_of(mesh), coacd.Mesh(mesh.vertices.astype(np.float64), mesh.faces)
    coarse = _COARSE * float(np.ptp(mesh.vertices, axis=0).max())
    while solid is not None and solid.num_tri() > _MOST_TRIANGLES and coarse > 0:
        # Of the full mesh the search takes minutes, and finds the same parts.
        solid, coarse = solid.simplify(coarse), 2 * coarse
        simple = solid.to_mesh()
        given = coacd.Mesh(simple.vert_properties[:, :3].astype(np.float64), simple.tri_verts)
    found = coacd.run_coacd(
        given,
        threshold=config.concavity,
        max_convex_hull=config.parts,
        preprocess_mode="auto" if solid is None else "off",
        mcts_nodes=10,
        mcts_iterations=30,
        resolution=1000,
        decimate=True,
        max_ch_vertex=_MOST_CORNERS,
        seed=0,
    )
    parts = []
    for corners, _ in found:
        try:
            parts.append(convex_collider(np.asarray(corners, np.float64)))
        except GagaError:  # flat: it holds nothing
            continue
    return tuple(parts)


def outside(parts: Sequence[TriangleMesh], held: Sequence[DoubleArray]) -> tuple[TriangleMesh, ...]:
    """Convex ``parts`` without what reaches into the convex hulls of ``held`` (K, 3) each.

    Parts fill hollows up to their concavity, and a simulator pushes apart what is in one place.
    Each is cut along the facet of the hull that it reaches behind the least.
    """
    from scipy.spatial import ConvexHull

    for other in held:
        planes, kept = ConvexHull(other).equations, list[TriangleMesh]()  # normals point outwards
        for part in parts:
            corners = part.vertices.astype(np.float64)
            behind = (planes[:, :3] @ corners.T + planes[:, 3:]).min(axis=1)
            least = int(np.argmax(behind))
            if behind[least] >= 0:
                kept.append(part)
                continue
            solid = library("manifold3d").Manifold.hull_points(corners)
            solid = solid.trim_by_plane(planes[least, :3], -planes[least, 3]).to_mesh()
            try:
                kept.append(convex_collider(np.asarray(solid.vert_properties[:, :3], np.float64)))
            except GagaError:  # nothing is left
                continue
        parts = kept
    return tuple(parts)


def _seats(held: Sequence[DoubleArray], deep: float) -> list[TriangleMesh]:
    """What objects with corners ``held`` (K, 3) each stand on: their lowest layers, ``deep`` down.

    Other parts end anywhere under them: on those alone an apple in a bowl tilted by 10 degrees.
    """
    found = []
    for corners in held:
        z = corners[:, 2]
        foot = corners[z <= z.min() + _LAYER * np.ptp(z)]
        under = np.column_stack([foot[:, :2], np.maximum(foot[:, 2] - deep, 0)])
        try:
            found.append(convex_collider(np.concatenate([foot, under])))
        except GagaError:  # it stands on a point
            continue
    return found


def parts_of(
    mesh: TriangleMesh, plane: Plane | None, cut: float, config: SimulationConfig
) -> tuple[TriangleMesh, ...]:
    """The convex parts of a body; what is lower than ``cut`` over ``plane`` is one of them.

    The others need not end where the body does: on those alone a box of 0.2 m tilted by 7 degrees.
    As it stood, its centre of mass is over what it stands on. None: it stands on nothing.
    """
    if plane is None:
        return convex_parts(mesh, config)
    parts = convex_parts(mesh, replace(config, parts=max(config.parts - 1, 1)))
    corners = [part.vertices.astype(np.float64) for part in parts]
    if config.parts > 1:
        vertices = mesh.vertices.astype(np.float64)
        wide = _FOOT * float(np.ptp(vertices, axis=0).max())
        under = mass_properties(mesh, 1.0, None).centre + wide * np.array(
            [[-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0]]
        )
        under[:, 2] -= plane.heights(under) / plane.normal[2]
        corners.append(np.concatenate([vertices[plane.heights(vertices) <= 1.01 * cut], under]))
    # Nothing of them is under the support.
    lifts = [-np.minimum(plane.heights(points), 0)[:, None] * plane.normal for points in corners]
    return tuple(convex_collider(a + b) for a, b in zip(corners, lifts, strict=True))


def mass_properties(mesh: TriangleMesh, density: float, mass: float | None) -> MassProperties:
    """Volume, mass, centre of mass and inertia of a closed mesh of one density.

    ``mass`` (kg) counts for more than ``density`` (kg/m^3). By signed tetrahedra to the origin
    (Blow and Binstock 2004). Raises ``GagaError`` when the mesh encloses nothing.
    """
    a, b, c = (mesh.vertices[mesh.faces[:, k]].astype(np.float64) for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    volume = float(volumes.sum())
    if not volume > 0:
        raise GagaError("An object that encloses nothing has no mass.")
    centre = (volumes[:, None] * (a + b + c)).sum(axis=0) / (4 * volume)
    a, b, c = a - centre, b - centre, c - centre
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    corners = a + b + c
    second = np.einsum("i,ij,ik->jk", volumes, corners, corners)
    second += sum(np.einsum("i,ij,ik->jk", volumes, p, p) for p in (a, b, c))
    weight = density if mass is None else mass / volume
    second *= weight / 20
    inertia = np.trace(second) * np.eye(3) - second
    return MassProperties(volume, weight * volume, centre, inertia)


def body_stage(
    gaussians: Gaussians,  # of the object alone, world of the simulation
    plane: Plane | None,
    config: SimulationConfig,
    mesh_config: MeshConfig,
    mass: float | None,
    density: float | None,
    photos: Sequence[DepthView] = (),
    held: Sequence[DoubleArray] = (),  # corners (K, 3) of each object that lies in it, world
) -> Stage[tuple[Body, bool]]:
    """The body of an object without a name, and whether its mesh is closed.

    Raises ``GagaError`` when it has no surface, or an extra is missing.
    """
    mesh = yield from proxy_mesh_stage(
        gaussians, choose(), up=np.array(UP), config=mesh_config, is_soft=True, photos=photos
    )
    voxel = float(np.ptp(mesh.vertices, axis=0).max()) / mesh_config.voxels
    stands = is_closed = False
    try:
        mesh, stands = closed_on(mesh, plane, voxel)
        mesh, is_closed = without(mesh, held, voxel / 2), True
    except MissingExtraError:
        raise
    except GagaError:  # it is used as it is
        pass
    lo, hi = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origin = np.array([*(lo[:2] + hi[:2]) / 2, lo[2]], np.float64)
    mesh = mesh.moved(origin, 1.0)
    foot = Plane(plane.origin - origin, plane.normal) if plane is not None and stands else None
    place = np.eye(4)
    place[:3, 3] = -origin
    inside = [corners - origin for corners in held]
    seats = _seats(inside[: config.parts // 2], voxel)
    rest = replace(config, parts=config.parts - len(seats))
    search = partial(parts_of, mesh, foot, _CUT * voxel, rest)
    parts = yield from threaded_stage(Progress("Find convex parts", 0, 1), search, _COACD)
    return Body(
        id=0,
        name="",
        stem="",
        position=origin,
        gaussians=placed(gaussians, place),
        mesh=mesh,
        parts=outside((*parts, *seats), inside),
        properties=mass_properties(mesh, density or config.density, mass),
        underside="assumed flat" if stands else "as seen",
    ), is_closed


def support_boxes(planes: Sequence[Plane], points: DoubleArray) -> tuple[Box, ...]:
    """A box under each of ``planes``, as large as the level layer of ``points`` (M, 3) on it.

    Planes at the same height that overlap are one.
    """
    boxes: list[Box] = []
    left = list(planes)
    size = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    while left:
        plane = left.pop(0)
        layer = 0.005 * size
        on = points[np.abs(plane.heights(points)) < layer]
        axes = upright_basis(plane.normal).T
        if len(on) >= _N_SUPPORT:  # all of the layer says better how it lies than a small part
            middle = np.median(on, axis=0)
            normal = np.linalg.svd(on - middle, full_matrices=False)[2][2]
            normal = normal * np.sign(normal[2])
            if normal[2] > _STEEPEST and abs(normal @ plane.normal) > np.cos(np.radians(2)):
                axes = upright_basis(normal).T
        local = (on - plane.origin) @ axes
        flat = local[:, :2] if len(local) else np.zeros((1, 2))
        lo, hi = np.percentile(flat, 0.5, axis=0), np.percentile(flat, 99.5, axis=0)
        thick = _THICKNESS * max(float((hi - lo).max()), 1e-6)
        centre = plane.origin + axes @ np.array([*(lo + hi) / 2, -thick / 2])
        half = np.array([*(hi - lo) / 2, thick / 2])
        box = Box(centre, axes, half)
        boxes.append(box)

        def lies_on(other: Plane, box: Box = box) -> bool:
            at = (other.origin - box.centre) @ box.axes
            is_inside = (np.abs(at[:2]) < box.half[:2]).all()
            return bool(is_inside and abs(at[2] - box.half[2]) < 0.005 * size)

        left = [other for other in left if not lies_on(other)]
    return tuple(boxes)


def height_field(
    gaussians: Gaussians,  # of what stays, world of the simulation
    bodies: Sequence[DoubleArray],  # centres (K, 3) of the splats of each
    boxes: Sequence[Box],
) -> HeightField | None:
    """Heights of what stays around ``bodies``, without ceilings; None: nothing is there.

    They stay under boxes, and under bodies where these are now, so that nothing is pushed away.
    """
    from scipy.ndimage import binary_dilation, median_filter

    every = np.concatenate(bodies)
    lo, hi = np.percentile(every, 1, axis=0), np.percentile(every, 99, axis=0)
    size = float((hi - lo).max())
    half, top, middle = _AROUND * size, float(hi[2]) + size, (lo + hi) / 2
    side = 2 * half
    near = (np.abs(gaussians.means[:, :2] - middle[:2]) < half).all(axis=1)
    near &= gaussians.means[:, 2] < top
    if not near.any():
        return None
    # From so far away, rows and columns of the picture are those of a grid.
    distance = half / np.tan(_VIEW / 2)
    focal = _CELLS * distance / side
    K = np.array([[focal, 0, _CELLS / 2], [0, focal, _CELLS / 2], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = -pose[:3, :3] @ np.array([*middle[:2], top + distance])
    seen = choose().render(gaussians.take(np.flatnonzero(near)), Camera(K, pose, _CELLS, _CELLS))
    is_shown = (seen.alpha >= _SHOWN) & (seen.median_depth > 0)
    if not is_shown.any():
        return None
    high = np.where(is_shown, top + distance - seen.median_depth, np.inf)[::-1].astype(np.float64)
    # Nobody saw how deep it is where nothing is shown; single cells are gaps between splats.
    high = median_filter(np.where(np.isfinite(high), high, high.min()), 3)
    cell, layer = side / _CELLS, _BELOW * side
    corner = middle[:2] - half + cell / 2
    for points in bodies:
        column, row = np.clip((points[:, :2] - corner) / cell + 0.5, 0, _CELLS - 1).astype(int).T
        under = np.zeros(high.shape, np.bool_)
        under[row, column] = True
        under = binary_dilation(under, np.ones((3, 3), np.bool_), iterations=_APART)
        high[under] = np.minimum(high[under], np.percentile(points[:, 2], 1) - layer)
    at = corner + cell * np.dstack(np.meshgrid(np.arange(_CELLS), np.arange(_CELLS)))
    for box in boxes:
        local = (np.dstack([at, high]) - box.centre) @ box.axes
        on_it = (np.abs(local[..., :2]) < box.half[:2]).all(axis=-1)
        on_it &= np.abs(local[..., 2] - box.half[2]) < layer
        high[on_it] -= 2 * layer
    base = float(high.min())
    return HeightField(np.array([*corner, base]), cell, (high - base).astype(np.float32))


def on_box(plane: Plane, boxes: Sequence[Box]) -> Plane:
    """The top of the box that ``plane`` lies on, so that what stands there touches it; else it."""
    for box in boxes:
        at = (plane.origin - box.centre) @ box.axes
        if (np.abs(at[:2]) < box.half[:2]).all() and abs(at[2] - box.half[2]) < box.half[2]:
            return Plane(box.centre + box.half[2] * box.axes[:, 2], box.axes[:, 2])
    return plane


def library(name: str) -> ModuleType:
    """An optional package; ``MissingExtraError`` with one sentence when it is not installed."""

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"Bodies for simulators need the package {name}. Install it: "
            f"{cure_without('simulation')}."
        ) from error
