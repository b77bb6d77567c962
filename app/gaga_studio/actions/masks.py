"""Masks of the open scene: providers, making, trying, importing, choosing, exporting."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.io.folder.scene_folder import SceneFolder, find_mask_folders
from gaga_core.io.masks.label_maps import read_labels, view_key
from gaga_core.io.masks.other_programs import recognise
from gaga_core.pipeline.import_masks import ImportReport, import_masks
from gaga_core.pipeline.segment import SegmentReport, segment_scene
from gaga_core.pipeline.settings import SegmentConfig
from gaga_core.progress import Progress, Stage
from gaga_core.segmentation.choose import ProviderEntry, ProviderSettings, available_providers
from gaga_core.segmentation.models.status import record
from gaga_core.segmentation.models.weights import models_folder, weights_at
from gaga_core.segmentation.regions import NAME as REGIONS
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, UserQuestion, notifies
from gaga_studio.session.session import Session
from gaga_studio.system import paths

Views = Literal["train", "all"]
MaskForm = Literal["png", "dataset", "coco"]
_PREVIEW = ".preview"  # mask folder of a preview; a leading dot keeps it out of the lists
_UNNAMED = "imported"  # name that `recognise` gives to masks of an unknown provider
_CANCEL = "Cancel"


@dataclass(frozen=True)
class MaskRequest:
    """The masks that a user asks for."""

    provider: str = REGIONS
    settings: ProviderSettings = field(default_factory=ProviderSettings)
    weights: Path | None = None  # of a model that lies elsewhere
    views: Views = "train"
    redo: bool = False
    use_depth: bool = True


@dataclass(frozen=True, eq=False)
class MaskPreview:
    """The masks of one photo, made to see what the settings give."""

    request: MaskRequest
    view: str
    labels: IntArray  # (H, W)
    n_masks: int
    seconds: float  # 0: it was there already


# --- who can make masks


def providers() -> tuple[ProviderEntry, ...]:
    """Return every provider, those that can be used first."""
    return tuple(sorted(available_providers(), key=lambda entry: not entry.is_available))


def has_model(entries: tuple[ProviderEntry, ...]) -> bool:
    """Return whether a model is here; regions need none."""
    return any(entry.is_available and entry.kind != "regions" for entry in entries)


def entry_of(path: Path) -> ProviderEntry:
    """Return the entry of a model in another folder; ``GagaError`` when it makes no masks."""
    found = weights_at(path)
    title = f"{found.model_type} in {found.path.name}"
    return ProviderEntry(path.stem, title, True, "", "own", found.path, licence="its own")


def first_steps() -> str:
    """Return what to tell the user while no model is here."""
    return (
        "Regions work at once, on any computer: they follow color, texture and the shape of the "
        "surface, and know nothing of objects. A model such as SAM 2.1 finds whole objects: choose "
        "one and get it. Nothing is downloaded without your consent. Or put its files into "
        f"{paths.shown(models_folder())}, or name its folder."
    )


# --- making


def why_not(session: Session, entry: ProviderEntry | None) -> str:
    """Return why masks cannot be made now; "" when they can."""
    reason = no_photos(session)
    if reason:
        return reason
    if entry is None:
        return "Choose a mask provider."
    return "" if entry.is_available else entry.reason


def no_photos(session: Session) -> str:
    """Return why there is no photo with a pose, or no free job runner; "" when there is."""
    if session.project is None:
        return "No scene is open."
    folder = session.project.folder
    if folder is None or not folder.cameras:
        return "Masks are made of photos, and this scene has none with a place."
    if not folder.image_paths:
        return f"The photos are not in {folder.root / 'images'}. Put them back."
    job = session.jobs.running
    return "" if job is None else f"{job.title} is still running."


def photos_of(session: Session, views: Views) -> tuple[str, ...]:
    """Return the names of the photos that a request covers."""
    folder = session.project.folder if session.project is not None else None
    if folder is None:
        return ()
    wanted = set(folder.train) if views == "train" else {c.name for c in folder.cameras}
    return tuple(c.name for c in folder.cameras if c.name in wanted)


def make(session: Session, request: MaskRequest | None = None) -> None:
    """Make the masks of all wanted photos; those that are there already stay unless ``redo``.

    What is finished when the job is cancelled is kept, and the next run continues from there.
    """
    request = request or MaskRequest()
    reason = no_photos(session)
    if reason:
        session.notify(Level.WARNING, reason)
        return
    document = session.need()
    ended: list[SegmentReport] = []

    def done(report: SegmentReport) -> None:
        ended.append(report)
        take_report(session, document, report)

    def end() -> None:
        if not ended and session.document is document:
            keep_partial(session, request.provider)

    session.jobs.start("Make masks", make_stage(_folder(document), request), None, done, end)


def take_report(session: Session, document: Document, report: SegmentReport) -> None:
    """Use the masks that were made, tell the user, and remember how long the model took."""
    if report.made and report.provider != REGIONS:
        record(report.provider, report.seconds / len(report.made))
        session.models.entries = ()  # looked at again
    if session.document is document:
        choose(session, report.folder.name)
    n = len(report.made) + len(report.kept)
    session.notify(Level.INFO, f"{report.n_masks:,} masks in {_photos(n)}.")
    for note in report.notes:
        session.notify(Level.WARNING, note)


@notifies
def try_one(
    session: Session, request: MaskRequest, view: str, on_done: Callable[[MaskPreview], None]
) -> None:
    """Make the masks of one photo without keeping them; a run with the same request reuses them."""
    stage = _preview_stage(_folder(session.need()), request, view)
    session.jobs.start(f"Try on {view}", stage, on_done=on_done)


def make_stage(
    folder: SceneFolder, request: MaskRequest, views: str | tuple[str, ...] = "", name: str = ""
) -> Stage[SegmentReport]:
    """Make the masks of ``request``; ``views`` and ``name`` override its views and their folder."""
    # torch is imported here, in the job's thread, and only when a model is asked for.
    from gaga_core.pipeline.compile_kernels import after_warm_up
    from gaga_core.segmentation.choose import provider_named

    yield Progress("Make masks", 0, 0, "Preparing")
    provider = provider_named(request.provider, weights=request.weights, settings=request.settings)
    stage = segment_scene(
        folder,
        provider,
        views=views or request.views,
        name=name,
        redo=request.redo and not name,
        config=SegmentConfig(use_depth=request.use_depth),
    )
    draws_depth = request.use_depth and "depth" in provider.cues and folder.model_path is not None
    return (yield from (after_warm_up(stage) if draws_depth else stage))


def _preview_stage(folder: SceneFolder, request: MaskRequest, view: str) -> Stage[MaskPreview]:
    place = folder.root / "masks" / _PREVIEW
    try:
        report = yield from make_stage(folder, request, (view,), _PREVIEW)
        labels = read_labels(report.folder / f"{view_key(view)}.png")
    finally:
        shutil.rmtree(place, ignore_errors=True)
        if place.parent.is_dir() and not any(place.parent.iterdir()):
            place.parent.rmdir()
    return MaskPreview(
        request, view, labels, report.n_masks, report.seconds if report.made else 0.0
    )


def keep_partial(session: Session, provider: str) -> None:
    """After a cancel or an error, use what is finished and tell the user."""
    chosen = session.provider
    _look_again(session.need())
    folders = mask_folders(session)
    if provider not in folders:
        return
    choose(session, chosen if chosen in folders else provider)
    _, made = stages.masks_of(session.need().project, provider)
    session.notify(
        Level.INFO, f"{_photos(len(made))} of {provider} are done. Make masks again goes on there."
    )


# --- choosing


def mask_folders(session: Session) -> tuple[str, ...]:
    """Return the names of the mask folders of the scene."""
    folder = session.project.folder if session.project is not None else None
    return tuple(folder.mask_folders) if folder is not None else ()


@notifies
def choose(session: Session, name: str) -> bool:
    """Use the masks of this folder from now on; False, and a notice, when it is gone."""
    document = session.need()
    _look_again(document)
    if name not in mask_folders(session):
        raise GagaError(f"There are no masks of {name} here any more. Make or import them.")
    session.provider, session.masks = stages.masks_of(document.project, name)
    document.forget_views()  # files of the same names may hold other masks now
    return True


def _look_again(document: Document) -> None:
    folder = document.project.folder
    if folder is not None:
        found = find_mask_folders(folder.root)
        document.project.folder = replace(folder, mask_folders=found)


# --- masks of other programs


def import_from(session: Session, source: Path) -> None:
    """Recognise what a folder or file of masks holds, ask, then import it as a mask folder."""
    document = session.need()
    folder = _folder(document)

    def look() -> Stage[tuple[str, str]]:
        yield Progress("Look at masks", 0, 1, source.name)
        found = recognise(source, [camera.name for camera in folder.cameras])
        plain = source.stem.strip(". ")
        return found.said, plain if plain and found.name == _UNNAMED else found.name

    def seen(found: tuple[str, str]) -> None:
        if session.document is document:
            _ask(session, folder, source, *found)

    session.jobs.start(f"Look at {source.name}", look(), on_done=seen)


def _ask(session: Session, folder: SceneFolder, source: Path, described: str, name: str) -> None:
    taken = (folder.root / "masks" / name).exists()
    other = free_name(folder, name)
    keep, instead = f"Import as {other}", f"Replace {name}"
    choices = (keep, instead, _CANCEL) if taken else ("Import", _CANCEL)
    extra = f" There are masks called {name} already." if taken else ""

    def chosen(choice: str) -> None:
        if choice == _CANCEL:
            return
        as_name = other if choice == keep else name
        _import(session, folder, source, as_name, replace_old=choice == instead)

    session.pending_question = UserQuestion(f"{described}{extra}", choices, chosen)


def free_name(folder: SceneFolder, name: str) -> str:
    """Return ``name``, or the first of "name 2", "name 3" ... that is not taken."""
    k, free = 1, name
    while (folder.root / "masks" / free).exists():
        k += 1
        free = f"{name} {k}"
    return free


def _import(
    session: Session, folder: SceneFolder, source: Path, name: str, *, replace_old: bool
) -> None:
    document = session.document

    def done(report: ImportReport) -> None:
        if session.document is document:
            choose(session, report.name)
        n = len(report.views)
        session.notify(Level.INFO, f"Imported {report.n_masks:,} masks in {_photos(n)}.")
        for note in report.notes()[1:]:
            session.notify(Level.WARNING, note)

    stage = import_masks(folder, source, name, replace=replace_old)
    session.jobs.start("Import masks", stage, on_done=done)


# --- exporting


def export(session: Session, form: MaskForm, out: Path) -> None:
    """Write the objects as every view shows them: maps, COCO, or a data set with the photos."""
    project = session.need().settled()
    frozen = replace(project, scene=replace(project.scene))

    def stage() -> Stage[str]:
        # These modules draw: numba is a good part of the launch time.
        from gaga_core.pipeline.mask_dataset import export_mask_dataset
        from gaga_core.pipeline.render import export_masks

        yield Progress("Export masks", 0, 0)
        if form == "png":
            maps = yield from export_masks(frozen, out)
            return f"Exported label maps of {len(maps)} views to {out}."
        made = yield from export_mask_dataset(frozen, out, form)
        text = f"Exported {made.n_masks:,} masks of {made.n_groups:,} objects to {out}."
        if made.without_photo:
            text += f" {len(made.without_photo)} views are left out: their photos are gone."
        return text

    title = f"Export masks to {out.name}"
    session.jobs.start(
        title, stage(), on_done=lambda text: session.notify(Level.INFO, text, shows=out)
    )


def _folder(document: Document) -> SceneFolder:
    folder = document.project.folder
    if folder is None:
        raise GagaError("A single splat file has no photos. Open its scene folder for masks.")
    return folder


def _photos(n: int) -> str:
    return "1 photo" if n == 1 else f"{n:,} photos"
