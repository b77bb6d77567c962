"""Level of detail of objects that no model made: of all, seen while dragged, and of one object."""

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import MemoryBank, at_level
from gaga_core.scene import edits
from gaga_core.scene.edits.splats import spread
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session


def levels_of(session: Session) -> Levels | None:
    """The levels of the open scene; None where its groups have none, or while they are made."""
    if session.scene is None or session.jobs.running is not None:
        return None
    bank = session.scene.bank
    return None if bank is None else bank.levels


def preview(session: Session, level: int) -> None:
    """Show the groups of a level, in the list and the picture, until `choose` or `cancel`."""
    bank = _bank(session)
    session.live = BankSnapshot("", at_level(bank, level), 0, keeps_ids=True)


def cancel(session: Session) -> None:
    """Show the groups of the scene again."""
    session.live = None


def choose(session: Session, level: int) -> None:
    """Give every splat its group of this level, as one edit.

    Corrections by hand of the groups before are replaced, too. Groups that are there at both
    levels keep their names.
    """
    cancel(session)
    document = session.need()
    scene = document.settled().scene
    bank = at_level(_bank(session), level)
    labels = spread(scene, bank.levels.labels[level] if bank.levels else bank.group)
    there = set(labels.tolist())
    names = {group: name for group, name in scene.names.items() if group in there}
    sure = (
        None if scene.confidence is None else scene.confidence.astype(np.float32) / np.float32(255)
    )
    order = scene.folders.renumbered({group: group for group in there if group > 0})
    document.do(edits.set_grouping(scene, labels, bank, names, "Change detail", sure, order))


@notifies
def split_here(session: Session) -> bool:
    """Make objects of the parts that the selected object has one level finer."""
    document = session.need()
    group = _selected_object(session)
    name = document.name_of(group)
    edit = edits.split_here(document.settled().scene, group, f"Split {name} here")
    if edit is None:
        raise GagaError(f"{name} has no parts at any level. Paint a part of it and use Separate.")
    return document.do(edit)


@notifies
def join_here(session: Session) -> bool:
    """Join the selected object with those that are one thing with it one level coarser."""
    document = session.need()
    group = _selected_object(session)
    name = document.name_of(group)
    edit = edits.join_here(document.settled().scene, group, f"Join {name} here")
    if edit is None:
        raise GagaError(f"{name} is one thing at all levels. Select others too, and use Merge.")
    return document.do(edit)


def _selected_object(session: Session) -> int:
    groups = session.selected_groups()
    if len(groups) != 1:
        raise GagaError("Select one object.")
    return int(groups[0])


def _bank(session: Session) -> MemoryBank:
    bank = session.need().settled().scene.bank
    if bank is None or bank.levels is None:
        raise ValueError("session: the scene has no levels of detail")
    return bank
