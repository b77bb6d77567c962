"""Builders of edits of folders of the object list (`gaga_core.scene.folders`)."""

from collections.abc import Iterable, Mapping, Sequence

from gaga_core.errors import GagaError
from gaga_core.scene.edits.folder_values import SetFolders
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


def put_in_folder(
    scene: Scene,
    groups: Iterable[int],
    folder: str,
    folders: Sequence[str] = (),
    title: str = "Put into a folder",
) -> SetFolders | None:
    """Put groups and other folders into a folder, which is made if it is not there; "" = the top.

    Groups that lie in one of ``folders`` stay in it and go along. A folder whose name is taken
    there gets a number. Raises ``GagaError`` for a folder that is not there, one that would go into
    itself or too deep, and for "no group" (0).
    """
    into = tidy_path(folder)
    now = Folders.of([*scene.folders.paths, into], scene.folders.home)
    tops = _tops([existing(scene, path) for path in folders])
    if any(is_inside(into, path) for path in tops):
        raise GagaError("A folder cannot go into itself.")
    homes: dict[int, str | None] = {}
    for group in groups:
        if group <= 0:
            raise GagaError('"unassigned" is no object, so it goes into no folder.')
        if not any(is_inside(now.home.get(group, ""), path) for path in tops):
            homes[group] = into or None
    for before, after in moved_folders(scene, into, tops):
        now = _renamed(now, before, after)
    return _edit(scene, now.paths, {**now.home, **homes}, title)


def moved_folders(scene: Scene, folder: str, folders: Sequence[str]) -> list[tuple[str, str]]:
    """Paths before and after of ``folders`` that `put_in_folder` moves, in its order.

    Those that lie in another one of them go along with it.
    """
    into = tidy_path(folder)
    now = Folders.of([*scene.folders.paths, into], {})
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
    made = Folders.of([*scene.folders.paths, path], scene.folders.home)
    return _edit(scene, made.paths, made.home, title)


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
    made = _renamed(scene.folders, path, after)
    return _edit(scene, made.paths, made.home, title)


def delete_folder(scene: Scene, *folders: str, title: str = "Delete folder") -> SetFolders | None:
    """Take folders away; what is in one goes into the folder that it was in.

    No object is deleted. Raises ``GagaError`` when there is no such folder.
    """
    now = scene.folders
    for path in sorted({existing(scene, folder) for folder in folders}, reverse=True):
        now = _without(now, path)  # what lies in another one comes first
    return _edit(scene, now.paths, now.home, title)


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
    return Folders.of(paths, home)


def inherit_folders(scene: Scene, origins: Mapping[int, int]) -> SetFolders | None:
    """Put new groups (keys) where the groups are that they come from (values)."""
    home = scene.folders.home
    new = {group: home.get(origin) for group, origin in origins.items()}
    return _edit(scene, scene.folders.paths, {**home, **new}, "Put into a folder")


def set_homes(scene: Scene, homes: Mapping[int, str], title: str) -> SetFolders | None:
    """Replace in which folder each group is; folders stay."""
    return _edit(scene, scene.folders.paths, homes, title)


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
        raise GagaError(f"At most {MOST_DEPTH} folders lie in each other. Choose another place.")
    return Folders.of(paths, {g: _moved(p, before, after) for g, p in folders.home.items()})


def _moved(path: str, before: str, after: str) -> str:
    return after + path[len(before) :] if is_inside(path, before) else path


def _edit(
    scene: Scene, paths: Iterable[str], homes: Mapping[int, str | None], title: str
) -> SetFolders | None:
    now = scene.folders
    after = {group: path or None for group, path in homes.items()}
    known = sorted({*now.home, *after})
    moved = tuple((g, now.home.get(g), after.get(g)) for g in known)
    moved = tuple(entry for entry in moved if entry[1] != entry[2])
    made = Folders.of(paths, {})
    if not moved and made.paths == now.paths:
        return None
    return SetFolders(title, now.paths, made.paths, moved)
