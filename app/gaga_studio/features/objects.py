"""Edits of objects: of the selected ones, and of one line of the list.

Each is one entry of the history.
"""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import MemoryBank, at_level
from gaga_core.scene import edits
from gaga_core.scene.edits.append import spread
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection import algebra
from gaga_studio.features import folders
from gaga_studio.features.base import (
    Command,
    ask,
    first_of,
    needs,
    no_scene,
    no_selection,
    not_one_object,
)
from gaga_studio.features.object_list import levels_of
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session

# --- Edits of objects: of the selected ones, and of one line of the list.
# Each is one entry of the history.


_FEW = 3  # objects that are shown while the others are isolated from them

# --- the selected splats


@notifies
def hide(session: Session) -> bool:
    """Hide the selected splats, and what lies under objects that are selected whole."""
    return folders.edit_along(session, "Hide", edits.hide)


@notifies
def isolate(session: Session) -> bool:
    """Hide everything but the selected splats; show all again when that is so already."""
    done = folders.edit_along(session, "Isolate", edits.isolate, with_locked=True)
    return done or show_all(session)


@notifies
def delete(session: Session) -> bool:
    """Delete the selected splats, and what lies under objects that are selected whole."""
    document = session.need()
    under = folders.along(session).groups
    said = folders.title_along(document, "Deleted", under)
    if not folders.edit_along(session, "Delete", edits.delete):
        return False
    if under:
        session.notify(Level.INFO, f"{said}. Undo brings them back.")
    return True


@notifies
def lock(session: Session) -> bool:
    """Protect the selected splats from being selected."""
    return folders.edit_along(session, "Lock", edits.lock)


@notifies
def separate(session: Session) -> bool:
    """Make the selected splats an object of their own."""
    return session.need().edit_selected("Separate", edits.separate)


@notifies
def merge(session: Session) -> bool:
    """Make the selected objects one."""
    document = session.need()
    groups = document.read.selected_groups()
    return document.edit_selected(
        "Merge", lambda scene, _, title: edits.merge_groups(scene, groups, title)
    )


@notifies
def split(session: Session) -> bool:
    """Split the selected object into the components that do not touch."""
    document = session.need()
    groups = document.read.selected_groups()
    if len(groups) != 1:
        raise GagaError("Select one object to split it.")
    name = document.name_of(groups[0])
    edit = edits.split(document.settled().scene, groups[0], title=f"Split {name}")
    if edit is None:
        raise GagaError(f"{name} is in one piece. Paint a part of it and use Separate.")
    return document.do(edit)


@notifies
def assign(session: Session, group: int, splats: IntArray | None = None) -> bool:
    """Give the selected splats (or ``splats`` (K,)) to an object.

    Whole objects are merged into it, so that the memory bank knows their masks as the object's.
    """
    document = session.need()
    scene = document.settled().scene
    chosen = document.selected() if splats is None else splats
    title = f"Assign to {document.name_of(group)}"
    whole = _whole_objects(scene, chosen)
    if group and whole:
        return document.do(edits.merge_groups(scene, (group, *whole), title))
    return document.do(edits.set_labels(scene, chosen, group, title))


@notifies
def delete_floaters(session: Session) -> bool:
    """Delete splats that stand alone, of the selection or of everything."""
    from gaga_core.scene.selection.neighbourhood import floaters

    document = session.need()
    scene = document.settled().scene
    chosen = document.read.selected_indices()
    among = chosen if len(chosen) else algebra.everything(scene)
    found = floaters(scene, among)
    if len(found) == 0:
        session.notify(Level.HINT, "No splat stands alone here.")
        return False
    return document.do(edits.delete(scene, found, f"Delete {len(found):,} floaters"))


# --- everything


@notifies
def show_all(session: Session) -> bool:
    """Show everything that is hidden."""
    document = session.need()
    return document.do(edits.show_all(document.settled().scene))


@notifies
def unlock_all(session: Session) -> bool:
    """Let everything be selected again."""
    document = session.need()
    scene = document.settled().scene
    return document.do(edits.unlock(scene, np.ones(len(scene), np.bool_), "Unlock all"))


# --- one line of the list


@notifies
def rename(session: Session, group: int, name: str) -> bool:
    """Name an object; an empty name gives it its number back."""
    document = session.need()
    return document.do(edits.rename(document.settled().scene, group, name))


@notifies
def set_color(session: Session, group: int, rgb: Sequence[float] | None) -> bool:
    """Give an object a color in lists and group pictures, 0..1; None = the palette's."""
    document = session.need()
    title = f"Color {document.name_of(group)}"
    return document.do(edits.set_color(document.settled().scene, group, rgb, title))


@notifies
def preview_color(session: Session, group: int, rgb: Sequence[float]) -> None:
    """Show an object's color while it is being chosen."""
    document = session.need()
    title = f"Color {document.name_of(group)}"
    document.history.preview_with(lambda scene: edits.set_color(scene, group, rgb, title))


@notifies
def set_hidden(session: Session, group: int, hidden: bool) -> bool:
    """Hide or show one object with all that lies under it (the eye in the list)."""
    document = session.need()
    scene = document.settled().scene
    build, verb = (edits.hide, "Hide") if hidden else (edits.show, "Show")
    title = f"{verb} {document.name_of(group)}"
    return document.do(build(scene, folders.group_and_under(scene, group), title))


@notifies
def set_locked(session: Session, group: int, locked: bool) -> bool:
    """Protect one object and all under it from being selected, or let them be again (the lock in
    the list)."""
    document = session.need()
    scene = document.settled().scene
    build, verb = (edits.lock, "Lock") if locked else (edits.unlock, "Unlock")
    title = f"{verb} {document.name_of(group)}"
    return document.do(build(scene, folders.group_and_under(scene, group), title))


@notifies
def isolate_group(session: Session, group: int) -> bool:
    """Hide everything but one object and what lies under it; show all again when that is so."""
    document = session.need()
    scene = document.settled().scene
    title = f"Isolate {document.name_of(group)}"
    alone = edits.isolate(scene, folders.group_and_under(scene, group), title)
    return document.do(alone) if alone is not None else show_all(session)


def isolated(session: Session) -> str:
    """Return what is shown while all other objects are hidden, "" while they are not."""
    if session.document is None or session.live is not None:
        return ""
    table = session.objects()
    shown = table.n_hidden < table.counts
    names = [name for name, is_shown in zip(table.names, shown, strict=True) if is_shown]
    if not 0 < len(names) <= _FEW or not (table.n_hidden[~shown] > 0).any():
        return ""
    return ", ".join(names)


def _whole_objects(scene: Scene, splats: IntArray) -> tuple[int, ...]:
    """The objects that ``splats`` (K,) are, if they are whole objects and nothing else."""
    groups = np.unique(scene.labels[splats])
    is_whole = len(groups) > 0 and groups[0] > 0
    is_whole = is_whole and len(group_indices(scene, groups.tolist())) == len(splats)
    return tuple(int(group) for group in groups) if is_whole else ()


# --- Level of detail of objects that no model made: of all, seen while dragged, and of one object.


def preview_level(session: Session, level: int) -> None:
    """Show the groups of a level, in the list and the picture, until `choose` or `cancel`."""
    bank = _bank(session)
    session.live = BankSnapshot("", at_level(bank, level), 0, keeps_ids=True)


def cancel_level(session: Session) -> None:
    """Show the groups of the scene again."""
    session.live = None


def choose_level(session: Session, level: int) -> None:
    """Give every splat its group of this level, as one edit.

    Corrections by hand of the groups before are replaced, too. Groups that are there at both
    levels keep their names.
    """
    cancel_level(session)
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


_no_levels = first_of(
    not_one_object,
    needs(
        levels_of,
        "These objects have no levels of detail: those of regions and of Segment Anything have.",
    ),
)
_not_several = first_of(
    no_selection,
    needs(
        lambda session: len(session.selected_groups()) > 1,
        "Select two objects or more: Shift adds to the selection.",
    ),
)
_nothing_hidden = needs(
    lambda session: (
        session.need().scene.has(State.HIDDEN) & ~session.need().scene.has(State.DELETED)
    ).any(),
    "Nothing is hidden.",
)
_nothing_locked = needs(
    lambda session: session.need().scene.has(State.LOCKED).any(), "Nothing is locked."
)
COMMANDS: tuple[Command, ...] = (
    Command("edit.delete_floaters", "Delete floaters", delete_floaters, enabled=no_scene),
    Command("object.hide", "Hide", hide, "H", enabled=no_selection),
    Command(
        "object.show_all", "Show all", show_all, "Shift+H", ("Alt+H",), enabled=_nothing_hidden
    ),
    Command("object.lock", "Lock", lock, enabled=no_selection),
    Command("object.unlock_all", "Unlock all", unlock_all, enabled=_nothing_locked),
    ask(
        "object.rename",
        "Rename",
        Request.RENAME,
        "F2",
        enabled=lambda s: "" if len(folders.chosen(s)) == 1 else not_one_object(s),
    ),
    Command("object.merge", "Merge into one", merge, enabled=_not_several),
    Command(
        "object.separate",
        "Separate into an object of its own",
        separate,
        "Shift+P",
        enabled=no_selection,
    ),
    Command("object.split", "Split into parts that do not touch", split, enabled=not_one_object),
    Command("object.split_here", "Split here (one level finer)", split_here, enabled=_no_levels),
    Command("object.join_here", "Join here (one level coarser)", join_here, enabled=_no_levels),
)
