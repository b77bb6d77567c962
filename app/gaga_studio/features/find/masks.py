"""Masks: who makes them and with which settings, making, importing, exporting; models."""

import shutil
import time
import webbrowser
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError, counted
from gaga_core.grouping.associate import AssociateConfig, Association, BankSnapshot
from gaga_core.io.folder.scene_folder import SceneFolder, find_mask_folders
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.masks.label_maps import RECORD, MaskRecord, mask_folder, read_labels, view_key
from gaga_core.io.masks.other_programs import recognise
from gaga_core.pipeline.import_masks import ImportReport, import_masks
from gaga_core.pipeline.segment import SegmentReport, ViewDone, segment_scene
from gaga_core.pipeline.settings import SegmentConfig
from gaga_core.progress import Progress, Stage, mapped
from gaga_core.scene.project import Project
from gaga_core.segmentation.choose import (
    ProviderEntry,
    ProviderSettings,
    available_providers,
    recorded_settings,
)
from gaga_core.segmentation.models.catalogue import KnownModel, known_model
from gaga_core.segmentation.models.download import Consent, Installed, download, remove
from gaga_core.segmentation.models.hub import HubConfig, Listing, list_files
from gaga_core.segmentation.models.status import ModelStatus, all_models, record
from gaga_core.segmentation.models.weights import family_of, models_folder, weights_at
from gaga_core.segmentation.regions import NAME as REGIONS
from gaga_core.segmentation.settings import GeneratorConfig
from gaga_core.settings import setting_of
from gaga_studio.features.base import (
    Command,
    ask,
    busy,
    first_of,
    no_groups,
    no_scene,
    no_views,
    preview_waits,
)
from gaga_studio.features.find import association
from gaga_studio.features.find.association import FindState, duration_text
from gaga_studio.features.find.memory_bank import KnownViews
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, UserQuestion, notifies
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.session import Session
from gaga_studio.system import paths

if TYPE_CHECKING:
    from gaga_core.segmentation.sam import Prompter


@dataclass
class ModelsState:
    """State of the sheet of models: the known models here, terms that wait for an answer."""

    entries: tuple[ModelStatus, ...] = ()  # as last looked at; empty = look when it is shown
    offered: Listing | None = None  # its licence and size are shown, the user has not answered
    removing: KnownModel | None = None  # the user is asked whether
    task: str = ""  # title of the last look at a model, or download
    problem: str = ""  # why the last one was not got, said in the sheet
    is_shown: bool = False  # a notice would stand over it or behind it
    then: Callable[[], object] | None = None  # what the offered model was wanted for
    promptable: tuple[ProviderEntry, ...] | None = None  # can segment one object; None = look
    prompters: dict[str, "Prompter"] = field(default_factory=dict)  # loaded, by name of the model

    def entry(self, name: str) -> ModelStatus | None:
        """The entry of a model, None before they were looked at."""
        return next((entry for entry in self.entries if entry.model.name == name), None)


# --- settings of a mask provider that have a slider, and their bounds


Family = Literal["regions", "sam", "universal", ""]
Part = Literal["regions", "generator", "universal", "flatten"]


@dataclass(frozen=True)
class Slider:
    """One setting; its title and limits are those of the field."""

    part: Part  # field of `ProviderSettings`
    field: str  # of the part
    hint: str
    is_logarithmic: bool = False


# fmt: off
_FLATTEN = (
    Slider("flatten", "min_visible",
           "Drop a mask if less than this stays visible under more confident ones"),
)
SLIDERS: dict[Family, tuple[Slider, ...]] = {
    "": (),
    "regions": (
        Slider("regions", "detail", "2: about twice as many regions, 0.5: about half",
               is_logarithmic=True),
        Slider("regions", "crease", "How much an edge in depth keeps regions apart; needs splats"),
    ),
    "sam": (
        Slider("generator", "points_per_side",
               "More find smaller objects; time grows with the square"),
        Slider("generator", "pred_iou_thresh", "That the model predicts for its own mask"),
        Slider("generator", "stability_score_thresh",
               "How little a mask may change when it is cut tighter or wider"),
        Slider("generator", "crop_layers",
               "Also look at 4, 16, ... crops, for small objects; takes longer"),
        *_FLATTEN,
    ),
    "universal": (
        Slider("universal", "min_score", "Fewer but more certain masks, or more masks"),
        Slider("universal", "max_overlap",
               "Of two masks that share more than this, the less confident one is dropped"),
        *_FLATTEN,
    ),
}
# fmt: on


def settings_family(entry: ProviderEntry) -> Family:
    """Return the kind of settings that a provider takes; "" while its weights are not here."""
    if entry.kind == "regions":
        return "regions"
    found = family_of(_model_type(entry))
    return "sam" if found == "sam" else "universal" if found == "universal" else ""


def part_of(settings: ProviderSettings, slider: Slider, entry: ProviderEntry) -> Any:
    """Return the settings that have the field of a slider: the provider's own until it is moved."""
    if slider.part == "flatten":
        return settings.flatten_of(settings_family(entry))
    return getattr(settings, slider.part) or _defaults(entry, settings)


def with_value(
    settings: ProviderSettings, slider: Slider, entry: ProviderEntry, value: float
) -> ProviderSettings:
    """Return the settings with a slider moved, inside its bounds."""
    part = part_of(settings, slider, entry)
    bounded = setting_of(part, slider.field).clamped(value)
    if isinstance(getattr(part, slider.field), int):
        bounded = round(bounded)
    if slider.part == "flatten" and settings_family(entry) == "universal":
        settings = replace(settings, profile="default")  # no longer the profile's
    return replace(settings, **{slider.part: replace(part, **{slider.field: bounded})})


def has_profile(entry: ProviderEntry) -> bool:
    """Whether the paper publishes settings for models of this kind."""
    return settings_family(entry) in ("sam", "universal")


def with_profile(settings: ProviderSettings, *, paper: bool) -> ProviderSettings:
    """Return the settings with the paper's published ones, or the defaults, in place of sliders."""
    fresh = ProviderSettings(regions=settings.regions, device=settings.device)
    return replace(fresh, profile="paper" if paper else "default")


def _defaults(entry: ProviderEntry, settings: ProviderSettings) -> GeneratorConfig:
    """Return those of a SAM on the CPU; settings that were not touched follow the device."""
    return settings.generator_of(_model_type(entry), on_gpu=False)


def _model_type(entry: ProviderEntry) -> str:
    return weights_at(entry.path).model_type if entry.path is not None else ""


Views = Literal["train", "all"]
MaskForm = Literal["png", "dataset", "coco"]
_PREVIEW = ".preview"  # mask folder of a preview; a leading dot keeps it out of the lists
_UNNAMED = "imported"  # name that `recognise` gives to masks of an unknown provider
_CANCEL = "Cancel"
REST = "object.masks_rest"
# Regions next to masks of whole objects would count as such.
_NEEDS_MODEL = (
    "These masks were not made here, and no model is here that makes the others. Download one "
    "(Models), or import them."
)


@dataclass(frozen=True)
class MaskRequest:
    """The masks that a user asks for."""

    provider: str = REGIONS
    settings: ProviderSettings = field(default_factory=ProviderSettings)
    weights: Path | None = None  # of a model that lies elsewhere
    views: Views = "train"
    redo: bool = False
    use_depth: bool = True
    longest_side: int = SegmentConfig.longest_side  # pixels


@dataclass(frozen=True, eq=False)
class MaskPreview:
    """The masks of one photo, made to see what the settings give."""

    request: MaskRequest
    view: str
    labels: IntArray  # (H, W)
    n_masks: int
    seconds: float  # 0: it was there already


# --- providers of masks


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
        return no_scene(session)
    folder = session.project.folder
    if folder is None or not folder.cameras:
        return "Masks need photos with known cameras; this scene has none."
    if not folder.image_paths:
        return f"The photos are not in {folder.root / 'images'}. Put them back."
    return busy(session)


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
    stage = make_stage(_folder(session.need()), request)
    _start_making(session, stage, request.provider)


def _start_making(session: Session, stage: Stage[SegmentReport], name: str) -> None:
    """Make masks into the folder ``name``; what is made when it is cancelled is used."""
    document, ended = session.need(), list[SegmentReport]()

    def done(report: SegmentReport) -> None:
        ended.append(report)
        take_report(session, document, report)

    def end() -> None:
        if not ended and session.document is document:
            keep_partial(session, name)

    session.jobs.start("Make masks", stage, None, done, end)


def rest_title(session: Session) -> str:
    """Return "Make masks for the other 3 photos", as it is now."""
    n = len(association.bare_photos(session))
    return f"Make masks for the other {counted(n, 'photo')}" if n else "Make masks for the others"


def why_no_rest(session: Session) -> str:
    """Return why there are no other photos to make masks for; "" when there are."""
    reason = no_photos(session)
    if reason or len(session.masks) == 0:
        return reason or "No photo has masks yet: use Make masks."
    path = _folder(session.need()).mask_folders.get(session.provider)
    is_foreign = path is not None and not (path / RECORD).is_file()
    if is_foreign and model_here(session) is None:
        return _NEEDS_MODEL
    return "" if association.bare_photos(session) else "All training photos have masks."


@notifies
def make_rest(session: Session) -> None:
    """Make masks of the photos that have none, next to those that are in use and as these were.

    Of masks that were not made here: with the model that is here.
    """
    name, folder = session.provider, _folder(session.need())
    request = _request_of(session, folder.mask_folders[name])
    stage = make_stage(folder, request, association.bare_photos(session), name)
    _start_making(session, stage, name)


def _request_of(session: Session, masks: Path) -> MaskRequest:
    """What made the masks of a folder."""
    if not (masks / RECORD).is_file():
        model = model_here(session)
        if model is None:
            raise GagaError(_NEEDS_MODEL)
        return MaskRequest(model.name)
    record, usual = read_foreign_json(masks / RECORD, MaskRecord), SegmentConfig()
    own, source = Path(record.source), record.provider != REGIONS and record.source
    return MaskRequest(
        record.provider,
        recorded_settings(record),
        own if source and own.exists() else None,
        use_depth=usual.use_depth if record.use_depth is None else record.use_depth,
        longest_side=usual.longest_side if record.longest_side is None else record.longest_side,
    )


def take_report(session: Session, document: Document, report: SegmentReport) -> None:
    """Use the masks that were made, tell the user, and remember how long the model took."""
    if report.made and report.provider != REGIONS:
        record(report.provider, report.seconds / len(report.made))
        session.feature(ModelsState).entries = ()  # looked at again
    if session.document is document:
        choose(session, report.folder.name)
    done = {*report.made, *report.kept}
    text = f"{counted(report.n_masks, 'mask')} in {counted(len(done), 'photo')}"
    folder = _folder(document)
    done |= set(mask_folder(report.folder, folder.image_paths).names)
    n_tests = sum(name in folder.image_paths and name not in done for name in folder.test)
    if n_tests:
        are, have = ("is", "has") if n_tests == 1 else ("are", "have")
        text += f"; {n_tests} more {are} for testing and {have} none"
    session.notify(Level.INFO, f"{text}.")
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
        config=SegmentConfig(request.longest_side, request.use_depth),
    )
    draws_depth = request.use_depth and "depth" in provider.cues and folder.model_path is not None
    return (yield from (after_warm_up(stage, "window") if draws_depth else stage))


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
    photos = f"{counted(len(made), 'photo')} of {provider} {'is' if len(made) == 1 else 'are'}"
    command = REST if session.provider == provider and not why_no_rest(session) else ""
    session.notify(Level.INFO, f"{photos} done. Make masks continues there.", command)


# --- choosing


def mask_folders(session: Session) -> tuple[str, ...]:
    """Return the names of the mask folders of the scene."""
    folder = session.project.folder if session.project is not None else None
    return tuple(folder.mask_folders) if folder is not None else ()


def folder_commands(session: Session) -> tuple[Command, ...]:
    """A command for each mask folder to choose from; none where there is one at most."""

    def use(name: str) -> Command:
        return Command(
            f"object.masks_of {name}",
            name,
            lambda session: choose(session, name),
            is_on=lambda session: session.provider == name,
        )

    folders = mask_folders(session)
    return tuple(map(use, folders)) if len(folders) > 1 else ()


@notifies
def choose(session: Session, name: str) -> bool:
    """Use the masks of this folder from now on; False, and a notice, when it is gone."""
    document = session.need()
    _look_again(document)
    if name not in mask_folders(session):
        raise GagaError(f"The masks of {name} are no longer here. Make or import them.")
    if document.scene.bank is not None and not document.project.bank_masks:
        document.project.bank_masks = session.provider
    session.provider, session.masks = stages.masks_of(document.project, name)
    document.feature(KnownViews).forget()  # files of the same names may hold other masks now
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
        masks, photos = counted(report.n_masks, "mask"), counted(n, "photo")
        is_used = session.document is document and len(mask_folders(session)) > 1
        use = f" The masks in use are those of {report.name} now." if is_used else ""
        for note in report.notes()[1:]:
            session.notify(Level.WARNING, note)
        session.notify(Level.INFO, f"Imported {masks} in {photos}.{use}")  # last: it stays in sight

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
            return f"Exported label maps of {counted(len(maps), 'view')} to {out}."
        made = yield from export_mask_dataset(frozen, out, form)
        masks, objects = counted(made.n_masks, "mask"), counted(made.n_groups, "object")
        return f"Exported {masks} of {objects} to {out}. {made.sentence}".rstrip()

    title = f"Export masks to {out.name}"
    session.jobs.start(
        title, stage(), on_done=lambda text: session.notify(Level.INFO, text, shows=out)
    )


def _folder(document: Document) -> SceneFolder:
    folder = document.project.folder
    if folder is None:
        raise GagaError("A single splat file has no photos. Open its scene folder for masks.")
    return folder


# --- objects while masks are made

LIVE_TITLE = "Make masks, find objects"
_LEAST_VIEWS = 2  # an object is what two photos agree on
_SHARE = 0.5  # most time for live objects, as a part of the time for the masks between them


def make_live(session: Session, request: MaskRequest) -> None:
    """Make masks photo by photo and show the objects so far; at the end, or when the user stops,
    they become one edit. A scene that has objects already gets masks alone."""
    document = session.need()
    if document.read.has_groups():
        make(session, request)
        return
    reason = no_photos(session) or preview_waits(session)
    if reason:
        session.notify(Level.WARNING, reason)
        return
    found: list[Association] = []  # newest last; the worker adds, nothing is changed
    ended: list[SegmentReport] = []
    progress, end_of_live = association.watch_bank(session)
    how = _config(session), session.rates
    stage = _stage(document.project, request, how, found)

    def done(report: SegmentReport) -> None:
        ended.append(report)
        take_report(session, document, report)

    def end() -> None:
        end_of_live()
        if session.document is not document:
            return
        if not ended:
            keep_partial(session, request.provider)
        if found:
            session.notify(Level.INFO, association.take_groups(document, found[-1]))
            for note in found[-1].notes:
                session.notify(Level.WARNING, note)
            association.lift_after_finding(session, found[-1].bank.preset)

    session.jobs.start(LIVE_TITLE, stage, progress, done, end)


def _config(session: Session) -> AssociateConfig:
    return session.feature(FindState).association(session.settings.preset)


def _stage(
    project: Project,
    request: MaskRequest,
    how: tuple[AssociateConfig, KnownRates],
    found: list[Association],
) -> Stage[SegmentReport]:
    """Make the masks; append to ``found`` the objects of the photos so far."""
    folder = project.folder
    if folder is None:
        raise GagaError("A single splat file has no photos. Open its scene folder for masks.")
    views: list[str] = []
    mark, n_seen, cost = time.perf_counter(), 0, 0.0
    with closing(make_stage(folder, request)) as stage:
        while True:
            try:
                step = next(stage)
            except StopIteration as end:
                report: SegmentReport = end.value
                break
            yield replace(step, payload=None)
            if not isinstance(step.payload, ViewDone):
                continue
            views.append(step.payload.view)
            is_due = _SHARE * (time.perf_counter() - mark) >= cost
            if len(views) >= _LEAST_VIEWS and is_due:
                began = time.perf_counter()
                yield from _objects(project, step, views, how, found)
                mark, n_seen = time.perf_counter(), len(views)
                cost = mark - began
    if len(views) > n_seen:
        last = Progress(LIVE_TITLE, 1, 1, "", ViewDone(report.folder, views[-1]))
        yield from _objects(project, last, views, how, found)
    return report


def _objects(
    project: Project,
    step: Progress,
    views: list[str],
    how: tuple[AssociateConfig, KnownRates],
    found: list[Association],
) -> Stage[None]:
    """Associate the masks of ``views``; progress stays that of the masks (``step``)."""
    done, folder = step.payload, project.folder
    assert isinstance(done, ViewDone)
    assert folder is not None  # `_stage` looked
    known = [camera.name for camera in folder.cameras]
    text = f"objects in {counted(len(views), 'photo')}"
    masks = mask_folder(done.folder, views, known)
    stage = association.associate_project_stage(project, masks, *how)
    newest = yield from mapped(stage, lambda _: replace(step, payload=None, message=text))
    found.append(newest)
    snapshot = BankSnapshot(done.view, newest.bank, newest.bank.n_groups)
    yield replace(step, payload=snapshot, message=text)


# --- models: got after consent, removed

FIRST_MODEL = known_model("sam2.1-tiny")  # offered where there is no model


def hub_config(session: Session) -> HubConfig:
    """Return which hub the preferences name, and whether it may be asked."""
    return HubConfig(session.settings.hub_mirror, session.settings.works_offline)


def refresh_models(session: Session) -> None:
    """Look again which models are here."""
    session.feature(ModelsState).entries = all_models()
    session.feature(ModelsState).promptable = None


def why_no_download(session: Session) -> str:
    """Return why no model can be got or removed now; "" when one can."""
    if reason := busy(session):
        return reason
    offline = hub_config(session).why_offline()
    return f"No model can be downloaded: {offline}." if offline else ""


def ask_model(
    session: Session, model: KnownModel, then: Callable[[], object] | None = None
) -> None:
    """Ask the hub for licence and size of ``model``, and show them; nothing is downloaded.

    ``then`` is called when the model has been downloaded.
    """
    state, config = session.feature(ModelsState), hub_config(session)

    def look() -> Stage[Listing]:
        yield Progress("Look at the model", 0, 0, config.host)
        return list_files(model, config)

    def seen(listing: Listing | None) -> None:
        state.offered, state.then = listing, then

    decline_model(session)
    state.task = f"Look at {model.title}"
    session.jobs.start(state.task, _told(state, look()), on_done=seen)


T = TypeVar("T")


def _told(state: ModelsState, stage: Stage[T]) -> Stage[T | None]:
    """``stage``; None where its error is told in the sheet."""
    try:
        return (yield from stage)
    except GagaError as error:
        if not state.is_shown:
            raise
        state.problem = str(error)
        return None


def accept_model(session: Session) -> None:
    """Accept the licence that is shown, and download the model."""
    state = session.feature(ModelsState)
    listing, then = state.offered, state.then
    if listing is None:
        return
    consent = Consent(listing.model.name, listing.licence_name)

    def done(installed: Installed | None) -> None:
        if installed is None:
            return
        session.notify(Level.INFO, f"{installed.model.title} is here: {installed.path}.")
        if then is not None:
            after.append(then)

    def end() -> None:
        refresh_models(session)
        for act in after:
            act()

    after: list[Callable[[], object]] = []
    stage = _told(state, download(listing, consent, hub_config(session)))
    state.task = f"Download {listing.model.title}"
    if session.jobs.start(state.task, stage, None, done, end, resumes=True):
        state.offered = state.then = None


def decline_model(session: Session) -> None:
    """Download nothing, remove nothing."""
    state = session.feature(ModelsState)
    state.offered = state.removing = state.then = None
    state.problem = ""


def ask_remove_model(session: Session, model: KnownModel) -> None:
    """Ask whether to delete a model."""
    decline_model(session)
    session.feature(ModelsState).removing = model


@notifies
def remove_asked_model(session: Session) -> bool:
    """Delete the model that was asked about."""
    model, session.feature(ModelsState).removing = session.feature(ModelsState).removing, None
    if model is None:
        return False
    folder = remove(model)
    session.feature(ModelsState).prompters.pop(model.name, None)
    refresh_models(session)
    session.notify(Level.INFO, f"Removed {folder}." if folder else f"{model.title} is gone.")
    return True


def open_model_page(model: KnownModel) -> None:
    """Show the page of a model, with its licence, in the browser."""
    webbrowser.open(model.page)


# --- masks with a model, from the offer of the next stage


def model_here(session: Session) -> KnownModel | None:
    """Return the model for masks that is here and quickest; None when there is none."""
    if not session.feature(ModelsState).entries:
        refresh_models(session)
    found = [
        e for e in session.feature(ModelsState).entries if e.path and e.model.purpose == "masks"
    ]
    quickest = min(found, key=lambda e: e.seconds or float("inf"), default=None)
    return quickest.model if quickest is not None else None


def model_duration(session: Session, name: str, n: int) -> str:
    """Return "about 3 min", as long as a model takes for ``n`` photos here; "" if not known."""
    if not session.feature(ModelsState).entries:
        refresh_models(session)
    entry = session.feature(ModelsState).entry(name)
    return duration_text(n * entry.seconds) if entry is not None and entry.seconds else ""


def model_title(session: Session) -> str:
    """Return "Make masks with SAM 2.1 Hiera tiny, 156 MB, about 3 min…", as it is now."""
    model = model_here(session) or FIRST_MODEL
    entry = session.feature(ModelsState).entry(model.name)
    is_here = entry is not None and entry.path is not None
    size = "" if is_here else f"{model.megabytes:,} MB"
    n = len(photos_of(session, "train"))
    parts = (f"Make masks with {model.title}", size, model_duration(session, model.name, n))
    return ", ".join(filter(None, parts)) + ("" if is_here else "…")


def why_no_model_masks(session: Session) -> str:
    """Return why no masks can be made with a model; "" when they can, perhaps after a download."""
    reason = no_photos(session) or preview_waits(session)
    return reason or ("" if model_here(session) is not None else why_no_download(session))


def make_with_model(session: Session) -> None:
    """Make masks with a model: at once when one is here, else after the user has got one."""
    document, model = session.need(), model_here(session)
    if model is not None:
        make_live(session, MaskRequest(provider=model.name))
        return

    def then() -> None:
        if session.document is document:
            make_live(session, MaskRequest(provider=FIRST_MODEL.name))

    session.request = Request.MODELS
    ask_model(session, FIRST_MODEL, then)


COMMANDS: tuple[Command, ...] = (
    ask("object.masks", "Make masks…", Request.MAKE_MASKS, "Ctrl+M", enabled=no_photos),
    Command(
        REST,
        "Make masks for the other photos",
        make_rest,
        enabled=why_no_rest,
        describe=rest_title,
    ),
    Command("object.masks_quick", "Make masks without a model (regions)", make, enabled=no_photos),
    Command(
        "object.masks_model",
        "Make masks with a model",
        make_with_model,
        enabled=why_no_model_masks,
        describe=model_title,
    ),
    ask("object.models", "Models…", Request.MODELS),
    ask(
        "object.import_masks",
        "Import masks from a folder…",
        Request.IMPORT_MASK_FOLDER,
        enabled=no_views,
    ),
    ask(
        "object.import_masks_file",
        "Import masks from a file…",
        Request.IMPORT_MASK_FILE,
        enabled=no_views,
    ),
    ask(
        "file.export_masks",
        "Export masks…",
        Request.EXPORT_MASKS,
        enabled=first_of(no_groups, no_views),
    ),
)
