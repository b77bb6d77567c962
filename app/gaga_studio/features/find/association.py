"""Find objects: associate masks with settings, identities, and the stage that comes next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.grouping.associate import AssociateConfig, Association, BankSnapshot, associate_stage
from gaga_core.grouping.memory_bank import MemoryBank, Preset
from gaga_core.identity.field import FILE as IDENTITY_FILE
from gaga_core.identity.field import encoding_colors, save_identity
from gaga_core.identity.lift import (
    STAGE,
    LiftConfig,
    lift_groups,
    mode_of_preset,
    task_of_association,
)
from gaga_core.identity.lift import Mode as LiftMode
from gaga_core.identity.train import FILE as CHECKPOINT
from gaga_core.io.folder.scene_folder import SceneFolder, select_views
from gaga_core.kernels import STAGE as PREPARES
from gaga_core.masks import MaskSet
from gaga_core.pipeline.associate import with_silhouettes
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.objects import NO_IDENTITIES
from gaga_core.scene.edits.splats import regrouped
from gaga_core.scene.project import Project, decided_groups
from gaga_core.scene.scene import LabelSource, Scene
from gaga_studio.features.base import Command, ask, needs, no_bank, no_masks, watch
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.session import NO_OBJECTS_OF_A_FILE, Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view import Mode, ToolName

# --- settings


TITLE = "Find objects"  # of the command, its task and its entry in the history


@dataclass
class FindState:
    """Feature of a session: how objects are found until the program ends."""

    groups: GroupSettings = field(default_factory=GroupSettings)
    identities: IdentitySettings = field(default_factory=IdentitySettings)
    took_the_tool: bool = False  # a click where there were no objects took the tool Object

    def association(self, preset: str) -> AssociateConfig:
        """Settings of an association by ``preset``; ``GagaError`` when they exclude each other."""
        try:
            return self.groups.config(preset)
        except ValueError as error:
            raise GagaError(f"These settings do not go together ({error}).") from error


def lift_mode(settings: Settings, preset: str = "") -> LiftMode | None:
    """The mode of identities once objects are found by ``preset`` (default: that of the settings).

    None: not at all.
    Presets paper and released train them, as published. Robust leaves them: its labels are votes
    either way.
    """
    modes: dict[str, LiftMode] = {"vote": "vote", "refine": "refine", "paper": "paper"}
    if settings.identities == "preset":
        return None if (preset or settings.preset) == "robust" else "paper"
    return modes.get(settings.identities)


# --- identity encodings of the groups, and whether labels come from votes or from them


__all__ = ["NO_IDENTITIES", "lift", "lift_after_finding", "use_labels"]
_CHANGED = "The objects were found again meanwhile, so the identities are left out. Lift again."


@notifies
def lift(session: Session, mode: LiftMode | None = None) -> None:
    """Make identities of the groups as one edit, in ``mode``; default: as the settings say.

    Labels come from them where they are published so: trained, from groups of a published preset.
    """
    document = session.need()
    bank = document.settled().scene.bank
    preset: Preset = bank.preset if bank is not None else "paper"
    mode = mode or lift_mode(session.settings, preset) or mode_of_preset(preset)
    options = session.feature(FindState).identities.config(preset, mode)
    rates = session.rates
    stage = lift_project_stage(document.project, session.masks, mode, options, rates)
    used = mode == "paper" and preset != "robust"

    check = watch(session, document, _CHANGED, lambda: document.settled().scene.bank is bank)

    def done(found: LiftedScene) -> None:
        if not check():
            return
        labels, confidence, colors = found.labels, found.confidence, found.colors
        scene = document.settled().scene
        if used:  # what a person made is in no mask, so the classifier does not know it
            now = scene.labels[: len(labels)]
            labels = np.where(np.isin(now, decided_groups(document.project)), now, labels)
        document.do(edits.set_identities(scene, labels, confidence, colors, used=used))
        session.notify(Level.INFO, _text(bank, is_used=used))

    session.jobs.start("Lift groups to identities", stage, on_done=done)


def lift_after_finding(session: Session, preset: str) -> None:
    """Go on with identities where the settings, or ``preset``, ask for them."""
    mode = lift_mode(session.settings, preset)
    if mode is not None:
        lift(session, mode)


@notifies
def use_labels(session: Session, source: LabelSource) -> None:
    """Take labels from the votes of the masks or from the identities, as one edit."""
    document = session.need()
    document.do(edits.use_labels(document.settled().scene, source))


def _text(bank: MemoryBank | None, *, is_used: bool) -> str:
    n = bank.n_groups if bank is not None else 0
    rest = (
        "Labels come from them now."
        if is_used
        else 'Labels stay votes; "Labels by identities" takes them.'
    )
    return f"{counted(n, 'group')} {'has' if n == 1 else 'have'} identities. {rest}"


# --- association


@notifies
def associate(session: Session, provider: str | None = None, preset: str | None = None) -> None:
    """Make groups from the masks of ``provider`` (default: the first), as one edit.

    With the settings of `FindState`; then identities, where the preset has them.
    """
    document, preset = session.need(), preset or session.settings.preset
    config = session.feature(FindState).association(preset)
    found = stages.masks_of(document.project, provider or session.provider)
    session.provider, session.masks = found
    rates, name = session.rates, session.provider
    stage = associate_project_stage(document.project, session.masks, config, rates)
    progress, end = watch_bank(session)

    def done(result: Association) -> None:
        document.project.bank_masks = name
        session.notify(Level.INFO, take_groups(document, result))
        took = session.feature(FindState).took_the_tool and session.tool is ToolName.OBJECT
        if took and len(session.selected_indices()) == 0:
            session.tool = ToolName.PICK  # now there are objects to pick
        for note in result.notes:
            session.notify(Level.WARNING, note)
        lift_after_finding(session, preset)

    session.jobs.start(TITLE, stage, progress, done, end)


def take_groups(document: Document, found: Association) -> str:
    """Set the groups of the scene, but those that a person decided on stay; return what there is.

    Names, colors, weights and folders go with the groups that are there again.
    """
    # Numba and SciPy: imported when first needed, they take a part of the launch time.
    from gaga_core.grouping.add_views import with_decisions

    scene = document.settled().scene
    former, changed = scene.labels[: len(found.labels)], decided_groups(document.project)
    of_file, new_ids = with_decisions(former, found.labels, changed, scene.names)
    n_kept = int(of_file.max(initial=0)) - int(found.labels.max(initial=0))
    labels, others = regrouped(scene, of_file)
    kept = new_ids | others
    names = {kept[group]: name for group, name in scene.names.items() if group in kept}
    document.do(
        edits.together(
            TITLE,
            (
                edits.set_grouping(
                    scene,
                    labels,
                    found.bank,
                    names,
                    TITLE,
                    found.confidence,
                    scene.folders.renumbered(kept),
                ),
                *edits.carry_looks(scene, kept),
            ),
        )
    )
    text = f"Found {counted(int((document.read.objects(None, False).ids > 0).sum()), 'object')}."
    text += f" {n_kept} of them stay as you changed them." if n_kept else ""
    return text


def watch_bank(session: Session) -> tuple[Callable[[object], None], Callable[[], None]]:
    """Return the callbacks of a job that fills a memory bank: for its progress, for its end.

    While it runs the picture shows the groups growing; then what it showed before.
    """
    document, mode = session.document, session.view.mode

    def progress(payload: object) -> None:
        if isinstance(payload, BankSnapshot) and session.document is document:
            view = session.view
            view.mode = view.mode if session.live else Mode.GROUPS  # seen growing
            session.live = payload

    def end() -> None:
        session.view.mode = mode if session.live else session.view.mode
        session.live = None

    return progress, end


def associate_project_stage(
    project: Project,
    masks: MaskSet,
    config: AssociateConfig,
    rates: KnownRates,
) -> Stage[Association]:
    """Associate the masks of the train views (test views are for scores, as in ``gaga associate``).

    Works on the Gaussians of the file: the photos show them where they stood. ``rates``: see
    `stages.prepared`.
    """
    if project.folder is None or len(masks) == 0:
        raise GagaError("This scene has no masks. Put label maps into its masks folder first.")
    cameras = select_views(project.folder, "train")
    gaussians = stages.file_gaussians(project.scene)
    config = with_silhouettes(config, project.folder, masks)

    return stages.prepared(
        rates,
        TITLE,
        lambda: associate_stage(gaussians, cameras, masks, choose(), config),
        "Preparing (the first run takes a little longer)",
        usual_s=finding_seconds(project.scene, len(masks), config.preset),
        name=_rate_name(config.preset),
    )


@dataclass(frozen=True, eq=False)
class LiftedScene:
    """Result of a lift for the rows of the opened file."""

    labels: IntArray  # (M,)
    confidence: FloatArray  # (M,) 0..1
    colors: UInt8Array  # (M, 3) of the encodings


def lift_project_stage(
    project: Project, masks: MaskSet, mode: LiftMode, config: LiftConfig, rates: KnownRates
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
    cameras, bank, gaussians = (
        select_views(folder, "train"),
        scene.bank,
        stages.file_gaussians(scene),
    )

    def lift() -> Stage[LiftedScene]:
        checkpoint = folder.work / CHECKPOINT
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

    usual_s = lifting_seconds(mode, config, cameras)
    return stages.prepared(rates, STAGE, lift, usual_s=usual_s, name=f"{STAGE}, {mode}")


_no_identities = needs(
    lambda session: session.need().scene.identities.other is not None, NO_IDENTITIES
)


def _labels(source: LabelSource) -> Command:
    return Command(
        f"object.labels_{source}",
        f"Labels by {source}",
        lambda session: use_labels(session, source),
        enabled=_no_identities,
        is_on=lambda s: s.scene is not None and s.scene.identities.source == source,
    )


COMMANDS: tuple[Command, ...] = (
    Command(
        "object.associate",
        TITLE,
        associate,
        "Ctrl+G",
        enabled=no_masks,
    ),
    ask(
        "object.find_settings",
        "Find objects with settings…",
        Request.FIND_OBJECTS,
        enabled=no_masks,
    ),
    Command("object.lift", "Lift groups to identities", lift, enabled=no_bank),
    _labels("votes"),
    _labels("identities"),
)


# --- the stage that a scene needs next

# Measured on two cores: a depth picture, a vote and the gate, per view and million splats.
_SECONDS_PER_VIEW = {"paper": 0.6, "released": 0.4, "robust": 1.2}
_LEAST_SECONDS = 2.0
_SECONDS_PER_PHOTO = 0.7  # regions: depth, superpixels and merging
_SECONDS_PER_VIEW_LIFTED = {"vote": 0.1, "refine": 0.3, "paper": 0.1}  # the demo scene's views
_SECONDS_PER_STEP = 0.02  # of identities from zeros, 16,384 pixels each
_SECONDS_PER_PIXEL = 2.4e-6  # ... of a step on all pixels, measured on ycb_table


def training_seconds(config: LiftConfig, cameras: Sequence[Camera]) -> float:
    """Estimated time to train identities on views of ``cameras``."""
    n, whole = config.paper.rows.per_view, max((c.width * c.height for c in cameras), default=0)
    per_step = _SECONDS_PER_STEP * n / 16384 if n else _SECONDS_PER_PIXEL * whole
    return config.paper.iterations * per_step


def lifting_seconds(mode: LiftMode, config: LiftConfig, cameras: Sequence[Camera]) -> float:
    """Estimated time to lift groups to identities from views of ``cameras``."""
    training = training_seconds(config, cameras) if mode == "paper" else 0.0
    return len(cameras) * _SECONDS_PER_VIEW_LIFTED[mode] + training


def training_text(config: LiftConfig, cameras: Sequence[Camera]) -> str:
    """A sentence on the training of identities after an association."""
    n, seconds = config.paper.iterations, duration_text(training_seconds(config, cameras))
    return (
        f"Then {n:,} training steps, {seconds}. Cancel keeps the objects; the next run continues."
    )


@dataclass(frozen=True)
class StageOffer:
    """A missing stage. Without an ``action`` there is no button: the reason tells what to do."""

    reason: str  # "48 photos have masks but no objects yet."
    action: str = ""  # text of the button
    command: str = ""  # id in the command table
    seconds: float = 0.0  # estimate
    note: str = ""  # in brackets behind the action: "now, without a model"
    more: tuple[tuple[str, str], ...] = ()  # other ways: texts of buttons and their commands

    @property
    def label(self) -> str:
        """ "Make masks (now, without a model, about 20 s)", "Find objects, about 20 s"."""
        if self.note:
            return f"{self.action} ({', '.join(filter(None, (self.note, self.duration)))})"
        return self.short_label

    @property
    def short_label(self) -> str:
        """ "Make masks, about 20 s": where there is little room."""
        return ", ".join(filter(None, (self.action, self.duration)))

    @property
    def duration(self) -> str:
        """ "about 20 s", "about 3 min"; empty without an estimate."""
        return duration_text(self.seconds)


def duration_text(seconds: float) -> str:
    """ "about 20 s", "about 3 min", "about 2 h"; empty when it is not known."""
    if seconds <= 0:
        return ""
    if seconds < 90:
        return f"about {max(5 * round(seconds / 5), 5)} s"
    return in_minutes(seconds)


def in_minutes(seconds: float) -> str:
    """ "about 3 min", "about 2 h"."""
    if seconds < 5400:
        return f"about {round(seconds / 60)} min"
    return f"about {round(seconds / 3600)} h"


def _rate_name(preset: str) -> str:
    """Name of the rate that is kept of what finding objects takes here."""
    return f"Find objects, {preset}"


def finding_seconds(scene: Scene, n_masks: int, preset: str) -> float:
    """Seconds that finding objects takes on two idle cores."""
    millions = len(scene) / 1e6
    return _LEAST_SECONDS + n_masks * _SECONDS_PER_VIEW.get(preset, 1.0) * (0.1 + millions)


def offer_of(
    project: Project,
    n_masks: int,
    preset: str,
    training_s: float = 0.0,
    rate: float = 1.0,
    kernels_s: float = 0.0,
) -> StageOffer:
    """Return the stage that a scene without groups needs.

    ``n_masks``: views with masks; ``training_s``: what identities take after the groups; ``rate``:
    how many times as long as usual finding objects takes on this machine; ``kernels_s``: what
    kernels that are not compiled yet take here.
    """
    folder, scene = project.folder, project.scene
    if folder is None:
        return StageOffer(NO_OBJECTS_OF_A_FILE)
    if not folder.mask_folders:
        return _no_masks(folder)
    if n_masks == 0:
        names = ", ".join(folder.mask_folders)
        return StageOffer(f"No file in masks/{names} has the name of a photo. Rename the masks.")
    seconds = kernels_s + rate * finding_seconds(scene, n_masks, preset) + training_s
    return StageOffer(
        f"{_photos_have(n_masks)} masks but no objects yet.",
        TITLE,
        "object.associate",
        seconds,
    )


def _no_masks(folder: SceneFolder) -> StageOffer:
    if not folder.cameras:
        return StageOffer(
            "This folder has splats but no photos with known cameras, so no groups can be made. "
            "Put images/ and sparse/ next to them."
        )
    n_photos = sum(camera.name in folder.image_paths for camera in folder.cameras)
    if n_photos == 0:
        n = len(folder.cameras)
        missing = "The photo is" if n == 1 else f"The {n} photos are"
        return StageOffer(
            f"{missing} not in {folder.root.name}/images, so there is nothing to make masks of. "
            f"Put {'it' if n == 1 else 'them'} back, or import masks."
        )
    seconds = _LEAST_SECONDS + len(folder.train) * _SECONDS_PER_PHOTO
    n_needed = len(folder.train_photos) or n_photos
    n_tests = n_photos - n_needed  # they get none, so that there are fewer masks then
    rest = f"; {n_tests} more {'is' if n_tests == 1 else 'are'} for testing" if n_tests else ""
    reason = f"{_photos_have(n_needed)} no masks yet{rest}."
    more = (("", "object.masks_model"), ("Other ways…", "object.masks"))
    note = "now, without a model"
    return StageOffer(reason, "Make masks", "object.masks_quick", seconds, note, more)


def masks_now(session: Session) -> MaskSet:
    """The masks in use as they are on the disk now: files may have come since they were listed."""
    document = session.need()
    folder = document.project.folder
    path = folder.mask_folders.get(session.provider) if folder is not None else None
    if path is None or not path.is_dir():
        return session.masks
    key = (session.provider, path.stat().st_mtime_ns, session.masks)
    return document.read.once(
        "masks on disk", key, lambda: stages.masks_of(document.project, session.provider)[1]
    )


def bare_photos(session: Session) -> tuple[str, ...]:
    """Names of the training photos that have no masks yet."""
    folder = session.project.folder if session.project is not None else None
    if folder is None:
        return ()
    masks = masks_now(session)
    return tuple(name for name in folder.train_photos if name not in masks)


def _photos_have(n: int) -> str:
    return "1 photo has" if n == 1 else f"{n} photos have"


def stage_offer(session: Session) -> StageOffer | None:
    """Return the stage that the open scene needs next; None if none, or while a job runs."""
    document = session.document
    if document is None or session.jobs.why_busy or document.read.has_groups():
        return None
    trains = lift_mode(session.settings) == "paper"
    preset, training = session.settings.preset, 0.0
    if trains:
        options = session.feature(FindState).identities.config(preset, "paper")
        training = training_seconds(options, session.cameras)
    kernels_s, rates = stages.kernels_seconds("window", "grouping"), session.rates
    here = rates.of(_rate_name(preset)), kernels_s * rates.of(PREPARES)
    offer = offer_of(document.project, len(session.masks), preset, training, *here)
    n_bare = len(bare_photos(session)) if offer.command == "object.associate" else 0
    if not n_bare:
        return offer
    reason = f"{offer.reason} {_photos_have(n_bare)} no masks yet."
    return replace(offer, reason=reason, more=(("", "object.masks_rest"),))
