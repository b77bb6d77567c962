"""Repair an association by hand: a mask goes to another group, and what follows from it is redone.

The bank before the mask's view stays; from that view on every mask is decided again in the same
order, the moved one as given: with "robust" by points on its surface, else by the splats behind it
(see `follow_points`). Either way decisions made by hand stay, ids of groups stay, and only splats
of groups whose masks changed get another label. (The authors name "a dynamic reassignment
mechanism" as future work.)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from gaga_core.arrays import BoolArray, FloatArray, IntArray, UInt16Array, UInt32Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.grouping.associate import BankSnapshot
from gaga_core.grouping.gate import ViewMasks
from gaga_core.grouping.memory_bank import (
    Decision,
    MemoryBank,
    Overlaps,
    groups_of_masks,
    overlap_of,
    with_gaussians,
)
from gaga_core.grouping.repair.view_evidence import Evidence, gather_stage
from gaga_core.grouping.robust.consensus import ConsensusConfig, merged_masks
from gaga_core.grouping.robust.label_masks import fill_unseen, voting_labels
from gaga_core.grouping.robust.surface_points import Leaders, point_tables
from gaga_core.grouping.views import vote_with_bank
from gaga_core.grouping.votes import LabelMap, Votes, VoteSums
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer

# --- Beyond the paper: a mask moved by hand among groups that the consensus of the views made.
# The views are processed in the order of the log, on the points of their surfaces: up to the
# mask's view every mask stays as it was decided, from there on a mask takes the group of most of
# its points that earlier views know. This is done twice, with the mask where it was and where it
# was moved: what differs is what follows from the move. Everything else keeps what the consensus
# gave it.


_SURE = 1 << 30  # points: the row's own group leads whatever else it shows

Forced = Mapping[tuple[str, int], int]  # (view, mask) -> group


def follow_points(
    evidence: Evidence, bank: MemoryBank, forced: Forced, first: str
) -> tuple[MemoryBank, list[csr_matrix]]:
    """The bank with masks moved as ``forced``, redone from view ``first`` on; it owns no splat yet.

    Also for each view the sparse table (M + 1, G + 1): how many points of each group show in each
    mask.
    """
    if evidence.points is None:
        raise ValueError("evidence: has no points, run gather_stage first")
    shown, names = evidence.points, [camera.name for camera in evidence.views]
    masks = [evidence.masks_of(camera).ids for camera in evidence.views]
    groups = groups_of_masks(bank, names)
    former = [_at(groups[name], ids) for name, ids in zip(names, masks, strict=True)]
    # What a person said of each mask, -1 = nothing; and the same with those masks where they were.
    told = [
        np.array([-1, *(forced.get((name, mask), -1) for mask in ids[1:].tolist())], np.int32)
        for name, ids in zip(names, masks, strict=True)
    ]
    was = [np.where(said >= 0, old, said) for said, old in zip(told, former, strict=True)]
    width = max((bank.n_groups, *forced.values())) + 1
    logged = dict.fromkeys(d.view for d in bank.log)
    order = [names.index(view) for view in logged if view in names]
    start = order.index(names.index(evidence.camera(first).name))
    walk = _Walk(shown, order, start, former, width)
    expected, moved = walk.groups(was), walk.groups(told)
    of_mask = [
        np.where((said >= 0) | (old != new), np.where(said >= 0, said, new), kept)
        for said, old, new, kept in zip(told, expected, moved, former, strict=True)
    ]
    tables = []
    for table in point_tables(shown, walk.points(of_mask, told), [len(ids) for ids in masks]):
        shape = (table.shape[0], max(width, table.shape[1]))
        tables.append(csr_matrix((table.data, table.indices, table.indptr), shape=shape))
    places = {name: v for v, name in enumerate(names)}
    log = _logged(evidence, bank, places, masks, (of_mask, tables), forced)
    unowned = np.full_like(bank.group, -1)
    return replace(bank, group=unowned, n_groups=width - 1, log=log), tables


@dataclass(frozen=True, eq=False)
class _Walk:
    """The views in their order, and the points that they show."""

    shown: IntArray  # (S, V) mask of each point in each view, 0 = none
    order: Sequence[int]  # views
    start: int  # place in ``order`` up to which decisions stay
    former: Sequence[IntArray]  # by view: (M + 1,) groups as they are
    width: int  # G + 1

    def groups(self, told: Sequence[IntArray]) -> list[IntArray]:
        """The group (M + 1,) of each view's masks; ``told`` are given, -1 = not given."""
        votes, pins = self._no_votes(), self._pins(told)
        result = [groups.copy() for groups in self.former]
        for place, v in enumerate(self.order):
            masks, groups = self.shown[:, v], result[v]
            if place > self.start:
                table = np.zeros((len(groups), self.width), np.int32)
                np.add.at(table, (masks, _labels_of_points(votes, pins)), 1)
                table[0], table[:, 0] = 0, 0
                known = table.any(axis=1)
                groups[known] = table[known].argmax(axis=1)
            groups[told[v] >= 0] = told[v][told[v] >= 0]
            votes[np.arange(len(votes)), groups[masks]] += 1
        return result

    def points(self, of_mask: Sequence[IntArray], told: Sequence[IntArray]) -> IntArray:
        """The group (S,) of each point: that of most masks that show it."""
        votes = self._no_votes()
        for v, groups in enumerate(of_mask):
            votes[np.arange(len(votes)), groups[self.shown[:, v]]] += 1
        return _labels_of_points(votes, self._pins(told))

    def _no_votes(self) -> UInt16Array | UInt32Array:
        """Zeros (S, G + 1) that hold a vote of each view."""
        shape = (len(self.shown), self.width)
        few = len(self.order) < 1 << 16
        return np.zeros(shape, np.uint16) if few else np.zeros(shape, np.uint32)

    def _pins(self, told: Sequence[IntArray]) -> IntArray:
        """The group that is given for each point (S,), -1 = none."""
        pins = np.full(len(self.shown), -1, np.int32)
        for v, groups in enumerate(told):
            said = groups[self.shown[:, v]]
            pins = np.where(said >= 0, said, pins)
        return pins


def _labels_of_points(votes: UInt16Array | UInt32Array, pins: IntArray) -> IntArray:
    """The group of most votes of each row, 0 without any; what is pinned is that."""
    best = votes[:, 1:].argmax(axis=1) + 1
    best[~votes[:, 1:].any(axis=1)] = 0
    return np.where(pins >= 0, pins, best).astype(np.int32)


def _at(groups: IntArray, ids: IntArray) -> IntArray:
    """``groups`` of the masks with ``ids`` (M + 1,), 0 for those beyond the last one known."""
    known = ids < len(groups)
    return np.where(known, groups[np.where(known, ids, 0)], np.int32(0))


def _label_map(
    evidence: Evidence,
    bank: MemoryBank,
    tables: Sequence[csr_matrix],  # of the views: points of each group in each mask
    forced: Forced,
    labels: IntArray,  # (N,) by which masks that hold several groups are divided
    rasterizer: Rasterizer,
) -> LabelMap:
    """Which groups the pixels of a view vote for; a mask moved by hand votes as a whole."""
    config = evidence.config.consensus or ConsensusConfig()
    of_masks = groups_of_masks(bank, [camera.name for camera in evidence.views])

    def of(camera: Camera) -> IntArray:
        v = evidence.views.index(camera)
        masks, table = evidence.masks_of(camera), tables[v].toarray()
        by_hand = [m for m, i in enumerate(masks.ids) if (camera.name, int(i)) in forced]
        merged = np.setdiff1d(merged_masks(tables[v], config), np.array(by_hand, np.int64))
        groups = _at(of_masks[camera.name], masks.ids)
        table[groups == 0] = 0
        table[np.flatnonzero(groups), groups[groups > 0]] += _SURE
        shown = None
        if len(merged):
            shown = rasterizer.label_splat(evidence.gaussians, camera, labels).labels
            shown = np.where(shown < table.shape[1], shown, np.int32(0))
        return voting_labels(masks, csr_matrix(table), merged, shown)

    return of


def _logged(
    evidence: Evidence,
    bank: MemoryBank,
    place: Mapping[str, int],  # of the views
    masks: Sequence[IntArray],
    found: tuple[Sequence[IntArray], Sequence[csr_matrix]],
    forced: Forced,
) -> tuple[Decision, ...]:
    """The log with the masks that moved; overlap = share of the points that the mask shows."""
    of_mask, tables = found
    best = [Leaders.of(table) for table in tables]
    known, log = {0}, []
    for old in bank.log:
        if old.view not in place:
            raise GagaError(
                f"{old.view} no longer has masks. Choose the masks that were associated."
            )
        v = place[old.view]
        m = int(np.searchsorted(masks[v], old.mask))
        group, by_hand = int(of_mask[v][m]), (old.view, old.mask) in forced
        decision = replace(old, is_new=group not in known, by_hand=by_hand)
        if group != old.group:
            counts = tables[v][m].toarray()[0]
            total = max(int(counts.sum()), 1)
            rival = int((best[v].second if best[v].first[m] == group else best[v].first)[m])
            decision = replace(
                decision,
                group=group,
                overlap=int(counts[group]) / total if group else 0.0,
                runner_up=rival,
                runner_up_overlap=int(counts[rival]) / total if rival else 0.0,
            )
        known.add(group)
        log.append(decision)
    return tuple(log)


# --- The move itself: which bank, which votes, which labels.

STAGE = "Move mask"
NEW = -1  # a group of its own
NONE = 0  # no group


@dataclass(frozen=True)
class Move:
    """A mask that belongs elsewhere."""

    view: str
    mask: int  # id in the view's label map
    group: int  # where it belongs, or `NEW`, or `NONE`


@dataclass(frozen=True, eq=False)
class Repair:
    """Result of a `Move` on an association."""

    bank: MemoryBank
    labels: IntArray  # (N,)
    confidence: FloatArray  # (N,) 0..1
    group: int  # where the mask is now; 0 = in none
    n_masks: int  # that changed their group, the moved one among them
    n_splats: int  # that changed theirs

    def sentence(self) -> str:
        """Summary of the move."""
        others = self.n_masks - 1
        masks = "no other mask" if others < 1 else f"{others} more mask{'s' * (others > 1)}"
        splats = counted(self.n_splats, "splat")
        return f"{masks.capitalize()} followed, {splats} changed their object."


def reassociate_stage(
    evidence: Evidence,
    bank: MemoryBank,
    labels: IntArray,  # (N,) of the rows of ``evidence.gaussians``
    confidence: FloatArray | None,  # (N,) 0..1; None = not known
    move: Move,
    rasterizer: Rasterizer,
    *,
    free: int = 0,  # an id from which on none is used elsewhere
) -> Stage[Repair]:
    """The association with ``move`` done, and what follows from it; nothing given is changed.

    Labels of splats change only from or to groups whose masks changed; groups that no mask of the
    bank made (separated by hand, say) stay as they are. Progress carries a `BankSnapshot` for each
    view that is redone. Raises ``GagaError`` when the bank knows no such mask.
    """
    log = {(d.view, d.mask): d for d in bank.log}
    if (move.view, move.mask) not in log:
        raise GagaError(f"The memory bank knows no mask {move.mask} of {move.view}.")
    used = max(bank.n_groups, int(labels.max(initial=0)), *(d.group for d in bank.log))
    free = max(free, used + 1)
    wanted = free if move.group == NEW else move.group
    forced = {(d.view, d.mask): d.group for d in bank.log if d.by_hand}
    forced[move.view, move.mask] = wanted
    free += move.group == NEW
    is_paper = evidence.config.consensus is None
    yield from part(gather_stage(evidence, rasterizer), 0, 3, STAGE)
    if is_paper:
        redone = yield from part(_refill(evidence, bank, forced, move.view, free), 1, 3, STAGE)
        vote = vote_with_bank(evidence.gated, redone, rasterizer, evidence.config.histogram_bytes)
        votes = yield from part(vote, 2, 3, STAGE)
    else:
        yield Progress(STAGE, 1, 3, "points", None)
        redone, tables = follow_points(evidence, bank, forced, move.view)
        live = replace(redone, group=np.where(labels > 0, labels, np.int32(-1)))
        yield Progress(
            STAGE, 1, 3, move.view, BankSnapshot(move.view, live, live.n_groups, keeps_ids=True)
        )
        label_map = _label_map(evidence, redone, tables, forced, labels, rasterizer)
        sums = VoteSums.empty(len(labels), redone.n_groups, evidence.config.histogram_bytes)
        stage = sums.add_stage(evidence.gaussians, evidence.views, label_map, rasterizer)
        yield from part(stage, 2, 3, STAGE)
        votes = sums.votes()
    touched = changed_groups(bank.log, redone.log)
    found = yield from _labels_after(evidence, redone, votes, labels, touched)
    sure = votes.confidence if confidence is None else confidence
    return _settled(bank, redone, (found, votes.confidence), (labels, sure), touched, wanted)


def changed_groups(before: Iterable[Decision], after: Iterable[Decision]) -> frozenset[int]:
    """Groups that lost or gained a mask; 0 is never among them."""
    old = {(d.view, d.mask): d.group for d in before}
    pairs = ((old.get((d.view, d.mask), 0), d.group) for d in after)
    return frozenset(g for pair in pairs if pair[0] != pair[1] for g in pair) - {0}


# --- the bank, view by view


def _refill(
    evidence: Evidence,
    bank: MemoryBank,
    forced: Mapping[tuple[str, int], int],
    first: str,
    free: int,
) -> Stage[MemoryBank]:
    """The bank filled again: as it was before view ``first``, decided again from there on."""
    former = {(d.view, d.mask): d for d in bank.log}
    order = list(dict.fromkeys(d.view for d in bank.log))
    start = order.index(first)
    ids, live = _Ids(free), MemoryBank.empty(len(bank.group), bank.preset)
    log = list[Decision]()
    for i, view in enumerate(order):
        masks, mask_of = evidence.gaussians_of(evidence.camera(view))
        if i < start:
            decisions = [former[view, int(m)] for m in masks.ids[1:] if (view, int(m)) in former]
        else:
            decisions = _decided(evidence, view, (masks, mask_of), live, (former, forced), ids)
        ids.opened |= {d.group for d in decisions}
        of_mask = groups_of_masks(replace(bank, log=tuple(decisions)), [view])[view]
        dense = np.append(of_mask, np.zeros(int(masks.ids[-1]) + 1, np.int32))[masks.ids]
        opened = np.isin(masks.ids, [d.mask for d in decisions if d.is_new])
        live = with_gaussians(live, mask_of, dense.astype(np.int32), opened)
        log += decisions
        top = max(bank.n_groups, ids.free - 1)
        live = replace(live, n_groups=top, log=tuple(log))
        n_open = len(ids.opened - {0})
        snapshot = BankSnapshot(view, live, n_open, keeps_ids=True)
        message = f"{view}: {n_open} groups"
        yield Progress(STAGE, i + 1, len(order), message, snapshot if i >= start else None)
    return replace(live, n_groups=max((bank.n_groups, *(d.group for d in log))))


class _Ids:
    """Which groups are open, and which id comes next."""

    def __init__(self, free: int) -> None:
        self.free = free
        self.opened: set[int] = set()

    def of_new_group(self, former: Decision | None) -> int:
        """Id of the group that a mask opens: the one it had when that is not open yet.

        A mask that had opened a group which is open already was merged into it by hand: it stays.
        """
        if (
            former is not None
            and former.group
            and (former.is_new or former.group not in self.opened)
        ):
            self.opened.add(former.group)
            return former.group
        self.free += 1
        return self.free - 1


def _decided(
    evidence: Evidence,
    view: str,
    shown: tuple[ViewMasks, IntArray],
    bank: MemoryBank,  # before the view
    known: tuple[Mapping[tuple[str, int], Decision], Mapping[tuple[str, int], int]],
    ids: _Ids,
) -> list[Decision]:
    """`memory_bank.add_view`, but masks of ``known[1]`` go where it says."""
    (masks, mask_of), (former, forced) = shown, known
    group, shared = bank.group, bank.shared
    overlaps = Overlaps.of(mask_of, group, len(masks), shared)
    sizes, (best, second) = overlaps.sizes, overlaps.groups.T

    def share(m: int, g: int) -> float:
        """The overlap, 0 with no group."""
        at = np.flatnonzero(overlaps.groups[m] == g)
        n = overlaps.counts[m, at[0]] if len(at) else ((mask_of == m) & (group == g)).sum()
        if len(at) == 0:
            n += ((mask_of[shared[:, 0]] == m) & (shared[:, 1] == g)).sum()
        return overlap_of(int(n), int(sizes[m]), bank.preset) if g else 0.0

    log, opened = [], set(ids.opened)
    for m in range(1, len(masks.ids)):
        key = (view, int(masks.ids[m]))
        joins = best[m] > 0 and share(m, int(best[m])) >= evidence.config.threshold
        if key in forced:
            to = forced[key]
        elif sizes[m] == 0 and bank.preset != "released":
            to = 0
        else:
            to = int(best[m]) if joins else ids.of_new_group(former.get(key))
        is_new = to > 0 and to not in opened
        opened.add(to)
        rival = int(second[m] if best[m] == to or (is_new and key not in forced) else best[m])
        counted = int(best[m]) if is_new and key not in forced else to
        counts = share(m, counted), rival, share(m, rival), int(sizes[m])
        log.append(Decision(*key, to, is_new, *counts, by_hand=key in forced))
    return log


# --- labels


def _labels_after(
    evidence: Evidence,
    bank: MemoryBank,
    votes: Votes,
    before: IntArray,
    touched: frozenset[int],
) -> Stage[IntArray]:
    """Labels (N,) after the vote: who no mask sees takes the bank's group, or its neighbours'."""
    if not evidence.config.fill_unseen:
        return np.where(votes.labels > 0, votes.labels, np.maximum(bank.group, 0))
    kept = np.where(_among(before, touched), np.int32(0), before)
    if evidence.config.surfaces_of_few(len(evidence.views)) is None:
        known = np.where(votes.labels > 0, votes.labels, kept)
    else:  # votes alone did not label the groups that nothing touched
        known = np.where(kept > 0, kept, votes.labels)
    groups = groups_of_masks(bank, [camera.name for camera in evidence.views])
    return (
        yield from fill_unseen(
            evidence.gaussians,
            evidence.views,
            evidence.masks,
            evidence.bounds,
            groups,
            max(bank.n_groups, int(before.max(initial=0))),
            known,
        )
    )


def _settled(
    former: MemoryBank,
    redone: MemoryBank,
    found: tuple[IntArray, FloatArray],
    before: tuple[IntArray, FloatArray],
    touched: frozenset[int],
    group: int,
) -> Repair:
    """Splats of groups that nothing happened to, or that a person made, stay as they are."""
    (labels, sure), (old, old_sure) = found, before
    stays = ~(_among(old, touched) | _among(labels, touched))
    owners = redone.group
    if (owners < 0).all():  # by votes: no group came first
        owners = np.where(stays, former.group, np.where(labels > 0, labels, np.int32(-1)))
    in_bank = {d.group for d in former.log}
    by_hand = [g for g in np.unique(old).tolist() if g > 0 and g not in in_bank]
    stays |= _among(old, by_hand)
    after = np.where(stays, old, labels).astype(np.int32)
    was = {(d.view, d.mask): d.group for d in former.log}
    return Repair(
        bank=replace(redone, group=owners.astype(np.int32)),
        labels=after,
        confidence=np.where(stays, old_sure, sure).astype(np.float32),
        group=group,
        n_masks=sum(was.get((d.view, d.mask), 0) != d.group for d in redone.log),
        n_splats=int((after != old).sum()),
    )


def _among(labels: IntArray, groups: Iterable[int] | Sequence[int]) -> BoolArray:
    return np.isin(labels, np.array(sorted(groups), np.int64))
