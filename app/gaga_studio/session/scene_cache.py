"""Values that panels read of a scene, computed once for each of its revisions."""

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, TypeVar, cast

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.query.group_facts import colors_outside, part_for_color
from gaga_core.scene import objects
from gaga_core.scene.edits.splats import regrouped
from gaga_core.scene.objects import ObjectTable, confidence_histogram
from gaga_core.scene.orientation import Pose
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.bounds import (
    OrientedBox,
    middle_pose,
    object_points,
    oriented_box,
    robust_box,
)
from gaga_core.scene.tint import mean_color

T = TypeVar("T")
_SAMPLE = 50_000  # splats looked at for a box
_PLACED = "splats state labels placement placements"  # of the revision: where the selection stands
SortKey = Literal["id", "name", "splats", "views", "quality"]


class SceneCache:
    """Cache of one scene: each value with the revision that it was computed for."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._kept: dict[str, tuple[object, object]] = {}

    def once(self, name: str, key: object, compute: Callable[[], T]) -> T:
        """Return what ``compute`` gave for this ``key``: computed again when the key is another."""
        kept = self._kept.get(name)
        if kept is None or kept[0] != key:
            kept = (key, compute())
            self._kept[name] = kept
        return cast(T, kept[1])

    def _by(self, name: str, fields: str, compute: Callable[[], T], *more: object) -> T:
        """Compute once for the revision of these ``fields`` of the scene, and ``more``."""
        revision = self._scene.revision
        return self.once(name, (*(getattr(revision, f) for f in fields.split()), *more), compute)

    def objects(self, live: BankSnapshot | None, is_previewing: bool) -> ObjectTable:
        """The object list; of the growing bank while ``live``. Unchanged during a drag."""
        scene = self._scene
        kept = self._kept.get("objects")
        if is_previewing and kept is not None:
            return cast(ObjectTable, kept[1])
        key = (scene.revision.total(), id(live) if live else 0)
        if live is None:
            return self.once("objects", key, lambda: objects.object_table(scene))
        labels, bank = self.live_labels(live), live.bank
        names, words = (scene.names, scene.described) if live.keeps_ids else ({}, {})
        shown = replace(scene, labels=labels, bank=bank, names=names, described=words)
        return self.once("objects", key, lambda: objects.object_table(shown))

    def live_labels(self, live: BankSnapshot) -> IntArray:
        """Group (N,) of each splat in the growing bank, 0 = none; copies are as they will be."""
        key = (id(live), self._scene.revision.splats)
        return self.once("live", key, lambda: regrouped(self._scene, groups_of(live.bank))[0])

    def has_groups(self) -> bool:
        """Whether any splat belongs to an object."""
        return self._by("grouped", "splats labels", lambda: bool((self._scene.labels > 0).any()))

    def n_splats(self) -> int:
        """Number of splats, without deleted ones."""
        scene = self._scene
        return self._by("count", "splats state", lambda: int((~scene.has(State.DELETED)).sum()))

    def selected_indices(self) -> IntArray:
        """Selected splats (K,)."""
        return self._by("indices", "splats state", lambda: objects.selected_indices(self._scene))

    def selected_groups(self) -> tuple[int, ...]:
        """Groups with a selected splat, ascending, without 0."""
        return self._by(
            "groups",
            "splats state labels",
            lambda: tuple(objects.selected_groups(self._scene).tolist()),
        )

    def selects_parts(self) -> bool:
        """Whether of a group with a selected splat others that are shown are not selected."""

        def find() -> bool:
            scene, chosen = self._scene, self.selected_indices()
            groups = np.array(self.selected_groups(), np.int32)
            n_shown = np.count_nonzero(np.isin(scene.labels, groups) & scene.visible)
            return bool(np.count_nonzero(scene.labels[chosen] > 0) < n_shown)

        return self._by("parts", "splats state labels", find)

    def n_loose(self) -> int:
        """How many of the selected splats belong to no group."""

        def find() -> int:
            return int(np.count_nonzero(self._scene.labels[self.selected_indices()] <= 0))

        return self._by("loose", "splats state labels", find)

    def selected_box(self, is_previewing: bool) -> tuple[DoubleArray, DoubleArray]:
        """Box lo, hi (3,) of the selection, world; during a drag: as before it."""

        def compute() -> tuple[DoubleArray, DoubleArray]:
            return robust_box(*self._selected_points())

        return self._placed("box", is_previewing, (), compute)

    def selected_pose(self, is_previewing: bool) -> Pose:
        """`middle_pose` of the selection, at least one splat; during a drag: as before it."""

        def compute() -> Pose:
            return middle_pose(self._scene, self.selected_indices(), *self._selected_points())

        return self._placed("pose", is_previewing, (), compute)

    def selected_sizes(self, is_previewing: bool, axes: DoubleArray) -> DoubleArray:
        """Sides (3,) of the selection's box along ``axes`` (3, 3), columns; as before a drag."""

        def compute() -> DoubleArray:
            points, share = self._selected_points()
            lo, hi = robust_box(points @ axes, share)
            return hi - lo

        return self._placed("sizes", is_previewing, axes.tobytes(), compute)

    def selected_oriented_box(self, is_previewing: bool) -> OrientedBox | None:
        """The smallest box around the selection; during a drag: as before it."""

        def compute() -> OrientedBox | None:
            return oriented_box(*self._selected_points())

        return self._placed("oriented box", is_previewing, (), compute)

    def _selected_points(self) -> tuple[FloatArray, float]:
        """Centres of the selection as `object_points`; of a part when it is large."""
        return self._by(
            "points", _PLACED, lambda: object_points(self._scene, self.selected_indices(), _SAMPLE)
        )

    def _placed(self, name: str, is_previewing: bool, more: object, compute: Callable[[], T]) -> T:
        """Return what is computed once for where the selection stands; during a drag: before it."""
        kept = self._kept.get(name)
        if is_previewing and kept is not None:
            return cast(T, kept[1])
        return self._by(name, _PLACED, compute, more)

    def seen_selection(
        self, cameras: Sequence[Camera], is_ready: bool
    ) -> tuple[IntArray, FloatArray | None]:
        """Splats (K,) that stand for the selection, and their colors from outside (K, 4).

        None unless ``is_ready``; ``cameras``: see `colors_outside`. The colors do not depend on
        where the selection stands nor on groups.
        """

        def compute() -> tuple[IntArray, FloatArray | None]:
            chosen = part_for_color(self.selected_indices())
            if not is_ready or len(chosen) == 0:
                return chosen, None
            return chosen, colors_outside(self._scene, chosen, cameras)

        return self._by("outside", "splats state", compute, *map(id, cameras), is_ready)

    def selected_color(self, cameras: Sequence[Camera], is_ready: bool) -> DoubleArray:
        """Mean color (3,) of the selection, 0..1, as it is drawn; see `seen_selection`."""
        splats, seen = self.seen_selection(cameras, is_ready)
        return self._by("color", _PLACED, lambda: mean_color(self._scene, splats, seen), id(seen))

    def listed(
        self, table: ObjectTable, text: str, sort: SortKey, descending: bool, quality: DoubleArray
    ) -> IntArray:
        """`listed`, once for what it depends on: a selection changes nothing of that."""
        by: dict[str, AnyArray] = {
            "splats": table.counts,
            "views": table.n_views,
            "quality": quality,
        }
        value = by[sort].tobytes() if sort in by else b""
        key = (text, sort, descending, table.ids.tobytes(), table.names, value)
        return self.once("listed", key, lambda: listed(table, text, sort, descending, quality))

    def labels_digest(self) -> str:
        """Digest of the groups of all splats; an undo restores it."""
        return self._by("digest", "splats labels", lambda: _digest(self._scene.labels))

    def overlap_is_of_points(self) -> bool:
        """Whether overlaps in the log are shares of surface points, not of splats."""
        bank = self._scene.bank
        return bank is not None and not bank.is_published

    def decision_now(self, former: Decision | None) -> Decision | None:
        """Return the present decision on the mask of ``former``; None if the bank has none."""
        bank = self._scene.bank
        if former is None or bank is None:
            return None
        return self.decision_of(former.view, former.mask)

    def decision_of(self, view: str, mask: int) -> Decision | None:
        """Return the decision of the bank on a mask, None if there is none."""
        bank = self._scene.bank
        if bank is None:
            return None
        return self.once("masks", bank, lambda: _by_mask(bank)).get((view, mask))

    def confidence(self, n_bins: int) -> tuple[float, LongArray] | None:
        """Mean confidence of the selected splats, and their number (B,) by confidence, ascending;
        None when it is unknown."""
        revision = self._scene.revision
        key = (revision.splats, revision.state, revision.labels, n_bins)
        return self.once(
            "confidence",
            key,
            lambda: confidence_histogram(self._scene, self.selected_indices(), n_bins),
        )

    def decisions(self, group: int, live: BankSnapshot | None) -> tuple[Decision, ...]:
        """Which mask of which view joined a group, in the order of the association."""
        bank = self._scene.bank if live is None else live.bank
        if bank is None:
            return ()
        return self.once("log", bank, lambda: by_group(bank)).get(group, ())


def _digest(labels: IntArray) -> str:
    return hashlib.blake2b(labels.tobytes(), digest_size=8).hexdigest()


def _by_mask(bank: MemoryBank) -> dict[tuple[str, int], Decision]:
    return {(decision.view, decision.mask): decision for decision in bank.log}


def groups_of(bank: MemoryBank) -> IntArray:
    """Group (M,) of each row of the opened file in a bank, 0 = none."""
    return np.maximum(bank.group, 0).astype(np.int32)


def by_group(bank: MemoryBank) -> dict[int, tuple[Decision, ...]]:
    """The log of a bank by group."""
    found: dict[int, list[Decision]] = {}
    for decision in bank.log:
        found.setdefault(decision.group, []).append(decision)
    return {group: tuple(decisions) for group, decisions in found.items()}


def listed(
    table: ObjectTable,
    text: str = "",
    sort: SortKey = "id",
    descending: bool = False,
    quality: DoubleArray | None = None,
) -> IntArray:
    """Rows (R,) of ``table`` to show: name or id contains ``text``; id 0 comes last.

    ``quality`` (G,) is by row. Equal keys stay in the order of their ids.
    """
    wanted = text.strip().casefold()
    rows = [
        row
        for row, name in enumerate(table.names)
        if wanted in name.casefold() or wanted == str(table.ids[row])
    ]
    keys: dict[str, Callable[[int], object]] = {
        "id": lambda row: int(table.ids[row]),
        "name": lambda row: natural(table.names[row]),
        "splats": lambda row: int(table.counts[row]),
        "views": lambda row: int(table.n_views[row]),
        "quality": lambda row: 0.0 if quality is None else float(quality[row]),
    }
    rows.sort(key=keys[sort], reverse=descending)  # type: ignore[arg-type]  # one kind per key
    rows.sort(key=lambda row: bool(table.ids[row] == 0))
    return np.array(rows, np.int32)


def natural(name: str) -> list[tuple[int, str]]:
    """Sort key: "group 9" comes before "group 12"."""
    words = re.split(r"(\d+)", name.casefold())
    return [(int(word), "") if word.isdecimal() else (-1, word) for word in words if word]
