"""Repair of what the association got wrong: masks that belong elsewhere, objects that are two.

Long work runs as a job on values taken at the call; its result is one entry of the history.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.scene import Scene
from gaga_studio.actions import associate, unchanged
from gaga_studio.session import stages
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.grouping.repair.reassociate import Repair
    from gaga_core.grouping.repair.split_group import GroupSplit
    from gaga_core.grouping.repair.view_evidence import Evidence

# Where a mask can go besides an object: as in `gaga_core.grouping.repair.reassociate`.
NEW, NONE = -1, 0
_CHANGED = "The objects changed while this ran, so nothing is done. Try it again."
_NO_BANK = "Nothing is known of the masks behind these objects. Use Find objects first."


# --- a mask that belongs elsewhere


@notifies
def move_mask(session: Session, decision: Decision, group: int) -> bool:
    """Put a mask into another object (or `NEW`, `NONE`), and redo what follows from its view on."""
    document, bank = _with_bank(session)
    if group == decision.group:
        return False
    scene = document.settled().scene
    evidence = evidence_of(session, document)
    labels, confidence = file_columns(scene)
    is_same, (progress, end) = watch(session, document), associate.watch_bank(session)
    free = edits.free_group(scene)

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
        to = {NEW: "a new object", NONE: "no object"}.get(group, document.name_of(group))
        title = f"Move mask {decision.mask} of {decision.view} to {to}"
        document.do(_edit_of(document.settled().scene, labels, repair, title))
        document.focus = repair.group or document.focus
        session.notify(Level.INFO, repair.sentence())

    name = "Associate again"
    return session.jobs.start(name, stages.prepared(name, stage), progress, done, end)


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


# --- an object that is two


@notifies
def split_by_masks(session: Session) -> bool:
    """Take the selected object apart into the two things that its masks show."""
    document, bank = _with_bank(session)
    groups = document.read.selected_groups()
    if len(groups) != 1:
        raise GagaError("Select one object to split it.")
    group, name = groups[0], document.name_of(groups[0])
    scene = document.settled().scene
    evidence = evidence_of(session, document)
    log = document.read.decisions(group, None)
    labels, _ = file_columns(scene)
    rows = np.flatnonzero(labels == group).astype(np.int32)
    is_same = watch(session, document)

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
        title = f"Split {name} by its masks"
        document.do(edits.split_off(now, group, split.rows, new_bank, into, title))
        text = f"{name} is two now: {len(split.masks)} of its {len(log)} masks and "
        session.notify(Level.INFO, f"{text}{len(split.rows):,} splats left it.")

    return session.jobs.start(f"Split {name}", stages.prepared("Vote again", stage), None, done)


# --- what both read


def evidence_of(session: Session, document: Document) -> "Evidence":
    """Return the evidence of the views, cached in the document: they are rendered once.

    Raises ``GagaError`` when there are no masks.
    """
    from gaga_core.grouping.associate import AssociateConfig
    from gaga_core.grouping.repair.view_evidence import Evidence

    folder, bank = document.project.folder, document.scene.bank
    if folder is None or bank is None or len(session.masks) == 0:
        raise GagaError("This scene has no masks. Put label maps into its masks folder first.")
    key = (session.masks.source or session.provider, bank.preset)
    kept = document.evidence.get(key)
    if kept is None:
        train = set(folder.train)
        cameras = [camera for camera in folder.cameras if camera.name in train]
        gaussians = stages.file_gaussians(document.scene)
        kept = Evidence.of(gaussians, cameras, session.masks, AssociateConfig.of(bank.preset))
        document.evidence[key] = kept
    return kept


def file_columns(scene: Scene) -> tuple[IntArray, FloatArray | None]:
    """Return groups (N,) and confidence (N,) 0..1 of the rows of the opened file."""
    n = len(stages.file_gaussians(scene))
    if scene.confidence is None:
        return scene.labels[:n], None
    return scene.labels[:n], scene.confidence.astype(np.float32) / np.float32(255)


def _with_bank(session: Session) -> tuple[Document, MemoryBank]:
    document = session.need()
    if document.scene.bank is None:
        raise GagaError(_NO_BANK)
    return document, document.scene.bank


def watch(session: Session, document: Document) -> Callable[[], bool]:
    """Return a check for the end of a job: are the objects what they were? If not, it says so."""
    labels, bank = document.scene.labels, document.scene.bank

    def is_same() -> bool:
        now = document.settled().scene
        return now.bank is bank and np.array_equal(now.labels[: len(labels)], labels)

    return unchanged.watch(session, document, is_same, _CHANGED)
