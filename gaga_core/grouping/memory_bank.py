"""The 3D-aware memory bank (section 3.2): which Gaussians each group owns, and why."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Literal, overload

import numpy as np
from scipy.sparse import coo_array

from gaga_core.arrays import IntArray, LongArray, check_shape
from gaga_core.grouping.gate_kernels import greatest_overlaps, take_free
from gaga_core.grouping.levels import Levels

Preset = Literal["paper", "robust"]  # see `associate.AssociateConfig.of`


@dataclass(frozen=True)
class Decision:
    """The decision on a mask, with its reason."""

    view: str  # name of the view
    mask: int  # id in that view's label map
    group: int  # the group that it joined or opened; 0 = none (no Gaussians passed the gate)
    is_new: bool  # opened the group
    overlap: float  # with the best group before the decision, #(G(m) and G_i) / #G(m)
    runner_up: int  # second-best group, 0 = none
    runner_up_overlap: float
    n_gaussians: int  # #G(m)
    by_hand: bool = False  # a person said so: see `reassociate`


class DecisionLog(Sequence[Decision]):
    """Decisions in the order made. A log and those that continue it share their entries.

    So a log that grows view by view costs what is added, and an earlier one stays as it was.
    """

    def __init__(self, entries: list[Decision], length: int) -> None:
        self._entries = entries  # of the longest log; this one ends at `length`
        self._length = length

    @staticmethod
    def of(decisions: Sequence[Decision]) -> "DecisionLog":
        """``decisions`` as a log that can be continued."""
        if isinstance(decisions, DecisionLog):
            return decisions
        return DecisionLog(list(decisions), len(decisions))

    def plus(self, decisions: Iterable[Decision]) -> "DecisionLog":
        """This log and then ``decisions``."""
        entries = self._entries
        if len(entries) != self._length:  # another log continues this one
            entries = entries[: self._length]
        entries.extend(decisions)
        return DecisionLog(entries, len(entries))

    def __eq__(self, other: object) -> bool:
        """Whether another sequence holds equal decisions in the same order."""
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]  # it can be compared, as a list

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[Decision]:
        return islice(self._entries, self._length)

    @overload
    def __getitem__(self, place: int) -> Decision: ...
    @overload
    def __getitem__(self, place: slice) -> tuple[Decision, ...]: ...
    def __getitem__(self, place: int | slice) -> Decision | tuple[Decision, ...]:
        places = range(self._length)[place]
        if isinstance(places, int):
            return self._entries[places]
        return tuple(self._entries[k] for k in places)


@dataclass(frozen=True, eq=False)
class MemoryBank:
    """The bank after some views. ``log`` holds one decision a mask, in the order made."""

    group: IntArray  # (N,) -1 = free, else group id 1..n_groups
    n_groups: int
    log: Sequence[Decision] = ()
    preset: Preset = field(kw_only=True)  # that decided; overlaps in the log are shares of splats
    # ("paper") or of points on the surfaces ("robust"), and a repair decides in the same way
    levels: Levels | None = field(default=None, kw_only=True)  # of detail, where masks give some

    @staticmethod
    def empty(n_gaussians: int, preset: Preset = "paper") -> "MemoryBank":
        """A bank in which every Gaussian is free."""
        return MemoryBank(np.full(n_gaussians, -1, np.int32), 0, preset=preset)


def at_level(bank: MemoryBank, level: int) -> MemoryBank:
    """The bank with the groups of another of its levels.

    Masks go where most of the Gaussians of their group go: a coarser level lists those of all of
    its parts, a finer one leaves them with the largest part. Raises ``ValueError`` without levels.
    """
    if bank.levels is None:
        raise ValueError("bank: has no levels of detail")
    labels = bank.levels.labels[level]
    old = np.maximum(bank.group, 0)
    # Sparse: a table of all pairs of ids, which come from a file, may not fit into memory.
    pairs = coo_array((np.ones(len(old), np.int32), (old, labels))).tocsr().tocoo()
    rising = np.lexsort((-pairs.col, pairs.data))  # of equal counts the lower label comes last
    rising = rising[pairs.col[rising] > 0]
    went = dict(zip(pairs.row[rising].tolist(), pairs.col[rising].tolist(), strict=True))
    log = tuple(replace(d, group=went.get(d.group, 0) if d.group else 0) for d in bank.log)
    return replace(
        bank,
        group=np.where(labels > 0, labels, np.int32(-1)),
        n_groups=int(labels.max(initial=0)),
        log=log,
        levels=replace(bank.levels, chosen=level),
    )


@dataclass(frozen=True, eq=False)
class Overlaps:
    """Of each mask of a view the two groups that own most of its Gaussians."""

    sizes: IntArray  # (M + 1,) #G(m)
    groups: IntArray  # (M + 1, 2) 0 = none; of equal counts the lower group comes first
    counts: IntArray  # (M + 1, 2) #(G(m) and G_g) of these

    @staticmethod
    def of(mask_of: IntArray, group: IntArray, n_masks: int) -> "Overlaps":
        """``mask_of`` (N,) has the mask 1..M of each Gaussian, 0 = none; ``group`` (N,) its group,
        -1 or 0 = free."""
        sizes = np.zeros(n_masks + 1, np.int32)
        groups, counts = np.zeros((n_masks + 1, 2), np.int32), np.zeros((n_masks + 1, 2), np.int32)
        tally = np.zeros(int(group.max(initial=0)) + 1, np.int32)
        greatest_overlaps(mask_of, group, sizes, tally, groups, counts)
        return Overlaps(sizes, groups, counts)


def add_view(
    bank: MemoryBank,
    view: str,
    mask_ids: IntArray,  # (M + 1,) id of each mask in the view's label map; entry 0 is 0
    mask_of: IntArray,  # (N,) mask 1..M of each Gaussian behind one, 0 = none
    threshold: float,
) -> tuple[MemoryBank, IntArray]:
    """The bank after the masks of one view, and the group (M + 1,) that each mask got, 0 = none.

    Mask by mask in the order of their ids, Overlap(m, i) = #(G(m) and G_i) / #G(m): the mask joins
    the group of greatest overlap (the older one on a tie) if that is at least ``threshold``, and
    the group gains the Gaussians of G(m) that no group owns; otherwise a new group opens. A mask
    behind which no Gaussian lies gets no group.

    One count for the whole view is exact, although the bank grows with each mask: the G(m) of one
    view are disjoint, so what an earlier mask of the view brought into a group is never in a later
    mask's G(m). For the same reason two masks of one view may join the same group, but never one
    that was opened in this view. ``bank`` itself is not changed.
    """
    check_shape("mask_of", mask_of, (len(bank.group),), np.int32)
    found = Overlaps.of(mask_of, bank.group, len(mask_ids) - 1)
    group_of_mask = np.zeros(len(mask_ids), np.int32)
    n_groups, log = bank.n_groups, []
    for m in range(1, len(mask_ids)):
        size, (best, runner_up) = int(found.sizes[m]), found.groups[m].tolist()
        overlap, second = (int(count) / max(size, 1) for count in found.counts[m])
        joins = best > 0 and overlap >= threshold
        if size > 0:
            n_groups += not joins
            group_of_mask[m] = best if joins else n_groups
        mask, group_of = int(mask_ids[m]), int(group_of_mask[m])
        is_new = size > 0 and not joins
        log.append(Decision(view, mask, group_of, is_new, overlap, runner_up, second, size))
    group = bank.group.copy()
    take_free(mask_of, group_of_mask, group)
    whole = DecisionLog.of(bank.log).plus(log)
    return replace(bank, group=group, n_groups=n_groups, log=whole), group_of_mask


def views_per_group(bank: MemoryBank) -> IntArray:
    """In how many views a mask joined each group, (n_groups + 1,); entry 0 is 0."""
    pairs = {(decision.view, decision.group) for decision in bank.log if decision.group > 0}
    groups = np.array([group for _, group in pairs], np.int64)
    return np.bincount(groups, minlength=bank.n_groups + 1).astype(np.int32)


def groups_of_masks(bank: MemoryBank, views: Iterable[str]) -> dict[str, IntArray]:
    """For each of ``views`` the group of every mask id that its label map has, 0 = none."""
    ids: dict[str, list[tuple[int, int]]] = {view: [(0, 0)] for view in views}
    for decision in bank.log:
        if decision.view in ids:
            ids[decision.view].append((decision.mask, decision.group))
    result = {}
    for view, pairs in ids.items():
        masks, groups = np.array(pairs, np.int64).T
        result[view] = np.zeros(int(masks.max()) + 1, np.int32)
        result[view][masks] = groups
    return result


def two_best(counts: IntArray | LongArray) -> tuple[LongArray, LongArray]:
    """Groups of the greatest and the second greatest count of each row, 0 where that is zero.

    Of equal counts the lower group comes first. Column 0, the free Gaussians, takes no part.
    """
    rest = counts.copy()
    rest[:, 0] = 0
    rows = np.arange(len(rest))
    best = rest.argmax(axis=1)  # 0 where every count is 0
    rest[rows, best] = 0
    return best, rest.argmax(axis=1)
