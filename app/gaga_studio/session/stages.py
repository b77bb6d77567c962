"""The stages behind the session's buttons. Each works on values taken at the call."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.export.export import MeshExport, export_objects_stage, export_scene_stage, least_psnr
from gaga_core.export.options import ExportOptions
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.identity.field import FILE as IDENTITY_FILE
from gaga_core.identity.field import encoding_colors, save_identity
from gaga_core.identity.lift import LiftConfig, Mode, lift_groups, task_of_association
from gaga_core.identity.train import FILE as CHECKPOINT
from gaga_core.io.demo_scene import ensure_demo
from gaga_core.io.folder.scene_folder import find_model, select_views
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.scene.export_manifest import listed_files, read_manifest
from gaga_core.scene.project import Project, open_path_stage, save_project
from gaga_core.scene.scene import Scene
from gaga_studio.system import paths

if TYPE_CHECKING:
    from gaga_core.pipeline.reconstruct import PhotoFind

T = TypeVar("T")
Export = Literal["scene", "selected", "objects"]
_AS_IS = ExportOptions()


def open_demo_stage(folder: Path) -> Stage[Project]:
    """Copy the demo scene to ``folder`` if it is not there yet, then open it."""
    return (yield from open_path_stage((yield from ensure_demo(folder))))


def open_stage(path: Path) -> "Stage[Project | PhotoFind]":
    """Open what is there; of photos without splats, or a video, what can be made of them."""
    from gaga_core.pipeline.reconstruct import look_at_photos

    yield Progress("Look at the folder", 0, 1, path.name)
    found = look_at_photos(path)
    if found is not None and find_model(found.scene) is None:
        return found
    return (yield from open_path_stage(found.scene if found is not None else path))


def kernels_stage() -> Stage[None]:
    """Compile what pictures, clicks and associations run, so that none of them waits for it.

    Once on a machine: later it ends at once.
    """
    from gaga_core.kernels import is_compiled

    if not is_compiled():
        from gaga_core.pipeline.compile_kernels import warm_up_stage

        yield from warm_up_stage()


def save_stage(
    project: Project, path: Path | None, copies_model: bool = False, overwrites: bool = False
) -> Stage[Path]:
    """Save the project as it is at the call, see `save_project`; returns where it is now."""
    frozen = replace(project, scene=replace(project.scene))

    def stage() -> Stage[Path]:
        yield Progress("Save", 0, 1)
        return save_project(frozen, path, copies_model=copies_model, overwrites=overwrites)

    return stage()


def associate_project_stage(
    project: Project, masks: MaskSet, config: AssociateConfig
) -> Stage[Association]:
    """Associate the masks of the train views (test views are for scores, as in ``gaga associate``).

    Works on the Gaussians of the file: the photos show them where they stood.
    """
    if project.folder is None or len(masks) == 0:
        raise GagaError("This scene has no masks. Put label maps into its masks folder first.")
    cameras = select_views(project.folder, "train")
    gaussians = file_gaussians(project.scene)

    return prepared(
        "Associate masks",
        lambda: associate_stage(gaussians, cameras, masks, choose(), config),
        "Preparing (the first run takes a little longer)",
    )


@dataclass(frozen=True, eq=False)
class LiftedScene:
    """What a lift says of the rows of the opened file."""

    labels: IntArray  # (M,)
    confidence: FloatArray  # (M,) 0..1
    colors: UInt8Array  # (M, 3) of the encodings


def lift_project_stage(
    project: Project, masks: MaskSet, mode: Mode, config: LiftConfig
) -> Stage[LiftedScene]:
    """Give the groups of the open scene identity encodings; write SCENE/gaga/identity.npz.

    Works on the Gaussians of the file and on the bank at the call. A training that is cancelled
    leaves its checkpoint there, and the next one goes on from it.
    """
    folder, scene = project.folder, project.scene
    if folder is None or scene.bank is None or len(masks) == 0:
        raise GagaError("Identities need groups that were found from masks. Use Find objects.")
    n, source = scene.n_opened, scene.identities
    votes = source.other if source.source == "identities" else None
    labels = scene.labels[:n] if votes is None else votes.labels
    sure = scene.confidence if votes is None else votes.confidence
    confidence = np.ones(n, np.float32) if sure is None else sure.astype(np.float32) / 255
    cameras, bank, gaussians = select_views(folder, "train"), scene.bank, file_gaussians(scene)

    def lift() -> Stage[LiftedScene]:
        checkpoint = folder.work / CHECKPOINT
        folder.work.mkdir(parents=True, exist_ok=True)
        task = task_of_association(
            gaussians,
            cameras,
            masks,
            (labels, confidence.astype(np.float32), bank),
            choose(),
            config,
            checkpoint=checkpoint,
        )
        identity, _ = yield from lift_groups(task, mode)
        save_identity(folder.work / IDENTITY_FILE, identity)
        if mode == "paper":
            checkpoint.unlink(missing_ok=True)
        colors = encoding_colors(identity.field.encodings)
        return LiftedScene(identity.labels, identity.confidence, colors)

    return prepared("Lift groups", lift)


def prepared(title: str, make: Callable[[], Stage[T]], text: str = "Preparing") -> Stage[T]:
    """Compile the kernels where needed, then run the stage that ``make`` builds.

    All in the job's thread: numba, torch and what ``make`` imports would slow the launch down.
    """
    from gaga_core.pipeline.compile_kernels import after_warm_up

    yield Progress(title, 0, 0, text)
    return (yield from after_warm_up(make()))


def file_gaussians(scene: Scene) -> Gaussians:
    """The Gaussians of the opened file, in its order: no duplicates, no splats of other files."""
    n = scene.n_opened  # all others are appended, so these are a prefix
    return scene.gaussians if n == len(scene) else scene.gaussians.take(np.arange(n))


def masks_of(project: Project, provider: str = "") -> tuple[str, MaskSet]:
    """The chosen (else the first) provider and its masks; empty when there are none."""
    folder = project.folder
    if folder is None or not folder.mask_folders:
        return "", MaskSet()
    if provider and provider not in folder.mask_folders:
        known = ", ".join(folder.mask_folders)
        raise GagaError(f"There are no masks of {provider!r} here. Choose one of {known}.")
    name = provider or next(iter(folder.mask_folders))
    return name, mask_folder(folder.mask_folders[name], [c.name for c in folder.cameras])


def export_stage(
    scene: Scene,
    what: Export,
    path: Path,
    *,
    chosen: Sequence[int] = (),
    groups: bool = False,
    form: SplatFormat | MeshExport = SplatFormat.PLY,
    options: ExportOptions = _AS_IS,
) -> Stage[str]:
    """Export, and return a sentence on what was written. ``form`` is that of objects' files."""
    if what == "objects":
        stage = export_objects_stage(scene, path, list(chosen) or None, form=form, options=options)

        def objects() -> Stage[str]:
            manifest = yield from stage
            n_files = len(listed_files(manifest))
            where = paths.shown(manifest.parent)
            said = f"Exported objects to {where} ({n_files} files and {manifest.name})."
            missing = read_manifest(manifest).left_out
            if missing:
                said += f" Left out, without a surface: {', '.join(missing)}."
            return said + _lost(least_psnr(manifest), "the object that lost most")

        return objects()
    kind: Literal["selected", "visible"] = "selected" if what == "selected" else "visible"
    whole = export_scene_stage(scene, path, what=kind, groups=groups, options=options)

    def splats() -> Stage[str]:
        made = yield from whole
        said = f"Exported {made.n_splats:,} splats to {paths.shown(path)}."
        return said + _lost(made.psnr, "what was written")

    return splats()


def _lost(psnr: float | None, what: str) -> str:
    """What a decimation lost, as a sentence; "" when there was none."""
    if psnr is None:
        return ""
    return f" Merged: pictures of {what} have {psnr:.1f} dB (PSNR) against those of before."
