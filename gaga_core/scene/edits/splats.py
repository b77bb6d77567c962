"""Builders of edits that select, hide, lock and delete splats, and add those of other files."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, IntArray, LongArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.packing import READS
from gaga_core.io.splats.sog import LOD_META, META
from gaga_core.io.splats.splat_files import is_standing
from gaga_core.io.splats.spz import OURS
from gaga_core.progress import Stage, portion
from gaga_core.scene.edits.objects import free_group, own_name, shown_names
from gaga_core.scene.edits.values import (
    AppendFile,
    AppendMade,
    Edit,
    FlipState,
    Kept,
    SetNames,
    SetPlacement,
    joined,
    read_added_stage,
    together,
)
from gaga_core.scene.frame import Frame
from gaga_core.scene.index_set import IndexSet, PackedInts, sorted_indices
from gaga_core.scene.orientation import NEARLY, turn_between
from gaga_core.scene.scene import Added, Placements, Scene, State
from gaga_core.scene.selection.algebra import world_means

How = Literal["set", "add", "remove", "intersect"]
_NOTHING = State(0)
_UPRIGHT = 1e-6  # of the elements of a rotation: less is rounding
_GAP = 1000  # groups of added files start at a multiple of this where a bank makes groups too


def set_state(
    scene: Scene, indices: AnyArray, on: State, off: State, title: str
) -> FlipState | None:
    """Turn bits ``on`` and ``off`` for these splats."""
    rows = sorted_indices(indices, len(scene))
    old = scene.state[rows]
    changed = np.zeros(len(scene), np.uint8)
    changed[rows] = old ^ ((old | np.uint8(on)) & ~np.uint8(off))
    return FlipState.of(title, changed)


def select(
    scene: Scene, indices: AnyArray, how: How = "set", title: str = "Select"
) -> FlipState | None:
    """Change the selection; deleted and locked splats cannot be selected."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    selected = scene.has(State.SELECTED)
    if how == "set":
        target = chosen
    elif how == "add":
        target = selected | chosen
    elif how == "remove":
        target = selected & ~chosen
    elif how == "intersect":
        target = selected & chosen
    else:
        raise ValueError(f"how: expected set, add, remove or intersect, got {how!r}")
    target = target & ~scene.has(State.DELETED | State.LOCKED)
    changed: UInt8Array = (target != selected).view(np.uint8) * np.uint8(State.SELECTED)
    return FlipState.of(title, changed)


def hide(scene: Scene, indices: AnyArray, title: str = "Hide") -> FlipState | None:
    """Hide splats; what is not seen is not selected either."""
    return set_state(scene, indices, State.HIDDEN, State.SELECTED, title)


def show(scene: Scene, indices: AnyArray, title: str = "Show") -> FlipState | None:
    """Show hidden splats."""
    return set_state(scene, indices, _NOTHING, State.HIDDEN, title)


def show_all(scene: Scene, title: str = "Show all") -> FlipState | None:
    """Show everything that is hidden."""
    return show(scene, scene.has(State.HIDDEN), title)


def isolate(scene: Scene, indices: AnyArray, title: str = "Isolate") -> FlipState | None:
    """Show these splats and hide all others."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    hidden, selected = np.uint8(State.HIDDEN), np.uint8(State.SELECTED)
    old = scene.state
    new = np.where(chosen, old & ~hidden, (old | hidden) & ~selected)
    new = np.where(scene.has(State.DELETED), old, new)
    return FlipState.of(title, old ^ new)


def lock(scene: Scene, indices: AnyArray, title: str = "Lock") -> FlipState | None:
    """Protect splats from being selected."""
    return set_state(scene, indices, State.LOCKED, State.SELECTED, title)


def unlock(scene: Scene, indices: AnyArray, title: str = "Unlock") -> FlipState | None:
    """Let splats be selected again."""
    return set_state(scene, indices, _NOTHING, State.LOCKED, title)


def delete(scene: Scene, indices: AnyArray, title: str = "Delete") -> FlipState | None:
    """Delete splats (a bit: rows stay until export)."""
    return set_state(scene, indices, State.DELETED, State.SELECTED, title)


def restore(scene: Scene, title: str = "Restore deleted") -> FlipState | None:
    """Bring back everything that was deleted, merged splats included: what scripts do."""
    return set_state(scene, scene.has(State.DELETED), _NOTHING, State.DELETED, title)


def restore_originals(scene: Scene, title: str = "Restore deleted") -> FlipState | None:
    """Bring back everything that was deleted; what `gaga_core.scene.reduce` merged of it goes."""
    if not has_deleted(scene):
        return None
    merged = _made(scene, merged=True)
    changed = np.where(scene.has(State.DELETED) != merged, np.uint8(State.DELETED), np.uint8(0))
    changed[merged & scene.has(State.SELECTED)] |= np.uint8(State.SELECTED)
    return FlipState.of(title, changed)


def has_deleted(scene: Scene) -> bool:
    """Whether `restore_originals` brings something back."""
    return bool((scene.has(State.DELETED) & ~_made(scene, merged=True)).any())


# --- splats of other files ----------------------------------------------------------------------


def append(
    scene: Scene,
    splats: Gaussians,
    path: Path,
    digest: str,
    labels: IntArray | None = None,
    names: Mapping[int, str] | None = None,
    *,
    up: DoubleArray | None = None,
) -> Edit | None:
    """Add the splats of the file ``path`` to the scene, selected, each of a group of its own.

    Groups of the file (``labels`` (K,), by default its column ``group``) become new groups with the
    ``names`` of these, else named after the file; splats without one become a group of the file's
    name. A name that another object has gets a number. They stand on one placement row, so that
    they move as a whole, and are drawn, sorted, picked and selected together with all others.
    ``digest`` "": they are kept themselves, as no file has them as they are. ``up`` (3,) of the
    scene: a file that says which way is up in it is turned there by the smallest rotation about the
    origin. Where its format has an axis that is up that is the way back of an export of this scene;
    of others only where both ups clearly differ: models of the same coordinates fit, although each
    up was estimated.
    """
    path = Path(path).absolute()
    is_folder = path.name in (META, LOD_META)  # of SOG
    file = path.parent.name if is_folder else path.name
    title, stem = f"Add {file}", file if is_folder else file.split(".")[0] or file
    first = free_group(scene)
    if scene.bank is not None:  # which may make groups of the next ids
        first = -(-first // _GAP) * _GAP
    if labels is None:
        labels = splats.extra.get("group", np.zeros(0, np.int32))
    labels, given = _groups(labels, len(splats), first, stem, names or {})
    used = shown_names(scene)
    given = {group: own_name(name, used) for group, name in given.items()}
    unselect, named = select(scene, np.zeros(0, np.int32)), SetNames.of(scene, given)
    if not digest:
        return together(title, (unselect, append_made(scene, splats, labels, title), named))
    place = _at_end(scene, labels, State.SELECTED)
    turn = _turn_upright(splats, path, up)
    # As if the scene had been turned since then, so that a reset placement stands, too.
    frame = Frame(np.linalg.inv(turn) @ scene.frame.world)
    edit = AppendFile(title, *place, str(path), digest, OURS, frame.rows)
    edit.__dict__["splats"] = splats  # read already
    stands = _placed_at_end(scene, len(splats), turn, title)
    return together(title, (unselect, edit, stands, named))


def _turn_upright(splats: Gaussians, path: Path, up: DoubleArray | None) -> DoubleArray:
    """What stands the splats of a file upright, see `append`: (4, 4), exactly the identity where
    they do."""
    turn = np.eye(4)
    if up is None or splats.up is None:
        return turn
    up = up / np.linalg.norm(up)
    if is_standing(path) or float(splats.up @ up) <= NEARLY:
        turn[:3, :3] = turn_between(splats.up, up)
    return np.eye(4) if np.allclose(turn, np.eye(4), atol=_UPRIGHT) else turn


def _placed_at_end(
    scene: Scene, n_added: int, motion: DoubleArray, title: str
) -> SetPlacement | None:
    """Move splats that were added on the placement row at the end; None for the identity."""
    if np.array_equal(motion, np.eye(4)):
        return None
    row, none = len(scene.placements), np.zeros(0, np.int32)
    return SetPlacement(
        title=title,
        n_rows=row + 1,
        rows=np.array([row], np.int32),
        before=Placements.identity(1),
        after=replace(Placements.identity(1), matrix=motion[None, :3]),
        moved=IndexSet.of(none, len(scene) + n_added),
        rows_from=none,
        rows_to=none,
    )


def append_made(
    scene: Scene,
    splats: Gaussians,
    labels: IntArray,
    title: str,
    state: State = State.SELECTED,
    *,
    merged_from: Frame | None = None,
) -> AppendMade | None:
    """Add splats (K,), world, that no file has, with their groups ``labels`` (K,).

    They are kept in the project and in scripts themselves. ``merged_from``: they are made of splats
    that are deleted, and were moved like that since these came.
    """
    if len(splats) == 0:
        return None
    frame, is_merged = (merged_from or scene.frame).rows, merged_from is not None
    return AppendMade(title, *_at_end(scene, labels, state), Kept(splats), frame, is_merged)


def _at_end(
    scene: Scene, labels: IntArray, state: State
) -> tuple[PackedInts, int, int, int, int, int, tuple[str, ...]]:
    """Data of the scene for `AppendSplats`."""
    sizes = scene.n_rows_of_files, len(scene), len(scene.placements), scene.gaussians.sh.shape[1]
    packed = PackedInts.of(labels.astype(np.int32))
    return packed, int(state), *sizes, tuple(scene.gaussians.extra)


def _groups(
    column: AnyArray, n: int, first: int, stem: str, known: Mapping[int, str]
) -> tuple[IntArray, dict[int, str]]:
    """New labels (N,) from ``first`` on, and the names of the new groups."""
    if len(column) != n or column.dtype.kind not in "iu":
        column = np.zeros(n, np.int32)
    ids, places = np.unique(np.maximum(column.astype(np.int64), 0), return_inverse=True)
    own = {0: stem} | dict(known)
    names = [own.get(group, f"{stem} {group}") for group in ids.tolist()]
    labels = (first + places).astype(np.int32)
    return labels, {first + i: name for i, name in enumerate(names)}


def with_added_stage(
    opened: Gaussians, added: Sequence[Added], made: Sequence[Gaussians] = ()
) -> Stage[Gaussians]:
    """Rows of the opened file and of all files that were added to it, read again.

    The share that is told is that of all, the opened file's among them.
    ``made``: in order, those of the entries that an edit made and no file holds.
    """
    whole, left = opened, list(made)
    n = max((item.first + item.n for item in added), default=0)
    for item in added:
        if item.is_made:
            splats = left.pop(0)
            if len(splats) != item.n:
                raise GagaError("The splats that the project itself keeps are damaged.")
            whole = joined(whole, splats)
            continue
        read = read_added_stage(Path(item.path), item.fingerprint, item.axes)
        splats, _ = yield from portion(read, item.first / n, (item.first + item.n) / n, READS)
        if len(splats) != item.n or len(whole) != item.first:
            raise GagaError(
                f"{item.path} does not fit the saved project. Put the previous file back."
            )
        whole = joined(whole, splats)
    return whole


def spread(scene: Scene, values: IntArray) -> IntArray:
    """Groups (N,) of all splats from those of the rows of the opened file (M,).

    Copies have the group of their original; splats that an edit made as part of an object, or among
    those of none, have that of the nearest splat which was there; other added splats keep theirs,
    moved to ids above the new ones where they would collide.
    """
    return _spread(scene, values, scene.source < len(values))


def regrouped(scene: Scene, found: IntArray) -> tuple[IntArray, dict[int, int]]:
    """Groups (N,) of all splats once those of the rows of the opened file (M,) are ``found`` again.

    As `spread`, but an object that is a copy stays one, and copies that a person put into another
    object stay with the nearest splats of that. A copy that is in no object is judged as
    `duplicate` would judge it now: where it is more than half of an object that is found, it is an
    object, too. Also the new ids of the groups that no row of the file is in, by former ids.
    """
    if len(scene) == len(found):
        return found, {}
    known = scene.source < len(found)
    follows = known.copy()
    now, original = scene.labels[known], scene.labels[scene.source[known]]
    follows[known] = (now == original) | (now == 0)
    labels = _spread(scene, found, follows)
    own = np.flatnonzero(~follows & ~_continuing(scene, follows))
    former, first_rows = np.unique(scene.labels[own], return_index=True)
    pairs = zip(former.tolist(), labels[own[first_rows]].tolist(), strict=True)
    loose = np.flatnonzero(follows & (scene.labels == 0) & ~scene.has(State.DELETED))
    loose = loose[loose >= scene.n_opened]
    if len(loose):
        first = max(int(labels.max()) + 1, free_group(scene))
        labels[loose] = _copied_wholes(found, scene.source[loose], first)
    return labels, {old: new for old, new in pairs if old and new}


def _copied_wholes(found: IntArray, source: LongArray, first: int) -> IntArray:
    """Groups (K,) of copies of the rows ``source`` (K,): ids from ``first`` on for each copy of
    more than half of a group, else those of the originals."""
    order = np.argsort(source, kind="stable")
    ordered = source[order]
    nth = np.empty(len(source), np.int64)  # which copy of its row each one is
    nth[order] = np.arange(len(source)) - np.searchsorted(ordered, ordered)
    groups: IntArray = found[source]
    kinds, places, n_copied = np.unique(
        np.stack([groups, nth], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    whole = (kinds[:, 0] > 0) & (2 * n_copied > np.bincount(found)[kinds[:, 0]])
    ids = np.where(whole, first + np.cumsum(whole) - 1, kinds[:, 0])
    return ids[places.ravel()].astype(np.int32)


def _spread(scene: Scene, values: IntArray, follows: BoolArray) -> IntArray:
    """See `spread`; those that ``follow`` (N,) have the group of their row of the file."""
    if follows.all():
        return values[scene.source]
    continuing = _continuing(scene, follows)
    own = scene.labels[~follows & ~continuing]
    top, least = int(values.max(initial=0)), int(own[own > 0].min(initial=np.iinfo(np.int32).max))
    labels = np.empty(len(scene), np.int32)
    labels[follows] = values[scene.source[follows]]
    moved = np.where((own > 0) & (least <= top), own + (top - least + 1), own)
    labels[~follows & ~continuing] = moved
    merged = _made(scene, merged=True)
    _follow_neighbours(scene, continuing & merged, follows, labels, State(0))
    _follow_neighbours(scene, continuing & ~merged, follows, labels, State.DELETED)
    return labels


def _follow_neighbours(
    scene: Scene, made: BoolArray, among: BoolArray, labels: IntArray, without: State
) -> None:
    """Give ``made`` splats (N,) the group in ``labels`` (N,) of the nearest one ``among`` others
    (N,) that was in the same group before; of one ``without`` these states if there is any."""
    if not made.any():
        return
    # SciPy's import takes long: only where an edit made splats.
    from scipy.spatial import cKDTree

    means = np.nan_to_num(world_means(scene))
    for group in np.unique(scene.labels[made]):
        of = scene.labels == group
        best = among & of & ~scene.has(without)
        near = np.flatnonzero(best if best.any() else among & of)
        found = labels[near]
        if (found == found[0]).all():
            labels[made & of] = found[0]
        else:
            _, places = cKDTree(means[near]).query(means[made & of])
            labels[made & of] = found[places]


def _continuing(scene: Scene, follows: BoolArray) -> BoolArray:
    """Splats (N,) that an edit put into a group, or among those of none, in which some ``follow``
    (N,) their row of the opened file: made ones, and copies that do not follow."""
    made = _made(scene) | (scene.source < scene.n_opened)
    made &= ~follows
    if made.any():
        made &= np.isin(scene.labels, np.unique(scene.labels[follows]))
    return made


def _made(scene: Scene, *, merged: bool = False) -> BoolArray:
    """Splats (N,) that an edit made, or only those that it ``merged``."""
    made = np.zeros(len(scene), np.bool_)
    for item in scene.added:
        if item.is_merged if merged else item.is_made:
            made |= (scene.source >= item.first) & (scene.source < item.first + item.n)
    return made
