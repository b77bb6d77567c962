"""The memory bank: repair, new views, replay, the splats of a mask, quality of objects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.grouping.associate import AssociateConfig, Association
from gaga_core.grouping.figures import BankGrowth
from gaga_core.grouping.memory_bank import Decision, MemoryBank, renumbered
from gaga_core.io.folder.scene_folder import select_views
from gaga_core.io.masks.label_maps import label_files_of, view_key
from gaga_core.masks import MaskSet
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.edits.splats import regrouped, spread
from gaga_core.scene.objects import ObjectTable, group_indices
from gaga_core.scene.scene import Scene
from gaga_studio.features import camera
from gaga_studio.features.base import (
    Command,
    ask,
    busy,
    first_of,
    need_bank,
    no_bank,
    no_masks,
    no_shown_bank,
    not_one_object,
    switch,
    watch,
)
from gaga_studio.features.find import association
from gaga_studio.session import stages
from gaga_studio.session.camera_rig import Pose
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.rates import KnownRates
from gaga_studio.session.scene_cache import groups_of
from gaga_studio.session.session import Session
from gaga_studio.session.view import Mode, ViewState

if TYPE_CHECKING:
    from gaga_core.evaluate.quality import GroupQuality, Quality
    from gaga_core.grouping.figures import BankGrowth, MaskSplats
    from gaga_core.grouping.repair.reassociate import Repair
    from gaga_core.grouping.repair.split_group import GroupSplit
    from gaga_core.grouping.repair.view_evidence import Evidence


Found = TypeVar("Found", Association, "Repair")


@dataclass
class Timeline:
    """The replay of the bank, step by step through its views."""

    growth: BankGrowth | None = None
    bank: MemoryBank | None = None  # that ``growth`` is of
    is_open: bool = False  # the picture shows the groups known at ``step``
    is_playing: bool = False
    follows: bool = True  # the camera flies to the view of the step
    step: int = 0
    waited_s: float = 0.0  # at this step
    former_mode: Mode = Mode.COLOR  # that comes back when the replay is closed
    came_from: tuple[Pose, int | None] | None = None  # the camera, and the photo, before it
    went_to: Pose | None = None  # where it brought the camera last

    def on_close(self, view: ViewState) -> None:
        """Show what was shown before the replay."""
        if self.is_open and view.mode is Mode.GROUPS:
            view.mode = self.former_mode


_Looked = tuple[str, "Evidence", str]  # a view, and the groups that it shows; "": not wanted


def masks_of_bank(session: Session) -> MaskSet:
    """The masks that the decisions of the memory bank are about."""
    document = session.need()
    folder, name = document.project.folder, document.project.bank_masks
    if folder is None or name == session.provider or name not in folder.mask_folders:
        return session.masks
    key = (name, folder.mask_folders[name])
    return document.read.once(
        "masks of the bank", key, lambda: stages.masks_of(document.project, name)[1]
    )


class KnownViews:
    """Findings in the masks of the views of a document."""

    def __init__(self) -> None:
        self.evidence: dict[tuple[str, str], Evidence] = {}  # by masks and preset
        self.looked_at: set[_Looked] = set()  # views
        self.seen: dict[_Looked, dict[int, dict[int, float]]] = {}  # see `shares_of_pixels`
        self.lit: tuple[object, MaskSplats | None] | None = None  # of one mask

    def forget(self) -> None:
        """Forget it: the masks are read again."""
        self.__init__()  # type: ignore[misc]


class ObjectQuality:
    """Measured quality of the objects of a document, at first what its scene folder keeps."""

    def __init__(self) -> None:
        self.by_labels: dict[str, Quality] | None = None  # by digest of the labels; None: not read


# --- Repair errors of the association: masks of other objects, two objects merged into one.
# Long work runs as a job on values taken at the call; its result is one entry of the history.


# Targets of a mask other than an object: as in `gaga_core.grouping.repair.reassociate`.
NEW, NONE = -1, 0
_CHANGED = "The objects changed meanwhile. Try again."
_OUTVOTED = (
    "No new object was made: masks of other views see all of its splats in other objects. Move "
    "those masks, or make it by a click (tool Object)."
)


# --- move a mask to another object


@notifies
def move_mask(session: Session, decision: Decision, group: int) -> bool:
    """Put a mask into another object (or `NEW`, `NONE`), and redo what follows from its view on."""
    document, bank = need_bank(session)
    if group == decision.group:
        return False
    scene = document.settled().scene
    evidence = evidence_of(session, document)
    labels, confidence = file_columns(scene)
    is_same, (progress, end) = watch_objects(session, document), association.watch_bank(session)
    free = edits.free_group(scene)
    to = {NEW: "a new object", NONE: "no object"}.get(group, document.name_of(group))
    title = f"Move mask {decision.mask} of {decision.view} to {to}"

    def stage() -> "Stage[Repair]":
        from gaga_core.grouping.repair.reassociate import (
            Move,
            reassociate_stage,  # numba, scipy
        )

        move = Move(decision.view, decision.mask, group)
        return reassociate_stage(evidence, bank, labels, confidence, move, choose(), free=free)

    def done(repair: "Repair") -> None:
        if not is_same():
            return
        if group == NEW and not (repair.labels == repair.group).any():
            session.notify(Level.WARNING, _OUTVOTED)
            return
        now = document.settled().scene
        moved = with_free_ids(edits.free_group(now), free, repair)
        document.do(_edit_of(now, labels, moved, title))
        document.focus = moved.group or document.focus
        session.notify(Level.INFO, repair.sentence())

    work = stages.prepared(session.rates, "Move mask", stage)
    return session.jobs.start(title, work, progress, done, end)


def _edit_of(scene: Scene, before: IntArray, repair: "Repair", title: str) -> edits.Edit | None:
    labels = repaired_labels(scene, before, repair.labels)
    grouping = edits.set_grouping(
        scene,
        labels,
        repair.bank,
        scene.names,
        title,
        confidence=repair.confidence,
        folders=scene.folders,
    )
    if not repair.group:
        return grouping
    return edits.together(title, (grouping, edits.select(scene, labels == repair.group)))


def repaired_labels(scene: Scene, before: IntArray, after: IntArray) -> IntArray:
    """Return groups (N,) of all splats when those of the opened file (M,) change.

    Copies follow their originals inside one object; added splats stay.
    """
    known = scene.source < len(before)
    rows = np.where(known, scene.source, 0)
    follows = known & (scene.labels == before[rows])
    labels: IntArray = np.where(follows, after[rows], scene.labels).astype(np.int32)
    return labels


def with_free_ids(first: int, free: int, found: Found) -> Found:
    """``found`` with its new groups, whose ids begin at ``free``, from ``first`` on: copies that
    were made meanwhile have the ids between."""
    ids = (found.labels, found.bank.group)
    last = max(found.bank.n_groups, *(int(one.max(initial=0)) for one in ids))
    if first <= free or last < free:
        return found
    to = np.arange(last + 1, dtype=np.int32)
    to[free:] += first - free
    changed = replace(found, bank=renumbered(found.bank, to, int(to[-1])), labels=to[found.labels])
    return (
        changed
        if isinstance(changed, Association)
        else replace(changed, group=int(to[changed.group]))
    )


# --- split an object by its masks


@notifies
def split_by_masks(session: Session) -> bool:
    """Take the selected object apart into the two objects that its masks show."""
    document, bank = need_bank(session)
    groups = document.read.selected_groups()
    if len(groups) != 1:
        raise GagaError("Select one object to split it.")
    group, name = groups[0], document.name_of(groups[0])
    scene = document.settled().scene
    evidence = evidence_of(session, document)
    log = document.read.decisions(group, None)
    labels, _ = file_columns(scene)
    rows = np.flatnonzero(labels == group).astype(np.int32)
    is_same = watch_objects(session, document)

    def stage() -> "Stage[GroupSplit]":
        from gaga_core.grouping.repair.split_group import split_group_stage

        return split_group_stage(evidence, log, rows, choose(), name=name)

    def done(split: "GroupSplit") -> None:
        if not is_same():
            return
        from gaga_core.grouping.repair.split_group import split_bank

        now = document.settled().scene
        into = edits.free_group(now)
        new_bank = split_bank(bank, split, group, into)
        title = f"Split {document.titled(group)} by its masks"
        document.do(edits.split_off(now, group, split.rows, new_bank, into, title))
        text = f"{name} is two now: {len(split.masks)} of its {counted(len(log), 'mask')} and "
        session.notify(Level.INFO, f"{text}{counted(len(split.rows), 'splat')} left it.")

    return session.jobs.start(
        f"Split {name}",
        stages.prepared(session.rates, "Vote again", stage),
        None,
        done,
    )


# --- shared by both repairs


def evidence_of(session: Session, document: Document) -> "Evidence":
    """Return the evidence of the views, cached in the document: they are rendered once.

    Raises ``GagaError`` when there are no masks.
    """
    from gaga_core.grouping.associate import AssociateConfig
    from gaga_core.grouping.repair.view_evidence import Evidence

    folder, bank = document.project.folder, document.scene.bank
    masks = masks_of_bank(session)
    if folder is None or bank is None or len(masks) == 0:
        raise GagaError("This scene has no masks. Put label maps into its masks folder first.")
    key = (masks.source or session.provider, bank.preset)
    kept = document.feature(KnownViews).evidence.get(key)
    if kept is None:
        train = set(folder.train)
        cameras = [camera for camera in folder.cameras if camera.name in train]
        gaussians = stages.file_gaussians(document.scene)
        kept = Evidence.of(gaussians, cameras, masks, AssociateConfig.of(bank.preset))
        document.feature(KnownViews).evidence[key] = kept
    return kept


def file_columns(scene: Scene) -> tuple[IntArray, FloatArray | None]:
    """Return groups (N,) and confidence (N,) 0..1 of the rows of the opened file."""
    n = len(stages.file_gaussians(scene))
    if scene.confidence is None:
        return scene.labels[:n], None
    return scene.labels[:n], scene.confidence.astype(np.float32) / np.float32(255)


def watch_objects(session: Session, document: Document) -> Callable[[], bool]:
    """Return a check for the end of a job: are the objects what they were? If not, it says so."""
    labels, bank = document.scene.labels, document.scene.bank

    def is_same() -> bool:
        now = document.settled().scene
        return now.bank is bank and np.array_equal(now.labels[: len(labels)], labels)

    return watch(session, document, _CHANGED, is_same)


# --- which object the panel is about


def group_of_panel(session: Session) -> int:
    """Return the object whose masks are shown: the one in the inspector, or the only one that is
    selected; 0 without."""
    groups = session.selected_groups()
    return session.focus if session.focus in groups else groups[0] if len(groups) == 1 else 0


def made_from(session: Session, group: int) -> int:
    """Return the object that the masks of ``group`` made: itself, or what it was split off.

    A part that was cut off by hand has no masks of its own.
    """
    document, bank = session.need(), session.need().scene.bank
    if bank is None or session.live is not None or document.read.decisions(group, None):
        return group

    def find() -> int:
        rows = group_indices(document.scene, group)
        before = spread(document.scene, groups_of(bank))[rows]  # of the originals
        return int(np.bincount(before).argmax()) if len(rows) else 0

    scene = document.scene
    return document.read.once("made from", (group, bank, scene.revision.labels), find) or group


def split_from(session: Session, group: int) -> int:
    """Return how many objects were split off ``group`` by hand, whose masks it still lists."""
    document, bank = session.need(), session.need().scene.bank
    if bank is None or session.live is not None:
        return 0

    def find() -> int:
        scene = document.scene
        was = spread(scene, groups_of(bank)) == group
        of_it, of_all = np.bincount(scene.labels[was]), np.bincount(scene.labels)
        others = np.flatnonzero(2 * of_it > of_all[: len(of_it)]).tolist()
        return len(
            [
                other
                for other in others
                if other not in (0, group)
                and not document.read.decisions(other, None)
                and not is_copy(document, other)
            ]
        )

    key = (group, bank, document.scene.revision.labels)
    return document.read.once("split from", key, find)


def is_copy(document: Document, group: int) -> bool:
    """Whether all splats of an object are duplicates of others."""
    scene = document.scene
    return bool((group_indices(scene, group) >= scene.n_opened).all())


# --- photos and masks that came later

_NO_OBJECTS = "There are no objects that more photos could improve. Use Find objects first."
_LEVELS = "These objects have levels of detail, which need all photos at once. Use Find objects."
_IDENTITIES = "The objects come from identities now. Choose Labels by votes first."


def new_views(session: Session) -> tuple[str, ...]:
    """Return the names of views with masks that took no part in the objects."""
    document = session.document
    if document is None or document.project.folder is None or document.scene.bank is None:
        return ()
    folder, bank, masks = (
        document.project.folder,
        document.scene.bank,
        association.masks_now(session),
    )

    def find() -> tuple[str, ...]:
        known = {decision.view for decision in bank.log}
        return tuple(name for name in folder.train if name in masks and name not in known)

    return document.read.once("new views", (bank, masks, folder.train), find)


def why_no_new_views(session: Session) -> str:
    """Return why nothing can be added, "" when something can."""
    scene = session.scene
    if scene is None or scene.bank is None:
        return _NO_OBJECTS
    if scene.bank.levels is not None or session.masks.are_regions:
        return _LEVELS
    if scene.identities.source == "identities":
        return _IDENTITIES
    if new_views(session):
        return _of_other_masks(session, scene.bank)
    return f"All photos with masks are used already. {text_on_bare_photos(session)}".rstrip()


def _of_other_masks(session: Session, bank: MemoryBank) -> str:
    """A sentence where most photos of the objects have none of the masks in use, "" elsewhere:
    what these would join is what those had said."""
    masks = association.masks_now(session)

    def count() -> tuple[int, int]:
        known = {decision.view for decision in bank.log}
        return len(known), sum(name in masks for name in known)

    n, n_there = session.need().read.once("views with masks", (bank, masks), count)
    if 2 * n_there > n:
        return ""
    return (
        f"The objects are of {counted(n, 'photo')}, of which {n_there} have masks in "
        f"{session.provider}. Choose the masks that they were made of (Use the masks of), or use "
        "Find objects."
    )


def where_masks_are(session: Session, decision: Decision) -> str:
    """Why the mask of a decision cannot be shown: it is gone, or in a folder that is not in use."""
    document = session.need()
    folder = document.project.folder
    paths = {} if folder is None else {n: p for n, p in folder.mask_folders.items() if p.is_dir()}
    inner = PurePosixPath(view_key(decision.view)).parent
    places = [place for path in paths.values() for place in (path, path / inner)]
    changed = tuple(place.stat().st_mtime_ns for place in places if place.is_dir())

    def find() -> list[str]:
        known, view = [camera.name for camera in document.cameras], [decision.view]
        return [name for name, path in paths.items() if label_files_of(path, view, known)]

    names = document.read.once("folders of a mask", (decision.view, *paths, changed), find)
    if not names or session.provider in names:
        return "Its masks are gone."
    return f"Its masks are those of {names[0]}, and others are in use: Find, Use the masks of."


def text_on_bare_photos(session: Session) -> str:
    """Return a sentence on photos without masks, "" when there are none."""
    n, folder = len(association.bare_photos(session)), session.need().project.folder
    have = "1 photo has" if n == 1 else f"{n:,} photos have"
    several = folder is not None and len(folder.mask_folders) > 1
    there = f" in {session.provider}" if several else ""
    return f"{have} no masks yet{there}: use Make masks." if n else ""


def consequences_of_adding(session: Session) -> tuple[str, ...]:
    """Return sentences on what happens to what a person did, before it is done."""
    scene = session.need().scene
    said = [
        "Names, colors, folders and parents stay; so do merged and split objects, "
        "and masks that you moved."
    ]
    if scene.bank is not None and scene.bank.is_published:
        said.append(
            "Splats that you put elsewhere by hand can follow the new masks: the preset "
            f"{scene.bank.preset.capitalize()} does not distinguish them from others."
        )
    else:
        said.append("Splats that you put elsewhere by hand stay there.")
    if scene.identities.colors is not None:
        said.append(
            "Identities cover only the earlier photos, so they are removed: lift them again."
        )
    return tuple(said)


@notifies
def add_views(session: Session) -> bool:
    """Associate the new views, as a job; False when another job runs."""
    # Numba and SciPy: imported when first needed, they take a part of the launch time.
    from gaga_core.grouping.add_views import EditedGroups, add_to_edited_stage

    document = session.need()
    folder, scene = document.project.folder, document.settled().scene
    if folder is None or scene.bank is None:
        return False
    session.masks = masks = association.masks_now(session)
    labels, confidence = file_columns(scene)
    edited = EditedGroups(scene.bank, labels, confidence, edits.free_group(scene))
    cameras, gaussians = select_views(folder, "train"), stages.file_gaussians(scene)
    config, n_new = AssociateConfig.of(scene.bank.preset), len(new_views(session))
    is_same = watch_objects(session, document)
    progress, end = association.watch_bank(session)
    n_before = len(set(scene.labels.tolist()) - {0})

    def done(found: Association) -> None:
        if not is_same():
            return
        now = document.settled().scene
        found = with_free_ids(edits.free_group(now), edited.free, found)
        after = repaired_labels(now, labels, found.labels)
        title = f"Add the masks of {counted(n_new, 'photo')}"
        document.do(
            edits.set_grouping(
                now, after, found.bank, now.names, title, found.confidence, now.folders
            )
        )
        n = len(set(document.scene.labels.tolist()) - {0}) - n_before
        opened = f"{n} new objects" if n > 1 else "one new object" if n == 1 else "no new object"
        session.notify(
            Level.INFO, f"The masks of {counted(n_new, 'photo')} joined the objects: {opened}."
        )
        association.lift_after_finding(session, config.preset)

    stage = stages.prepared(
        session.rates,
        "Add views",
        lambda: add_to_edited_stage(gaussians, cameras, masks, edited, choose(), config),
        "Preparing (the first run takes a little longer)",
        usual_s=association.finding_seconds(scene, n_new, config.preset),
    )
    return session.jobs.start("Add photos and masks", stage, progress, done, end)


# --- replay

_ALL_S, _LEAST_S, _MOST_S = 16.0, 0.15, 0.8  # of a replay, and of one view


def timeline_of(session: Session) -> Timeline:
    """Return the replay of the open scene; a closed one when nothing is open."""
    return session.document.feature(Timeline) if session.document is not None else Timeline()


@notifies
def toggle_timeline(session: Session) -> bool:
    """Open the replay, as a job where the growth is not known yet; or close it."""
    document = session.need()
    timeline, bank = document.feature(Timeline), document.scene.bank
    if timeline.is_open:
        close_timeline(session)
        return True
    session.request = Request.TIMELINE
    if bank is None:
        raise GagaError("The memory bank is empty. Use Find objects first.")
    if timeline.growth is not None and timeline.bank is bank:
        _show(session, document)
        return True
    evidence, (labels, _) = evidence_of(session, document), file_columns(document.scene)

    def stage() -> "Stage[BankGrowth]":
        from gaga_core.grouping.figures import growth_stage  # numba

        return growth_stage(evidence.gated, bank, labels, choose())

    def done(growth: "BankGrowth") -> None:
        if session.document is document and document.scene.bank is bank:
            timeline.growth, timeline.bank = growth, bank
            _show(session, document)

    name = "Replay the memory bank"
    return session.jobs.start(name, stages.prepared(session.rates, name, stage), on_done=done)


def _show(session: Session, document: Document) -> None:
    timeline = document.feature(Timeline)
    timeline.former_mode, session.view.mode = session.view.mode, Mode.GROUPS
    timeline.is_open = timeline.is_playing = True
    timeline.came_from, timeline.went_to = (session.rig.goal, session.active_view), None
    go_to_step(session, 0)


def close_timeline(session: Session) -> None:
    """Show the scene as it is again, from where the camera stood before the replay.

    A view mode that was chosen during the replay, and a camera moved by hand, stay.
    """
    timeline = timeline_of(session)
    if timeline.is_open:
        timeline.is_open = timeline.is_playing = False
        if session.view.mode is Mode.GROUPS:
            session.view.mode = timeline.former_mode
        if timeline.came_from is not None and timeline.went_to is session.rig.goal:
            pose, session.active_view = timeline.came_from
            session.rig.return_to(pose)


def toggle_timeline_playing(session: Session) -> None:
    """Play, from the start when it had ended; or stop."""
    timeline = timeline_of(session)
    if timeline.growth is None or not timeline.is_open:
        return
    timeline.is_playing = not timeline.is_playing
    if timeline.is_playing and timeline.step >= timeline.growth.last_step:
        go_to_step(session, 0)


def go_to_step(session: Session, step: int) -> None:
    """Show the bank after ``step`` views, or at the nearest step that there is."""
    timeline = timeline_of(session)
    growth = timeline.growth
    if growth is None:
        return
    timeline.step, timeline.waited_s = min(max(step, 0), growth.last_step), 0.0
    view = view_of_step(session)
    index = camera.view_index(session, view) if view else None
    if timeline.follows and index is not None:
        camera.go_to_view(session, index)
        timeline.went_to = session.rig.goal


def set_follows(session: Session, follows: bool) -> None:
    """Let the camera follow the views, or stay where it is."""
    timeline_of(session).follows = follows
    if follows:
        go_to_step(session, timeline_of(session).step)


def views_text(session: Session, views: Sequence[str]) -> str:
    """Say which ``views`` made the groups: "All 35 training photos" of a scene of 40 photos."""
    folder = session.need().project.folder
    train = folder.train if folder is not None else ()
    kind = "training photos" if len(train) < len(session.cameras) else "photos"
    if not set(views) <= set(train):
        return f"All {counted(len(views), 'photo')}"
    of = f"All {len(train)}" if len(views) == len(train) else f"{len(views)} of {len(train)}"
    return f"{of} {kind}"


def view_of_step(session: Session) -> str:
    """Return the view whose masks came last; "" before the first and at the end."""
    timeline = timeline_of(session)
    growth = timeline.growth
    if growth is None or not 0 < timeline.step < growth.last_step:
        return ""
    return growth.views[timeline.step - 1]


def tick_timeline(session: Session, dt: float) -> None:
    """Advance the replay, once a frame. It ends when its bank does: edits and jobs replace it."""
    timeline = timeline_of(session)
    growth, scene = timeline.growth, session.scene
    if scene is None or growth is None or not timeline.is_open:
        return
    if scene.bank is not timeline.bank or session.live is not None:
        close_timeline(session)
        return
    if not timeline.is_playing:
        return
    timeline.waited_s += dt
    if timeline.waited_s >= min(max(_ALL_S / growth.last_step, _LEAST_S), _MOST_S):
        go_to_step(session, timeline.step + 1)
        timeline.is_playing = timeline.step < growth.last_step


def timeline_labels(session: Session) -> IntArray | None:
    """Return the group (N,) of each splat at this step; None when the scene's own are shown.

    At the last step that is so: the saved groups, with the edits since then.
    """
    document, timeline = session.document, timeline_of(session)
    growth, step = timeline.growth, timeline.step
    if document is None or growth is None or not timeline.is_open or step == growth.last_step:
        return None
    scene = document.scene
    key = (growth, step, scene.revision.splats)
    return document.read.once("timeline", key, lambda: regrouped(scene, growth.labels_at(step))[0])


def bank_at(session: Session) -> MemoryBank | None:
    """Return the bank with the decisions made up to this step; None without a replay."""
    document, timeline = session.document, timeline_of(session)
    bank, growth = timeline.bank, timeline.growth
    if document is None or bank is None or growth is None:
        return None
    step = min(timeline.step, len(growth.views))
    key = (bank, step)
    return document.read.once(
        "bank at", key, lambda: replace(bank, log=bank.log[: growth.n_decisions[step]])
    )


# --- the splats of a mask, lit in the picture

# Red, green, blue and share 0..255 of a color over the splat's own.
IN_GATE = (255, 176, 32, 235)
CUT_OFF = (226, 58, 190, 235)  # behind the mask, but not at the depth of its surface
REST = (36, 37, 42, 165)


def mask_splats_of(session: Session, decision: Decision) -> "MaskSplats | None":
    """Return the splats behind a mask; None until a quiet job has read its view, or if it cannot.

    Ask again in a later frame.
    """
    view = _view_of(session, decision)
    if view is None:
        return None
    document, evidence, camera = view
    known, looked = document.feature(KnownViews), _looked(document, evidence, camera)
    if session.jobs.quiet is None and looked not in known.looked_at:
        known.looked_at.add(looked)  # once: a view that cannot be read fails every time
        labels = file_columns(document.scene)[0] if shows_pixels(document) else None
        stage = _look_stage(evidence, camera, session.rates, labels, known.seen, looked)
        session.jobs.start_quiet("Look at the view", stage)
    if decision.view not in evidence.bounds:
        return None
    key = (decision.view, decision.mask, evidence)
    if known.lit is None or known.lit[0] != key:
        known.lit = (key, _splats(evidence, camera, decision.mask))
    return known.lit[1]


def _splats(evidence: "Evidence", camera: Camera, mask: int) -> "MaskSplats | None":
    from gaga_core.grouping.figures import mask_splats  # numba

    try:
        return mask_splats(evidence.gated, camera, mask)
    except GagaError:  # the masks were made again: nothing is lit, and there are no shares
        return None


def mask_overlaps(
    session: Session, decision: Decision, *, has_gate: bool = True
) -> dict[int, float] | None:
    """Return the share of a mask that each group holds, descending: of the splats behind it, or of
    its pixels where `shows_pixels`.

    0 is no group. None until a quiet job has read its view: ask again in a later frame. Empty when
    the masks are gone. The same dict as long as nothing changed.
    """
    view, splats = _view_of(session, decision), mask_splats_of(session, decision)
    if view is None:
        return {}
    document = view[0]
    if splats is not None and shows_pixels(document, has_gate=has_gate):
        by_mask = document.feature(KnownViews).seen.get(_looked(*view))
        if by_mask is not None:
            return by_mask.get(decision.mask, {})
        splats = None
    if splats is None:
        return None if session.jobs.quiet is not None else {}
    from gaga_core.grouping.figures import shares_of_groups  # numba

    chosen, scene = splats.of(has_gate), document.scene
    key = (splats, has_gate, scene.revision.splats, scene.revision.labels)
    return document.read.once(
        "shares", key, lambda: shares_of_groups(scene.labels[: len(chosen)], chosen)
    )


def shows_pixels(document: Document, *, has_gate: bool = True) -> bool:
    """Whether `mask_overlaps` tells what a mask shows, by pixels, for the masks were decided so.

    They were by points on the surfaces that they show. Splats behind a mask say otherwise: large
    ones are few, and those of a thing in front of another may all lie nearer than the gate accepts.
    """
    return has_gate and document.read.overlap_is_of_points()


def _looked(document: Document, evidence: "Evidence", camera: Camera) -> _Looked:
    groups = document.read.labels_digest() if shows_pixels(document) else ""
    return camera.name, evidence, groups


def mask_tint(session: Session, decision: Decision | None) -> UInt8Array | None:
    """Return the colors (N, 4) that light up the splats of a mask; None when nothing is lit.

    The same array as long as nothing changed.
    """
    document = session.document
    if document is None or decision is None or not session.view.lights_masks:
        return None
    splats = mask_splats_of(session, decision)
    if splats is None:
        return None
    has_gate, revision = session.view.has_mask_gate, document.scene.revision.splats
    key = (splats, has_gate, revision)
    return document.read.once("tint", key, lambda: _colors(document, splats, has_gate))


def _colors(document: Document, splats: "MaskSplats", has_gate: bool) -> UInt8Array:
    """Colors (N, 4) of all splats; copies have those of their originals, added ones are dim."""
    kind = splats.gated.astype(np.uint8)
    if not has_gate:
        kind += 2 * (splats.behind & ~splats.gated).astype(np.uint8)
    kind = np.append(kind, np.uint8(0))
    table = np.array([REST, IN_GATE, CUT_OFF], np.uint8)
    colors: UInt8Array = table[kind[np.minimum(document.scene.source, len(kind) - 1)]]
    return colors


def _view_of(session: Session, decision: Decision) -> "tuple[Document, Evidence, Camera] | None":
    """Return what a mask is looked up in; None when its masks are gone."""
    document = session.document
    if document is None or document.scene.bank is None:
        return None
    try:
        evidence = evidence_of(session, document)
        return document, evidence, evidence.camera(decision.view)
    except GagaError:  # there are no masks of this view
        return None


def _look_stage(
    evidence: "Evidence",
    camera: Camera,
    rates: KnownRates,
    labels: IntArray | None,  # (N,) of the rows of the file
    seen: dict[_Looked, dict[int, dict[int, float]]],
    looked: _Looked,
) -> Stage[object]:
    """Find the accepted depths of the masks of one view, and what they show of ``labels``."""

    def gather() -> Stage[object]:
        from gaga_core.grouping.figures import shares_of_pixels
        from gaga_core.grouping.repair.view_evidence import gather_stage

        yield from gather_stage(evidence.only([camera]), choose(), only_bounds=True)
        if labels is not None:
            frame = choose().label_splat(evidence.gaussians, camera, labels)
            seen[looked] = shares_of_pixels(evidence.masks_of(camera), frame.labels)
        return None

    return stages.prepared(rates, "Look at the view", gather)


# --- quality of the objects


@notifies
def measure_quality(session: Session) -> bool:
    """Compare every object's picture with its masks, view by view."""
    document = session.need()
    scene = document.settled().scene
    evidence, bank = evidence_of(session, document), scene.bank
    assert bank is not None  # `evidence_of` looked
    labels, confidence = file_columns(scene)
    digest = document.read.labels_digest()

    def stage() -> "Stage[Quality]":
        from gaga_core.evaluate.quality import quality_stage

        return quality_stage(evidence, bank, labels, confidence, choose())

    def done(found: "Quality") -> None:
        from gaga_core.evaluate.quality import write_quality

        measured = _measured(document)
        measured.pop(digest, None)
        measured[digest] = found
        folder = document.project.folder
        assert folder is not None  # `evidence_of` looked
        try:
            write_quality(folder.work, found, bank, digest)
        except GagaError as error:
            session.notify(Level.WARNING, f"The measurement is shown, but not kept: {error}")

    title = "Measure the objects"
    return session.jobs.start(title, stages.prepared(session.rates, title, stage), None, done)


def _measured(document: Document) -> "dict[str, Quality]":
    """What was measured, the newest last, by digest of the labels."""
    state = document.feature(ObjectQuality)
    if state.by_labels is None:
        state.by_labels = {}
        folder, bank = document.project.folder, document.scene.bank
        if folder is not None and bank is not None:
            from gaga_core.evaluate.quality import read_quality

            state.by_labels = read_quality(folder.work, bank)
    return state.by_labels


def shown_quality(session: Session) -> "tuple[Quality | None, bool]":
    """Return the newest measurement, and whether it is of the present groups."""
    found = {} if session.document is None else _measured(session.document)
    if session.document is None or not found:
        return None, False
    now = found.get(session.document.read.labels_digest())
    return (now, True) if now is not None else (list(found.values())[-1], False)


def quality_of(session: Session, group: int) -> "GroupQuality | None":
    """Return the measurement of one object, None if there is none."""
    found, _ = shown_quality(session)
    return None if found is None else found.groups.get(group)


def quality_column(session: Session, table: ObjectTable) -> DoubleArray:
    """Return the agreement (G,) of the rows of the list, -1 where nothing is known."""
    found, _ = shown_quality(session)
    return np.full(len(table), -1.0) if found is None else found.agreement(table.ids)


def worst_view(session: Session) -> None:
    """Fly to the photo in which the object in the inspector agrees least with its masks."""
    found = quality_of(session, session.focus)
    if found is not None and found.views:
        index = camera.view_index(session, found.views[0].view)
        if index is not None:
            camera.go_to_view(session, index)


def _no_mask_split(session: Session) -> str:
    """Needs one selected object that several masks joined, and the job runner."""
    if reason := not_one_object(session) or no_bank(session):
        return reason
    n_masks = len(session.decisions(session.selected_groups()[0]))
    return "" if n_masks > 1 else "An object needs two masks or more to be split by them."


def _no_quality(session: Session) -> str:
    """Needs the measured quality of the object in the inspector."""
    if quality_of(session, session.focus) is not None:
        return ""
    if session.document is None or not session.focus:
        return not_one_object(session)
    return "Nothing is measured of this object. Use Measure the quality of the objects first."


_no_replay = first_of(no_shown_bank, busy)
COMMANDS: tuple[Command, ...] = (
    ask(
        "object.add_views",
        "Add new photos and masks…",
        Request.ADD_VIEWS,
        enabled=first_of(no_masks, why_no_new_views),
    ),
    Command(
        "object.quality", "Measure the quality of the objects", measure_quality, enabled=no_bank
    ),
    Command("object.worst_view", "Go to the worst view", worst_view, enabled=_no_quality),
    Command(
        "object.split_masks",
        "Split into the two objects that its masks show",
        split_by_masks,
        enabled=_no_mask_split,
    ),
    switch(
        "view.lights_masks",
        "Light up the splats of the chosen mask",
        "lights_masks",
        enabled=no_shown_bank,
    ),
    switch(
        "view.mask_gate", "Depth gate of the chosen mask", "has_mask_gate", enabled=no_shown_bank
    ),
    Command(
        "view.timeline",
        "Replay the memory bank",
        toggle_timeline,
        enabled=lambda s: "" if timeline_of(s).is_open else _no_replay(s),
        is_on=lambda s: timeline_of(s).is_open,
    ),
)
