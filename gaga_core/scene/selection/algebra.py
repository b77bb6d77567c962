"""Which splats: all, none, whole groups, and where they are.

Every function returns sorted rows (K,) int32; `gaga_core.scene.edits.select` makes them the
selection.
"""

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.scene.objects import selected_groups
from gaga_core.scene.scene import Scene, State


def selectable(scene: Scene) -> BoolArray:
    """Splats (N,) that a gesture may select: drawn and not locked."""
    return ~scene.has(State.HIDDEN | State.DELETED | State.LOCKED)


def everything(scene: Scene) -> IntArray:
    """All splats that can be selected."""
    return rows_of(selectable(scene))


def whole(scene: Scene) -> IntArray:
    """All splats, hidden, locked and deleted ones too: what moves when the scene moves as one."""
    return np.arange(len(scene), dtype=np.int32)


def nothing() -> IntArray:
    """No splats."""
    return np.zeros(0, np.int32)


def inverted(scene: Scene) -> IntArray:
    """Those that can be selected and are not."""
    return rows_of(selectable(scene) & ~scene.has(State.SELECTED))


def groups_inside(scene: Scene, splats: IntArray, share: float = 0.5) -> IntArray:
    """Groups (K,), ascending and without 0, of which at least ``share`` of the splats that can be
    selected are among ``splats``: what a rectangle around objects means."""
    n_labels = int(scene.labels.max(initial=0)) + 1
    total = np.bincount(scene.labels[selectable(scene)], minlength=n_labels)
    inside = np.bincount(scene.labels[splats], minlength=n_labels)
    groups = rows_of((inside > 0) & (inside >= share * total))
    return groups[groups > 0]


def world_means(scene: Scene, splats: IntArray | None = None) -> FloatArray:
    """Positions (K, 3) with placements applied, world; of all splats by default."""
    rows = slice(None) if splats is None else splats
    means = scene.gaussians.means[rows]
    index = scene.placement[rows]
    moved = np.flatnonzero(index)
    if len(moved) == 0:
        return means
    matrix = scene.placements.matrix[index[moved]]
    result = means.copy()
    result[moved] = np.einsum("nij,nj->ni", matrix[:, :, :3], means[moved]) + matrix[:, :, 3]
    return result


def rows_of(mask: BoolArray) -> IntArray:
    """Rows (K,) of a mask (N,)."""
    return np.flatnonzero(mask).astype(np.int32)


# --- Groups under the objects that are selected whole (`gaga_core.scene.folders`).


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
    return rows_of(taken)
