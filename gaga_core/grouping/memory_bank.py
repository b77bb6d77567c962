"""The 3D-aware memory bank (section 3.2): which Gaussians each group owns, and why."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Literal, overload

import numpy as np
from scipy.sparse import coo_array

from gaga_core.arrays import BoolArray, IntArray, LongArray, check_shape
from gaga_core.grouping.gate_kernels import greatest_overlaps, take_free
from gaga_core.grouping.levels import Levels

Preset = Literal["paper", "released", "robust"]  # see `associate.AssociateConfig.of`


@dataclass(frozen=True)
class Decision:
    """The decision on a mask, with its reason."""

    view: str  # name of the view
    mask: int  # id in that view's label map
    group: int  # the group that it joined or opened; 0 = none (no Gaussians passed the gate)
    is_new: bool  # opened the group
    overlap: float  # with the best group before the decision, see `overlap_of`
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
    preset: Preset = field(kw_only=True)  # that decided; overlaps in the log are of splats
    # ("paper", "released") or of points on the surfaces ("robust"); a repair decides alike
    levels: Levels | None = field(default=None, kw_only=True)  # of detail, where masks give some
    # (S, 2) Gaussian and a further group that holds it, too: only the preset "released" has such
    shared: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.int32), kw_only=True)

    @property
    def is_published(self) -> bool:
        """Whether masks joined view after view, as in the paper or its released code."""
        return self.preset != "robust"

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


def renumbered(bank: MemoryBank, to: IntArray, n_groups: int) -> MemoryBank:
    """``bank`` with the ids ``to`` (G + 1,) of its ids."""

    def moved(decision: Decision) -> Decision:
        group, second = int(to[decision.group]), int(to[decision.runner_up])
        return replace(decision, group=group, runner_up=second)

    group = np.where(bank.group > 0, to[np.maximum(bank.group, 0)], bank.group).astype(np.int32)
    shared = np.stack([bank.shared[:, 0], to[bank.shared[:, 1]]], axis=1)
    log = tuple(map(moved, bank.log))
    return replace(bank, group=group, n_groups=n_groups, log=log, shared=shared)


@dataclass(frozen=True, eq=False)
class Overlaps:
    """Of each mask of a view the two groups that own most of its Gaussians."""

    sizes: IntArray  # (M + 1,) #G(m)
    groups: IntArray  # (M + 1, 2) 0 = none; of equal counts the lower group comes first
    counts: IntArray  # (M + 1, 2) #(G(m) and G_g) of these

    @staticmethod
    def of(
        mask_of: IntArray, group: IntArray, n_masks: int, shared: IntArray | None = None
    ) -> "Overlaps":
        """``mask_of`` (N,) has the mask 1..M of each Gaussian, 0 = none; ``group`` (N,) its group,
        -1 or 0 = free; ``shared`` (S, 2) as in `MemoryBank`."""
        sizes = np.zeros(n_masks + 1, np.int32)
        if shared is not None and len(shared) > 0:
            masks = np.append(mask_of, mask_of[shared[:, 0]])
            groups = np.append(np.maximum(group, 0), shared[:, 1])
            width, behind = int(groups.max()) + 1, masks > 0
            cells = masks[behind].astype(np.int64) * width + groups[behind]
            counted = np.bincount(cells, minlength=(n_masks + 1) * width)
            table = counted.reshape(n_masks + 1, width).astype(np.int32)
            best = np.stack(two_best(table), axis=1).astype(np.int32)
            counts = np.take_along_axis(table, best.astype(np.int64), axis=1)
            sizes[1:] = np.bincount(mask_of, minlength=n_masks + 1)[1:]
            return Overlaps(sizes, best, np.where(best > 0, counts, np.int32(0)))
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

    Mask by mask in the order of their ids: the mask joins the group of greatest overlap
    (`overlap_of`; the older one on a tie) if that is at least ``threshold``, and the group gains
    the Gaussians of G(m) that no group owns; otherwise a new group opens. A mask behind which no
    Gaussian lies gets no group. Preset "released": a new group holds all of G(m), also what other
    groups hold, and a mask without Gaussians opens an empty one.

    One count for the whole view is exact, although the bank grows with each mask: the G(m) of one
    view are disjoint, so what an earlier mask of the view brought into a group is never in a later
    mask's G(m). For the same reason two masks of one view may join the same group, but never one
    that was opened in this view. ``bank`` itself is not changed.
    """
    check_shape("mask_of", mask_of, (len(bank.group),), np.int32)
    found = Overlaps.of(mask_of, bank.group, len(mask_ids) - 1, bank.shared)
    group_of_mask, opened = np.zeros(len(mask_ids), np.int32), np.zeros(len(mask_ids), np.bool_)
    n_groups, log, opens_empty = bank.n_groups, [], bank.preset == "released"
    for m in range(1, len(mask_ids)):
        size, (best, runner_up) = int(found.sizes[m]), found.groups[m].tolist()
        overlap, second = (overlap_of(int(count), size, bank.preset) for count in found.counts[m])
        joins = best > 0 and overlap >= threshold
        if size > 0 or opens_empty:
            opened[m] = not joins
            n_groups += not joins
            group_of_mask[m] = best if joins else n_groups
        mask, group_of = int(mask_ids[m]), int(group_of_mask[m])
        log.append(
            Decision(view, mask, group_of, bool(opened[m]), overlap, runner_up, second, size)
        )
    taken = with_gaussians(bank, mask_of, group_of_mask, opened)
    whole = DecisionLog.of(bank.log).plus(log)
    return replace(taken, n_groups=n_groups, log=whole), group_of_mask


def overlap_of(count: int, size: int, preset: Preset) -> float:
    """Overlap of a mask of ``size`` Gaussians with a group that holds ``count`` of them.

    Section 3.2: Overlap(m, i) = #(G(m) and G_i) / #G(m). The released code divides by the sum of
    both numbers, so its greatest overlap is a half, and its 0.1 is the paper's 0.111.
    """
    return count / max(size + count if preset == "released" else size, 1)


def with_gaussians(
    bank: MemoryBank,
    mask_of: IntArray,  # (N,) 0 = none
    group_of_mask: IntArray,  # (M + 1,) 0 = none
    opened: BoolArray,  # (M + 1,) masks that opened their group
) -> MemoryBank:
    """The bank whose groups have taken what they may of their masks' Gaussians."""
    group, shared = bank.group.copy(), bank.shared
    if bank.preset == "released":
        rows = np.flatnonzero(opened[mask_of] & (group > 0))
        further = np.stack([rows, group_of_mask[mask_of[rows]]], axis=1).astype(np.int32)
        shared = np.concatenate([shared, further])
    take_free(mask_of, group_of_mask, group)
    return replace(bank, group=group, shared=shared)


def ids_of_first_view(bank: MemoryBank) -> dict[int, int]:
    """The mask id of each group that the first view opened, as the paper numbers its groups.

    Inside, groups are counted from 1 without gaps, because ids of masks may have gaps or be large.
    """
    first = next((decision.view for decision in bank.log), "")
    of_first = (d for d in bank.log if d.view == first and d.is_new)
    return {decision.group: decision.mask for decision in of_first} if bank.is_published else {}


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
