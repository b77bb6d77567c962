"""Commands that export a scene: the whole, its objects, masks or cameras, and labelled data."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import AnyScene, AsJson, Backend, SwitchError, options, possible
from gaga_core.errors import GagaError
from gaga_core.export.dataset.settings import DatasetConfig, forms_of
from gaga_core.export.options import ExportOptions
from gaga_core.export.simulation.settings import SimulationConfig
from gaga_core.pipeline.settings import EngineConfig

if TYPE_CHECKING:
    from gaga_core.export.export import MeshExport
    from gaga_core.identity.field import IdentityField
    from gaga_core.io.splats.splat_files import SplatFormat
    from gaga_core.scene.project import Project

_CHANGES = ("sh_degree", "crop", "centre", "ground", "scale", "decimate", "as_trained")
_PHYSICS = ("density", "friction", "parts", "concavity")
_SPLATS = ("scene", "objects")
_BODIES = ("objects", "simulation")
_WORLD = (*_SPLATS, "cameras")  # what lies in the world of the exported splats
GOES_WITH = {  # --what that a switch changes something of
    "format": ("masks",),
    "form": _SPLATS,
    "mesh_file": ("objects",),
    "voxels": _BODIES,
    "triangles": ("objects",),
    "only": _BODIES,
    "with_children": _BODIES,
    "folder": _BODIES,
    "groups": ("scene",),
    "sh_degree": _SPLATS,
    "crop": _WORLD,
    "centre": _WORLD,
    "ground": _WORLD,
    "scale": (*_WORLD, "simulation"),
    "decimate": _SPLATS,
    "as_trained": _SPLATS,
    "identity": _SPLATS,
    "to": ("simulation",),
    "mass": ("simulation",),
    "object_density": ("simulation",),
    **dict.fromkeys(_PHYSICS, ("simulation",)),
}


@dataclass(frozen=True)
class ExportCommand:
    """Export a scene with its edits: the whole, or one file per object, or the group maps."""

    scene: AnyScene
    options: Annotated[ExportOptions, options(ExportOptions, *_CHANGES)]
    simulation: Annotated[SimulationConfig, options(SimulationConfig, *_PHYSICS)]
    out: Path
    """A .ply, .compressed.ply, .splat, .spz, .sog, .glb, .usd or .html for --what scene; for
    cameras a .json as 3DGS trainings write it, transforms.json (nerfstudio), or a folder (COLMAP);
    a folder otherwise."""
    what: Literal["scene", "objects", "simulation", "masks", "cameras"] = "scene"
    """scene: one file of all that is visible. objects: one file per group and groups.json.
    simulation: each object as a rigid body with convex parts, and the rest as what stays.
    masks: a 16-bit map of group ids for every view. cameras: those of the photos, in the
    world of the scene that the same switches export."""
    format: Literal["png", "coco", "dataset"] = "png"
    """Of masks. png: one map a view. coco: instances.json with run-length masks. dataset: photos,
    maps, colored previews, COCO instances and panoptic, and a list of the groups."""
    form: (
        Literal["ply", "compressed-ply", "splat", "spz", "spz4", "sog", "glb", "usd", "html"]
        | Literal["mesh", "collider", "box"]
        | None
    ) = None
    """Of files of splats; default: what the name of --out asks for, else ply. spz is version 3.
    html is one page that shows scene and objects in any browser, without a network. mesh: the
    closed surface of each object with colors; collider: a convex solid around it of at most 255
    triangles; box: its oriented box (objects)."""
    mesh_file: Literal["glb", "obj"] = "glb"
    """Of meshes, colliders and boxes."""
    voxels: int = 96
    """Of a mesh along the longest side of its object: how fine it is."""
    triangles: int = 20_000
    """Of a mesh, about, at most: larger ones are made of fewer voxels. 0: as many as there are."""
    only: tuple[int, ...] = ()
    """Group ids (objects); default: all."""
    with_children: bool = False
    """With --only: also all that lies under these objects in the object list (objects)."""
    folder: str = ""
    """Only objects of this folder of the object list, "Kitchen", and of those in it (objects)."""
    groups: bool = False
    """Add a column with the group id of each Gaussian (scene)."""
    identity: bool = False
    """Add the identity encodings of gaga lift as obj_dc_0..15, and write classifier.pth next to
    the files: what Gaussian Grouping and Gaga load (scene, objects; .ply)."""
    to: str = "usd,mjcf"
    """Files for simulators, with commas: usd (OpenUSD), mjcf (MuJoCo), urdf (a file an object,
    and static.urdf) (simulation)."""
    mass: tuple[str, ...] = ()
    """Mass of an object in kg by its group id, as 12=0.35 (simulation)."""
    object_density: tuple[str, ...] = ()
    """Density of an object in kg/m^3 by its group id, as 12=800 (simulation)."""
    json: AsJson = False

    def run(self) -> int:
        """Write plain 3DGS files that other tools open."""
        from gaga_core.export.page import content_of
        from gaga_core.identity.classifier_io import CLASSIFIER_FILE, write_classifier
        from gaga_core.io.splats.splat_files import SplatFormat
        from gaga_core.scene.project import require_other_file

        self._check()
        solid = self._solid()
        form = SplatFormat(self.form) if self.form and solid is None else SplatFormat.PLY
        if self.what == "scene":
            form = self._form_of_file(form)  # a mistake is told before a large model is read
        project = out.open_project(self.scene)
        require_other_file(project, self.out)
        if self.what == "masks":
            return self._masks(project)
        options = replace(self.options, up=project.up, page=content_of(project))
        if self.what == "simulation":
            return self._simulation(project, options)
        if self.what == "cameras":
            from gaga_core.export.cameras import export_cameras

            n = export_cameras(project, self.out, options)
            return out.result({"file": str(self.out), "cameras": n}, as_json=self.json)
        if self.identity and (solid is not None or form is not SplatFormat.PLY):
            raise GagaError("Only .ply has room for identity encodings. Choose --form ply.")
        field = _add_identity(project) if self.identity else None
        if self.what == "scene":
            values = self._whole(project, form, options)
        else:
            values = self._objects(project, solid or form, options)
        if field is not None:
            folder = self.out.parent if self.what == "scene" else self.out
            write_classifier(folder / CLASSIFIER_FILE, field.weight, field.bias)
            values["classifier"] = str(folder / CLASSIFIER_FILE)
        return out.result(values, as_json=self.json)

    def _check(self) -> None:
        """Raise ``SwitchError`` for switches that do not go together."""
        own = (*fields(self), *fields(self.options), *fields(self.simulation))
        defaults = {field.name: field.default for field in own}
        given = vars(self.options) | vars(self.simulation) | vars(self)
        for name, right in GOES_WITH.items():
            if self.what not in right and given[name] != defaults[name]:
                switch = f"--{name.replace('_', '-')}"
                other = " or ".join(f"--what {what}" for what in right)
                raise SwitchError(
                    f"{switch} goes with {other}, not with {self.what}. Leave it out."
                )
        if self.with_children and not self.only:
            raise SwitchError("--with-children goes with --only: say which objects.")

    def _form_of_file(self, form: "SplatFormat") -> "SplatFormat":
        """The form of the one file: --form, which the end of its name must not contradict."""
        from gaga_core.io.splats.splat_files import form_of

        if not self.form:
            return form_of(self.out)
        try:
            named = form_of(self.out)
        except GagaError:  # it ends in nothing that is known
            return form
        # A compressed .ply is a .ply, and both versions of .spz have one ending.
        if not form.suffix.endswith(named.suffix):
            raise SwitchError(
                f"--form {self.form} does not go with the name {self.out.name}. Leave it out, or "
                "choose another name."
            )
        return form

    def _whole(
        self, project: "Project", form: "SplatFormat", options: "ExportOptions"
    ) -> dict[str, object]:
        from gaga_core.export.export import export_losses, export_scene_stage
        from gaga_core.io.splats.splat_files import SplatFormat
        from gaga_core.pipeline.search import describe_project

        scene, groups = project.scene, self.groups
        if form is SplatFormat.HTML:
            behind = describe_project(project).background  # and names objects
            options = replace(options, page=replace(options.page, background=behind))
        say_losses(export_losses(scene, form, groups=groups, options=options))
        stage = export_scene_stage(scene, self.out, groups=groups, form=form, options=options)
        made = out.follow(stage)
        values: dict[str, object] = {"file": str(self.out), "gaussians": made.n_splats}
        return values | ({} if made.psnr is None else {"decimated_psnr": round(made.psnr, 2)})

    def _solid(self) -> "MeshExport | None":
        """What stands for an object in place of its splats, when that is asked for."""
        from gaga_core.export.export import MeshExport, MeshForm
        from gaga_core.export.solids import MeshConfig
        from gaga_core.io.meshes import MeshFile

        if self.form not in list(MeshForm):
            return None
        if self.what != "objects":
            raise GagaError(f"A {self.form} is made of an object: add --what objects.")
        if self.options.decimate != 1.0:
            raise GagaError("--decimate is for splats: choose --voxels for the size of a mesh.")
        with possible():
            config = MeshConfig(self.voxels, self.triangles)
        return MeshExport(MeshForm(self.form), MeshFile(self.mesh_file), config)

    def _objects(
        self, project: "Project", form: "SplatFormat | MeshExport", options: "ExportOptions"
    ) -> dict[str, object]:
        from gaga_core.export.export import export_objects_stage, least_psnr, objects_losses
        from gaga_core.scene.export_manifest import listed_files, read_manifest
        from gaga_core.scene.project import files_read

        scene, only = project.scene, self._only(project)
        say_losses(objects_losses(scene, form, only, options))
        stage = export_objects_stage(
            scene,
            self.out,
            only,
            source=str(self.scene),
            form=form,
            options=options,
            kept=files_read(project),
        )
        manifest = out.follow(stage)
        missing = read_manifest(manifest).left_out
        if missing:
            out.say(f"Without a surface, and so left out: {', '.join(missing)}.")
        psnr = least_psnr(manifest)
        values: dict[str, object] = {
            "manifest": str(manifest),
            "files": len(listed_files(manifest)),
        }
        return values | ({} if psnr is None else {"least_decimated_psnr": round(psnr, 2)})

    def _simulation(self, project: "Project", options: "ExportOptions") -> int:
        from gaga_core.export.simulation.export import (
            SimulationExport,
            SimulatorForm,
            export_simulation_stage,
            sentences,
        )
        from gaga_core.export.solids import MeshConfig
        from gaga_core.pipeline.search import describe_project

        try:
            forms = tuple(SimulatorForm(name) for name in self.to.split(","))
        except ValueError as error:
            raise SwitchError(f"--to is of usd, mjcf and urdf, not {self.to!r}.") from error
        with possible():
            mesh = MeshConfig(self.voxels, triangles=0)
        how = SimulationExport(
            forms,
            self.simulation,
            mesh,
            _by_group("--mass", self.mass),
            _by_group("--object-density", self.object_density),
            up=options.up,
            scale=options.scale,
            background=describe_project(project).background,
        ).seeing(project)
        stage = export_simulation_stage(
            project.scene, self.out, how, self._only(project), str(self.scene)
        )
        manifest, world = out.follow(stage)
        for sentence in sentences(world):
            out.say(sentence)
        values = {
            "manifest": str(manifest),
            "objects": len(world.bodies),
            "convex_parts": sum(len(body.parts) for body in world.bodies),
            "supports": len(world.static.boxes),
        }
        return out.result(values, as_json=self.json)

    def _only(self, project: "Project") -> Sequence[int] | None:
        """Groups to write, named after what they look like; None: all."""
        from gaga_core.pipeline.search import describe_project
        from gaga_core.scene.edits.folders import existing

        describe_project(project)
        scene = project.scene
        only = self.only
        if self.with_children:
            only = (*only, *scene.folders.under(*only))
        if not self.folder:
            return only or None
        inside = scene.folders.groups(existing(scene, self.folder))
        return [group for group in inside if not only or group in only]

    def _masks(self, project: "Project") -> int:
        if self.format == "png":
            from gaga_core.pipeline.render import export_masks

            maps = out.follow(export_masks(project, self.out))
            return out.result({"folder": str(self.out), "files": len(maps)}, as_json=self.json)
        from gaga_core.pipeline.mask_dataset import export_mask_dataset

        made = out.follow(export_mask_dataset(project, self.out, self.format))
        if made.sentence:
            out.say(made.sentence)
        return out.result(made.to_json(), as_json=self.json)


def _by_group(switch: str, given: Sequence[str]) -> dict[int, float]:
    """Positive numbers by group id of texts as "12=0.35"; ``SwitchError`` for others."""
    found = {}
    for text in given:
        group, _, value = text.partition("=")
        try:
            found[int(group)] = float(value)
        except ValueError as error:
            raise SwitchError(f"{switch} is a group id and a number, as 12=0.35.") from error
        if not 0 < found[int(group)] < float("inf"):
            raise SwitchError(f"{switch} is a group id and a number above 0, as 12=0.35.")
    return found


def say_losses(losses: Iterable[str]) -> None:
    """Say what the form does not keep, before anything is written."""
    for sentence in losses:
        out.say(sentence)


def _add_identity(project: "Project") -> "IdentityField":
    """Give the splats of ``project`` their encodings as extra columns; the layer that reads them.

    They are of `gaga lift`; without one, those with which the model came.
    """
    import numpy as np

    from gaga_core.identity.classifier_io import field_of_model, with_encodings
    from gaga_core.identity.field import FILE
    from gaga_core.pipeline.lift import read_identity

    field = field_of_model(project.scene.gaussians, project.model_path)
    folder = project.folder
    if folder is not None and (field is None or (folder.work / FILE).is_file()):
        field = read_identity(folder, project.scene.n_opened).field
    if field is None:
        raise GagaError("Identity encodings belong to a scene folder. Name that instead.")
    encodings = field.encodings
    none = np.zeros((1, encodings.shape[1]), encodings.dtype)  # of splats of added files
    rows = np.minimum(project.scene.source, len(encodings))
    encodings = np.concatenate([encodings, none])[rows]
    project.scene.gaussians = with_encodings(project.scene.gaussians, encodings)
    return field


@dataclass(frozen=True)
class DatasetCommand:
    """Make labelled pictures of new views: masks, boxes, poses and depth of every object."""

    scenes: Positional[tuple[Path, ...]]
    """Scene folders or saved projects; what they show now is labelled."""
    config: Annotated[DatasetConfig, options(DatasetConfig)]
    engine: Annotated[EngineConfig, options(EngineConfig, "workers", "address")]
    out: Path | None = None
    """Folder of the data set; one that is there is completed: only stale pictures are made again.
    Default: next to the first scene, as NAME-dataset."""
    to: str = "coco,yolo,bop"
    """Formats of the labels, with commas between: coco, yolo, bop."""
    executor: Literal["none", "local", "dask"] = "none"
    """Who makes the pictures of many scenes: processes here, or workers of dask."""
    backend: Backend = "auto"
    json: AsJson = False

    def run(self) -> int:
        """Write pictures, labels, and index.html with samples and statistics."""
        from gaga_core.pipeline.dataset import dataset_stage
        from gaga_core.raster import choose

        forms = forms_of(self.to)
        if not self.scenes:
            raise GagaError("Name a scene folder, or several.")
        first = self.scenes[0].absolute()
        target = self.out or first.with_name(f"{first.stem}-dataset")
        workers = None if self.executor == "none" else replace(self.engine, engine=self.executor)
        engine = choose(self.backend)
        stage = dataset_stage(self.scenes, target, self.config, forms, workers, rasterizer=engine)
        made = out.follow(stage, compiles=True)
        for note in (*made.notes, *made.failed):
            out.say(note)
        values = made.to_json()
        if not self.json:
            values |= {f"pictures for {split}": n for split, n in made.by_split.items()}
            values = {key: value for key, value in values.items() if value and key != "by_split"}
            values = {key: values[key] for key in values if key not in ("notes", "failed")}
        out.result(values, as_json=self.json)
        return 1 if made.failed else 0
