"""Builder of the edit that duplicates splats."""

import re
from collections.abc import Set

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.scene.edits.folders import inherit_folders
from gaga_core.scene.edits.placement import composed
from gaga_core.scene.edits.placement_values import AppendCopies, SetPlacement, take_rows
from gaga_core.scene.edits.state import select
from gaga_core.scene.edits.values import Edit, SetNames, together
from gaga_core.scene.index_set import IndexSet, PackedInts, sorted_indices
from gaga_core.scene.scene import Scene, State


def duplicate(
    scene: Scene,
    indices: AnyArray,
    matrix: AnyArray | None = None,
    new_group: bool = True,
    title: str = "Duplicate",
) -> Edit | None:
    """Append copies of these splats, moved by ``matrix`` (3, 4) world; the copies get selected.

    With ``new_group`` each group that is copied whole becomes a new group, named after the
    original ("mug 2") where that has a name; copies of a part of a group stay in it. Deleted
    splats are not copied.
    """
    splats = sorted_indices(indices, len(scene))
    splats = splats[~scene.has(State.DELETED)[splats]]
    if len(splats) == 0:
        return None
    moved = _copied_rows(scene, splats, matrix)
    labels: IntArray = scene.labels[splats]
    named: tuple[Edit | None, ...] = ()
    if new_group:
        labels, named = _copied_groups(scene, splats)
    rows = scene.placement[splats]
    if moved is not None:
        target = np.arange(moved.n_rows, dtype=np.int32)
        target[moved.rows_from] = moved.rows_to
        rows = target[rows]
    copies = AppendCopies(
        title, IndexSet.of(splats, len(scene)), PackedInts.of(labels), PackedInts.of(rows)
    )
    unselect = select(scene, np.zeros(0, np.int32))
    return together(title, (unselect, moved, copies, *named))


def _copied_rows(scene: Scene, splats: AnyArray, matrix: AnyArray | None) -> SetPlacement | None:
    """Rows of their own for moved copies; no splat of the scene moves to them."""
    if matrix is None:
        return None
    n_rows = len(scene.placements)
    used = np.unique(scene.placement[splats]).astype(np.int32)
    rows = n_rows + np.arange(len(used), dtype=np.int32)
    old = take_rows(scene.placements, used)
    return SetPlacement(
        title="Duplicate",
        n_rows=n_rows,
        rows=rows,
        before=take_rows(scene.placements, np.zeros(0, np.int32)),
        after=composed(old, np.asarray(matrix, np.float64)[:3], None, 1.0),
        moved=IndexSet.of(np.zeros(0, np.int64), len(scene)),
        rows_from=used,
        rows_to=rows,
    )


def _copied_groups(scene: Scene, splats: AnyArray) -> tuple[IntArray, tuple[Edit | None, ...]]:
    """Labels (K,) of the copies, and the names and folders of the new groups."""
    labels = scene.labels[splats]
    live = scene.labels[~scene.has(State.DELETED)]
    n_labels = int(live.max(initial=0)) + 1
    n_live = np.bincount(live, minlength=n_labels)
    n_chosen = np.bincount(labels, minlength=n_labels)
    whole = np.flatnonzero((n_chosen > 0) & (n_chosen == n_live))
    whole = whole[whole != 0]
    if len(whole) == 0:
        return labels, ()
    fresh = free_group(scene) + np.arange(len(whole), dtype=np.int32)
    target = np.arange(n_labels, dtype=np.int32)
    target[whole] = fresh
    used = set(scene.names.values())
    after = []
    for old, new in zip(whole, fresh, strict=True):
        if int(old) in scene.names:
            name = _next_name(scene.names[int(old)], used)
            used.add(name)
            after.append((int(new), name))
    names = SetNames("Rename", tuple((group, None) for group, _ in after), tuple(after))
    origins = dict(zip(fresh.tolist(), whole.tolist(), strict=True))
    return target[labels], (names if after else None, inherit_folders(scene, origins))


def _next_name(name: str, used: Set[str]) -> str:
    """The first free of "mug 2", "mug 3" for a copy of "mug", and of "mug 2" if there is a mug."""
    base = re.sub(r" \d+$", "", name)
    stem, k = base if base in used else name, 2
    while f"{stem} {k}" in used:
        k += 1
    return f"{stem} {k}"


def free_group(scene: Scene) -> int:
    """The first id above every group that was ever used."""
    order = scene.folders
    named = max((*scene.names, *order.home, *order.parent, *order.parent.values()), default=0)
    in_bank = scene.bank.n_groups if scene.bank is not None else 0
    other = scene.identities.other  # its groups come back when labels are switched
    waiting = int(other.labels.max(initial=0)) if other is not None else 0
    return max(int(scene.labels.max(initial=0)), named, in_bank, waiting) + 1


def clone(
    scene: Scene, indices: AnyArray, matrix: AnyArray, group: int, title: str = "Clone"
) -> Edit | None:
    """Append copies of these splats, moved by ``matrix`` (3, 4) world, as part of ``group``.

    What a clone brush does: nothing gets selected. Deleted splats are not copied.
    """
    splats = sorted_indices(indices, len(scene))
    splats = splats[~scene.has(State.DELETED)[splats]]
    moved = _copied_rows(scene, splats, matrix)
    if len(splats) == 0 or moved is None:
        return None
    target = np.arange(moved.n_rows, dtype=np.int32)
    target[moved.rows_from] = moved.rows_to
    labels = PackedInts.of(np.full(len(splats), group, np.int32))
    rows = PackedInts.of(target[scene.placement[splats]])
    chosen = IndexSet.of(splats, len(scene))
    return together(title, (moved, AppendCopies(title, chosen, labels, rows, State(0))))
