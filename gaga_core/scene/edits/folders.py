"""Builders of edits of the order among objects: folders, and groups under other groups."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

from gaga_core.errors import GagaError
from gaga_core.scene.edits.values import SetFolders
from gaga_core.scene.folders import (
    MOST_DEPTH,
    SEPARATOR,
    Folders,
    checked_name,
    is_inside,
    name_of,
    parent_of,
    path_of,
    tidy_path,
)
from gaga_core.scene.scene import Scene

_T = TypeVar("_T")


def put_in_folder(
    scene: Scene,
    groups: Iterable[int],
    folder: str,
    folders: Sequence[str] = (),
    title: str = "Put into a folder",
) -> SetFolders | None:
    """Put groups and other folders into a folder, which is made if it is not there; "" = the top.

    Groups that lie in one of ``folders``, or under one of ``groups``, stay there and go along; the
    others lie under no group after that. A folder whose name is taken there gets a number. Raises
    ``GagaError`` for a folder that is not there, one that would go into itself or too deep, and for
    "no group" (0).
    """
    into = tidy_path(folder)
    now = _with_paths(scene.folders, into)
    tops = _tops([existing(scene, path) for path in folders])
    if any(is_inside(into, path) for path in tops):
        raise GagaError("A folder cannot go into itself.")
    wanted = list(groups)
    if min(wanted, default=1) <= 0:
        raise GagaError('"unassigned" is no object, so it goes into no folder.')
    goes = [
        group
        for group in now.tops_of(wanted)
        if not any(is_inside(now.places.get(group, ""), path) for path in tops)
    ]
    for before, after in moved_folders(scene, into, tops):
        now = _renamed(now, before, after)
    parent = {child: above for child, above in now.parent.items() if child not in goes}
    home = {**now.home, **dict.fromkeys(goes, into)}
    return set_folders(scene, Folders.of(now.paths, home, parent), title)


def moved_folders(scene: Scene, folder: str, folders: Sequence[str]) -> list[tuple[str, str]]:
    """Paths before and after of ``folders`` that `put_in_folder` moves, in its order.

    Those that lie in another one of them go along with it.
    """
    into = tidy_path(folder)
    now = _with_paths(scene.folders, into)
    moved: list[tuple[str, str]] = []
    for path in _tops([existing(scene, path) for path in folders]):
        if parent_of(path) != into:
            moved.append((path, now.free(into, name_of(path))))
            now = _renamed(now, *moved[-1])
    return moved


def new_folder(scene: Scene, folder: str, title: str = "New folder") -> SetFolders | None:
    """Make an empty folder, and those that it lies in; None when it is there."""
    path = tidy_path(folder)
    if not path:
        raise GagaError("A folder needs a name.")
    return set_folders(scene, _with_paths(scene.folders, path), title)


def rename_folder(
    scene: Scene, folder: str, name: str, title: str = "Rename folder"
) -> SetFolders | None:
    """Give a folder another name; its path and those of all that is in it follow.

    Raises ``GagaError`` when there is no such folder, or the name is taken next to it.
    """
    path = existing(scene, folder)
    after = path_of(parent_of(path), checked_name(name))
    if after == path:
        return None
    if after in scene.folders.paths:
        raise GagaError(f"There is a folder {name_of(after)} already. Choose another name.")
    return set_folders(scene, _renamed(scene.folders, path, after), title)


def delete_folder(scene: Scene, *folders: str, title: str = "Delete folder") -> SetFolders | None:
    """Take folders away; what is in one goes into the folder that it was in.

    No object is deleted. Raises ``GagaError`` when there is no such folder.
    """
    now = scene.folders
    for path in sorted({existing(scene, folder) for folder in folders}, reverse=True):
        now = _without(now, path)  # what lies in another one comes first
    return set_folders(scene, now, title)


def _without(folders: Folders, path: str) -> Folders:
    parent = parent_of(path)
    rest = Folders.of([p for p in folders.paths if not is_inside(p, path)], {})
    paths = [p for p in folders.paths if p != path]
    home = {g: parent if p == path else p for g, p in folders.home.items()}
    for inner in [p for p in folders.paths if parent_of(p) == path]:
        free = rest.free(parent, name_of(inner))
        rest = Folders.of([*rest.paths, free], {})
        paths = [_moved(p, inner, free) for p in paths]
        home = {g: _moved(p, inner, free) for g, p in home.items()}
    return Folders.of(paths, home, folders.parent)


def inherit_folders(scene: Scene, origins: Mapping[int, int]) -> SetFolders | None:
    """Put new groups (keys) where the groups are that they come from (values).

    Where a group and what lies under it have new groups, these lie under each other, too.
    """
    now = scene.folders
    made = {origin: group for group, origin in origins.items()}
    home, parent = dict(now.home), dict(now.parent)
    for group, origin in origins.items():
        if origin in now.parent:
            above = now.parent[origin]
            parent[group] = made.get(above, above)
        else:
            home[group] = now.home.get(origin, "")
    return set_folders(scene, Folders.of(now.paths, home, parent), "Put into a folder")


def set_folders(scene: Scene, folders: Folders, title: str) -> SetFolders | None:
    """Replace the folders and what is in them; None when nothing would change."""
    now = scene.folders
    moved, parents = _changes(now.home, folders.home), _changes(now.parent, folders.parent)
    if not moved and not parents and folders.paths == now.paths:
        return None
    return SetFolders(title, now.paths, folders.paths, moved, parents)


def _changes(
    before: Mapping[int, _T], after: Mapping[int, _T]
) -> tuple[tuple[int, _T | None, _T | None], ...]:
    """What differs: group, value before and after; None = not there."""
    values = ((g, before.get(g), after.get(g)) for g in sorted({*before, *after}))
    return tuple(entry for entry in values if entry[1] != entry[2])


def _with_paths(folders: Folders, *paths: str) -> Folders:
    return Folders.of([*folders.paths, *paths], folders.home, folders.parent)


def existing(scene: Scene, folder: str) -> str:
    """The path of a folder that is there; ``GagaError`` when it is not."""
    path = tidy_path(folder)
    if path not in scene.folders.paths:
        raise GagaError(f'There is no folder "{folder}" here.')
    return path


def _tops(paths: Sequence[str]) -> list[str]:
    """Those that lie in none of the others, each once."""
    tops: list[str] = []
    for path in sorted(set(paths)):
        if not any(is_inside(path, top) for top in tops):
            tops.append(path)
    return tops


def _renamed(folders: Folders, before: str, after: str) -> Folders:
    paths = [_moved(path, before, after) for path in folders.paths]
    if any(path.count(SEPARATOR) >= MOST_DEPTH for path in paths):
        raise GagaError(f"Folders can be nested {MOST_DEPTH} deep at most. Choose another place.")
    home = {g: _moved(p, before, after) for g, p in folders.home.items()}
    return Folders.of(paths, home, folders.parent)


def _moved(path: str, before: str, after: str) -> str:
    return after + path[len(before) :] if is_inside(path, before) else path


# --- groups under others ------------------------------------------------------------------------


def set_parent(
    scene: Scene, groups: Sequence[int], parent: int, title: str = "Put under an object"
) -> SetFolders | None:
    """Put groups under the group ``parent``; groups under them go along.

    Groups that lie under another one of ``groups`` stay there. Raises ``GagaError`` for "no group"
    (0), and when a group would lie under itself.
    """
    if min((parent, *groups)) <= 0:
        raise GagaError('"unassigned" is no object, so it goes under none, and none under it.')
    now = scene.folders
    goes = now.tops_of(groups)
    if not {parent, *now.above(parent)}.isdisjoint(goes):
        raise GagaError("An object cannot go under itself, or under an object that is under it.")
    made = Folders.of(now.paths, now.home, {**now.parent, **dict.fromkeys(goes, parent)})
    return set_folders(scene, made, title)


def leave_parent(
    scene: Scene, groups: Sequence[int], title: str = "Take out from under its object"
) -> SetFolders | None:
    """Put groups next to the group that they lie under; None when they lie under none.

    What lies under them goes along. Groups that lie under another one of ``groups`` stay there.
    """
    now = scene.folders
    home, parent = dict(now.home), dict(now.parent)
    for group in now.tops_of(groups):
        if group in now.parent:
            above = parent.pop(group)
            if above in now.parent:
                parent[group] = now.parent[above]
            else:
                home[group] = now.home.get(above, "")
    return set_folders(scene, Folders.of(now.paths, home, parent), title)


def merge_places(
    scene: Scene, into: int, others: Sequence[int], title: str = "Merge"
) -> SetFolders | None:
    """What the order among objects is once ``others`` are a part of ``into``.

    What lies under one of them lies under ``into``. That stays where it is, or goes where the
    topmost of ``others`` was that it lay under.
    """
    now = scene.folders
    merged = {into, *others}
    home = {group: path for group, path in now.home.items() if group not in others}
    parent = {
        group: into if above in merged else above
        for group, above in now.parent.items()
        if group not in merged
    }
    top = next((g for g in reversed([into, *now.above(into)]) if g in merged), into)
    if top in now.parent:
        parent[into] = now.parent[top]
    elif top in now.home:
        home[into] = now.home[top]
    return set_folders(scene, Folders.of(now.paths, home, parent), title)
