"""One export: what, in which form, how changed, where to; and what it will be like."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.evaluate.photo_film import PhotoFilmConfig, photo_film_stage
from gaga_core.export.cameras import CameraForm, estimated_camera_bytes, export_cameras
from gaga_core.export.export import (
    PACKED,
    STAGE,
    MeshExport,
    MeshForm,
    estimated_bytes,
    export_losses,
    export_objects_stage,
    export_scene_stage,
    exported_indices,
    least_psnr,
    objects_indices,
    objects_losses,
    sampled_bytes,
)
from gaga_core.export.options import ExportOptions, PageContent
from gaga_core.export.page import content_of
from gaga_core.export.simulation.export import SimulationExport, unit_sentence
from gaga_core.export.solids import MOST_OVER
from gaga_core.io.files import explain_os_error, is_file, safe_name
from gaga_core.io.meshes import MeshFile
from gaga_core.io.splats.splat_files import SplatFormat, form_of
from gaga_core.io.video import video_suffix
from gaga_core.kernels import STAGE as KERNELS
from gaga_core.pipeline import film as video
from gaga_core.pipeline.film import FilmConfig
from gaga_core.pipeline.film import What as FilmWhat
from gaga_core.progress import Progress, Stage, portion
from gaga_core.scene import cleanup as cleanup_edits
from gaga_core.scene.export_manifest import listed_files, read_manifest
from gaga_core.scene.objects import selected_groups
from gaga_core.scene.project import files_read, require_other_file
from gaga_core.scene.scene import Scene, State
from gaga_studio.features import camera, cleanup, folders, measure, simulate, split_view
from gaga_studio.features.base import (
    Command,
    ask,
    busy,
    no_groups,
    no_photos,
    no_scene,
    no_selection,
    not_saveable,
)
from gaga_studio.features.find.search import SearchState
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, SplatLook
from gaga_studio.system import paths

# Share of an export of objects that are cleaned first until that is done: of ten parts of the demo
# scene 0.75 (.ply), 0.58 (.sog), 0.6 (.html).
_CLEANED = 0.6
What = Literal["scene", "selected", "objects"] | Literal["cameras", "simulation"]
Export = Literal["scene", "selected", "objects"]


@dataclass(frozen=True)
class ExportPlan:
    """The export to write. ``path`` is a folder for objects, bodies and for cameras of COLMAP."""

    path: Path
    what: What = "scene"
    # Solids: of objects only.
    form: SplatFormat | MeshExport | CameraForm | SimulationExport = SplatFormat.PLY
    options: ExportOptions = field(default_factory=ExportOptions)


@dataclass(frozen=True)
class ExportSummary:
    """The files that a plan will write."""

    n_splats: int  # of cameras: 0
    n_files: int
    n_bytes: int  # an estimate, or the most
    lost: tuple[str, ...]  # what the form does not keep, a sentence each
    n_cameras: int = 0
    is_most: bool = False  # whether it may be far less: of meshes that stay under their limit


@notifies
def start(session: Session, plan: ExportPlan) -> bool:
    """Write it, as a job; a folder that is not there yet is made."""
    try:
        plan.path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GagaError(explain_os_error(error, plan.path.parent)) from error
    options = plan.options
    if isinstance(plan.form, SimulationExport):
        start_export(session, plan.path, simulate.export_stage(session, plan.path, plan.form))
        return True
    if plan.what == "cameras" or isinstance(plan.form, CameraForm):
        start_export(session, plan.path, _cameras_stage(session, plan.path, options))
        return True
    if plan.form is SplatFormat.HTML or options.decimate < 1:  # judged from the photos
        options = replace(options, page=page_content(session))
    assert plan.what != "simulation"
    export(session, plan.what, plan.path, form=plan.form, options=options)
    return True


def _cameras_stage(session: Session, path: Path, options: ExportOptions) -> Stage[str]:
    """Write the cameras as they are now; returns a sentence on it."""
    project = session.need().settled()
    frozen = replace(project, scene=replace(project.scene))

    def stage() -> Stage[str]:
        yield Progress("Export cameras", 0, 0)
        n = export_cameras(frozen, path, options)
        return f"Exported {path.name}: {counted(n, 'camera')}, in {paths.shown(path.parent)}."

    return stage()


def page_content(session: Session) -> PageContent:
    """Content of a web page in addition to the splats; it begins with the present view."""
    document = session.need()
    project = replace(document.project, scene=document.scene)
    found = document.feature(SearchState).described
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


def _bodies_sentence(session: Session) -> str:
    scene, groups = session.need().scene, session.selected_groups()
    if not groups:
        return "All objects but the background become bodies."
    shown = np.unique(scene.labels[scene.visible])
    bodies = [group for group in groups if group in shown]
    if not bodies:
        return "None of the selected objects is visible, so there is nothing to export."
    verb = "becomes a body" if len(bodies) == 1 else "become bodies"
    return f"{session.need().names_of(bodies)} {verb}, all else stays."


def _hidden_objects(scene: Scene, groups: Sequence[int] | None) -> tuple[str, ...]:
    """A sentence where some of the ``groups`` (default: all) are hidden; () where none is."""
    there = ~scene.has(State.DELETED) & (scene.labels > 0)
    if groups is not None:
        there &= np.isin(scene.labels, np.array(groups, np.int32))
    shown = np.unique(scene.labels[there & scene.visible])
    n = len(np.unique(scene.labels[there])) - len(shown)
    are = "is" if n == 1 else "are"
    return (f"{counted(n, 'object')} {are} hidden, and not exported.",) if n else ()


_NO_OBJECTS = "Objects and their names are not in the file: they are saved with the project."


def _summary(session: Session, plan: ExportPlan) -> ExportSummary:
    if plan.what == "cameras" or isinstance(plan.form, CameraForm):
        return _cameras_summary(session, plan)
    scene, options = folders.scene_along(session), plan.options
    if isinstance(plan.form, SimulationExport):
        unit = unit_sentence(is_metric=scene.frame.is_metric, how=measure.HOW_TO_SCALE)
        left = _hidden_objects(scene, selected_groups(scene).tolist() or None)
        said = (_bodies_sentence(session), *left, *([unit] if unit else []))
        return ExportSummary(len(exported_indices(scene)), 0, 0, said)
    groups = selected_groups(scene).tolist() or None
    if isinstance(plan.form, MeshExport):
        return _mesh_summary(scene, plan.form, groups, options)
    if plan.what == "objects":
        splats = objects_indices(scene, groups, options)
        n_files = len(np.unique(scene.labels[splats]))
        lost = _hidden_objects(scene, groups) + objects_losses(scene, plan.form, groups, options)
    else:
        what = "selected" if plan.what == "selected" else "visible"
        splats = options.inside(scene, exported_indices(scene, what))  # type: ignore[arg-type]
        n_files = 1
        lost = export_losses(scene, plan.form, what=what, options=options)  # type: ignore[arg-type]
        if plan.form is not SplatFormat.HTML and scene.labels[splats].any():
            lost = (*lost, _NO_OBJECTS)
        hidden = np.flatnonzero(scene.has(State.HIDDEN) & ~scene.has(State.DELETED))
        n_hidden = len(options.inside(scene, hidden.astype(np.int32)))
        if n_hidden and plan.what == "scene":
            are = "is" if n_hidden == 1 else "are"
            lost = (f"{counted(n_hidden, 'splat')} {are} hidden, and not exported.", *lost)
    degree = scene.gaussians.sh_degree
    if options.sh_degree is not None:
        degree = min(degree, options.sh_degree)
    n_splats = options.count(len(splats))
    n_listed = len(np.unique(scene.labels[splats])) if plan.form is SplatFormat.HTML else 0
    if plan.form in PACKED:
        sample = scene.gaussians, splats, n_splats, options, plan.form
        n_bytes = sampled_bytes(*sample, n_listed)
    else:
        n_bytes = estimated_bytes(scene.gaussians, n_splats, plan.form, degree)
    if n_splats < len(splats):
        lost = ("Neighbours are merged; the loss is measured afterwards.", *lost)
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
    lost = _hidden_objects(scene, groups) + objects_losses(scene, how, groups, options)
    n_bytes, is_most = n_files * _mesh_bytes(how), how.form is MeshForm.MESH
    return ExportSummary(len(splats), n_files, n_bytes, lost, is_most=is_most)


def _mesh_bytes(how: MeshExport) -> int:
    """About how large the file of an object is; of a mesh with as many triangles as it may have."""
    is_glb = how.file is MeshFile.GLB
    if how.form is MeshForm.BOX:
        return 1_000 if is_glb else 370  # 12 triangles, measured
    if how.form is MeshForm.COLLIDER:
        return 5_200 if is_glb else 6_900  # 128 vertices, 252 triangles, measured
    n = round(MOST_OVER * how.config.triangles) or 5 * how.config.voxels**2  # of a ball
    return n * 24 + 1_000 if is_glb else n * 44


def form_of_name(name: str) -> SplatFormat | None:
    """The form that a typed name asks for; None when it asks for none."""
    known = any(name.lower().endswith(form.suffix) for form in SplatFormat)
    return form_of(Path(name)) if known else None


def folder(session: Session) -> Path:
    """The default folder of exports: never a hidden folder of ours."""
    place = session.project
    if place is None:
        return paths.exports()
    root = place.folder.root if place.folder is not None else place.model_path.parent
    return paths.exports() if root.is_relative_to(paths.home()) else root


def proposed(session: Session, what: What, form: SplatFormat | CameraForm) -> Path:
    """The path that is proposed: the name of the scene or of the object."""
    document = session.need()
    stem, groups = safe_name(Path(document.name).stem), session.selected_groups()
    if what == "objects":
        return folder(session) / f"{stem} objects"
    if what == "simulation":
        return folder(session) / f"{stem} bodies"
    if isinstance(form, CameraForm):
        # Readers of transforms.json look for photos next to it, under its own name.
        name = form.value if form is CameraForm.TRANSFORMS_JSON else f"{stem} {form}"
        return folder(session) / name
    if what == "scene":
        return folder(session) / f"{stem} edited{form.suffix}"
    name = document.name_of(groups[0]) if len(groups) == 1 else f"{stem} selection"
    return folder(session) / f"{safe_name(name)}{form.suffix}"


def export(
    session: Session,
    what: Export,
    path: Path,
    *,
    form: SplatFormat | MeshExport = SplatFormat.PLY,
    options: ExportOptions | None = None,
) -> None:
    """Write what is visible, the selection, or one file per (selected, else any) object.

    Whole selected objects are cleaned first if that is wanted. ``path`` is a folder for "objects",
    whose files are of ``form``; else its suffix is the form of the file.
    """
    if session.scene is None:
        return
    session.need().settled()
    options = options or ExportOptions(up=camera.up_of(session))
    kept = files_read(session.need().project)
    groups = cleanup.to_clean(session) if what != "scene" else ()
    if not groups:
        scene = replace(folders.scene_along(session))  # as it is now: the job may wait
        listed = selected_groups(scene).tolist()
        start_export(session, path, export_stage(scene, what, path, listed, form, options, kept))
        return
    scene, also = replace(session.scene), folders.locked_along(session)
    chosen = (*groups, *np.unique(scene.labels[also]).tolist())

    def stage() -> Stage[str]:
        cleaning = cleanup_edits.clean_objects_stage(scene, groups)
        labels = yield from portion(cleaning, 0, _CLEANED, STAGE)
        copy = cleanup_edits.cleaned_copy(scene, groups, labels)
        state = copy.state.copy()
        state[also] |= np.uint8(State.SELECTED)  # written as they are
        copy.state = state
        writing = export_stage(copy, what, path, chosen, form, options, kept)
        return (yield from portion(writing, _CLEANED, 1, STAGE))

    start_export(session, path, stage())


def why_not_there(session: Session, path: Path) -> str:
    """Why nothing may be exported to ``path``; empty when it may. Looked for once."""
    document = session.need()

    def find() -> str:
        try:
            require_other_file(document.project, path)
        except GagaError as error:
            return str(error)
        return ""

    stamp = path.stat().st_mtime_ns if is_file(path) else 0
    return document.read.once("why not there", (path, stamp, document.project.path), find)


def start_export(session: Session, path: Path, stage: Stage[str]) -> None:
    """Run ``stage``, which exports to ``path`` and returns a sentence on what it has written."""

    def done(text: str) -> None:
        session.has_exported = True
        session.notify(Level.INFO, text, shows=path)

    session.jobs.start(f"Export to {path.name}", stage, on_done=done, waits=True, writes=True)


def export_stage(
    scene: Scene,
    what: Export,
    path: Path,
    chosen: Sequence[int],
    form: SplatFormat | MeshExport,
    options: ExportOptions,
    kept: Collection[Path],
) -> Stage[str]:
    """Export, and return a sentence on what was written. ``form`` is that of objects' files, which
    replace none that is ``kept``."""
    if what == "objects":
        stage = export_objects_stage(
            scene, path, list(chosen) or None, form=form, options=options, kept=kept
        )
        manifest = yield from stage
        n_files, where = len(listed_files(manifest)), paths.shown(manifest.parent)
        said = f"Exported {counted(n_files, 'file')} and {manifest.name} to {where}."
        if missing := read_manifest(manifest).left_out:
            said += f" Left out, without a surface: {', '.join(missing)}."
        psnr, of = least_psnr(manifest), "the object that lost most"
    else:
        kind: Literal["selected", "visible"] = "selected" if what == "selected" else "visible"
        made = yield from export_scene_stage(scene, path, what=kind, options=options)
        where = paths.shown(path.parent)
        said = f"Exported {path.name}: {counted(made.n_splats, 'splat')}, in {where}."
        psnr, of = made.psnr, "the export"
    if psnr is None:
        return said
    return (
        f"{said} Merged: pictures of {of} have {psnr:.1f} dB (PSNR) against those before the merge."
    )


# --- films and pictures

WHATS: dict[Mode, FilmWhat] = {Mode.COLOR: "rgb", Mode.GROUPS: "groups", Mode.DEPTH: "depth"}
_MODES = {what: mode for mode, what in WHATS.items()}
_Painters = tuple[video.Painter | None, video.Painter | None]  # of a film; left of its line


@notifies
def export_film(
    session: Session, target: Path, config: FilmConfig, *, before: bool = False
) -> bool:
    """Write the path as a video, as a job; drawn by the graphics card where there is one.

    ``before``: left of the line of ``config.split`` is the scene before its last edit.
    """
    document = session.need()
    require_other_file(document.project, target)
    settled = document.settled()
    camera_path = camera.path_of(session)
    earlier = split_view.scene_before(session) if before and config.split is not None else None
    painter, left = _painters(session, config, has_earlier=earlier is not None)
    looked = replace(config, antialiased=_look(session))
    stage = video.film_stage(
        settled.scene,
        camera_path,
        target,
        looked,
        painter=painter,
        left=video.LeftSide(earlier, left),
    )
    return session.jobs.start(
        f"Film {target.name}",
        _drawn(session, stage, _film_amount(session, config, target.suffix, (painter, left))),
        on_done=lambda path: session.notify(Level.INFO, f"Saved the film to {path}.", shows=path),
        writes=True,
    )


def _painters(session: Session, config: FilmConfig, *, has_earlier: bool) -> _Painters:
    """The window's drawing of a film, and of what is left of its line; None: the rasterizer's."""
    requests = session.render_requests
    if requests is None or not requests.is_fast or max(config.video.size) > requests.max_side:
        return None, None
    painter = _painter(session, config)
    if painter is None or config.split is None or has_earlier:
        return painter, None
    return painter, _painter(session, replace(config, what=config.split.left))


def photos_of(session: Session, views: str) -> tuple[str, ...]:
    """Return the photos of "all", "train" or "test" that are here, by name."""
    folder = session.need().project.folder
    if folder is None:
        return ()
    parts = {"train": folder.train, "test": folder.test}
    names = parts.get(views, tuple(camera.name for camera in folder.cameras))
    return tuple(name for name in names if name in folder.image_paths)


@notifies
def export_photo_film(session: Session, target: Path, config: PhotoFilmConfig, views: str) -> bool:
    """Write a film through photos as a job: what is chosen of them left of a line."""
    video_suffix(target)
    require_other_file(session.need().project, target)
    names = photos_of(session, views)
    stage = photo_film_stage(session.need().settled(), target, config, names)
    return session.jobs.start(
        f"Film {target.name}",
        _drawn(session, stage, _photo_film_amount(session, config, views, target.suffix)),
        on_done=lambda path: session.notify(Level.INFO, f"Saved the film to {path}.", shows=path),
        writes=True,
    )


@notifies
def save_picture(
    session: Session, target: Path, size: tuple[int, int], *, transparent: bool = False
) -> bool:
    """Write what the camera sees at any size as .png or .jpg, as a job."""
    video.check_picture(target, size, transparent)
    require_other_file(session.need().project, target)
    scene = session.need().settled().scene
    view, requests = session.view, session.render_requests
    camera = session.rig.shot().camera(*size)
    what = WHATS.get(view.mode)
    config = FilmConfig(what or "rgb", view.background, antialiased=_look(session))
    painter: video.Painter | None = None
    if (
        requests is not None
        and max(size) <= requests.max_side
        and (requests.is_fast or what is None)
    ):
        painter = _painter(session, config, transparent=transparent, mode=view.mode)
    elif what is None:
        raise GagaError(
            f"A picture of this size cannot show {view.mode.value}. Choose a smaller one, or "
            "Color, Groups or Depth."
        )
    stage = video.picture_stage(
        scene, camera, target, config, transparent=transparent, painter=painter
    )
    return session.jobs.start(
        f"Save {target.name}",
        _drawn(session, stage, _Amount(target.suffix, size, 1, 1 if painter is None else 0)),
        on_done=lambda path: session.notify(
            Level.INFO, f"Saved the picture to {path}.", shows=path
        ),
        writes=True,
    )


@dataclass(frozen=True)
class _Amount:
    """How much a film or a picture is: of a ``size``, ``n_drawn`` by the rasterizer. What one of a
    ``kind`` took says nothing of another."""

    suffix: str
    size: tuple[int, int]
    n_written: int
    n_drawn: int
    kind: str = ""

    @property
    def rate_name(self) -> str:
        kind = self.kind if self.n_drawn else f"{self.kind} of the window"
        return f"Write {self.suffix.lower()}{kind}"

    def usual_seconds(self, session: Session) -> float:
        """See `video.usual_seconds`."""
        document = session.need()
        scene, revision = document.scene, document.scene.revision
        n_splats = document.read.once(
            "shown splats", (revision.splats, revision.state), lambda: int(scene.visible.sum())
        )
        return video.usual_seconds(self.suffix, self.size, n_splats, self.n_written, self.n_drawn)

    def seconds_here(self, session: Session) -> float:
        """Seconds until it is written on this machine."""
        kernels_s = stages.kernels_seconds("window") if self.n_drawn else 0.0
        rates = session.rates
        return self.usual_seconds(session) * rates.of(self.rate_name) + kernels_s * rates.of(
            KERNELS
        )


def _film_amount(session: Session, config: FilmConfig, suffix: str, painters: _Painters) -> _Amount:
    n = len(camera.path_of(session).frame_times(config.video.fps))
    n_sides = 1 if config.split is None else 2
    n_drawn = n * (n_sides - sum(one is not None for one in painters))
    return _Amount(suffix, config.video.size, n, n_drawn)


def _photo_film_amount(
    session: Session, config: PhotoFilmConfig, views: str, suffix: str
) -> _Amount:
    n_photos = len(photos_of(session, views))
    n_written = n_photos * max(round(config.seconds * config.video.fps), 1)
    n_drawn = n_photos * (2 if config.left == "errors" else 1)
    # Most of its pictures are like the one before, and so sooner written.
    return _Amount(suffix, config.video.size, n_written, n_drawn, " of photos")


def film_seconds(session: Session, config: FilmConfig, *, before: bool = False) -> float:
    """Return the seconds that `export_film` of an .mp4 takes here."""
    is_split = before and config.split is not None
    has_earlier = is_split and split_view.scene_before(session) is not None
    painters = _painters(session, config, has_earlier=has_earlier)
    return _film_amount(session, config, ".mp4", painters).seconds_here(session)


def photo_film_seconds(session: Session, config: PhotoFilmConfig, views: str) -> float:
    """Return the seconds that `export_photo_film` of an .mp4 takes here."""
    return _photo_film_amount(session, config, views, ".mp4").seconds_here(session)


def _drawn(session: Session, stage: Stage[Path], amount: _Amount) -> Stage[Path]:
    """``stage``, which writes a film or a picture, with its time left.

    Behind the kernels where the rasterizer draws: the window draws otherwise.
    """
    name, usual_s = amount.rate_name, amount.usual_seconds(session)
    if not amount.n_drawn:
        return session.rates.timed(stage, name, usual_s)
    return stages.prepared(
        session.rates, "Draw", lambda: stage, parts=("window",), usual_s=usual_s, name=name
    )


def _painter(
    session: Session, config: FilmConfig, *, transparent: bool = False, mode: Mode | None = None
) -> video.Painter | None:
    """Return the window's own drawing at full quality; None for depth, whose range would jump."""
    requests = session.render_requests
    if requests is None or (config.what == "depth" and mode is None):
        return None
    view = replace(
        session.view,
        mode=mode or _MODES[config.what],
        background=config.background,
        splat_budget=0,
        coarse_budget=0,
        resolution_scale=1.0,
        show_outline=False,
        show_frusta=False,
    )

    def paint(camera: Camera) -> UInt8Array:
        return requests.paint(camera, view, transparent=transparent)

    return paint


def _look(session: Session) -> bool | None:
    look = session.view.look
    return None if look is SplatLook.AUTO else look is SplatLook.ANTIALIASED


# --- commands


def _not_filmable(session: Session) -> str:
    """Needs two keyframes or more, or photos to go through, and the job runner."""
    return (camera.no_path(session) if camera.no_photo_files(session) else "") or busy(session)


COMMANDS: tuple[Command, ...] = (
    ask(
        "file.export_scene",
        "Export scene…",
        Request.EXPORT_SCENE,
        "Ctrl+Shift+E",
        enabled=no_scene,
    ),
    ask("file.export_page", "Export a web page…", Request.EXPORT_PAGE, enabled=no_scene),
    ask("file.export_selected", "Export selection…", Request.EXPORT_SELECTED, enabled=no_selection),
    ask("file.export_objects", "Export objects…", Request.EXPORT_OBJECTS, enabled=no_groups),
    ask("file.export_meshes", "Export meshes…", Request.EXPORT_MESHES, enabled=no_groups),
    ask(
        "file.export_simulation",
        "Export for simulation…",
        Request.EXPORT_SIMULATION,
        enabled=no_groups,
    ),
    ask("file.export_cameras", "Export cameras…", Request.EXPORT_CAMERAS, enabled=no_photos),
    ask(
        "file.save_picture",
        "Save picture…",
        Request.SAVE_PICTURE,
        "Ctrl+Alt+S",
        enabled=not_saveable,
    ),
    ask("camera.film", "Save film…", Request.SAVE_FILM, enabled=_not_filmable),
)
