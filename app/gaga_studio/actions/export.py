"""One export: what, in which form, how changed, where to; and what it will be like."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.export.cameras import CameraForm, estimated_camera_bytes, export_cameras
from gaga_core.export.export import (
    MeshExport,
    MeshForm,
    export_losses,
    exported_indices,
    objects_indices,
    objects_losses,
)
from gaga_core.export.options import ExportOptions, PageContent, Point, estimated_bytes
from gaga_core.export.page import content_of
from gaga_core.io.files import explain_os_error
from gaga_core.io.meshes import MeshFile
from gaga_core.io.splats.splat_files import SplatFormat, form_of
from gaga_core.progress import Progress, Stage
from gaga_core.scene.objects import selected_groups
from gaga_core.scene.scene import Scene
from gaga_studio.actions import children, cleanup, files
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session
from gaga_studio.session.stages import Export
from gaga_studio.system import paths

What = Export | Literal["cameras"]
_FILLED = 0.6  # of the triangles of a ball: most objects are thinner


@dataclass(frozen=True)
class ExportPlan:
    """What is to be written. ``path`` is a folder for objects and for cameras of COLMAP."""

    path: Path
    what: What = "scene"
    form: SplatFormat | MeshExport | CameraForm = SplatFormat.PLY  # solids: of objects only
    options: ExportOptions = field(default_factory=ExportOptions)


@dataclass(frozen=True)
class ExportSummary:
    """What a plan will write."""

    n_splats: int  # of cameras: 0
    n_files: int
    n_bytes: int  # an estimate
    lost: tuple[str, ...]  # what the form does not keep, a sentence each
    n_cameras: int = 0


@notifies
def start(session: Session, plan: ExportPlan) -> bool:
    """Write it, as a job; a folder that is not there yet is made."""
    try:
        plan.path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GagaError(explain_os_error(error, plan.path.parent)) from error
    options = plan.options
    if plan.what == "cameras" or isinstance(plan.form, CameraForm):
        files.start_export(session, plan.path, _cameras_stage(session, plan.path, options))
        return True
    if plan.form is SplatFormat.HTML or options.keep < 1:  # a decimation is judged from the photos
        options = replace(options, page=page_content(session))
    cleanup.export(session, plan.what, plan.path, form=plan.form, options=options)
    return True


def _cameras_stage(session: Session, path: Path, options: ExportOptions) -> Stage[str]:
    """Write the cameras as they are now; returns a sentence on it."""
    project = session.need().settled()
    frozen = replace(project, scene=replace(project.scene))

    def stage() -> Stage[str]:
        yield Progress("Export cameras", 0, 0)
        n = export_cameras(frozen, path, options)
        return f"Exported {n:,} cameras to {paths.shown(path)}."

    return stage()


def page_content(session: Session) -> PageContent:
    """What a web page shows besides the splats: it begins with the present view."""
    document = session.need()
    project = replace(document.project, scene=document.scene)
    found = document.search.described
    behind = found.description.background if found is not None else frozenset()
    return replace(content_of(project), start=session.rig.shot(), background=behind)


@notifies
def show_in_folder(session: Session, path: Path) -> bool:
    """Show what was written in the file manager."""
    del session
    paths.show(path)
    return True


def summary(session: Session, plan: ExportPlan) -> ExportSummary:
    """What ``plan`` will write, worked out again when the scene or the plan changes."""
    document = session.need()
    # Where it lies and how large it is changes neither counts nor losses.
    options = replace(plan.options, centre=False, ground=False, scale=1.0)
    going = session.settings.children_go_along
    key = (document.scene.revision.total(), going, plan.what, plan.form, options)
    asked = replace(plan, options=options)
    return document.read.once("export", key, lambda: _summary(session, asked))


def _summary(session: Session, plan: ExportPlan) -> ExportSummary:
    if plan.what == "cameras" or isinstance(plan.form, CameraForm):
        return _cameras_summary(session, plan)
    scene, options = children.scene_along(session), plan.options
    groups = selected_groups(scene).tolist() or None
    if isinstance(plan.form, MeshExport):
        return _mesh_summary(scene, plan.form, groups, options)
    if plan.what == "objects":
        splats = objects_indices(scene, groups, options)
        n_files = len(np.unique(scene.labels[splats]))
        lost = objects_losses(scene, plan.form, groups, options)
    else:
        what = "selected" if plan.what == "selected" else "visible"
        splats = options.inside(scene, exported_indices(scene, what))  # type: ignore[arg-type]
        n_files = 1
        lost = export_losses(scene, plan.form, what=what, options=options)  # type: ignore[arg-type]
    degree = scene.gaussians.sh_degree
    if options.sh_degree is not None:
        degree = min(degree, options.sh_degree)
    n_splats = options.count(len(splats))
    n_listed = len(np.unique(scene.labels[splats])) if plan.form is SplatFormat.HTML else 0
    n_bytes = estimated_bytes(scene.gaussians, n_splats, plan.form, degree, n_listed)
    if n_splats < len(splats):
        lost = ("Neighbours are merged; afterwards you are told what that lost.", *lost)
    return ExportSummary(n_splats, n_files, n_bytes, lost)


def _cameras_summary(session: Session, plan: ExportPlan) -> ExportSummary:
    cameras = session.cameras
    is_off = any(abs(c.K[0, 2] - c.width / 2) + abs(c.K[1, 2] - c.height / 2) > 1 for c in cameras)
    lost: tuple[str, ...] = ()
    if plan.form is CameraForm.CAMERAS_JSON and is_off:
        lost = ("The principal point is left out: readers take the middle of the picture.",)
    if plan.form is CameraForm.COLMAP:
        lost = ("Points of the model are written without their tracks.",)
    n_files = 3 if plan.form is CameraForm.COLMAP else 1
    folder = session.need().project.folder
    n_bytes = 0
    if folder is not None and isinstance(plan.form, CameraForm):
        n_bytes = estimated_camera_bytes(folder, plan.form)
    return ExportSummary(0, n_files, n_bytes, lost, len(cameras))


def _mesh_summary(
    scene: Scene, how: MeshExport, groups: Sequence[int] | None, options: ExportOptions
) -> ExportSummary:
    splats = objects_indices(scene, groups, options)
    n_files = len(np.unique(scene.labels[splats]))
    lost = objects_losses(scene, how, groups, options)
    return ExportSummary(len(splats), n_files, n_files * _mesh_bytes(how), lost)


def _mesh_bytes(how: MeshExport) -> int:
    """About how large the file of an object is: of a mesh, as of a ball that fills its voxels."""
    n = 250 if how.form is not MeshForm.MESH else round(5 * how.config.voxels**2 * _FILLED)
    vertex, triangle = (24, 12) if how.file is MeshFile.GLB else (50, 19)
    return n // 2 * vertex + n * triangle


def form_of_name(name: str) -> SplatFormat | None:
    """The form that a typed name asks for; None when it asks for none."""
    known = any(name.lower().endswith(form.suffix) for form in SplatFormat)
    return form_of(Path(name)) if known else None


def folder(session: Session) -> Path:
    """Where exports go unless another place is chosen: never a hidden folder of ours."""
    place = session.project
    if place is None:
        return paths.exports()
    root = place.folder.root if place.folder is not None else place.model_path.parent
    return paths.exports() if root.is_relative_to(paths.home()) else root


def proposed(session: Session, what: What, form: SplatFormat | CameraForm) -> Path:
    """The path that is proposed: the name of the scene or of the object."""
    document = session.need()
    stem, groups = Path(document.name).stem, session.selected_groups()
    if what == "objects":
        return folder(session) / f"{stem} objects"
    if isinstance(form, CameraForm):
        # Readers of transforms.json look for photos next to it, under its own name.
        name = form.value if form is CameraForm.TRANSFORMS_JSON else f"{stem} {form}"
        return folder(session) / name
    if what == "scene":
        return folder(session) / f"{stem} edited{form.suffix}"
    name = document.name_of(groups[0]) if len(groups) == 1 else f"{stem} selection"
    return folder(session) / f"{_file_name(name)}{form.suffix}"


def _file_name(name: str) -> str:
    """``name`` without letters that a file may not have."""
    return "".join("-" if letter in '/\\:*?"<>|' else letter for letter in name)


def up_of(session: Session) -> Point:
    """Which way is up in the open scene, unit (3,)."""
    x, y, z = session.rig.up / np.linalg.norm(session.rig.up)
    return float(x), float(y), float(z)
