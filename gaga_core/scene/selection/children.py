"""What lies under the objects that are selected whole (`gaga_core.scene.folders`)."""

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.scene.objects import selected_groups
from gaga_core.scene.scene import Scene, State


def groups_under_selection(scene: Scene) -> tuple[int, ...]:
    """Groups under the objects that are selected whole, ascending; those too are left out.

    An object is selected whole when all its splats are that can be: locked and hidden ones cannot.
    """
    if not scene.folders.parent:
        return ()
    barred = scene.has(State.DELETED | State.HIDDEN | State.LOCKED)
    left = scene.labels[~barred & ~scene.has(State.SELECTED)]
    whole = np.setdiff1d(selected_groups(scene), left).tolist()
    return scene.folders.under(*whole)


def splats_under_selection(scene: Scene, *, with_locked: bool = False) -> IntArray:
    """Splats (K,) of `groups_under_selection` that are neither selected nor deleted.

    What is hidden is among them: it belongs to what it lies under. What is locked is among them
    only ``with_locked``: to be shown or written, never to be changed.
    """
    groups = groups_under_selection(scene)
    if not groups:
        return np.zeros(0, np.int32)
    taken = np.isin(scene.labels, np.array(groups, np.int32))
    left_out = State.SELECTED | State.DELETED
    taken &= ~scene.has(left_out if with_locked else left_out | State.LOCKED)
    return np.flatnonzero(taken).astype(np.int32)
