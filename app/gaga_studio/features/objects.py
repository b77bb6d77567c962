"""Objects: hide, lock, delete, merge, split, name and color them, and their levels of detail.

Each edit is one entry of the history.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError, counted
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import MemoryBank, at_level
from gaga_core.scene import edits
from gaga_core.scene.edits.splats import regrouped
from gaga_core.scene.folders import name_of
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Revision, Scene, State, Weight
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
    one_object,
)
from gaga_studio.features.object_list import levels_of
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session

_MOST_NAMED = 3  # objects that are named while all others are hidden
Item = int | str  # an object with all that lies under it, or the path of a folder

# --- the selected splats


@notifies
def hide(session: Session) -> bool:
    """Hide the selected splats, and the objects under those that are selected whole."""
    return folders.edit_along(session, "Hide", edits.hide)


@notifies
def isolate(session: Session) -> bool:
    """Hide everything but the selected splats; show all again when that is so already."""
    done = folders.edit_along(session, "Isolate", edits.isolate, with_locked=True)
    return done or session.edit(edits.show_all)


@notifies
def delete(session: Session) -> bool:
    """Delete the selected splats, and the objects under those that are selected whole."""
    under = folders.along(session).groups
    said = folders.title_along(session.need(), "Deleted", under)
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
    groups = session.selected_groups()
    return session.need().edit_selected(
        "Merge", lambda scene, _, title: edits.merge_groups(scene, groups, title)
    )


@notifies
def split(session: Session) -> bool:
    """Split the selected object into the components that do not touch."""
    group = one_object(session, "Select one object to split it.")
    name = session.need().name_of(group)
    title = f"Split {session.need().titled(group)}"
    edit = edits.split(session.need().settled().scene, group, title=title)
    if edit is None:
        raise GagaError(f"{name} is in one piece. Paint a part of it and use Separate.")
    return session.need().do(edit)


@notifies
def assign(session: Session, group: int, splats: IntArray | None = None) -> bool:
    """Give the selected splats (or ``splats`` (K,)) to an object.

    Whole objects are merged into it, so that the memory bank knows their masks as the object's.
    """
    document = session.need()
    scene = document.settled().scene
    chosen = document.selected() if splats is None else splats
    title = f"Assign to {document.titled(group)}"
    groups = [int(there) for there in np.unique(scene.labels[chosen])]
    is_whole = bool(groups) and groups[0] > 0 and len(group_indices(scene, groups)) == len(chosen)
    if group and is_whole:
        return document.do(edits.merge_groups(scene, (group, *groups), title))
    return document.do(edits.set_labels(scene, chosen, group, title))


@notifies
def delete_floaters(session: Session) -> bool:
    """Delete isolated splats, of the selection or of everything."""
    from gaga_core.scene.selection.neighbourhood import floaters

    scene, chosen = session.need().settled().scene, session.selected_indices()
    found = floaters(scene, chosen if len(chosen) else algebra.everything(scene))
    if len(found) == 0:
        session.notify(Level.HINT, "There are no isolated splats here.")
        return False
    return session.edit(
        lambda scene: edits.delete(scene, found, f"Delete {counted(len(found), 'floater')}")
    )


# --- all splats


@notifies
def restore(session: Session) -> bool:
    """Bring back everything that was deleted."""
    return session.edit(edits.restore_originals)


@notifies
def show_all(session: Session) -> bool:
    """Show everything that is hidden."""
    return session.edit(edits.show_all)


@notifies
def unlock_all(session: Session) -> bool:
    """Let everything be selected again."""
    return session.edit(
        lambda scene: edits.unlock(scene, np.ones(len(scene), np.bool_), "Unlock all")
    )


# --- one line of the list


@notifies
def rename(session: Session, group: int, name: str) -> bool:
    """Name an object; an empty name gives it its number back."""
    before = session.need().titled(group)
    title = f"Rename {before} to {name}" if name.strip() else f"Take the name {before} back"
    return session.edit(lambda scene: edits.rename(scene, group, name, title))


@notifies
def set_color(session: Session, group: int, rgb: Sequence[float] | None) -> bool:
    """Give an object a color in lists and group pictures, 0..1; None = the palette's."""
    title = f"Color {session.need().titled(group)}"
    return session.edit(lambda scene: edits.set_color(scene, group, rgb, title))


@notifies
def set_weight(session: Session, group: int, weight: Weight | None) -> bool:
    """Give an object a mass or a density for simulations; None = the density of an export."""
    title = f"Weigh {session.need().titled(group)}"
    return session.edit(lambda scene: edits.set_weight(scene, group, weight, title))


@notifies
def preview_color(session: Session, group: int, rgb: Sequence[float]) -> None:
    """Show an object's color while it is being chosen."""
    document = session.need()
    title = f"Color {document.titled(group)}"
    document.preview_with(lambda scene: edits.set_color(scene, group, rgb, title))


@notifies
def set_hidden(session: Session, item: Item, hidden: bool) -> bool:
    """Hide or show all of an object or a folder (the eye in the list)."""
    build, verb = (edits.hide, "Hide") if hidden else (edits.show, "Show")
    title = f"{verb} {_name(session.need(), item)}"
    return session.edit(lambda scene: build(scene, _splats(scene, item), title))


@notifies
def set_locked(session: Session, item: Item, locked: bool) -> bool:
    """Protect all of an object or a folder from being selected, or not (the lock in the list)."""
    build, verb = (edits.lock, "Lock") if locked else (edits.unlock, "Unlock")
    title = f"{verb} {_name(session.need(), item)}"
    return session.edit(lambda scene: build(scene, _splats(scene, item), title))


@notifies
def isolate_item(session: Session, item: Item) -> bool:
    """Hide everything but an object or a folder; show all again when that is so already."""
    document = session.need()
    scene = document.settled().scene
    splats = _splats(scene, item)
    if len(splats) == 0:
        return False
    alone = edits.isolate(scene, splats, f"Isolate {_name(document, item)}")
    return document.do(alone if alone is not None else edits.show_all(scene))


def _name(document: Document, item: Item) -> str:
    return name_of(item) if isinstance(item, str) else document.name_of(item)


def _splats(scene: Scene, item: Item) -> IntArray:
    """Splats (K,) of an item, deleted ones left out."""
    if isinstance(item, str):
        return group_indices(scene, scene.folders.groups(item))
    return group_indices(scene, (item, *scene.folders.under(item)))


def isolated(session: Session) -> str:
    """Return what is shown while all other objects are hidden, "" while they are not."""
    if session.document is None or session.live is not None:
        return ""
    table = session.objects()
    shown = table.n_hidden < table.counts
    names = [name for name, is_shown in zip(table.names, shown, strict=True) if is_shown]
    if not 0 < len(names) <= _MOST_NAMED or not (table.n_hidden[~shown] > 0).any():
        return ""
    return ", ".join(names)


def all_hidden(session: Session) -> bool:
    """Return whether there are splats, and all are hidden."""
    if session.document is None or session.live is not None:
        return False
    table = session.objects()
    return bool(table.counts.sum() > 0 and table.n_hidden.sum() == table.counts.sum())


# --- levels of detail of objects: of all, shown while dragged, and of one


def preview_level(session: Session, level: int) -> None:
    """Show the groups of a level, in the list and the picture, until chosen or cancelled."""
    session.live = BankSnapshot("", at_level(_bank(session), level), 0, keeps_ids=True)


def cancel_level(session: Session) -> None:
    """Show the groups of the scene again."""
    session.live = None


def choose_level(session: Session, level: int) -> None:
    """Give every splat its group of this level, as one edit.

    Corrections by hand of the groups before are replaced, too. Groups that are there at both
    levels keep their names, and those of any level have them again when it is chosen.
    """
    cancel_level(session)
    scene = session.need().settled().scene
    bank = at_level(_bank(session), level)
    found = bank.levels.labels[level] if bank.levels else np.maximum(bank.group, 0)
    labels, others = regrouped(scene, found)
    kept = {group: group for group in np.unique(found[found > 0]).tolist()} | others
    names = {kept[group]: name for group, name in scene.names.items() if group in kept}
    away = scene.names.keys() - kept.keys()
    if bank.levels and away:
        of_any = np.flatnonzero(np.bincount(bank.levels.labels.ravel()))  # one id at all levels
        names |= {group: scene.names[group] for group in away & set(of_any.tolist())}
    sure = (
        None if scene.confidence is None else scene.confidence.astype(np.float32) / np.float32(255)
    )
    order = scene.folders.renumbered(kept)

    def change(scene: Scene) -> edits.Edit | None:
        title = "Change detail"
        grouping = edits.set_grouping(scene, labels, bank, names, title, sure, order)
        return edits.together(title, (grouping, *edits.carry_looks(scene, kept)))

    session.edit(change)


@notifies
def split_here(session: Session) -> bool:
    """Make objects of the parts that the selected object has one level finer."""
    group = one_object(session)
    name = session.need().name_of(group)
    title = f"Split {session.need().titled(group)} here"
    edit = edits.split_here(session.need().settled().scene, group, title)
    if edit is None:
        raise GagaError(f"{name} has no parts at any level. Paint a part of it and use Separate.")
    return session.need().do(edit)


@notifies
def join_here(session: Session) -> bool:
    """Join the selected object with those that are one object with it one level coarser."""
    group = one_object(session)
    name, scene = session.need().name_of(group), session.need().settled().scene
    title = f"Join {name} here"
    edit = edits.join_here(scene, group, title)
    if edit is None:
        raise GagaError(f"{name} is one object at all levels. Select others too, and use Merge.")
    joined = replace(scene, revision=Revision())
    edit.apply(joined)
    whole = edits.select(scene, np.flatnonzero(joined.labels == group), title=title)
    return session.need().do(edits.together(title, (edit, whole)))


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
_nothing_deleted = needs(
    lambda session: edits.has_deleted(session.need().scene), "Nothing is deleted."
)
_nothing_locked = needs(
    lambda session: session.need().scene.has(State.LOCKED).any(), "Nothing is locked."
)
COMMANDS: tuple[Command, ...] = (
    Command("edit.delete_floaters", "Delete floaters", delete_floaters, enabled=no_scene),
    Command("edit.restore", "Restore deleted", restore, enabled=_nothing_deleted),
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
        "Separate into a new object",
        separate,
        "Shift+P",
        enabled=no_selection,
    ),
    Command("object.split", "Split into parts that do not touch", split, enabled=not_one_object),
    Command("object.split_here", "Split here (one level finer)", split_here, enabled=_no_levels),
    Command("object.join_here", "Join here (one level coarser)", join_here, enabled=_no_levels),
)
