"""Builders of edits of objects: their groups, names, colors and levels, and named selections."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray, LongArray, UInt8Array, check_shape
from gaga_core.errors import GagaError
from gaga_core.grouping.levels import Levels
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.scene.edits.folders import inherit_folders, merge_places, set_folders
from gaga_core.scene.edits.values import (
    Edit,
    SetBank,
    SetColor,
    SetConfidence,
    SetIdentities,
    SetLabels,
    SetNamedSelection,
    SetNames,
    SetWeight,
    together,
)
from gaga_core.scene.folders import Folders
from gaga_core.scene.index_set import IndexSet, PackedInts, sorted_indices
from gaga_core.scene.objects import group_indices
from gaga_core.scene.scene import Identities, Labelling, LabelSource, Scene, State, Weight
from gaga_core.scene.selection.algebra import selectable

NO_IDENTITIES = "There are no identities of these groups. Lift the groups first."
# Splats of a part, of its whole and at all: smaller ones are no part.
_LEAST_SHARE, _FEWEST = 0.01, 10


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
    return name_groups(scene, {group: name}, title)


def name_groups(
    scene: Scene, names: Mapping[int, str], title: str = "Name objects"
) -> SetNames | None:
    """Name many groups at once, as one edit; None when nothing would change."""
    after = {group: " ".join(name.split()) or None for group, name in sorted(names.items())}
    return SetNames.of(scene, after, title)


def shown_names(scene: Scene) -> set[str]:
    """What objects are called now, by a person or by their descriptions, in lower case."""
    return {name.casefold() for name in (*scene.names.values(), *scene.described.values())}


def numbered(name: str, used: set[str]) -> str:
    """The first free of "mug 2", "mug 3" for another "mug", and for another "mug 5" if there is a
    mug of another number, or without one. It is ``used`` from now on."""
    base = re.sub(r" \d+$", "", name)
    family = re.compile(rf"{re.escape(base.casefold())}(?: \d+)?")
    has_others = any(family.fullmatch(other) for other in used - {name.casefold()})
    stem, k = base if has_others else name, 2
    while f"{stem} {k}".casefold() in used:
        k += 1
    used.add(f"{stem} {k}".casefold())
    return f"{stem} {k}"


def own_name(name: str, used: set[str]) -> str:
    """``name``, `numbered` where another has it. It is ``used`` from now on."""
    if name.casefold() in used:
        return numbered(name, used)
    used.add(name.casefold())
    return name


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


def set_weight(
    scene: Scene, group: int, weight: Weight | None, title: str = "Set the weight"
) -> SetWeight | None:
    """Give a group a mass or a density for simulations; None = the density of an export.

    Raises ``ValueError`` for one that is not above 0.
    """
    if weight is not None and not 0 < weight.value < np.inf:
        raise ValueError(f"weight: expected a number above 0, got {weight.value}")
    before = scene.weights.get(group)
    return None if weight == before else SetWeight(title, group, before, weight)


def carry_looks(scene: Scene, kept: Mapping[int, int]) -> tuple[Edit | None, ...]:
    """Edits that leave colors and weights with their groups: new ids by former ones."""
    colors = {kept[group]: rgb for group, rgb in scene.colors.items() if group in kept}
    weights = {kept[group]: weight for group, weight in scene.weights.items() if group in kept}
    return (
        *(set_color(scene, g, colors.get(g)) for g in sorted({*scene.colors, *colors})),
        *(set_weight(scene, g, weights.get(g)) for g in sorted({*scene.weights, *weights})),
    )


def free_group(scene: Scene) -> int:
    """The first id above every group that was ever used."""
    order = scene.folders
    named = max(
        (*scene.names, *scene.weights, *order.home, *order.parent, *order.parent.values()),
        default=0,
    )
    in_bank = 0
    if scene.bank is not None:  # groups of other levels come back when these are chosen
        levels = scene.bank.levels
        of_levels = 0 if levels is None else int(levels.labels.max(initial=0))
        in_bank = max(scene.bank.n_groups, of_levels)
    other = scene.identities.other  # its groups come back when labels are switched
    waiting = int(other.labels.max(initial=0)) if other is not None else 0
    return max(int(scene.labels.max(initial=0)), named, in_bank, waiting) + 1


def set_grouping(
    scene: Scene,
    labels: IntArray,
    bank: MemoryBank | None,
    names: Mapping[int, str] | None = None,
    title: str = "Find objects",
    confidence: FloatArray | None = None,
    folders: Folders | None = None,
) -> Edit | None:
    """The result of an association: labels (N,), its bank, and names (default: none).

    ``confidence`` (M,) in 0..1 is by row of the opened file. ``folders``: where the
    groups are (default: the folders stay, and are empty). Identities of the former groups go.
    """
    after, sure, now = dict(names or {}), None, scene.identities
    if confidence is not None:
        check_shape("confidence", confidence, ("M",))
        sure = as_bytes(confidence)
    is_plain = now.source == "votes" and now.other is None and now.colors is None
    return together(
        title,
        (
            set_labels(scene, np.ones(len(scene), np.bool_), labels, title),
            SetBank.of(title, scene.bank, bank) if bank is not scene.bank else None,
            _set_confidence(scene, sure, title),
            None if is_plain else SetIdentities.of(title, now, Identities()),
            SetNames.of(scene, {g: after.get(g) for g in sorted({*scene.names, *after})}),
            set_folders(scene, folders or Folders(scene.folders.paths), title),
        ),
    )


def _set_confidence(scene: Scene, after: UInt8Array | None, title: str) -> SetConfidence | None:
    if after is scene.confidence:
        return None
    return SetConfidence.of(title, scene.confidence, after)


def as_bytes(confidence: FloatArray) -> UInt8Array:
    """Confidence (M,) in 0..1 as it is kept: 0..255."""
    return np.rint(np.clip(np.nan_to_num(confidence), 0, 1) * 255).astype(np.uint8)


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
    names = SetNames.of(scene, {into: name, **dict.fromkeys(others)})
    bank = None
    if scene.bank is not None:
        bank = SetBank.of(title, scene.bank, _merged_bank(scene.bank, into, others))
    labels = set_labels(scene, merged, into, title)
    places = merge_places(scene, into, others, title)
    return together(title, (labels, bank, names, places))


def _merged_bank(bank: MemoryBank, into: int, others: Sequence[int]) -> MemoryBank:
    log = tuple(_merged_decision(decision, into, frozenset(others)) for decision in bank.log)
    group, held = (
        np.where(np.isin(ids, np.array(others, np.int32)), into, ids).astype(np.int32)
        for ids in (bank.group, bank.shared[:, 1])
    )
    shared = np.stack([bank.shared[:, 0], held], axis=1)
    return replace(bank, group=group, log=log, shared=shared)


def _merged_decision(decision: Decision, into: int, others: frozenset[int]) -> Decision:
    """The decision on a mask once ``others`` are ``into``: its own group is no rival of itself."""
    if decision.group in others:
        decision = replace(decision, group=into, by_hand=True)
    if decision.runner_up not in {into, *others}:
        return decision
    if decision.group == into:
        return replace(decision, runner_up=0, runner_up_overlap=0.0)
    return replace(decision, runner_up=into)


# --- parts of objects ---------------------------------------------------------------------------


def _parted(
    scene: Scene,
    group: int,
    new: Sequence[int],
    edits: Iterable[Edit | None],
    title: str,
    end: str = "",
) -> Edit | None:
    """Edits that part ``new`` groups from a group: with names after its own, and where it is."""
    name, used, named = scene.names.get(group), shown_names(scene), dict[int, str]()
    stem = f"{name} {end}".strip()
    for id_ in new if name else ():
        named[id_] = own_name(stem, used)
    homes = inherit_folders(scene, dict.fromkeys(new, group))
    return together(title, (*edits, name_groups(scene, named, "Rename"), homes))


def separate(scene: Scene, indices: AnyArray, title: str = "Separate") -> Edit | None:
    """Make these splats a group of their own, named after the one that most of them leave."""
    splats = sorted_indices(indices, len(scene))
    splats = splats[~scene.has(State.DELETED)[splats]]
    if len(splats) == 0:
        return None
    left = int(np.bincount(scene.labels[splats]).argmax())
    if left and len(splats) == np.count_nonzero(scene.labels[splats] == left):
        rest = np.setdiff1d(group_indices(scene, left), splats)
        if len(rest) == 0:  # the whole group already
            return None
    group = free_group(scene)
    labels = set_labels(scene, splats, group, title)
    return _parted(scene, left, [group], [labels], title, "part")


def split(scene: Scene, group: int, least: int = 50, title: str = "Split") -> Edit | None:
    """Give each connected component of a group its own id; the largest keeps the group's.

    None when the group is in one piece; ``least`` as in `components_of`.
    """
    # Imported when first needed: importing search trees takes a part of the launch time.
    from gaga_core.scene.selection.neighbourhood import components_of

    parts = components_of(scene, group_indices(scene, group), least)
    if len(parts) < 2:
        return None
    first = free_group(scene)
    new = range(first, first + len(parts) - 1)
    rows: IntArray = np.concatenate(parts[1:])
    ids = np.repeat(new, [len(part) for part in parts[1:]])
    order = np.argsort(rows)
    labels = set_labels(scene, rows[order], ids[order].astype(np.int32), title)
    return _parted(scene, group, new, [labels], title)


def split_off(
    scene: Scene, group: int, rows: IntArray, bank: MemoryBank, into: int, title: str = "Split"
) -> Edit | None:
    """Make these rows (K,) of the opened file, and copies of them, group ``into``, where they are
    of ``group``; ``bank`` is the memory bank that goes with it."""
    leaves = np.zeros(int(scene.source.max(initial=-1)) + 1, np.bool_)
    leaves[rows] = True
    chosen = (scene.labels == group) & leaves[scene.source]
    labels = set_labels(scene, chosen, into, title)
    return _parted(scene, group, [into], [labels, SetBank.of(title, scene.bank, bank)], title)


@dataclass(frozen=True, eq=False)
class Parting:
    """Partition of some splats into two parts or more."""

    level: int  # that cuts them
    ids: LongArray  # (P,) labels of the parts at that level, the largest first
    part_of: LongArray  # (K,) part 0..P-1 of each splat; what is in no part goes to the largest


def parting(levels: Levels, source: LongArray, first: int = 0) -> Parting | None:
    """Cut splats with these rows (K,) of the opened file at the coarsest level that parts them.

    Levels before ``first`` do not count. None when no level parts them.
    """
    least = max(_FEWEST, _LEAST_SHARE * len(source))
    for level in range(first, len(levels.labels)):
        label = levels.labels[level][source]
        size = np.bincount(label)
        size[:1] = 0
        parts = np.flatnonzero(size >= least)
        if len(parts) > 1:
            ids = parts[np.argsort(-size[parts], kind="stable")]
            number = np.zeros(len(size), np.int64)
            number[ids] = np.arange(len(ids))
            return Parting(level, ids, number[label])
    return None


def split_here(scene: Scene, group: int, title: str = "Split here") -> Edit | None:
    """Make groups of the parts of a group, at the coarsest level that parts it.

    Levels are those that `gaga_core.grouping.surfaces` made; groups that were changed by hand
    since count as what most of their splats are. The largest part keeps the group's id and name.
    None when no level parts the group. Raises ``GagaError`` when the scene has no levels.
    """
    levels = _levels(scene)
    rows = group_indices(scene, group)
    rows = rows[scene.source[rows] < levels.labels.shape[1]]
    cut = parting(levels, scene.source[rows])
    if cut is None:
        return None
    ids = _free_ids(scene, levels, cut.ids[1:])
    new_id = np.append(np.int32(group), ids)
    labels = set_labels(scene, rows, new_id[cut.part_of], title)
    return _parted(scene, group, ids.tolist(), [labels], title)


def join_here(scene: Scene, group: int, title: str = "Join here") -> Edit | None:
    """Join a group with those that are one object with it at the finest level that says so.

    The id of ``group`` stays; its name does, else the first name found is taken. None when the
    group is one of its own at every level. Raises ``GagaError`` when the scene has no levels.
    """
    levels = _levels(scene)
    rows = np.flatnonzero((scene.source < levels.labels.shape[1]) & (scene.labels > 0))
    label, source = scene.labels[rows], scene.source[rows]
    total = np.bincount(label, minlength=group + 1)
    if total[group] == 0:
        return None
    for labels in levels.labels[::-1]:
        parent = int(np.bincount(labels[source[label == group]]).argmax())
        within = np.bincount(label[labels[source] == parent], minlength=len(total))
        others = np.flatnonzero(within > total / 2)
        others = others[others != group]
        if parent > 0 and len(others):
            return merge_groups(scene, (group, *others.tolist()), title)
    return None


def _levels(scene: Scene) -> Levels:
    if scene.bank is None or scene.bank.levels is None:
        raise GagaError(
            "These objects have no levels of detail. Use Find objects with masks of regions, or of "
            "Segment Anything."
        )
    return scene.bank.levels


def _free_ids(scene: Scene, levels: Levels, parts: LongArray) -> IntArray:
    """Ids (P,) of new groups: the parts' own ids of the levels where no group has them, so that
    names stay when the level of detail of all changes later."""
    order = scene.folders
    taken = {*np.unique(scene.labels).tolist(), *scene.names, *order.home, *order.parent}
    taken |= {*order.parent.values()}
    top = free_group(scene)
    ids = []
    for part in parts.tolist():
        is_free = part not in taken
        ids.append(part if is_free else top)
        top += not is_free
    return np.array(ids, np.int32)


# --- votes or identities ------------------------------------------------------------------------


def use_labels(scene: Scene, source: LabelSource) -> Edit | None:
    """Take the labels of the opened file's rows from ``source``; None when they are already.

    The labels in use are kept as they are, corrections by hand included, and come back when their
    source is chosen again. Duplicates and added splats stay in their groups. Raises ``GagaError``
    when there are no identities.
    """
    if source == scene.identities.source:
        return None
    wanted = scene.identities.other
    if wanted is None:
        raise GagaError(NO_IDENTITIES)
    kept = _in_use(scene, len(wanted.labels))
    after = replace(scene.identities, source=source, other=kept)
    return _with_labels(scene, wanted, after, f"Labels by {source}")


def set_identities(
    scene: Scene,
    labels: IntArray,  # (M,) by row of the opened file
    confidence: FloatArray,  # (M,) 0..1
    colors: UInt8Array,  # (M, 3)
    *,
    used: bool,
) -> Edit | None:
    """The result of a lift: what its classifier says of each Gaussian (`identity.field`).

    ``used``: labels come from there from now on; else votes stay in use. Former identities are
    replaced.
    """
    n = scene.n_opened
    check_shape("labels", labels, (n,), np.int32)
    check_shape("confidence", confidence, (n,), np.float32)
    check_shape("colors", colors, (n, 3), np.uint8)
    found, now = Labelling(labels, as_bytes(confidence)), scene.identities
    has_votes = now.source == "votes"
    votes = _in_use(scene, n) if has_votes else now.other
    other, after = None if has_votes else votes, Identities("votes", found, colors)
    if used:
        other, after = found, Identities("identities", votes, colors)
    return _with_labels(scene, other, after, "Lift groups to identities")


def _in_use(scene: Scene, n: int) -> Labelling:
    return Labelling(scene.labels[:n].copy(), scene.confidence)


def _with_labels(
    scene: Scene, found: Labelling | None, after: Identities, title: str
) -> Edit | None:
    """Other identities, and the labels that are in use then; None = those that are now."""
    edits: list[Edit | None] = [SetIdentities.of(title, scene.identities, after)]
    if found is not None:
        labels = set_labels(scene, np.arange(len(found.labels)), found.labels, title)
        edits += [labels, _set_confidence(scene, found.confidence, title)]
    return together(title, edits)


# --- named selections ---------------------------------------------------------------------------


def keep_selection(scene: Scene, name: str, indices: AnyArray) -> SetNamedSelection | None:
    """Keep these splats under a name; one of that name is replaced.

    Raises ``GagaError`` for an empty name.
    """
    title = " ".join(name.split())
    if not title:
        raise GagaError("A selection needs a name to be kept.")
    kept = IndexSet.of(sorted_indices(indices, len(scene)), len(scene))
    before = scene.named_selections.get(title)
    if before is not None and before.equals(kept):
        return None
    return SetNamedSelection("Keep selection", title, before, kept)


def forget_selection(scene: Scene, name: str) -> SetNamedSelection | None:
    """Forget a named selection; the splats stay as they are."""
    before = scene.named_selections.get(name)
    return None if before is None else SetNamedSelection("Forget selection", name, before, None)


def named_selection(scene: Scene, name: str) -> IntArray:
    """Splats (K,) of a named selection that can be selected now.

    Rows never move, so a set stays right while the scene grows. ``GagaError`` for another name.
    """
    if name not in scene.named_selections:
        raise GagaError(f'There is no selection named "{name}" here.')
    rows = scene.named_selections[name].indices()
    rows = rows[rows < len(scene)]  # the copies of an undone duplicate are no more
    return rows[selectable(scene)[rows]].astype(np.int32)
