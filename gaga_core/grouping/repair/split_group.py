"""Split a group by its own masks: the person sees two objects where the bank has one.

Masks that show different objects of the group cover different splats of it. The first cut is that
of the graph of masks (weights: shared over all covered splats of both, Jaccard; cut: the sign of
its second eigenvector, Shi and Malik, 2000). Then masks and splats vote in turn: a splat belongs to
the side whose masks cover it more often, and a mask that covers both sides does not vote, as the
mask that had merged the two must not. Masks of one object all cover much the same, so that any cut
of theirs is expensive (and the second eigenvector arbitrary): such a cut is refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.grouping.repair.view_evidence import Evidence, gather_stage
from gaga_core.progress import Progress, Stage, part
from gaga_core.raster.base import Rasterizer

STAGE = "Vote again"
_SAMPLE = 16384  # splats of the group that the cut is sought on
_ROUNDS = 20
_PURE = 0.8  # share of a mask's splats on one side from which it speaks for that side
_SIDE_SHARE_MIN = 0.02  # share of the group's splats on the smaller side
# Normalised cut (0..2) between two objects at most, of the masks that speak for one side. It is 0
# where masks show two objects and 1 where they all show one (each side as like the other as
# itself); 0.5 is in the middle. Found on groups of three generated scenes, 8 and 20 views.
_CUT_MAX = 0.5
_NEIGHBOURS = 8
_EQUAL = 1e-6  # eigenvalues, of at most 1, and shares of a vector that count as equal


@dataclass(frozen=True, eq=False)
class GroupSplit:
    """The two parts of a group. The larger side keeps the group's id."""

    rows: IntArray  # (K,) splats of the smaller side
    masks: frozenset[tuple[str, int]]  # (view, mask) that go with it


def split_group_stage(
    evidence: Evidence,
    log: Sequence[Decision],  # of the group
    rows: IntArray,  # (K,) its splats
    rasterizer: Rasterizer,
    *,
    name: str = "The object",
) -> Stage[GroupSplit]:
    """Cluster the masks of a group into two by the splats that they cover, its splats with them.

    Raises ``GagaError`` when the masks do not show two objects.
    """
    wanted = {d.view for d in log}
    views = [camera for camera in evidence.views if camera.name in wanted]
    if len(log) < 2 or len(rows) == 0:
        raise GagaError(f"{name} has too few masks to vote. Paint a part of it and use Separate.")
    own = evidence.only(views)
    yield from part(gather_stage(own, rasterizer, only_bounds=True), 0, 3, STAGE)
    means = np.ascontiguousarray(evidence.gaussians.means[rows])
    rng = np.random.default_rng(0)
    some = np.sort(rng.permutation(len(rows))[:_SAMPLE])
    covers, sees = yield from part(_covered(own, log, means[some]), 1, 3, STAGE)
    side = two_sides(covers, sees)
    hint = "Paint a part of it and use Separate."
    one_piece = GagaError(f"The masks of {name} show it in one piece. {hint}")
    if side is None:
        raise one_piece
    score = yield from part(_scores(own, log, means, side), 2, 3, STAGE)
    second = _filled(means, score) < 0
    if second.mean() > 0.5:
        second, side = ~second, -side
    if second.mean() < _SIDE_SHARE_MIN:
        raise one_piece
    masks = frozenset((d.view, d.mask) for d, s in zip(log, side, strict=True) if s < 0)
    return GroupSplit(rows[second], masks)


def split_bank(bank: MemoryBank, split: GroupSplit, group: int, into: int) -> MemoryBank:
    """The bank in which the masks and splats of ``split`` are group ``into``."""
    log, opened = [], False
    for d in bank.log:
        if d.group == group and (d.view, d.mask) in split.masks:
            moved = (d.view, d.mask, into, not opened, d.overlap, group, d.overlap, d.n_gaussians)
            log.append(Decision(*moved, by_hand=True))
            opened = True
        else:
            log.append(d)
    owners = bank.group.copy()
    rows = split.rows[owners[split.rows] == group]
    owners[rows] = into
    return replace(bank, group=owners, n_groups=max(bank.n_groups, into), log=tuple(log))


def two_sides(
    covers: BoolArray,  # (D, K) splats that each mask covers
    sees: BoolArray,  # (D, K) splats that some mask of its view covers
) -> DoubleArray | None:
    """Side (D,) of each mask, 1 or -1, 0 = covers both; None when there are no two sides."""
    shared = covers.astype(np.float32) @ covers.T.astype(np.float32)
    # Of what a mask covers, only what the other's view sees at all distinguishes them.
    a = covers.astype(np.float32) @ sees.T.astype(np.float32)
    union = a + a.T - shared
    weight = np.where(union > 0, shared / np.maximum(union, 1), 0).astype(np.float64)
    side = np.sign(_fiedler(weight))
    for _ in range(_ROUNDS):
        score = side @ covers
        if not (score > 0).any() or not (score < 0).any():
            return None
        spoken = covers[:, score != 0].sum(axis=1)
        share = (covers[:, score > 0].sum(axis=1) + 0.0) / np.maximum(spoken, 1)
        after = np.where(share >= _PURE, 1.0, np.where(share <= 1 - _PURE, -1.0, 0.0))
        after[spoken == 0] = 0
        if (after == side).all():
            break
        side = after
    score = side @ covers
    least = max(_SIDE_SHARE_MIN * covers.any(axis=0).sum(), 1)
    if min((score > 0).sum(), (score < 0).sum()) < least:
        return None
    if not (side > 0).any() or not (side < 0).any():
        return None
    return side if _normalised_cut(weight, side) <= _CUT_MAX else None


def _normalised_cut(weight: DoubleArray, side: DoubleArray) -> float:
    """What the cut between the sides (D,) costs, as a share of all that each is joined to, summed
    (Shi and Malik, 2000); masks of side 0 take no part."""
    one, other = side > 0, side < 0
    cut = weight[np.ix_(one, other)].sum()
    whole = [weight[np.ix_(part, one | other)].sum() for part in (one, other)]
    return float(sum(cut / max(total, 1e-12) for total in whole))


def _fiedler(weight: DoubleArray) -> DoubleArray:
    """The second eigenvector (D,) of the normalised graph Laplacian of ``weight`` (D, D).

    Of a sign or of equal eigenvalues the mask decides that the vector tells most about, the first
    of several: last bits would.
    """
    degree = np.maximum(weight.sum(axis=1), 1e-12)
    scaled = weight / np.sqrt(degree[:, None] * degree[None, :])
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    first = np.sqrt(degree / degree.sum())
    space = vectors[:, np.abs(values - values[-2]) < _EQUAL]
    projector = space @ space.T
    if values[-1] - values[-2] < _EQUAL:
        projector -= np.outer(first, first)
    told = np.diag(projector)
    vector = projector[:, int(np.argmax(told > told.max() - _EQUAL))] / np.sqrt(degree)
    # Where the graph falls apart the vector is flat on each part: cut between them.
    result: DoubleArray = vector - (vector.max() + vector.min()) / 2
    return np.where(np.abs(result) < _EQUAL * np.abs(result).max(), 0.0, result)


def _covered(
    evidence: Evidence, log: Sequence[Decision], means: FloatArray
) -> Stage[tuple[BoolArray, BoolArray]]:
    covers = np.zeros((len(log), len(means)), np.bool_)
    for i, camera in enumerate(evidence.views):
        yield Progress(STAGE, i, len(evidence.views), camera.name)
        masks, mask_of = evidence.gaussians_of(camera, means)
        for row, d in enumerate(log):
            if d.view == camera.name:
                covers[row] = masks.ids[mask_of] == d.mask
    sees = np.zeros_like(covers)
    for view in {d.view for d in log}:
        same = np.array([d.view == view for d in log])
        sees[same] = covers[same].any(axis=0)
    return covers, sees


def _scores(
    evidence: Evidence, log: Sequence[Decision], means: FloatArray, side: DoubleArray
) -> Stage[IntArray]:
    """Masks of the one side less masks of the other that cover each splat, (K,)."""
    score = np.zeros(len(means), np.int32)
    for i, camera in enumerate(evidence.views):
        yield Progress(STAGE, i, len(evidence.views), camera.name)
        masks, mask_of = evidence.gaussians_of(camera, means)
        of_mask = np.zeros(len(masks.ids), np.int32)
        for d, s in zip(log, side, strict=True):
            if d.view == camera.name:
                of_mask[masks.ids == d.mask] = int(s)
        score += of_mask[mask_of]
    return score


def _filled(means: FloatArray, score: IntArray) -> IntArray:
    """Splats without a vote take the side of most of their nearest neighbours that have one."""
    from scipy.spatial import cKDTree

    known, open_ = np.flatnonzero(score), np.flatnonzero(score == 0)
    if len(known) == 0 or len(open_) == 0:
        return score
    _, near = cKDTree(means[known]).query(means[open_], k=min(_NEIGHBOURS, len(known)))
    sides = np.sign(score[known])[near.reshape(len(open_), -1)]
    result = np.sign(score)
    total = sides.sum(axis=1)
    result[open_] = np.where(total != 0, np.sign(total), sides[:, 0])
    return result.astype(np.int32)
