"""Bodies as OpenUSD: splats, mesh, convex parts and physics (UsdPhysics), one prim an object."""

from pathlib import Path
from typing import Any

import numpy as np

from gaga_core.export.simulation.bodies import GRAVITY, Body, World
from gaga_core.geometry import matrices_to_quats
from gaga_core.io.files import atomic_write
from gaga_core.io.meshes import TriangleMesh
from gaga_core.io.splats.usd import add_splats, export, usd

_ROOT = "/World"
_OBJECTS = f"{_ROOT}/objects"


def check() -> None:
    """Raise ``GagaError`` with one sentence when OpenUSD cannot be written."""
    usd()


def write_world(path: Path, world: World) -> None:
    """Write ``world`` as one OpenUSD file: z up, metres."""
    usd()
    from pxr import Gf, Kind, Usd, UsdGeom, UsdPhysics, UsdShade

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, _ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root).SetKind(Kind.Tokens.assembly)
    physics = UsdPhysics.Scene.Define(stage, f"{_ROOT}/physics")
    physics.CreateGravityDirectionAttr(Gf.Vec3f(0, 0, -1))
    physics.CreateGravityMagnitudeAttr(GRAVITY)
    material = UsdShade.Material.Define(stage, f"{_ROOT}/surface")
    surface = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    surface.CreateStaticFrictionAttr(world.config.friction)
    surface.CreateDynamicFrictionAttr(world.config.friction)
    UsdGeom.Scope.Define(stage, _OBJECTS)
    for body in world.bodies:
        _add_body(stage, f"{_OBJECTS}/{_prim_name(body.stem)}", body, material)
    static = UsdGeom.Xform.Define(stage, f"{_ROOT}/static")
    if world.static.gaussians is not None:
        add_splats(stage, f"{_ROOT}/static/splats", world.static.gaussians)
    for k, box in enumerate(world.static.boxes):
        cube = UsdGeom.Cube.Define(stage, f"{_ROOT}/static/support_{k}")
        cube.CreateSizeAttr(2.0)
        cube.CreateExtentAttr([(-1, -1, -1), (1, 1, 1)])
        w, x, y, z = (float(v) for v in matrices_to_quats(box.axes[None])[0])
        cube.AddTranslateOp().Set(Gf.Vec3d(*box.centre.tolist()))
        cube.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))
        cube.AddScaleOp().Set(Gf.Vec3f(*box.half.tolist()))
        cube.CreatePurposeAttr(UsdGeom.Tokens.guide)
        _collides(cube.GetPrim(), material)
    if world.static.ground is not None:
        ground = _add_mesh(stage, f"{_ROOT}/static/ground", world.static.ground.mesh())
        ground.CreatePurposeAttr(UsdGeom.Tokens.guide)
        _collides(ground.GetPrim(), material)
        UsdPhysics.MeshCollisionAPI.Apply(ground.GetPrim())  # as it is: triangles
    Usd.ModelAPI(static).SetKind(Kind.Tokens.component)
    with atomic_write(path) as temporary:
        export(stage, temporary, path.suffix)


def _add_body(stage: Any, path: str, body: Body, material: Any) -> None:
    from pxr import Gf, Kind, Usd, UsdGeom, UsdPhysics

    xform = UsdGeom.Xform.Define(stage, path)
    prim = xform.GetPrim()
    w, x, y, z = (float(v) for v in matrices_to_quats(body.turn[None])[0])
    if body.copy_of:  # the same prims again, at another place
        prim.GetReferences().AddInternalReference(f"{_OBJECTS}/{_prim_name(body.copy_of)}")
        prim.GetAttribute("xformOp:translate").Set(Gf.Vec3d(*body.position.tolist()))
        prim.GetAttribute("xformOp:orient").Set(Gf.Quatd(w, x, y, z))
    else:
        xform.AddTranslateOp().Set(Gf.Vec3d(*body.position.tolist()))
        xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))
    Usd.ModelAPI(prim).SetKind(Kind.Tokens.component)
    prim.SetDisplayName(body.name)
    prim.SetCustomDataByKey("gaga:group", body.id)
    prim.SetCustomDataByKey("gaga:name", body.name)
    prim.SetCustomDataByKey("gaga:underside", body.underside)
    _label(prim, body.name)
    if body.copy_of:
        return
    UsdPhysics.RigidBodyAPI.Apply(prim)
    mass = UsdPhysics.MassAPI.Apply(prim)
    of = body.properties
    mass.CreateMassAttr(of.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*of.centre.tolist()))
    moments, axes = np.linalg.eigh(of.inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments.tolist()))
    w, x, y, z = (float(v) for v in matrices_to_quats(axes[None])[0])
    mass.CreatePrincipalAxesAttr(Gf.Quatf(w, x, y, z))
    add_splats(stage, f"{path}/splats", body.gaussians)
    # The mesh stands for the splats where a program does not know them.
    mesh = _add_mesh(stage, f"{path}/mesh", body.mesh)
    mesh.CreatePurposeAttr(UsdGeom.Tokens.proxy)
    UsdGeom.Scope.Define(stage, f"{path}/collision")
    for k, part in enumerate(body.parts):
        _add_solid(stage, f"{path}/collision/part_{k}", part, material)


def _add_solid(stage: Any, path: str, part: TriangleMesh, material: Any) -> None:
    """A convex part that things collide with."""
    from pxr import UsdGeom, UsdPhysics

    solid = _add_mesh(stage, path, part)
    solid.CreatePurposeAttr(UsdGeom.Tokens.guide)
    _collides(solid.GetPrim(), material)
    hull = UsdPhysics.MeshCollisionAPI.Apply(solid.GetPrim())
    hull.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)


def _label(prim: Any, name: str) -> None:
    """Say what a prim shows, as simulators read it for labels of pictures."""
    from pxr import UsdSemantics

    UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr([name])


def _collides(prim: Any, material: Any) -> None:
    from pxr import UsdPhysics, UsdShade

    UsdPhysics.CollisionAPI.Apply(prim)
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")


def _add_mesh(stage: Any, path: str, mesh: TriangleMesh) -> Any:
    from pxr import UsdGeom, Vt

    made = UsdGeom.Mesh.Define(stage, path)
    made.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(mesh.vertices))
    made.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    made.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.ravel()))
    made.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    lo, hi = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    made.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([lo, hi])))
    if mesh.colors is not None:
        colors = (mesh.colors / np.float32(255)).astype(np.float32)
        made.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(colors))
    return made


def _prim_name(stem: str) -> str:
    """A name that OpenUSD allows."""
    plain = stem.replace("-", "_")
    return plain if not plain[0].isdigit() else f"_{plain}"
