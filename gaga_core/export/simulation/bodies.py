"""Rigid bodies of objects: a closed mesh, convex parts, mass, centre of mass and inertia.

The world of a simulation has z up and lengths in metres where the scene's unit is known. The axes
of a body are those of that world; its origin is the middle of its box's underside.
"""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import MeshConfig, convex_collider, proxy_mesh_stage
from gaga_core.gaussians import Gaussians
from gaga_core.io.meshes import TriangleMesh
from gaga_core.io.splats.glb import placed
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene.orientation import upright_basis
from gaga_core.training.stereo import DepthView

UP = (0.0, 0.0, 1.0)  # of the world of a simulation
GRAVITY = 9.81  # m/s^2 downwards
_SOLID = 0.2  # opacity from which on a splat counts as a surface
_ASIDE, _NEAR = 0.5, 0.25  # of the object's size: how far around and above or below its lowest
# point its support is looked for; else it is below, of a layer with this share of the fullest.
_FULL = 0.5
_LAYER = 0.02  # of the object's size: height of the layer of splats that a plane is fitted to
_N_SUPPORT = 30  # splats: fewer are no surface
_STEEPEST = np.cos(np.radians(20.0))  # of a plane that something stands on
_GAP = 0.15  # of the object's height: a foot that ends higher over its support does not touch it
_CUT = 2.0  # voxels over the support from which on downwards the underside is made flat
_MOST_CORNERS = 64  # of a convex part: what PhysX takes on a graphics card
_COARSE, _MOST_TRIANGLES = 0.002, 1_500  # of the extent; what convex parts are searched in
_THICKNESS = 0.05  # of the longer side of a support: how thick its box is


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
class Static:
    """What stays: splats, the boxes that things stand on, and objects that were not chosen."""

    gaussians: Gaussians | None  # world of the simulation; None: there are none
    boxes: tuple[Box, ...]
    obstacles: tuple[TriangleMesh, ...] = ()  # convex parts, world of the simulation


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

    World of the simulation. None: nothing level is there.
    """
    lo, hi = np.percentile(points, 1, axis=0), np.percentile(points, 99, axis=0)
    size = float((hi - lo).max())
    reach = _ASIDE * float((hi - lo)[:2].max())
    near = ((others[:, :2] > lo[:2] - reach) & (others[:, :2] < hi[:2] + reach)).all(axis=1)
    layer, foot = _LAYER * size, others[near]
    stands = foot[np.abs(foot[:, 2] - lo[2]) < _NEAR * size]
    plane = _level_plane(stands, 1.0, layer)
    # What hangs in the air falls on the highest of several surfaces.
    return plane or _level_plane(foot[foot[:, 2] < lo[2]], _FULL, layer)


def _level_plane(cloud: DoubleArray, share: float, layer: float) -> Plane | None:
    """The plane of the highest ``layer`` with this ``share`` of the points of the fullest one."""
    if len(cloud) < _N_SUPPORT:
        return None
    rows = np.sort(cloud[:, 2])
    in_layer = np.searchsorted(rows, rows + layer, side="right") - np.arange(len(rows))
    start = rows[np.flatnonzero(in_layer >= share * in_layer.max())[-1]]
    inside = (cloud[:, 2] >= start) & (cloud[:, 2] <= start + layer)
    corner, fit = cloud.min(axis=0), np.array([0.0, 0.0, start + layer / 2])
    for _ in range(3):
        if inside.sum() < _N_SUPPORT:
            return None
        design = np.column_stack([cloud[:, :2] - corner[:2], np.ones(len(cloud))])
        fit = np.linalg.lstsq(design[inside], cloud[inside, 2], rcond=None)[0]
        inside = np.abs(design @ fit - cloud[:, 2]) < layer
    normal = np.array([-fit[0], -fit[1], 1.0]) / np.sqrt(fit[0] ** 2 + fit[1] ** 2 + 1)
    if normal[2] < _STEEPEST:
        return None
    middle = np.median(cloud[inside], axis=0)
    on_it = fit[0] * (middle[0] - corner[0]) + fit[1] * (middle[1] - corner[1]) + fit[2]
    return Plane(np.array([middle[0], middle[1], on_it]), normal)


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
) -> Stage[tuple[Body, bool]]:
    """The body of an object without a name, and whether its mesh is closed.

    Raises ``GagaError`` when it has no surface, or an extra is missing.
    """
    mesh = yield from proxy_mesh_stage(
        gaussians, choose(), up=np.array(UP), config=mesh_config, is_soft=True, photos=photos
    )
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    stands = is_closed = False
    try:
        mesh, stands = closed_on(mesh, plane, extent / mesh_config.voxels)
        is_closed = True
    except MissingExtraError:
        raise
    except GagaError:  # it is used as it is
        pass
    lo, hi = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    origin = np.array([*(lo[:2] + hi[:2]) / 2, lo[2]], np.float64)
    mesh = mesh.moved(origin, 1.0)
    place = np.eye(4)
    place[:3, 3] = -origin
    return Body(
        id=0,
        name="",
        stem="",
        position=origin,
        gaussians=placed(gaussians, place),
        mesh=mesh,
        parts=convex_parts(mesh, config),
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
            f"Bodies for simulators need the package {name}. Install it by "
            "pip install 'gaga-studio[simulation]'."
        ) from error
