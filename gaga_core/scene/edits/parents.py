"""Builders of edits that put groups under other groups (`gaga_core.scene.folders`)."""

from collections.abc import Sequence

from gaga_core.errors import GagaError
from gaga_core.scene.edits.folder_values import SetFolders
from gaga_core.scene.edits.folders import set_folders
from gaga_core.scene.folders import Folders
from gaga_core.scene.scene import Scene


def set_parent(
    scene: Scene, groups: Sequence[int], parent: int, title: str = "Put under an object"
) -> SetFolders | None:
    """Put groups under the group ``parent``; what lies under them goes along.

    Groups that lie under another one of ``groups`` stay there. Raises ``GagaError`` for "no group"
    (0), and when a group would lie under itself.
    """
    if min((parent, *groups)) <= 0:
        raise GagaError('"unassigned" is no object, so it goes under none, and none under it.')
    now = scene.folders
    goes = now.tops_of(groups)
    if not {parent, *now.above(parent)}.isdisjoint(goes):
        raise GagaError("An object cannot go under itself, or under what lies under it.")
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
            _put_next_to(now, group, now.parent[group], home, parent)
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


def _put_next_to(
    now: Folders, group: int, other: int, home: dict[int, str], parent: dict[int, int]
) -> None:
    """Note in ``home`` and ``parent`` that a group is where another one is."""
    parent.pop(group, None)
    if other in now.parent:
        parent[group] = now.parent[other]
    else:
        home[group] = now.home.get(other, "")
