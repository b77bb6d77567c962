"""Folders of the object list, and objects under other objects that are edited together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.scene import edits
from gaga_core.scene.folders import name_of, parent_of, parents_of, path_of
from gaga_core.scene.objects import ObjectTable, group_indices
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.algebra import groups_under_selection, splats_under_selection
from gaga_studio.features.base import Command, first_of, needs, no_groups, no_selection, setting
from gaga_studio.features.object_list import FolderSums, ObjectListView, folder_sums
from gaga_studio.session.document import Build, Document
from gaga_studio.session.notices import Request, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.scene.edits import How

_NEW = "Folder"  # what a new one is called until it has a name

# --- chosen folders


@notifies
def choose(session: Session, folder: str, how: "How" = "set") -> bool:
    """Choose a folder, add or remove it: all objects in it are selected, or not any more."""
    document = session.need()
    before = () if how == "set" else chosen(session)
    rest = [path for path in before if path != folder]
    groups = document.scene.folders.groups(folder)
    verb = "Deselect" if how == "remove" else "Select"
    done = document.select(
        group_indices(document.scene, groups), how, f"{verb} folder {name_of(folder)}"
    )
    listing = document.feature(ObjectListView)
    listing.chosen = tuple(rest if how == "remove" else [*rest, folder])
    listing.chosen_with = _selection(document, listing.chosen)
    return done


def chosen(session: Session) -> tuple[str, ...]:
    """Return the folders that were chosen, while the selection is still what that made.

    Not any more once objects came into them or left: a command for the folder would miss those.
    """
    if (document := session.document) is None:
        return ()
    listing = document.feature(ObjectListView)
    if not listing.chosen or listing.chosen_with != _selection(document, listing.chosen):
        return ()
    return tuple(path for path in listing.chosen if path in document.scene.folders.paths)


def of_selection(session: Session) -> tuple[str, ...]:
    """Return the chosen folders, else the one that the selected objects are in."""
    if session.scene is None:
        return ()
    homes = {session.scene.folders.places.get(g, "") for g in session.selected_groups()}
    return chosen(session) or (tuple(homes - {""}) if len(homes) == 1 else ())


def _selection(document: Document, folders: Sequence[str]) -> object:
    read, inside = document.read, document.scene.folders.groups
    selected = read.selected_groups(), len(read.selected_indices())
    return *selected, tuple(inside(folder) for folder in folders)


# --- edits


@notifies
def new_folder(session: Session) -> bool:
    """Put the selected objects and chosen folders into a new folder, and ask for its name.

    It lies where they are; it is empty when nothing is selected, and inside of the one folder that
    is chosen where nothing else is selected.
    """
    document = session.need()
    scene = document.settled().scene
    folders, groups = chosen(session), session.selected_groups()
    places = [parent_of(path) for path in folders] or [
        scene.folders.places.get(group, "") for group in groups
    ]
    is_alone = len(folders) == 1 and set(groups) <= set(scene.folders.groups(folders[0]))
    inside = folders[0] if is_alone else ""
    path = scene.folders.free(inside or _common(places), _NEW)
    if (groups or folders) and not inside:
        edit = edits.put_in_folder(scene, groups, path, folders, "New folder")
    else:
        edit = edits.new_folder(scene, path)
    if not document.do(edit):
        return False
    choose(session, path)
    document.feature(ObjectListView).reveal(path)
    session.request = Request.RENAME
    return True


def _common(places: Sequence[str]) -> str:
    """The deepest folder that contains all of these folders."""
    if not places:
        return ""
    ways = [[*reversed(parents_of(place)), place] for place in places]
    common = ""
    for names in zip(*ways, strict=False):
        if len(set(names)) > 1:
            break
        common = names[0]
    return common


@notifies
def put_in(
    session: Session, folder: str, groups: Sequence[int], folders: Sequence[str] = ()
) -> bool:
    """Put objects and folders into a folder; "" takes them out of all."""
    document = session.need()
    scene = document.settled().scene
    n = len(groups) + len(folders)
    names = [document.name_of(group) for group in groups] + [name_of(path) for path in folders]
    what = names[0] if n == 1 else f"{n} objects" if not folders else f"{n} things"
    title = f"Put {what} into {name_of(folder)}" if folder else f"Take {what} out of its folder"
    edit = edits.put_in_folder(scene, groups, folder, folders, title)
    moved = edits.moved_folders(scene, folder, folders)
    if not document.do(edit):
        return False
    for before, after in moved:
        document.feature(ObjectListView).follow(before, after)
    document.feature(ObjectListView).reveal(folder)
    return True


@notifies
def take_out(session: Session) -> bool:
    """Take the chosen folders, else the selected objects, one folder up."""
    document = session.need()
    scene = document.settled().scene
    folders = [path for path in chosen(session) if parent_of(path)]
    groups = [] if folders else [g for g in session.selected_groups() if g in scene.folders.home]
    places = [parent_of(path) for path in folders] + [scene.folders.home[g] for g in groups]
    return put_in(session, parent_of(_common(places)), groups, folders)


@notifies
def rename(session: Session, folder: str, name: str) -> bool:
    """Give a folder another name; an empty one leaves it as it is."""
    after = path_of(parent_of(folder), " ".join(name.split()))
    title = f"Rename {name_of(folder)} to {name_of(after)}"
    if not name.strip() or not session.edit(
        lambda scene: edits.rename_folder(scene, folder, name, title)
    ):
        return False
    session.need().feature(ObjectListView).follow(folder, after)
    return True


@notifies
def delete(session: Session, *folders: str) -> bool:
    """Take folders away; their objects stay."""
    what = f"folder {name_of(folders[0])}" if len(folders) == 1 else f"{len(folders)} folders"
    return session.edit(lambda scene: edits.delete_folder(scene, *folders, title=f"Delete {what}"))


# --- the content of a folder


def sums(session: Session) -> dict[str, FolderSums]:
    """Return what is in each folder, by its path."""
    document, table = session.need(), session.objects()
    folders = document.scene.folders
    return document.read.once("folder sums", (table, folders), lambda: folder_sums(table, folders))


def is_alone(table: ObjectTable, own: FolderSums) -> bool:
    """Return whether the objects of a folder with these sums, and nothing else, are shown."""
    n_shown = int((table.counts - table.n_hidden).sum())
    return 0 < own.n_splats == n_shown and not own.n_hidden


# --- objects under other objects


@notifies
def put_under(session: Session, parent: int, groups: Sequence[int]) -> bool:
    """Put objects under another one; objects under them go along."""
    document = session.need()
    scene = document.settled().scene
    title = f"Put {document.titled(*groups)} under {document.titled(parent)}"
    if not document.do(edits.set_parent(scene, groups, parent, title)):
        return False
    document.feature(ObjectListView).reveal_group(scene.folders, groups[0])
    return True


@notifies
def leave_parent(session: Session) -> bool:
    """Take each of the selected objects out from under its parent."""
    document = session.need()
    scene = document.settled().scene
    groups = [group for group in session.selected_groups() if group in scene.folders.parent]
    over = {scene.folders.parent[group] for group in groups}
    above = document.titled(over.pop()) if len(over) == 1 else "what they lie under"
    return document.do(
        edits.leave_parent(scene, groups, f"Take {document.titled(*groups)} out from under {above}")
    )


@notifies
def select_with_children(session: Session) -> bool:
    """Select the selected objects whole, and all objects under them."""
    document, groups = session.need(), session.selected_groups()
    if not groups:
        return False
    under = document.scene.folders.under(*groups)
    title = f"Select {_and_under(document.titled(groups[0]), len(groups), len(under))}"
    return document.select(group_indices(document.scene, (*groups, *under)), "set", title)


# --- edits of the selection that children go along with


@dataclass(frozen=True, eq=False)
class Along:
    """The selection and what goes along with it."""

    splats: IntArray  # (K,) both
    groups: tuple[int, ...]  # that go along


def along(session: Session, *, with_locked: bool = False) -> Along:
    """Return the selected splats, and those under objects that are selected whole.

    Without the latter when "Children go along" is off. Locked ones only ``with_locked``: isolating
    and exporting change nothing of them. Raises ``NothingSelectedError``.
    """
    document = session.need()
    chosen, scene = document.selected(), document.scene
    if not session.settings.children_go_along or not scene.folders.parent:
        return Along(chosen, ())
    revision = scene.revision
    key = (revision.splats, revision.state, revision.labels, scene.folders)

    def find() -> Along:
        splats = splats_under_selection(scene, with_locked=with_locked)
        moved = set(np.unique(scene.labels[splats]).tolist())
        groups = tuple(group for group in groups_under_selection(scene) if group in moved)
        return Along(np.sort(np.concatenate([chosen, splats])).astype(np.int32), groups)

    return document.read.once("along with locked" if with_locked else "along", key, find)


def locked_along(session: Session) -> IntArray:
    """Return the locked splats (K,) that isolating and exporting take along; none without any."""
    if len(session.selected_indices()) == 0:
        return np.zeros(0, np.int32)
    splats = along(session, with_locked=True).splats
    return np.setdiff1d(splats, along(session).splats, assume_unique=True)


def scene_along(session: Session, *, with_locked: bool = True) -> Scene:
    """Return the scene with what goes along selected, too: what exports read. Not for edits."""
    scene = session.need().scene
    if len(session.selected_indices()) == 0:
        return scene
    taken = along(session, with_locked=with_locked)
    if not taken.groups:
        return scene
    state = scene.state.copy()
    state[taken.splats] |= np.uint8(State.SELECTED)
    return replace(scene, state=state)


def edit_along(session: Session, verb: str, build: Build, *, with_locked: bool = False) -> bool:
    """Apply the edit that ``build`` makes of the scene, `along`, and a title that names both."""
    document = session.need()
    scene = document.settled().scene
    taken = along(session, with_locked=with_locked)
    return document.do(build(scene, taken.splats, title_along(document, verb, taken.groups)))


def title_along(document: Document, verb: str, groups: Sequence[int]) -> str:
    """Return the title of an edit of the selection with ``groups``: "Delete pot and 2 under it"."""
    n_own = max(len(document.read.selected_groups()), 1)
    return _and_under(document.title_for(verb), n_own, len(groups))


def _and_under(text: str, n: int, n_under: int) -> str:
    if not n_under:
        return text
    return f"{text} and {n_under} under {'it' if n == 1 else 'them'}"


def _is_in_folder(session: Session) -> bool:
    home = session.need().scene.folders.home
    if folders := chosen(session):
        return any(parent_of(path) for path in folders)
    return any(group in home for group in session.selected_groups())


no_folders = needs(
    lambda session: session.need().scene.folders.paths,
    "There are no folders yet. Select objects, then use New folder.",
)
_no_folder = first_of(
    no_folders,
    needs(of_selection, "Choose a folder in the list, or an object that is in one."),
)
_not_in_folder = first_of(no_folders, needs(_is_in_folder, "The selection is in no folder."))
_under_nothing = first_of(
    no_selection,
    needs(
        lambda session: (
            not session.need().scene.folders.parent.keys().isdisjoint(session.selected_groups())
        ),
        "The selection is under no object. Drag it onto one.",
    ),
)
_nothing_under = first_of(
    no_selection,
    needs(
        lambda session: session.need().scene.folders.under(*session.selected_groups()),
        "There is nothing under this object. Drag another one onto it.",
    ),
)
COMMANDS: tuple[Command, ...] = (
    Command("object.folder", "New folder", new_folder, "Ctrl+Shift+G", enabled=no_groups),
    Command("object.folder_out", "Take out of the folder", take_out, enabled=_not_in_folder),
    Command(
        "object.folder_delete",
        "Delete the folder, keep its objects",
        lambda session: delete(session, *of_selection(session)),
        enabled=_no_folder,
    ),
    Command(
        "object.leave_parent",
        "Take out from under its object",
        leave_parent,
        enabled=_under_nothing,
    ),
    setting("object.children_go_along", "Children go along", "children_go_along"),
    Command(
        "select.children", "Select with children", select_with_children, enabled=_nothing_under
    ),
)
