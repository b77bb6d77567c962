"""Builder of the edit that adds the splats of another file, and what reads such scenes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.splat_files import is_same_model, model_fingerprint, read_splats_stage
from gaga_core.io.splats.spz import OURS
from gaga_core.progress import Stage
from gaga_core.scene.edits.append_values import AppendSplats, joined
from gaga_core.scene.edits.duplicate import free_group
from gaga_core.scene.edits.state import select
from gaga_core.scene.edits.values import Edit, SetNames, together
from gaga_core.scene.frame import Frame
from gaga_core.scene.index_set import PackedInts
from gaga_core.scene.scene import Added, Scene, State
from gaga_core.scene.selection.algebra import world_means

_GAP = 1000  # groups of added files start at a multiple of this where a bank makes groups too


def read_added_stage(
    path: Path, digest: str = "", axes: str = OURS
) -> Stage[tuple[Gaussians, str]]:
    """Splats of a file to be added, and its fingerprint; with ``digest``: it must be that one.

    ``axes``: of an .spz that does not say its own.

    Raises ``GagaError`` with one sentence when the file is gone, changed or damaged.
    """
    path = Path(path).absolute()
    if digest and not path.is_file():
        raise GagaError(f"The added splats are gone: {path}. Put the file back.")
    found = model_fingerprint(path)
    if digest and not is_same_model(path, digest):
        raise GagaError(f"{path} changed since its splats were added. Put the former file back.")
    return (yield from read_splats_stage(path, axes)), found


def append(
    scene: Scene, splats: Gaussians, path: Path, digest: str, title: str = ""
) -> Edit | None:
    """Add the splats of the file ``path`` to the scene, selected, each of a group of its own.

    Groups of the file (a column ``group``) become new groups, named after the file; splats without
    one become a group of the file's name. They stand on one placement row, so that they move as a
    whole, and are drawn, sorted, picked and selected together with all others.
    """
    path = Path(path).absolute()
    title = title or f"Add {path.name}"
    stem = path.name.split(".")[0] or path.stem
    first = free_group(scene)
    if scene.bank is not None:  # which may make groups of the next ids
        first = -(-first // _GAP) * _GAP
    labels, names = _groups(splats, first, stem)
    edit = AppendSplats(
        title=title,
        n=len(scene),
        n_rows=len(scene.placements),
        n_sh=scene.gaussians.sh.shape[1],
        columns=tuple(scene.gaussians.extra),
        splats=splats,
        labels=PackedInts.of(labels),
        added=Added(str(path), digest, scene.n_rows_of_files, len(splats), frame=scene.frame.rows),
    )
    named = SetNames("Rename", tuple((group, None) for group, _ in names), names)
    return together(title, (select(scene, np.zeros(0, np.int32)), edit, named))


def append_made(
    scene: Scene,
    splats: Gaussians,
    labels: IntArray,
    title: str,
    state: State = State.SELECTED,
    *,
    merged_from: Frame | None = None,
) -> AppendSplats | None:
    """Add splats (K,), world, that no file has, with their groups ``labels`` (K,).

    They are kept in the project and in scripts themselves. ``merged_from``: they are made of splats
    that are deleted, and were moved like that since these came.
    """
    if len(splats) == 0:
        return None
    origin = "", "", scene.n_rows_of_files, len(splats)
    return AppendSplats(
        title=title,
        n=len(scene),
        n_rows=len(scene.placements),
        n_sh=scene.gaussians.sh.shape[1],
        columns=tuple(scene.gaussians.extra),
        splats=splats,
        labels=PackedInts.of(labels.astype(np.int32)),
        added=Added(
            *origin,
            frame=(merged_from or scene.frame).rows,
            is_merged=merged_from is not None,
        ),
        state=state,
    )


def _groups(
    splats: Gaussians, first: int, stem: str
) -> tuple[IntArray, tuple[tuple[int, str | None], ...]]:
    """New labels (K,) from ``first`` on, and the names of the new groups."""
    column = splats.extra.get("group")
    if column is None or column.dtype.kind not in "iu":
        column = np.zeros(len(splats), np.int32)
    ids, places = np.unique(np.maximum(column.astype(np.int64), 0), return_inverse=True)
    names = [stem if group == 0 else f"{stem} {group}" for group in ids.tolist()]
    labels = (first + places).astype(np.int32)
    return labels, tuple((first + i, name) for i, name in enumerate(names))


def with_added_stage(
    opened: Gaussians, added: Sequence[Added], made: Sequence[Gaussians] = ()
) -> Stage[Gaussians]:
    """Rows of the opened file and of all files that were added to it, read again.

    ``made``: in order, those of the entries that an edit made and no file holds.
    """
    whole, left = opened, list(made)
    for item in added:
        if item.is_made:
            splats = left.pop(0)
            if len(splats) != item.n:
                raise GagaError("The splats that the project itself keeps are damaged.")
            whole = joined(whole, splats)
            continue
        splats, _ = yield from read_added_stage(Path(item.path), item.fingerprint, item.axes)
        if len(splats) != item.n or len(whole) != item.first:
            raise GagaError(
                f"{item.path} does not fit the saved project. Put the former file back."
            )
        whole = joined(whole, splats)
    return whole


def ids_of_added(scene: Scene, labels: IntArray) -> dict[int, int]:
    """New ids (values) of the groups of added splats, by their ids in the scene, see `spread`."""
    if not scene.added:
        return {}
    own = (scene.source >= scene.n_opened) & ~_continuing(scene)
    pairs = np.unique(np.stack([scene.labels[own], labels[own]], axis=1), axis=0).tolist()
    return {old: new for old, new in pairs if old and new}


def spread(scene: Scene, values: IntArray) -> IntArray:
    """Groups (N,) of all splats from those of the rows of the opened file (M,).

    Copies have the group of their original; splats that an edit made as part of an object, or among
    those of none, have that of the nearest splat which was there; other added splats keep theirs,
    moved to ids above the new ones where they would collide.
    """
    known = scene.source < len(values)
    if known.all():
        return values[scene.source]
    continuing = _continuing(scene)
    own = scene.labels[~known & ~continuing]
    top, least = int(values.max(initial=0)), int(own[own > 0].min(initial=np.iinfo(np.int32).max))
    labels = np.empty(len(scene), np.int32)
    labels[known] = values[scene.source[known]]
    moved = np.where((own > 0) & (least <= top), own + (top - least + 1), own)
    labels[~known & ~continuing] = moved
    merged = _made(scene, merged=True)
    _follow_neighbours(scene, continuing & merged, known, labels, State(0))
    _follow_neighbours(scene, continuing & ~merged, known, labels, State.DELETED)
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


def _continuing(scene: Scene) -> BoolArray:
    """Splats (N,) that an edit made as part of a group that the opened file has splats of, or of
    none as some of the file."""
    made = _made(scene)
    if made.any():
        made &= np.isin(scene.labels, np.unique(scene.labels[scene.source < scene.n_opened]))
    return made


def _made(scene: Scene, *, merged: bool = False) -> BoolArray:
    """Splats (N,) that an edit made, or only those that it ``merged``."""
    made = np.zeros(len(scene), np.bool_)
    for item in scene.added:
        if item.is_merged if merged else item.is_made:
            made |= (scene.source >= item.first) & (scene.source < item.first + item.n)
    return made
