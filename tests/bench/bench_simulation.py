"""Rigid bodies of trained splats: size, mass, rest, and whether vessels hold a ball.

Scenes of scanned objects (CC BY 4.0) with known poses, ycb_table and ycb_crowd, whose splats were
trained on renders; groups are those of the preset robust from simulated masks. Empty where they are
not on the machine. Resolution and carving were chosen on ycb_table alone.
"""

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.camera import Camera
from gaga_core.export.simulation.bodies import Body, World, convex_parts, mass_properties
from gaga_core.export.simulation.export import (
    SimulationExport,
    SimulatorForm,
    export_simulation_stage,
    world_stage,
)
from gaga_core.export.simulation.falling import fall
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.meshes import TriangleMesh
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.search import describe_project
from gaga_core.progress import run_stage
from gaga_core.scene.project import Project, open_path_stage
from tests.bench.figures import Figure, data_folder
from tools.scenes.scans import Mesh, read_scan

_POINTS = 20_000  # of a scan and of a mesh
_SEEN = 0.003  # m behind the nearest point of a pixel: what a photo shows
_BALL = 0.015  # m, radius
_VESSELS = ("024_bowl", "025_mug")
_SECONDS = 2.0


@dataclass(frozen=True, eq=False)
class Truth:
    """A scanned object where it stands."""

    name: str
    mesh: TriangleMesh  # world
    surface: DoubleArray  # (N, 3) points on it, world
    seen: BoolArray  # (N,) in a photo
    mass: float  # kg

    def is_in(self, points: DoubleArray) -> BoolArray:
        """Whether points (N, 3) are in its box."""
        lo, hi = self.surface.min(axis=0) - _SEEN, self.surface.max(axis=0) + _SEEN
        inside: BoolArray = ((points > lo) & (points < hi)).all(axis=1)
        return inside


def figures() -> list[Figure]:
    """Figures of all objects of ycb_table, and of the vessels of ycb_crowd, which chose nothing."""
    if not data_folder("ycb_meshes").is_dir():
        return []
    found = []
    with tempfile.TemporaryDirectory() as folder:
        if data_folder("ycb_table").is_dir():
            found += _of_table(_grouped("ycb_table", Path(folder) / "table"), Path(folder))
        if data_folder("ycb_crowd").is_dir():
            found += _of_crowd(_grouped("ycb_crowd", Path(folder) / "crowd"), Path(folder))
    return found


def _of_table(project: Project, folder: Path) -> list[Figure]:
    world, truths = run_stage(world_stage(project.scene, _how(project))), truths_of("ycb_table")
    pairs = [(body, truth) for body in world.bodies if (truth := _matching(body, truths))]
    chamfers, volumes = zip(*(compared(body, truth) for body, truth in pairs), strict=True)
    moved, turned, late = resting(world)
    rests = (moved < 0.005) & (turned < 3.0) & (late < 0.0005)
    off = np.abs(np.array(volumes) - 1)
    return [
        Figure("bodies: scanned objects found", len(pairs), "", ">= 12"),
        Figure("bodies: Chamfer, median", 1e3 * float(np.median(chamfers)), "mm", "<= 3"),
        Figure("bodies: Chamfer, worst", 1e3 * max(chamfers), "mm"),
        Figure("bodies: error of mass, median", 100 * float(np.median(off)), "%", "<= 30"),
        Figure("bodies: share with mass within 30 %", float((off <= 0.3).mean()), ""),
        Figure("bodies: share that rest where they stood", float(rests.mean()), "", ">= 1"),
        *_held("ycb_table", project, world, pairs, folder / "table-bodies"),
    ]


def _of_crowd(project: Project, folder: Path) -> list[Figure]:
    """Bodies of the vessels alone: they are known by their splats."""
    scene, truths = project.scene, truths_of("ycb_crowd")
    groups = []
    for group in np.unique(scene.labels[scene.labels > 0]).tolist():
        points = scene.gaussians.means[scene.labels == group].astype(np.float64)
        inside = [truth.is_in(points).mean() for truth in truths]
        name = truths[int(np.argmax(inside))].name
        groups += [group] if max(inside) > 0.5 and name in _VESSELS else []
    world = run_stage(world_stage(scene, _how(project), groups))
    pairs = [(body, truth) for body in world.bodies if (truth := _matching(body, truths))]
    return _held("ycb_crowd", project, world, pairs, folder / "crowd-bodies")


def _how(project: Project) -> SimulationExport:
    behind = describe_project(project).background
    return SimulationExport(up=project.up, background=behind).seeing(project)


def _held(
    name: str,
    project: Project,
    world: World,
    pairs: Sequence[tuple[Body, Truth]],
    folder: Path,
) -> list[Figure]:
    """Which share of the vessels hold a ball: by their convex parts, and by one hull each."""
    vessels = [(body, truth) for body, truth in pairs if truth.name in _VESSELS]
    parts = _exported(project, world, folder / "parts")
    hulls = _exported(project, _as_hulls(world), folder / "hulls")
    return [
        Figure(
            f"bodies: vessels of {name} that hold a ball, {said}",
            float(np.mean([holds_ball(mjcf, body, truth) for body, truth in vessels])),
            "",
            bar,
        )
        for mjcf, said, bar in ((parts, "parts", ">= 1"), (hulls, "one hull", ""))
    ]


def _grouped(name: str, folder: Path) -> Project:
    """A scene with its groups found here; results are in ``folder``."""
    folder.mkdir()
    for path in data_folder(name).iterdir():
        if path.name != "gt":
            (folder / path.name).symlink_to(path)
    run_stage(associate_scene(open_scene_folder(folder), "sim", AssociateConfig.of("robust")))
    return run_stage(open_path_stage(folder))


def truths_of(name: str) -> list[Truth]:
    """The scanned objects of a scene where they stand, and what its photos show of them."""
    told = json.loads((data_folder(name) / "objects.json").read_text("utf-8"))["objects"]
    rng = np.random.default_rng(0)
    found = []
    for one in told[1:]:  # the first is the table
        scan = read_scan(data_folder("ycb_meshes"), one["name"])
        lo, hi = scan.mesh.vertices.min(axis=0), scan.mesh.vertices.max(axis=0)
        angle = np.radians(one["yaw_deg"])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        vertices = scan.mesh.vertices - np.array([*(lo + hi)[:2] / 2, lo[2]])
        vertices[:, :2] = vertices[:, :2] @ turn.T
        mesh = replace(scan.mesh, vertices=vertices + np.array(one["position"]))
        surface, seen = mesh.sample(_POINTS, rng)[0], np.zeros(_POINTS, bool)
        found.append(Truth(one["name"], _plain(mesh), surface, seen, scan.mass))
    cameras = open_scene_folder(data_folder(name)).cameras
    seen = in_photos(np.concatenate([truth.surface for truth in found]), cameras)
    parts = np.split(seen, len(found))
    return [replace(truth, seen=part) for truth, part in zip(found, parts, strict=True)]


def in_photos(points: DoubleArray, cameras: Sequence[Camera]) -> BoolArray:
    """Which points (N, 3) of all surfaces are first in a pixel of a photo, or nearly."""
    seen = np.zeros(len(points), bool)
    for camera in cameras:
        pixels, depth = camera.project(points)
        inside = camera.shows(pixels, depth)
        column, row = pixels[inside].astype(int).T
        nearest = np.full((camera.height, camera.width), np.inf)
        np.minimum.at(nearest, (row, column), depth[inside])
        # Points are as far apart as pixels: what is in front may be in the next one.
        nearest = minimum_filter(nearest, 3)
        seen[inside] |= depth[inside] < nearest[row, column] + _SEEN
    return seen


def compared(body: Body, truth: Truth) -> tuple[float, float]:
    """Chamfer distance (m) of the visual mesh to the scan where it was seen, and how many times
    the mass is the true one at the true density."""
    rng = np.random.default_rng(1)
    vertices = body.mesh.vertices + body.position
    ours = Mesh(vertices, body.mesh.faces, np.zeros((len(vertices), 2)), np.ones((1, 1, 3)))
    points = ours.sample(_POINTS, rng)[0]
    away = np.asarray(cKDTree(points).query(truth.surface[truth.seen])[0])
    back, nearest = map(np.asarray, cKDTree(truth.surface).query(points))
    chamfer = (away.mean() + back[truth.seen[nearest]].mean()) / 2
    return float(chamfer), body.properties.volume / mass_properties(truth.mesh, 1.0, None).volume


def resting(world: World) -> tuple[DoubleArray, DoubleArray, DoubleArray]:
    """How far bodies are after two seconds (m, degrees), and how far they moved in the last
    half second (m)."""
    places = np.stack(list(fall(world, _SECONDS)))
    first, last = places[0], places[-1]
    turn = np.einsum("bij,bij->b", first[:, :3, :3], last[:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((turn - 1) / 2, -1, 1)))
    late = np.ptp(places[-15:, :, :3, 3], axis=0).max(axis=1)
    return np.linalg.norm(last[:, :3, 3] - first[:, :3, 3], axis=1), angle, late


def holds_ball(mjcf: Path, body: Body, truth: Truth) -> bool:
    """Whether a ball of 30 mm that falls into a vessel of a file is in it two seconds later.

    Other bodies are taken away: in the bowl of ycb_table lies an apple.
    """
    import mujoco

    rim = truth.surface[truth.surface[:, 2] > truth.surface[:, 2].max() - 0.003]
    middle, top = (rim.min(axis=0) + rim.max(axis=0))[:2] / 2, float(rim[:, 2].max())
    reach = float(np.ptp(rim[:, :2], axis=0).max()) / 2
    spec = mujoco.MjSpec.from_file(str(mjcf))
    for other in [one for one in spec.bodies[1:] if one.name != body.stem]:
        spec.delete(other)
    ball = spec.worldbody.add_body(name="ball", pos=[*middle, top + 0.02])
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_BALL, 0, 0], mass=0.02)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(_SECONDS / model.opt.timestep))
    at = data.body("ball").xpos - data.body(body.stem).xpos + body.position
    return bool(at[2] < top and np.linalg.norm(at[:2] - middle) < reach)


def _exported(project: Project, world: World, folder: Path) -> Path:
    how = SimulationExport((SimulatorForm.MJCF,))
    run_stage(export_simulation_stage(project.scene, folder, how, world=world))
    return folder / "scene.xml"


def _as_hulls(world: World) -> World:
    one = replace(world.config, parts=1)
    bodies = (replace(body, parts=convex_parts(body.mesh, one)) for body in world.bodies)
    return replace(world, bodies=tuple(bodies))


def _matching(body: Body, truths: Sequence[Truth]) -> Truth | None:
    """The scanned object that most of a body's splats are in; None: it is none of them."""
    points = body.gaussians.means + body.position
    inside = [float(truth.is_in(points).mean()) for truth in truths]
    return truths[int(np.argmax(inside))] if max(inside) > 0.5 else None


def _plain(mesh: Mesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices.astype(np.float32), mesh.faces)
