"""Builders of edits that split groups: off a selection, or into connected components."""

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.scene.edits.duplicate import free_group
from gaga_core.scene.edits.folders import inherit_folders
from gaga_core.scene.edits.groups import rename, set_labels
from gaga_core.scene.edits.values import Edit, SetBank, together
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Scene, State


def separate(scene: Scene, indices: AnyArray, title: str = "Separate") -> Edit | None:
    """Make these splats a group of their own, named after the one that most of them leave."""
    splats = sorted_indices(indices, len(scene))
    splats = splats[~scene.has(State.DELETED)[splats]]
    if len(splats) == 0:
        return None
    left = int(np.bincount(scene.labels[splats]).argmax())
    if left and len(splats) == np.count_nonzero(scene.labels[splats] == left):
        rest = np.setdiff1d(group_indices(scene, left), splats)
        if len(rest) == 0:  # the whole group already
            return None
    group = free_group(scene)
    name = scene.names.get(left)
    return together(
        title,
        (
            set_labels(scene, splats, group, title),
            rename(scene, group, f"{name} part") if name else None,
            inherit_folders(scene, {group: left}),
        ),
    )


def split(scene: Scene, group: int, least: int = 50, title: str = "Split") -> Edit | None:
    """Give each connected component of a group its own id; the largest keeps the group's.

    None when the group is in one piece; ``least`` as in `components_of`.
    """
    # Imported when first needed: importing search trees takes a part of the launch time.
    from gaga_core.scene.selection.neighbourhood import components_of

    parts = components_of(scene, group_indices(scene, group), least)
    if len(parts) < 2:
        return None
    first = free_group(scene)
    rows: IntArray = np.concatenate(parts[1:])
    ids = np.repeat(np.arange(first, first + len(parts) - 1), [len(p) for p in parts[1:]])
    order = np.argsort(rows)
    labels = set_labels(scene, rows[order], ids[order].astype(np.int32), title)
    name = scene.names.get(group)
    names = [
        rename(scene, first + i, f"{name} {i + 2}") for i in range(len(parts) - 1 if name else 0)
    ]
    homes = inherit_folders(scene, dict.fromkeys(range(first, first + len(parts) - 1), group))
    return together(title, (labels, *names, homes))


def split_off(
    scene: Scene, group: int, rows: IntArray, bank: MemoryBank, into: int, title: str = "Split"
) -> Edit | None:
    """Make these rows (K,) of the opened file, and copies of them, group ``into``, where they are
    of ``group``; ``bank`` is the memory bank that goes with it."""
    leaves = np.zeros(int(scene.source.max(initial=-1)) + 1, np.bool_)
    leaves[rows] = True
    chosen = (scene.labels == group) & leaves[scene.source]
    name = scene.names.get(group)
    return together(
        title,
        (
            set_labels(scene, chosen, into, title),
            SetBank(title, scene.bank, bank),
            rename(scene, into, f"{name} 2") if name else None,
            inherit_folders(scene, {into: group}),
        ),
    )
