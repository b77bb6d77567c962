"""Export for simulators: bodies of a scene's objects, and their files, all together or none."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.export.export import as_step, exported_indices, slug
from gaga_core.export.simulation import mjcf, usd
from gaga_core.export.simulation.bodies import (
    UP,
    Body,
    MissingExtraError,
    Plane,
    Static,
    World,
    body_stage,
    height_field,
    library,
    lies_in,
    on_box,
    support_boxes,
    support_of,
    upright_place,
)
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.export.solids import MeshConfig
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import matrices_to_quats
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.splats.glb import placed
from gaga_core.io.splats.splat_files import write_splats_stage
from gaga_core.progress import Progress, Stage
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.objects import group_name
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene, of_scene_now
from gaga_core.training.stereo import OBJECT_VIEWS, DepthView, evenly, object_depths_stage
from gaga_core.training.views import TrainView, read_view

STEP = "Make bodies"
MANIFEST = "simulation.json"
MANIFEST_VERSION = 1
_PHOTO_SIDE = 1600  # pixels of the longest side of photos
_STILL = 1e-4  # of the scene: what moved less stands where photos saw it
# Of the time of a body; the rest is the search for convex parts. 28 of 73 s for six pieces of the
# demo on two cores.
_MESH_SHARE = 0.4
_SOLID = 0.2  # opacity from which on a splat counts as a surface that carries something


class SimulatorForm(StrEnum):
    """Files for simulators."""

    MJCF = "mjcf"  # scene.xml
    USD = "usd"  # scene.usd
    URDF = "urdf"  # a file an object, and static.urdf


@dataclass(frozen=True)
class SimulationExport:
    """What is made of a scene for a simulator."""

    forms: tuple[SimulatorForm, ...] = (SimulatorForm.USD, SimulatorForm.MJCF)
    config: SimulationConfig = field(default_factory=SimulationConfig)
    mesh: MeshConfig = field(default_factory=lambda: MeshConfig(triangles=0))
    masses: Mapping[int, float] = field(default_factory=dict)  # kg, by group
    densities: Mapping[int, float] = field(default_factory=dict)  # kg/m^3, by group
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)  # unit, world
    scale: float = 1.0  # metres per scene unit, where it is given
    background: Collection[int] = ()  # groups that stay
    cameras: tuple[Camera, ...] = ()  # of photos, world
    photos: Mapping[str, Path] = field(default_factory=dict)  # by name of a camera

    def seeing(self, project: Project) -> "SimulationExport":
        """With the photos of ``project``, so that what they saw through is empty."""
        folder = project.placed_folder
        if folder is None:
            return self
        cameras = tuple(camera for camera in folder.cameras if camera.name in folder.image_paths)
        return replace(self, cameras=cameras, photos=folder.image_paths)


HOW_TO_SCALE = "Set the scale in the window, or give --scale."


def unit_sentence(*, is_metric: bool, how: str = HOW_TO_SCALE) -> str:
    """What is said where no length of the scene is known, and ``how`` it is set; empty where one
    is."""
    return (
        ""
        if is_metric
        else "The length of a unit is not known, so lengths are written as they are and taken for "
        f"metres. {how}"
    )


@of_scene_now
def world_stage(
    scene: Scene, how: SimulationExport, groups: Sequence[int] | None = None
) -> Stage[World]:
    """The bodies of ``groups`` (default: all but the background) and what stays: the rest.

    Objects that are not chosen stay: no body is made of them, their heights are in the way.
    Raises ``GagaError`` when none of them is visible or has a surface, or an extra is missing.
    """
    for name in ("manifold3d", *(["coacd"] if how.config.parts > 1 else [])):
        library(name)  # before anything is computed
    splats = exported_indices(scene)
    labels = scene.labels[splats]
    found = np.setdiff1d(labels, [0, *how.background])
    chosen = found if groups is None else np.intersect1d(labels[labels > 0], list(groups))
    if len(chosen) == 0:
        raise GagaError("None of these objects is visible, so there is nothing to export.")
    begin = Progress(STEP, 0, len(chosen) + 1, "prepare")  # the last step writes
    gaussians = yield from as_step(begin, bake_stage(scene, indices=splats))
    gaussians = placed(gaussians, upright_place(how.up, how.scale))
    gaussians = gaussians.with_metres(scene.frame.is_metric or how.scale != 1.0)
    finite = np.isfinite(gaussians.means).all(axis=1)
    firm = finite & (gaussians.opacities > _SOLID)
    means = gaussians.means.astype(np.float64)
    rest = ~np.isin(labels, chosen)
    views = yield from as_step(begin, _views_stage(how))
    stays_put = _stays_put(scene, splats, gaussians, upright_place(how.up, how.scale))
    planes = {
        int(g): support_of(means[firm & (labels == g)], means[firm & (labels != g)])
        for g in chosen
        if (firm & (labels == g)).sum() > 0
    }
    boxes = support_boxes(
        [p for p in planes.values() if p is not None and _is_static(p, means, firm, rest)],
        means[firm & rest],
    )
    bodies, left_out, holes, used = list[Body](), list[str](), list[str](), set[str]()
    held = _held(chosen.tolist(), {int(g): means[firm & (labels == g)] for g in chosen})
    # What lies in another one comes first: the other is hollow there.
    order = sorted(chosen.tolist(), key=lambda group: (len(held[group]), group))
    for i, group in enumerate(order):
        name = group_name(scene, group)
        step = Progress(STEP, i, begin.total, name)
        yield step
        plane = planes.get(group)
        plane = plane and on_box(plane, boxes)
        if plane is None and any(group in inside for inside in held.values()):
            low = means[firm & (labels == group)]
            plane = Plane(low[np.argmin(low[:, 2])], np.array(UP))  # what it lies in is flat there
        stem = slug(name) or f"group-{group}"
        stem = stem if stem not in used else f"{stem}-{group}"
        copy = None if held[group] else _copied(scene, how, bodies, group, name, stem)
        if copy is not None:
            used.add(stem)
            bodies.append(copy)
            holes += (
                [name] if any(b.stem == copy.copy_of and b.name in holes for b in bodies) else []
            )
            continue
        own = finite & (labels == group)
        photos = list[DepthView]()
        if views and stays_put[own].all():
            looks = object_depths_stage(means[own & firm], views)
            photos = yield from as_step(step, looks)
        stage = body_stage(
            gaussians.take(np.flatnonzero(own)),
            plane,
            how.config,
            how.mesh,
            *_weight(scene, how, group),
            photos,
            [
                np.concatenate([p.vertices for p in body.parts]) @ body.turn.T + body.position
                for body in bodies
                if body.id in held[group]
            ],
        )
        try:
            body, is_closed = yield from as_step(step, stage, _MESH_SHARE)
        except MissingExtraError:
            raise
        except GagaError:  # it has no surface: the others are written
            left_out.append(name)
            continue
        used.add(stem)
        holes += [] if is_closed else [name]
        lying = tuple(body.name for body in bodies if body.id in held[group])
        bodies.append(replace(body, id=group, name=name, stem=stem, holds=lying))
    bodies.sort(key=lambda body: body.id)
    if not bodies:
        raise GagaError("None of these objects has a surface, so there is nothing to export.")
    stays = np.flatnonzero(rest & finite)
    remains = gaussians.take(stays) if len(stays) else None
    where = [means[firm & (labels == body.id)] for body in bodies]
    ground = None
    if remains is not None:
        ground = height_field(remains, [points for points in where if len(points)], boxes)
    static = Static(remains, boxes, ground)
    return World(
        tuple(bodies),
        static,
        is_metric=scene.frame.is_metric or how.scale != 1.0,
        config=how.config,
        left_out=tuple(left_out),
        without_support=tuple(b.name for b in bodies if planes.get(b.id) is None),
        not_closed=tuple(holes),
    )


def _held(groups: Sequence[int], points: Mapping[int, DoubleArray]) -> dict[int, set[int]]:
    """Which groups lie in each one; ``points``: centres (K, 3) of each."""
    boxes = {g: (p.min(axis=0), p.max(axis=0)) for g, p in points.items() if len(p)}
    return {
        group: {
            other
            for other in boxes
            if other != group
            and group in boxes
            and (boxes[other][0] < boxes[group][1]).all()
            and (boxes[other][1] > boxes[group][0]).all()
            and lies_in(points[other], points[group])
        }
        for group in groups
    }


def _copied(
    scene: Scene, how: SimulationExport, bodies: Sequence[Body], group: int, name: str, stem: str
) -> Body | None:
    """The body of a group that is a copy of one of ``bodies``, moved and turned; else None."""
    place, own = upright_place(how.up, how.scale), _rows(scene, group)
    for body in bodies:
        other = _rows(scene, body.id)
        same = len(own) == len(other) and np.array_equal(scene.source[own], scene.source[other])
        if not same or _weight(scene, how, group) != _weight(scene, how, body.id):
            continue
        table, (here, there) = scene.placements, scene.placement[np.stack([own, other])]
        pairs = np.unique(np.stack([here, there]), axis=1).T
        here, there = pairs[:, 0], pairs[:, 1]
        if not (
            np.array_equal(table.color[here], table.color[there])
            and np.array_equal(table.opacity[here], table.opacity[there])
            and np.array_equal(scene.gaussians.means[own], scene.gaussians.means[other])
        ):
            continue
        whole = np.tile(np.eye(4), (2, len(pairs), 1, 1))
        whole[:, :, :3] = table.matrix[here], table.matrix[there]
        motions = place @ whole[0] @ np.linalg.inv(whole[1]) @ np.linalg.inv(place)
        turn = motions[0, :3, :3]
        is_rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-5) and np.linalg.det(turn) > 0
        if is_rigid and np.allclose(motions, motions[0], atol=1e-6):
            return body.moved(motions[0], group, name, stem)
    return None


def _rows(scene: Scene, group: int) -> IntArray:
    """Splats of a group that are exported, in the order of the opened file."""
    rows = exported_indices(scene)
    rows = rows[scene.labels[rows] == group]
    ordered: IntArray = rows[np.argsort(scene.source[rows], kind="stable")]
    return ordered


def _views_stage(how: SimulationExport) -> Stage[list[TrainView]]:
    """The photos in the world of the simulation, evenly among all; none where none are given."""
    carried = carried_cameras(how.cameras, upright_place(how.up, how.scale))
    cameras = evenly(carried, OBJECT_VIEWS)
    views = []
    for k, camera in enumerate(cameras):
        yield Progress("Read photos", k, len(cameras), camera.name)
        views.append(read_view(camera, how.photos[camera.name], _PHOTO_SIDE))
    return views


def _stays_put(
    scene: Scene, splats: IntArray, gaussians: Gaussians, place: DoubleArray
) -> BoolArray:
    """Which of ``splats`` (K,) are where the photos saw them, not moved since."""
    motion = place @ scene.frame.world
    stood = scene.gaussians.means[splats] @ motion[:3, :3].T + motion[:3, 3]
    off = np.abs(stood - gaussians.means).max(axis=1)
    still: BoolArray = ~(off > _STILL * float(np.ptp(gaussians.means, axis=0).max()))
    return still


def _weight(scene: Scene, how: SimulationExport, group: int) -> tuple[float | None, float | None]:
    """Mass and density of a group: as the export says, else as a person typed it in the scene."""
    mass, density = how.masses.get(group), how.densities.get(group)
    own = scene.weights.get(group)
    if own is None or mass is not None or density is not None:
        return mass, density
    return (own.value, None) if own.kind == "mass" else (None, own.value)


def _is_static(plane: Plane, means: DoubleArray, firm: BoolArray, rest: BoolArray) -> bool:
    """Whether what stays, not another object, makes most of a plane at its origin."""
    size = 0.1 * float(np.ptp(means[firm & ~rest], axis=0).max())
    near = firm & (np.linalg.norm(means - plane.origin, axis=1) < size)
    near &= np.abs(plane.heights(means)) < 0.05 * size
    return bool((near & rest).sum() >= (near & ~rest).sum())


def sentences(world: World, how: str = HOW_TO_SCALE) -> tuple[str, ...]:
    """What a person should know of ``world``, a sentence each; ``how`` its scale is set."""
    said = [unit_sentence(is_metric=world.is_metric, how=how)]
    if world.left_out:
        said.append(f"Without a surface, and so left out: {', '.join(world.left_out)}.")
    if world.without_support:
        said.append(
            f"No level support is seen under {', '.join(world.without_support)}: the underside is "
            "as the splats have it, and in a simulation it may fall."
        )
    if world.not_closed:
        said.append(
            f"Not closed, so mass and convex parts are rough: {', '.join(world.not_closed)}."
        )
    return tuple(sentence for sentence in said if sentence)


_FILES = {
    SimulatorForm.MJCF: "scene.xml",
    SimulatorForm.USD: "scene.usd",
    SimulatorForm.URDF: "static.urdf",
}


def why_not_into(folder: Path, forms: Sequence[SimulatorForm]) -> str:
    """A sentence where ``folder`` has files of these names that no export wrote; else ""."""
    if (folder / MANIFEST).is_file():
        return ""
    taken = [name for name in map(_FILES.__getitem__, forms) if (folder / name).exists()]
    folders = ("splats",) if set(forms) == {SimulatorForm.USD} else ("meshes", "splats")
    taken += [name for name in folders if (folder / name).exists()]
    if not taken:
        return ""
    return f"{folder} holds {' and '.join(taken)} of something else. Choose another folder."


def export_simulation_stage(
    scene: Scene,
    folder: Path,
    how: SimulationExport,
    groups: Sequence[int] | None = None,
    source: str = "",
    world: World | None = None,
) -> Stage[tuple[Path, World]]:
    """Write bodies and what stays into ``folder``; the manifest's path, and what was written.

    ``world``: what `world_stage` made of the same, where it is there.
    Raises ``GagaError`` as `world_stage` does, and for a ``folder`` with files of something else.
    """
    if taken := why_not_into(folder, how.forms):
        raise GagaError(taken)
    if SimulatorForm.USD in how.forms:
        usd.check()
    world = world or (yield from world_stage(scene, how, groups))
    with staging_folder(folder) as staging:
        files, splats = list[str](), dict[str, str]()
        (staging / "splats").mkdir()
        n = len(world.bodies) + len(world.left_out)  # as `world_stage` counted
        parts = [(body.stem, body.gaussians) for body in world.bodies if not body.copy_of]
        if world.static.gaussians is not None:
            parts.append(("static", world.static.gaussians))
        for i, (stem, gaussians) in enumerate(parts):
            splats[stem] = f"splats/{stem}.ply"
            step = Progress(STEP, n + i / len(parts), n + 1, f"write {stem}.ply")
            yield from as_step(step, write_splats_stage(staging / splats[stem], gaussians))
        files += splats.values()
        splats |= {body.stem: splats[body.copy_of] for body in world.bodies if body.copy_of}
        if {SimulatorForm.MJCF, SimulatorForm.URDF} & set(how.forms):
            files += mjcf.write_meshes(staging, world)
        texts = dict[str, str]()
        if SimulatorForm.MJCF in how.forms:
            texts["scene.xml"] = mjcf.mjcf_of(world, splats)
        if SimulatorForm.URDF in how.forms:
            for body in world.bodies:
                texts[f"{body.stem}.urdf"] = mjcf.urdf_of(body, how.config.friction)
            texts["static.urdf"] = mjcf.static_urdf_of(world)
        if SimulatorForm.USD in how.forms:
            usd.write_world(staging / "scene.usd", world)
            files.append("scene.usd")
        described = json.dumps(_described(world, splats, source), indent=1, ensure_ascii=False)
        texts[MANIFEST] = described + "\n"
        for name, text in texts.items():
            (staging / name).write_text(text, encoding="utf-8")
        yield Progress(STEP, n + 1, n + 1)
        publish_all(staging, [*files, *texts], folder)
    return folder / MANIFEST, world


def _described(world: World, splats: Mapping[str, str], source: str) -> dict[str, Any]:
    """Content of simulation.json: SI units where the scene's unit is known."""
    return {
        "version": MANIFEST_VERSION,
        "source": source,
        "up": [0, 0, 1],
        "metric": world.is_metric,
        "friction": world.config.friction,
        "objects": [
            {
                "id": body.id,
                "name": body.name,
                "splats": splats[body.stem],
                "position": body.position.tolist(),
                "orientation": matrices_to_quats(body.turn[None])[0].tolist(),
                "copy_of": body.copy_of,
                "volume": body.properties.volume,
                "mass": body.properties.mass,
                "centre_of_mass": body.properties.centre.tolist(),
                "inertia": body.properties.inertia.tolist(),
                "convex_parts": len(body.parts),
                "underside": body.underside,
                "hollow_for": list(body.holds),
                "closed": body.name not in world.not_closed,
            }
            for body in world.bodies
        ],
        "static": {
            "splats": splats.get("static", ""),
            "boxes": len(world.static.boxes),
            "height_field": world.static.ground is not None,
        },
        "left_out": list(world.left_out),
    }
