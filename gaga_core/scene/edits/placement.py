"""Builders of edits that move, recolor and copy splats, and that move the scene as a whole."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.errors import GagaError, decimal_text
from gaga_core.geometry import compose_affine
from gaga_core.scene.edits.folders import inherit_folders
from gaga_core.scene.edits.objects import free_group, numbered, set_weight, shown_names
from gaga_core.scene.edits.splats import select
from gaga_core.scene.edits.values import (
    AppendCopies,
    Edit,
    SetFrame,
    SetNames,
    SetPlacement,
    take_rows,
    together,
)
from gaga_core.scene.frame import Frame, scale_of
from gaga_core.scene.index_set import IndexSet, PackedInts, sorted_indices
from gaga_core.scene.named_arrays import placements_of
from gaga_core.scene.scene import Placements, Revision, Scene, State
from gaga_core.scene.selection import algebra

_TOO_FAR = (
    "This would bring splats farther away, or make them larger, smaller or brighter, than can be "
    "saved. Take a less extreme number."
)
_ROUNDING = 1e-12  # relative: what is that near to where its file has it was not moved
_SAME_LENGTH = 1e-6  # relative: lengths are measured in float32
_LEAST_SCALE, _MOST_SCALE = 1e-9, 1e9  # factors of the whole scene


def transform(
    scene: Scene, indices: AnyArray, matrix: AnyArray, title: str = "Move"
) -> SetPlacement | None:
    """Move splats by the world map ``matrix`` (3, 4), after whatever moved them before.

    Raises ``ValueError`` when the map is not finite or flattens space, ``GagaError`` when splats
    would be farther away, larger or smaller than can be saved.
    """
    world = np.asarray(matrix, np.float64)[:3]
    if world.shape != (3, 4) or not np.isfinite(world).all() or not np.linalg.det(world[:, :3]):
        raise ValueError("matrix: expected a finite, invertible (3, 4) affine map")
    return _place(scene, indices, title, matrix=world)


def transform_each(
    scene: Scene, moves: Sequence[tuple[AnyArray, AnyArray]], title: str
) -> Edit | None:
    """Move each of some sets of splats by a world map (3, 4) of its own; one edit of all."""
    moved, made = replace(scene, revision=Revision()), list[Edit | None]()
    for indices, matrix in moves:
        edit = transform(moved, indices, matrix, title)
        if edit is not None:  # the next one counts its rows of the table from there
            edit.apply(moved)
        made.append(edit)
    return together(title, made)


def reset_placement(
    scene: Scene, indices: AnyArray, title: str = "Reset placement"
) -> SetPlacement | None:
    """Put splats back to where they were when their file was opened or added.

    In the scene as it was moved as a whole since then.
    """
    return _place(scene, indices, title, resets=True)


def recolor(
    scene: Scene,
    indices: AnyArray,
    affine: AnyArray,
    opacity: float = 1.0,
    title: str = "Recolor",
) -> SetPlacement | None:
    """Color splats by ``affine`` (3, 4) in RGB and multiply their opacity, after earlier recolors.

    Raises ``ValueError`` when a number is not finite or the opacity is negative, ``GagaError`` when
    a number would be larger than can be saved.
    """
    color = np.asarray(affine, np.float64)[:3]
    if color.shape != (3, 4) or not np.isfinite(color).all():
        raise ValueError("affine: expected a finite (3, 4) map")
    if not np.isfinite(opacity) or opacity < 0:
        raise ValueError(f"opacity: expected a factor >= 0, got {opacity}")
    return _place(scene, indices, title, color=color, opacity=opacity)


def as_it_came(scene: Scene) -> Scene:
    """``scene`` with the splats of the opened file, and copies of them, where that file has them,
    moved as the scene is as a whole; itself where they are. Colors stay as they are."""
    used, first = np.unique(scene.placement, return_index=True)
    rows = scene.source[first] < scene.n_opened
    splats, used = first[rows], used[rows].astype(np.int32)
    matrix = scene.placements.matrix.copy()
    matrix[used] = _of_files(scene, splats, take_rows(scene.placements, used), used)
    if np.array_equal(matrix, scene.placements.matrix):
        return scene
    return replace(scene, placements=replace(scene.placements, matrix=matrix))


def _place(
    scene: Scene,
    indices: AnyArray,
    title: str,
    *,
    matrix: AnyArray | None = None,
    color: AnyArray | None = None,
    opacity: float = 1.0,
    resets: bool = False,
) -> SetPlacement | None:
    """Compose onto the rows of these splats, or give them that of a file ("resets").

    A row that stands for chosen splats only is changed where it is, so that an object that is
    dragged ten times keeps one row; else the chosen splats get a row of their own. Row 0 stays.
    Deleted splats count as users of their row: brought back, they stand where they stood.
    """
    splats = sorted_indices(indices, len(scene))
    if len(splats) == 0:
        return None
    n_rows = len(scene.placements)
    chosen = np.bincount(scene.placement[splats], minlength=n_rows)
    used = np.flatnonzero(chosen).astype(np.int32)
    whole = chosen[used] == np.bincount(scene.placement, minlength=n_rows)[used]
    whole &= used != 0
    in_place, parted = used[whole], used[~whole]
    appended = n_rows + np.arange(len(parted), dtype=np.int32)
    rows = np.concatenate([in_place, appended])
    old = take_rows(scene.placements, np.concatenate([in_place, parted]))
    after = composed(old, matrix, color, opacity)
    if resets:
        sources = np.concatenate([in_place, parted])
        after = replace(after, matrix=_of_files(scene, splats, old, sources))
    _require_saved(after)
    columns = (
        (getattr(old, name), getattr(after, name)) for name in ("matrix", "color", "opacity")
    )
    if all(np.array_equal(a, b) for a, b in columns):
        return None
    goes = np.isin(scene.placement[splats], parted)
    return SetPlacement(
        title=title,
        n_rows=n_rows,
        rows=rows,
        before=take_rows(scene.placements, in_place),
        after=after,
        moved=IndexSet.of(splats[goes], len(scene)),
        rows_from=parted,
        rows_to=appended,
    )


def _require_saved(rows: Placements) -> None:
    """``GagaError`` when a project with these rows could not be opened again."""
    try:
        placements_of({"matrix": rows.matrix, "color": rows.color, "opacity": rows.opacity})
    except ValueError as error:
        raise GagaError(_TOO_FAR) from error


def _of_files(scene: Scene, splats: AnyArray, old: Placements, rows: IntArray) -> DoubleArray:
    """Matrices (R, 3, 4) that ``rows`` of the table, with the values ``old``, had as files came.

    All splats of a row are of one file.
    """
    used, places = np.unique(scene.placement[splats], return_index=True)
    first = dict(zip(used.tolist(), splats[places].tolist(), strict=True))
    motions = [scene.motion_of(int(scene.source[first[row]]))[:3] for row in rows.tolist()]
    made: DoubleArray = np.array(motions).reshape(-1, 3, 4)
    size = np.abs(made).max(axis=(1, 2), keepdims=True)
    is_there = (np.abs(made - old.matrix) <= _ROUNDING * size).all(axis=(1, 2), keepdims=True)
    return np.where(is_there, old.matrix, made)


def composed(
    old: Placements, matrix: AnyArray | None, color: AnyArray | None, opacity: float
) -> Placements:
    """Rows that do what ``old`` does and then these maps."""
    return Placements(
        matrix=old.matrix if matrix is None else compose_affine(matrix, old.matrix),
        color=old.color if color is None else compose_affine(color, old.color),
        opacity=old.opacity * opacity,
    )


# --- the scene as a whole -----------------------------------------------------------------------


def move_scene(
    scene: Scene, matrix: AnyArray, title: str, *, is_metric: bool | None = None
) -> Edit | None:
    """Move everything, hidden and locked splats too, by a similarity (3, 4), world.

    Photos, bookmarks and the camera path follow (`gaga_core.scene.frame`). ``is_metric`` says
    whether a unit is a metre then; by default as before. Raises ``ValueError`` when the map is no
    rotation times a scale, ``GagaError`` when the scene would be farther away or larger than can be
    saved.
    """
    motion = np.vstack([np.asarray(matrix, np.float64)[:3], [0.0, 0.0, 0.0, 1.0]])
    scale_of(motion)
    before = scene.frame
    metric = before.is_metric if is_metric is None else is_metric
    try:
        after = Frame(motion @ before.world, metric)
    except ValueError as error:
        raise GagaError(_TOO_FAR) from error
    set_frame = None if after.equals(before) else SetFrame(title, before, after)
    is_still = np.array_equal(motion, np.eye(4))
    moved = None if is_still else transform(scene, algebra.whole(scene), motion[:3], title)
    return together(title, [moved, set_frame])


def set_scale(scene: Scene, length: float, metres: float, about: AnyArray) -> Edit | None:
    """Scale everything about a point (3,) so that ``length``, world, becomes ``metres``.

    A unit is a metre then; None where it has that length in metres already. Raises ``GagaError``
    when a length is no positive number, or the factor is none that a scene can have.
    """
    if not (np.isfinite([length, metres]).all() and length > 0 and metres > 0):
        raise GagaError("A length must be above 0.")
    factor = metres / length
    if not _LEAST_SCALE < factor < _MOST_SCALE:
        times = decimal_text(factor)
        raise GagaError(f"The scene would become {times} times as large. Check the lengths.")
    if scene.frame.is_metric and abs(factor - 1) < _SAME_LENGTH:
        return None
    offset = (1 - factor) * np.asarray(about, np.float64)
    grown = np.column_stack([factor * np.eye(3), offset])
    return move_scene(scene, grown, "Set scale", is_metric=True)


def set_origin(scene: Scene, point: AnyArray) -> Edit | None:
    """Move everything so that a point (3,), world, becomes the origin."""
    offset = -np.asarray(point, np.float64)
    return move_scene(scene, np.column_stack([np.eye(3), offset]), "Set origin")


# --- copies -------------------------------------------------------------------------------------


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
    labels: IntArray = scene.labels[splats]
    named: tuple[Edit | None, ...] = ()
    if new_group:
        labels, named = _copied_groups(scene, splats)
    unselect = select(scene, np.zeros(0, np.int32))
    copies = _copies(scene, splats, matrix, labels, title)
    return together(title, (unselect, *copies, *named))


def clone(
    scene: Scene, indices: AnyArray, matrix: AnyArray, group: int, title: str = "Clone"
) -> Edit | None:
    """Append copies of these splats, moved by ``matrix`` (3, 4) world, as part of ``group``.

    What a clone brush does: nothing gets selected. Deleted splats are not copied.
    """
    splats = sorted_indices(indices, len(scene))
    splats = splats[~scene.has(State.DELETED)[splats]]
    if len(splats) == 0:
        return None
    labels = np.full(len(splats), group, np.int32)
    return together(title, _copies(scene, splats, matrix, labels, title, State(0)))


def _copies(
    scene: Scene,
    splats: AnyArray,
    matrix: AnyArray | None,
    labels: IntArray,
    title: str,
    state: State = State.SELECTED,
) -> tuple[SetPlacement | None, AppendCopies]:
    """Copies (K,), on rows of their own when they are moved; no splat of the scene moves there."""
    n, rows, moved = len(scene), scene.placement[splats], None
    if matrix is not None:
        n_rows, none = len(scene.placements), np.zeros(0, np.int32)
        used, places = np.unique(rows, return_inverse=True)
        fresh = n_rows + np.arange(len(used), dtype=np.int32)
        rows, world = fresh[places], np.asarray(matrix, np.float64)[:3]
        after = composed(take_rows(scene.placements, used), world, None, 1.0)
        before, nobody = take_rows(scene.placements, none), IndexSet.of(none, n)
        moved = SetPlacement("Duplicate", n_rows, fresh, before, after, nobody, used, fresh)
    packed = PackedInts.of(labels), int(state)
    return moved, AppendCopies(title, *packed, IndexSet.of(splats, n), PackedInts.of(rows))


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
    used, names = shown_names(scene), {}
    for old, new in zip(whole.tolist(), fresh.tolist(), strict=True):
        if old in scene.names:
            names[new] = numbered(scene.names[old], used)
    origins = dict(zip(fresh.tolist(), whole.tolist(), strict=True))
    weights = (set_weight(scene, new, scene.weights.get(old)) for new, old in origins.items())
    return target[labels], (SetNames.of(scene, names), inherit_folders(scene, origins), *weights)
