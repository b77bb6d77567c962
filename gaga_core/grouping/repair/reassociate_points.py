"""Beyond the paper: a mask moved by hand among groups that the consensus of the views made.

The views are processed in the order of the log, on the points of their surfaces: up to the
mask's view every mask stays as it was decided, from there on a mask takes the group of most of its
points that earlier views know. This is done twice, with the mask where it was and where it was
moved: what differs is what follows from the move. Everything else keeps what the consensus gave it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from gaga_core.arrays import IntArray, UInt16Array, UInt32Array
from gaga_core.camera import Camera
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.grouping.repair.view_evidence import Evidence
from gaga_core.grouping.robust.consensus import ConsensusConfig, merged_masks
from gaga_core.grouping.robust.label_masks import voting_labels
from gaga_core.grouping.robust.point_tables import Leaders, point_tables
from gaga_core.raster.base import Rasterizer

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
    shown = evidence.points
    masks = [evidence.masks_of(camera).ids for camera in evidence.views]
    former = _groups(evidence, bank, masks)
    told = [
        _told(camera.name, ids, forced) for camera, ids in zip(evidence.views, masks, strict=True)
    ]
    was = [np.where(groups >= 0, old, groups) for groups, old in zip(told, former, strict=True)]
    start = evidence.views.index(evidence.camera(first))
    width = max((bank.n_groups, *forced.values())) + 1
    order = _order(evidence, bank)
    walk = _Walk(shown, order, order.index(start), former, width)
    expected, moved = walk.groups(was), walk.groups(told)
    of_mask = [
        np.where((groups >= 0) | (old != new), np.where(groups >= 0, groups, new), kept)
        for groups, old, new, kept in zip(told, expected, moved, former, strict=True)
    ]
    point = walk.points(of_mask, told)
    found = point_tables(shown, point, [len(ids) for ids in masks])
    tables = [_widened(table, width) for table in found]
    log = _logged(evidence, bank, masks, (of_mask, tables), forced)
    unowned = np.full_like(bank.group, -1)
    return replace(bank, group=unowned, n_groups=width - 1, log=log), tables


def _widened(table: csr_matrix, width: int) -> csr_matrix:
    """``table`` with at least so many columns."""
    shape = (table.shape[0], max(width, table.shape[1]))
    return csr_matrix((table.data, table.indices, table.indptr), shape=shape)


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
                np.add.at(table, (masks, _labels(votes, pins)), 1)
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
        return _labels(votes, self._pins(told))

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


def _labels(votes: UInt16Array | UInt32Array, pins: IntArray) -> IntArray:
    """The group of most votes of each row, 0 without any; what is pinned is that."""
    best = votes[:, 1:].argmax(axis=1) + 1
    best[~votes[:, 1:].any(axis=1)] = 0
    return np.where(pins >= 0, pins, best).astype(np.int32)


def _told(view: str, ids: IntArray, forced: Forced) -> IntArray:
    """Groups (M + 1,) that a person gave the masks of a view, -1 = none given."""
    said = [forced.get((view, int(i)), -1) for i in ids]
    return np.array([-1, *said[1:]], np.int32)


def _order(evidence: Evidence, bank: MemoryBank) -> list[int]:
    """The views that the log knows, in its order."""
    at = {camera.name: v for v, camera in enumerate(evidence.views)}
    return [at[view] for view in dict.fromkeys(d.view for d in bank.log) if view in at]


@dataclass(frozen=True, eq=False)
class VotingMaps:
    """Which group the pixels of a view vote for."""

    evidence: Evidence
    bank: MemoryBank
    tables: Sequence[csr_matrix]  # of the views: points of each group in each mask
    forced: Forced
    labels: IntArray  # (N,) by which masks that hold several groups are divided
    rasterizer: Rasterizer

    def of(self, camera: Camera) -> IntArray:
        """Groups (H, W), 0 = does not vote. A mask moved by hand votes as a whole."""
        evidence = self.evidence
        v = evidence.views.index(camera)
        masks, table = evidence.masks_of(camera), self.tables[v].toarray()
        merged = merged_masks(self.tables[v], evidence.config.consensus or ConsensusConfig())
        by_hand = [m for m, i in enumerate(masks.ids) if (camera.name, int(i)) in self.forced]
        merged = np.setdiff1d(merged, np.array(by_hand, np.int64))
        groups = _groups(evidence, self.bank, [masks.ids], camera.name)[0]
        table[groups == 0] = 0
        table[np.flatnonzero(groups), groups[groups > 0]] += _SURE
        shown = None
        if len(merged):
            shown = self.rasterizer.label_splat(evidence.gaussians, camera, self.labels).labels
            shown = np.where(shown < table.shape[1], shown, np.int32(0))
        return voting_labels(masks, csr_matrix(table), merged, shown)


def _groups(
    evidence: Evidence, bank: MemoryBank, masks: Sequence[IntArray], only: str = ""
) -> list[IntArray]:
    """For each view the group (M + 1,) of each dense mask."""
    by_view: dict[str, dict[int, int]] = {}
    for d in bank.log:
        by_view.setdefault(d.view, {})[d.mask] = d.group
    names = [only] if only else [camera.name for camera in evidence.views]
    return [
        np.array([by_view.get(name, {}).get(int(i), 0) for i in ids], np.int32)
        for name, ids in zip(names, masks, strict=True)
    ]


def _place(evidence: Evidence, masks: Sequence[IntArray], view: str, mask: int) -> tuple[int, int]:
    v = evidence.views.index(evidence.camera(view))
    return v, int(np.searchsorted(masks[v], mask))


def _logged(
    evidence: Evidence,
    bank: MemoryBank,
    masks: Sequence[IntArray],
    found: tuple[Sequence[IntArray], Sequence[csr_matrix]],
    forced: Forced,
) -> tuple[Decision, ...]:
    """The log with the masks that moved; overlap = share of the points that the mask shows."""
    of_mask, tables = found
    best = [Leaders.of(table) for table in tables]
    known: set[int] = set()
    log = []
    for old in bank.log:
        v, m = _place(evidence, masks, old.view, old.mask)
        group, by_hand = int(of_mask[v][m]), (old.view, old.mask) in forced
        decision = replace(old, is_new=group > 0 and group not in known, by_hand=by_hand)
        if group != old.group:
            counts = tables[v][m].toarray()[0]
            total = max(int(counts.sum()), 1)
            leads = best[v]
            rival = int(leads.second[m] if leads.first[m] == group else leads.first[m])
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
