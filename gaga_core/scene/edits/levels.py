"""Builders of edits that change the level of detail of one group: finer, or coarser.

They read the levels that `gaga_core.grouping.surfaces` made, so they know what to part and whom to
join; groups that were changed by hand since count as what most of their splats are.
"""

import numpy as np

from gaga_core.arrays import IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.grouping.levels import Levels
from gaga_core.scene.edits.duplicate import free_group
from gaga_core.scene.edits.folders import inherit_folders
from gaga_core.scene.edits.groups import merge_groups, rename, set_labels
from gaga_core.scene.edits.values import Edit, together
from gaga_core.scene.objects import group_indices, parting
from gaga_core.scene.scene import Scene


def split_here(scene: Scene, group: int, title: str = "Split here") -> Edit | None:
    """Make groups of the parts of a group, at the coarsest level that parts it.

    The largest part keeps the group's id and name. None when no level parts the group. Raises
    ``GagaError`` when the scene has no levels.
    """
    levels = _levels(scene)
    rows = group_indices(scene, group)
    rows = rows[scene.source[rows] < levels.labels.shape[1]]
    cut = parting(levels, scene.source[rows])
    if cut is None:
        return None
    ids = _free_ids(scene, levels, cut.ids[1:])
    new_id = np.append(np.int32(group), ids)
    name = scene.names.get(group)
    names = [rename(scene, int(new), f"{name} {i + 2}") for i, new in enumerate(ids) if name]
    homes = inherit_folders(scene, dict.fromkeys(ids.tolist(), group))
    return together(title, (set_labels(scene, rows, new_id[cut.part_of], title), *names, homes))


def join_here(scene: Scene, group: int, title: str = "Join here") -> Edit | None:
    """Join a group with those that are one thing with it at the finest level that says so.

    The id of ``group`` stays; its name does, else the first name found is taken. None when the
    group is one of its own at every level. Raises ``GagaError`` when the scene has no levels.
    """
    levels = _levels(scene)
    rows = np.flatnonzero((scene.source < levels.labels.shape[1]) & (scene.labels > 0))
    label, source = scene.labels[rows], scene.source[rows]
    total = np.bincount(label, minlength=group + 1)
    if total[group] == 0:
        return None
    for labels in levels.labels[::-1]:
        parent = int(np.bincount(labels[source[label == group]]).argmax())
        within = np.bincount(label[labels[source] == parent], minlength=len(total))
        others = np.flatnonzero(within > total / 2)
        others = others[others != group]
        if parent > 0 and len(others):
            return merge_groups(scene, (group, *others.tolist()), title)
    return None


def _levels(scene: Scene) -> Levels:
    if scene.bank is None or scene.bank.levels is None:
        raise GagaError(
            "These objects have no levels of detail. Use Find objects with masks of regions, or of "
            "Segment Anything."
        )
    return scene.bank.levels


def _free_ids(scene: Scene, levels: Levels, parts: LongArray) -> IntArray:
    """Ids (P,) of new groups: the parts' own ids of the levels where no group has them, so that
    names stay when the level of detail of all changes later."""
    order = scene.folders
    taken = {*np.unique(scene.labels).tolist(), *scene.names, *order.home, *order.parent}
    taken |= {*order.parent.values()}
    top = max(free_group(scene), int(levels.labels.max()) + 1)
    ids = []
    for part in parts.tolist():
        is_free = part not in taken
        ids.append(part if is_free else top)
        top += not is_free
    return np.array(ids, np.int32)
