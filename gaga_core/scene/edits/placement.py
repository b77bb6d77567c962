"""Builders of edits of placement rows: move, recolor."""

from dataclasses import replace

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.geometry import compose_affine
from gaga_core.scene.edits.placement_values import SetPlacement, take_rows
from gaga_core.scene.index_set import IndexSet, sorted_indices
from gaga_core.scene.scene import Placements, Scene

_ROUNDING = 1e-12  # relative: what is that near to where its file has it was not moved


def transform(
    scene: Scene, indices: AnyArray, matrix: AnyArray, title: str = "Move"
) -> SetPlacement | None:
    """Move splats by the world map ``matrix`` (3, 4), after whatever moved them before.

    Raises ``ValueError`` when the map is not finite or flattens space.
    """
    world = np.asarray(matrix, np.float64)[:3]
    if world.shape != (3, 4) or not np.isfinite(world).all() or not np.linalg.det(world[:, :3]):
        raise ValueError("matrix: expected a finite, invertible (3, 4) affine map")
    return _place(scene, indices, title, matrix=world)


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

    Raises ``ValueError`` when a number is not finite or the opacity is negative.
    """
    color = np.asarray(affine, np.float64)[:3]
    if color.shape != (3, 4) or not np.isfinite(color).all():
        raise ValueError("affine: expected a finite (3, 4) map")
    if not np.isfinite(opacity) or opacity < 0:
        raise ValueError(f"opacity: expected a factor >= 0, got {opacity}")
    return _place(scene, indices, title, color=color, opacity=opacity)


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
    if _same(old, after):
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


def _same(a: Placements, b: Placements) -> bool:
    return (
        np.array_equal(a.matrix, b.matrix)
        and np.array_equal(a.color, b.color)
        and np.array_equal(a.opacity, b.opacity)
    )
