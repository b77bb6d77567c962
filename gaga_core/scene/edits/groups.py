"""Builders of edits of groups: assign, rename, merge, the result of an association."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.scene.edits.folders import set_folders
from gaga_core.scene.edits.parents import merge_places
from gaga_core.scene.edits.values import (
    Edit,
    SetBank,
    SetColor,
    SetConfidence,
    SetIdentities,
    SetLabels,
    SetNames,
    together,
)
from gaga_core.scene.folders import Folders
from gaga_core.scene.index_set import IndexSet, PackedInts, sorted_indices
from gaga_core.scene.scene import Identities, Scene


def set_labels(
    scene: Scene, indices: AnyArray, labels: IntArray | int, title: str = "Assign"
) -> SetLabels | None:
    """Put splats into groups: one id for all, or one a splat (sorted by row, like ``indices``).

    Raises ``ValueError`` when a label is negative, or when unsorted rows come with many labels.
    """
    splats = sorted_indices(indices, len(scene))
    after = np.broadcast_to(np.asarray(labels, np.int32), (len(splats),))
    if np.ndim(labels) and indices.dtype != np.bool_ and not np.array_equal(splats, indices):
        raise ValueError("indices: expected sorted unique rows when each has its own label")
    if (after < 0).any():
        raise ValueError("labels: expected ids >= 0")
    before = scene.labels[splats]
    differs = after != before
    if not differs.any():
        return None
    return SetLabels(
        title,
        IndexSet.of(splats[differs], len(scene)),
        PackedInts.of(before[differs]),
        PackedInts.of(after[differs]),
    )


def rename(scene: Scene, group: int, name: str, title: str = "Rename") -> SetNames | None:
    """Name a group; an empty name takes its own name away."""
    after = " ".join(name.split()) or None
    before = scene.names.get(group)
    if after == before:
        return None
    return SetNames(title, ((group, before),), ((group, after),))


def name_groups(
    scene: Scene, names: Mapping[int, str], title: str = "Name objects"
) -> SetNames | None:
    """Name many groups at once, as one edit; None when nothing would change."""
    after = {group: " ".join(name.split()) or None for group, name in sorted(names.items())}
    changed = tuple((g, name) for g, name in after.items() if scene.names.get(g) != name)
    if not changed:
        return None
    return SetNames(title, tuple((g, scene.names.get(g)) for g, _ in changed), changed)


def set_color(
    scene: Scene, group: int, rgb: Sequence[float] | None, title: str = "Color"
) -> SetColor | None:
    """Give a group a color of its own, 0..1, in lists and group pictures; None = the palette's."""
    after = None
    if rgb is not None:
        red, green, blue = (round(min(max(float(c), 0.0), 1.0), 4) for c in rgb)
        after = (red, green, blue)
    before = scene.colors.get(group)
    return None if after == before else SetColor(title, group, before, after)


def set_grouping(
    scene: Scene,
    labels: IntArray,
    bank: MemoryBank | None,
    names: Mapping[int, str] | None = None,
    title: str = "Associate masks",
    confidence: FloatArray | None = None,
    folders: Folders | None = None,
) -> Edit | None:
    """The result of an association: labels (N,), its bank, and names (default: none).

    ``confidence`` (M,) in 0..1 is by row of the opened file. ``folders``: where the
    groups are (default: the folders stay, and are empty). Identities of the former groups go.
    """
    after = dict(names or {})
    touched = sorted({*scene.names, *after})
    changed = [g for g in touched if scene.names.get(g) != after.get(g)]
    rename_all = SetNames(
        "Rename",
        tuple((g, scene.names.get(g)) for g in changed),
        tuple((g, after.get(g)) for g in changed),
    )
    return together(
        title,
        (
            set_labels(scene, np.ones(len(scene), np.bool_), labels, title),
            SetBank(title, scene.bank, bank) if bank is not scene.bank else None,
            _set_confidence(scene, confidence, title),
            _forget_identities(scene, title),
            rename_all if changed else None,
            set_folders(scene, folders or Folders(scene.folders.paths), title),
        ),
    )


def _forget_identities(scene: Scene, title: str) -> SetIdentities | None:
    """Labels are votes again, and what encodings said of other groups is gone."""
    now = scene.identities
    if now.source == "votes" and now.other is None and now.colors is None:
        return None
    return SetIdentities(title, now, Identities())


def _set_confidence(
    scene: Scene, confidence: FloatArray | None, title: str
) -> SetConfidence | None:
    after = None
    if confidence is not None:
        check_shape("confidence", confidence, ("M",))
        after = as_bytes(confidence)
    if after is scene.confidence:
        return None
    return SetConfidence(title, scene.confidence, after)


def as_bytes(confidence: FloatArray) -> UInt8Array:
    """Confidence (M,) in 0..1 as it is kept: 0..255."""
    result: UInt8Array = np.rint(np.clip(np.nan_to_num(confidence), 0, 1) * 255).astype(np.uint8)
    return result


def merge_groups(scene: Scene, groups: Sequence[int], title: str = "Merge") -> Edit | None:
    """Make several groups one: the first one. Its name stays, else the first name found is taken.

    The bank's log follows, so that the merged group lists the masks of all its parts.
    Raises ``GagaError`` for "no group" (0).
    """
    wanted = list(dict.fromkeys(int(g) for g in groups))
    if 0 in wanted:
        raise GagaError('"unassigned" is no object. Choose groups to merge.')
    if len(wanted) < 2:
        return None
    into, others = wanted[0], wanted[1:]
    merged = np.isin(scene.labels, np.array(others, np.int32))
    name = next((scene.names[g] for g in wanted if g in scene.names), None)
    after: dict[int, str | None] = {**dict.fromkeys(others), into: name}
    changed = [g for g in wanted if scene.names.get(g) != after[g]]
    names = SetNames(
        "Rename",
        tuple((g, scene.names.get(g)) for g in changed),
        tuple((g, after[g]) for g in changed),
    )
    bank = None
    if scene.bank is not None:
        bank = SetBank(title, scene.bank, _merged_bank(scene.bank, into, others))
    labels = set_labels(scene, merged, into, title)
    places = merge_places(scene, into, others, title)
    return together(title, (labels, bank, names if changed else None, places))


def _merged_bank(bank: MemoryBank, into: int, others: Sequence[int]) -> MemoryBank:
    gone = set(others)
    log = tuple(replace(d, group=into) if d.group in gone else d for d in bank.log)
    group = np.where(np.isin(bank.group, np.array(others, np.int32)), into, bank.group)
    return replace(bank, group=group.astype(np.int32), log=log)
