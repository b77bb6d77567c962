"""Quality of the objects: measured on demand, cached for every state of the groups."""

from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.scene.objects import ObjectTable
from gaga_studio.actions import association_repair, navigation
from gaga_studio.session import stages
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.evaluate.quality import GroupQuality, Quality


@notifies
def measure(session: Session) -> bool:
    """Compare every object's picture with its masks, view by view."""
    document = session.need()
    scene = document.settled().scene
    evidence, bank = association_repair.evidence_of(session, document), scene.bank
    assert bank is not None  # `evidence_of` looked
    labels, confidence = association_repair.file_columns(scene)
    digest = document.read.labels_digest()

    def stage() -> "Stage[Quality]":
        from gaga_core.evaluate.quality import quality_stage

        return quality_stage(evidence, bank, labels, confidence, choose())

    def done(found: "Quality") -> None:
        document.quality[digest] = found

    title = "Measure the objects"
    return session.jobs.start(title, stages.prepared(title, stage), None, done)


def shown(session: Session) -> "tuple[Quality | None, bool]":
    """Return the newest measurement, and whether it is of the present groups."""
    document = session.document
    if document is None or not document.quality:
        return None, False
    now = document.quality.get(document.read.labels_digest())
    return (now, True) if now is not None else (list(document.quality.values())[-1], False)


def of_group(session: Session, group: int) -> "GroupQuality | None":
    """Return the measurement of one object, None if there is none."""
    found, _ = shown(session)
    return None if found is None else found.groups.get(group)


def column(session: Session, table: ObjectTable) -> DoubleArray:
    """Return the agreement (G,) of the rows of the list, -1 where nothing is known."""
    found, _ = shown(session)
    return np.full(len(table), -1.0) if found is None else found.agreement(table.ids)


def worst_view(session: Session) -> None:
    """Fly to the photo in which the object in the inspector agrees least with its masks."""
    found = of_group(session, session.focus)
    if found is not None and found.views:
        index = navigation.view_index(session, found.views[0].view)
        if index is not None:
            navigation.go_to_view(session, index)
