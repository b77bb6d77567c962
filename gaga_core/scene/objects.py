"""The object list: one row a group."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.color import LUMA, group_palette, shades
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.raster.cpu.prepare import for_kernel
from gaga_core.scene.folders import Folders
from gaga_core.scene.scene import RGB, Scene, State
from gaga_core.scene.splat_kernels import tally_groups

UNASSIGNED = "unassigned"
_MUTED_FROM = 4  # groups, from which on large ones are muted
_SMALL, _LARGE = 0.35, 0.6  # radii, of the scene's: from not muted at all to muted most
_MUTED = 0.7  # of its color is taken from a large surface
_LUMA = LUMA.astype(np.float32)
_DENSE = 1 << 20  # up to here a group id is its own row while counting


@dataclass(frozen=True, eq=False)
class ObjectTable:
    """One row per group that has a splat that is not deleted, by id; id 0 is "unassigned"."""

    ids: IntArray  # (G,) ascending
    counts: LongArray  # (G,) splats, not deleted
    n_views: IntArray  # (G,) views in which a mask joined the group
    n_selected: LongArray  # (G,)
    n_hidden: LongArray  # (G,)
    n_locked: LongArray  # (G,)
    colors: FloatArray  # (G, 3) swatch
    names: tuple[str, ...]  # see `group_name`
    centre: DoubleArray  # (G, 3) mean position, world, placements applied
    radius: DoubleArray  # (G,) twice the root mean square distance from it
    lo: DoubleArray  # (G, 3) bounding box of centres, world
    hi: DoubleArray  # (G, 3)

    def __len__(self) -> int:
        return len(self.ids)

    def row(self, group: int) -> int | None:
        """Row of a group; None when it has no splats."""
        at = int(np.searchsorted(self.ids, group))
        return at if at < len(self.ids) and self.ids[at] == group else None


def object_table(scene: Scene) -> ObjectTable:
    """The object list of ``scene``: one pass, about 10 ms per million splats.

    Live labels of a running association: ``object_table(replace(scene, labels=..., bank=...))``.
    """
    key, top = scene.labels, int(scene.labels.max(initial=0))
    if top < _DENSE and int(key.min(initial=0)) >= 0:
        ids = np.arange(top + 1, dtype=np.int64)
    else:
        found, places = np.unique(key, return_inverse=True)
        key, ids = places.astype(np.int32), found.astype(np.int64)
    counts = np.zeros((len(ids), 16), np.int64)
    spread = np.zeros((len(ids), 10))
    spread[:, :3], spread[:, 3:6] = np.inf, -np.inf
    tally_groups(
        key,
        scene.state,
        scene.placement,
        for_kernel(scene.placements.matrix, np.float64),
        for_kernel(scene.gaussians.means, np.float32),
        counts,
        spread,
    )
    counts[:, np.arange(16) & State.DELETED != 0] = 0
    rows = np.flatnonzero(counts.sum(axis=1))
    counts, spread = counts[rows], spread[rows]
    shown = ids[rows].astype(np.int32)

    def having(bit: State) -> LongArray:
        return counts[:, np.arange(16) & bit != 0].sum(axis=1)

    n = counts.sum(axis=1)
    centre = spread[:, 6:9] / n[:, None]
    variance = spread[:, 9] / n - (centre**2).sum(axis=1)
    radius = 2 * np.sqrt(np.maximum(variance, 0))
    views = _views_of_groups(scene.bank)
    return ObjectTable(
        ids=shown,
        counts=n,
        n_views=np.array([views[group] for group in shown.tolist()], np.int32),
        n_selected=having(State.SELECTED),
        n_hidden=having(State.HIDDEN),
        n_locked=having(State.LOCKED),
        colors=_calm(group_colors(shown, scene.colors), shown, (n, centre, radius), scene.colors),
        names=tuple(group_name(scene, int(g)) for g in shown),
        centre=centre,
        radius=radius,
        lo=spread[:, :3],
        hi=spread[:, 3:6],
    )


def group_name(scene: Scene, group: int) -> str:
    """The name a person gave, else its description, else "group 12"; group 0 is "unassigned"."""
    if group == 0:
        return UNASSIGNED
    return scene.names.get(group) or scene.described.get(group) or f"group {group}"


def group_indices(scene: Scene, groups: Iterable[int] | int) -> IntArray:
    """Splats (K,) of these groups that are not deleted, hidden ones included."""
    wanted = [groups] if isinstance(groups, int) else [int(g) for g in groups]
    if len(wanted) == 1:
        inside = scene.labels == wanted[0]
    else:
        inside = np.isin(scene.labels, np.array(wanted, np.int32))
    inside &= ~scene.has(State.DELETED)
    return np.flatnonzero(inside).astype(np.int32)


def selected_indices(scene: Scene) -> IntArray:
    """Splats (K,) that are selected and not deleted."""
    bits = np.uint8(State.SELECTED | State.DELETED)
    return np.flatnonzero((scene.state & bits) == np.uint8(State.SELECTED)).astype(np.int32)


def selected_groups(scene: Scene) -> IntArray:
    """Groups (K,) that have a selected splat, ascending; 0 is never among them."""
    groups = np.unique(scene.labels[selected_indices(scene)])
    return groups[groups > 0].astype(np.int32)


def group_colors(ids: IntArray, own: Mapping[int, RGB] | None = None) -> FloatArray:
    """Swatch colors (G, 3) of groups: a person's ``own``, else the group render mode's palette."""
    top = int(ids.max(initial=0))
    # The palette is stable by id: a longer one, kept, serves every shorter list.
    palette = _palette(max(256, 1 << top.bit_length())) if top < _DENSE else _palette(256)
    colors: FloatArray = palette[ids % len(palette)]
    for group, rgb in (own or {}).items():
        colors[ids == group] = rgb
    return colors


def folder_colors(folders: Folders, ids: IntArray) -> FloatArray:
    """Colors (G, 3) of groups ``ids`` (G,): one hue for each folder, dark gray for none."""
    hue = {path: i for i, path in enumerate(folders.paths)}
    places = folders.places
    hues = np.array([hue.get(places.get(group, ""), -1) for group in ids.tolist()], np.int32)
    colors = shades(np.maximum(hues, 0), ids)
    colors[hues < 0] = _palette(256)[0]
    return colors


def muted_colors(table: ObjectTable) -> dict[int, RGB]:
    """Colors of the groups of ``table`` that differ from the palette of groups, by group."""
    plain = group_colors(table.ids)
    differs = np.abs(plain - table.colors).max(axis=1) > 0
    return {
        int(table.ids[row]): (float(r), float(g), float(b))
        for row, (r, g, b) in zip(np.flatnonzero(differs), table.colors[differs], strict=True)
    }


def _calm(
    colors: FloatArray,
    ids: IntArray,
    balls: tuple[LongArray, DoubleArray, DoubleArray],
    own: Mapping[int, RGB],
) -> FloatArray:
    """``colors`` (G, 3) with those of large surfaces muted: walls and floors are no neon.

    ``balls`` are counts, centres and radii of the groups. Muted is what spreads over a large part
    of the scene, if there are several groups; colors that a person chose stay as they are.
    """
    n, centre, radius = balls
    if np.count_nonzero(ids) < _MUTED_FROM:
        return colors
    middle = (n[:, None] * centre).sum(axis=0) / n.sum()
    squares = radius**2 / 4 + ((centre - middle) ** 2).sum(axis=1)
    spread = 2 * np.sqrt((n * squares).sum() / n.sum())
    share = np.clip((radius / max(spread, 1e-12) - _SMALL) / (_LARGE - _SMALL), 0, 1)
    share[np.isin(ids, [0, *own])] = 0
    gray = (colors @ _LUMA)[:, None]
    return (colors + _MUTED * share[:, None] * (gray - colors)).astype(np.float32)


@lru_cache(maxsize=4)
def _palette(n_groups: int) -> FloatArray:
    return group_palette(n_groups)


@lru_cache(maxsize=1)
def _views_of_groups(bank: MemoryBank | None) -> Counter[int]:
    """Number of views in the log by group. Banks are frozen and hash by identity."""
    seen = {(d.group, d.view) for d in bank.log} if bank is not None else ()
    return Counter(group for group, _ in seen)


# --- Confidence of the splats' groups: histogram over a selection, and uncertain splats.


def confidence_histogram(
    scene: Scene, splats: IntArray, n_bins: int = 20
) -> tuple[float, LongArray] | None:
    """Mean confidence 0..1 of ``splats`` (K,), and their number (B,) in bins of ascending
    confidence; None when it is unknown."""
    column = scene.confidence_of()
    if column is None:
        return None
    found = column[splats].astype(np.int64)
    mean = float(found.mean()) / 255 if len(found) else 0.0
    return mean, np.bincount(found * n_bins // 256, minlength=n_bins)


def confidence_of_groups(scene: Scene, ids: IntArray) -> DoubleArray:
    """Mean confidence (G,), 0..1, of the splats of groups ``ids`` (G,); -1 where it is unknown.

    Deleted splats do not count.
    """
    column = scene.confidence_of()
    if column is None:
        return np.full(len(ids), -1.0)
    live = ~scene.has(State.DELETED)
    labels, n = scene.labels[live], int(ids.max(initial=0)) + 1
    total = np.bincount(labels, column[live], n)[ids]
    count = np.bincount(labels, minlength=n)[ids]
    return np.where(count > 0, total / (255.0 * np.maximum(count, 1)), -1.0)


def uncertain(scene: Scene, splats: IntArray, below: float) -> IntArray:
    """Those of ``splats`` (K,), locked and deleted ones aside, with a confidence under ``below``.

    Splats that no mask sees have confidence 0. Raises ``GagaError`` when confidence is unknown.
    """
    column = scene.confidence_of()
    if column is None:
        raise GagaError(
            "The confidence of the splats is not known. Use Find objects to measure it."
        )
    free = ~scene.has(State.LOCKED | State.DELETED)[splats]
    return splats[free & (column[splats] < below * 255)]
