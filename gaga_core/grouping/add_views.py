"""New views of a scene that was associated: their masks join its groups, or open new ones.

Nothing of the former views is done again: their decisions stay in the memory bank's log, and their
votes count by the weight that was saved with the labels. Presets "paper" and "released": the bank
goes on as in section 3.2, as if the new views came last. Preset "robust": a mask takes the group
that most of its pixels show; masks of objects in no earlier mask are left, and the consensus of the
new views finds the groups among them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix

from gaga_core.arrays import BoolArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import (
    AssociateConfig,
    Association,
    BankSnapshot,
    fill_bank,
    in_order,
)
from gaga_core.grouping.memory_bank import (
    Decision,
    MemoryBank,
    groups_of_masks,
    renumbered,
    two_best,
    views_per_group,
)
from gaga_core.grouping.robust.consensus import ConsensusConfig, consensus_stage
from gaga_core.grouping.robust.label_masks import voting_labels
from gaga_core.grouping.robust.surface_points import DepthMaps, Leaders
from gaga_core.grouping.views import GatedViews, load_labels, views_as_masked, vote_with_bank
from gaga_core.grouping.votes import Votes, VoteSums, splat_groups
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, mapped, part
from gaga_core.raster import for_many_views
from gaga_core.raster.base import Rasterizer, SpatialChunks

STAGE = "Add views"
_SEEN, _SEEN_SHARE = 0.5, 0.03  # of views: least votes of a Gaussian that a mask has shown
_KNOWN = 0.5  # share of a mask's pixels that must show groups, or it is of something new
_SEEN_BACK = 0.15  # ... where neighbours say the same of the rest


@dataclass(frozen=True, eq=False)
class FormerGroups:
    """A saved association."""

    bank: MemoryBank
    labels: IntArray  # (N,) 0 = none
    confidence: FloatArray  # (N,) share of the label in the vote
    weight: FloatArray  # (N,) summed blending weight over labelled pixels


def add_views_stage(
    gaussians: Gaussians,
    cameras: Sequence[Camera],  # former views and new ones
    masks: MaskSet,
    former: FormerGroups,
    rasterizer: Rasterizer,
    config: AssociateConfig,
) -> Stage[Association]:
    """Associate the views with masks that are not in the bank's log; the others are not touched.

    Raises ``GagaError`` when there are none, or when the groups cannot be added to: those that have
    levels of detail are made by all views together.
    """
    known = {decision.view for decision in former.bank.log}
    views = views_as_masked(cameras, masks, former.bank.preset)
    others = [camera for camera in views if camera.name not in known]
    # A label map without any mask leaves no decision: it would be new for ever.
    new = [camera for camera in others if load_labels(masks, camera)[0].any()]
    if not new:
        raise GagaError("All views with masks are used already. There is nothing to add.")
    if former.bank.levels is not None or masks.are_regions:
        raise GagaError(
            "Groups with levels of detail are made of all views at once. Leave --add out."
        )
    chunks = SpatialChunks.of(gaussians)
    rasterizer = for_many_views(rasterizer, chunks)
    gated = GatedViews(gaussians, new, masks, config.gate, config.depth, chunks)
    if former.bank.is_published or config.consensus is None:
        bank, votes, begun = yield from _by_memory_bank(gated, former, rasterizer, config)
    else:
        bank, votes, begun = yield from _by_shown_groups(gated, former, rasterizer, config)
    merged = _with_former(former, votes, begun)
    labels = np.where(merged.labels > 0, merged.labels, np.maximum(bank.group, 0)).astype(np.int32)
    if bank.preset == "robust":  # the votes say who owns what, not who came first
        bank = replace(bank, group=np.where(labels > 0, labels, np.int32(-1)))
    return Association(
        bank=bank,
        labels=labels,
        confidence=merged.confidence,
        mask_groups=groups_of_masks(bank, [camera.name for camera in views]),
        views_per_group=views_per_group(bank),
        notes=(f"Views that were added: {len(new)}, to {len(known)} before.",),
        weight=merged.weight,
    )


def _by_memory_bank(
    gated: GatedViews, former: FormerGroups, rasterizer: Rasterizer, config: AssociateConfig
) -> Stage[tuple[MemoryBank, Votes, FloatArray]]:
    """The paper: the bank after the new views, the votes, and those (N,) that they began with."""
    order = in_order(gated.views, config)
    filled = fill_bank(gated, former.bank, order, rasterizer, config.threshold, STAGE)
    bank = yield from part(filled, 0, 2, STAGE)
    best = former.confidence * former.weight
    sums = VoteSums.started(former.labels, best, bank.n_groups, config.histogram_bytes)
    vote = vote_with_bank(gated, bank, rasterizer, config.histogram_bytes, sums)
    votes = yield from part(vote, 1, 2, STAGE)
    return bank, votes, best


def _by_shown_groups(
    gated: GatedViews, former: FormerGroups, rasterizer: Rasterizer, config: AssociateConfig
) -> Stage[tuple[MemoryBank, Votes, FloatArray]]:
    """Beyond the paper: masks take the groups that they show; the rest finds its own. Former votes
    for what no former mask showed are of masks next to it: they do not count against new ones."""
    consensus = config.consensus or ConsensusConfig()
    seen = yield from part(_seen_labels(gated, former, rasterizer), 0, 4, STAGE)
    depths = DepthMaps(gated.views)
    tables: dict[str, csr_matrix] = {}
    left: dict[str, IntArray] = {}
    for i, camera in enumerate(gated.views):
        yield Progress(STAGE, len(gated.views) + i, 4 * len(gated.views), camera.name)
        gated.render(camera, rasterizer, depths)
        shown = splat_groups(rasterizer, gated.gaussians, camera, seen)
        masks = gated.masks_of(camera)
        table = _pixels(masks.labels, shown, len(masks), former.bank.n_groups)
        guessed = splat_groups(rasterizer, gated.gaussians, camera, former.labels)
        is_known = _known(table, _pixels(masks.labels, guessed, len(masks), former.bank.n_groups))
        table[:, 0], table[0] = 0, 0
        table[~is_known] = 0
        tables[camera.name] = csr_matrix(table)
        rest = np.where(is_known[masks.labels], 0, masks.ids[masks.labels]).astype(np.int32)
        if rest.any():
            left[camera.name] = rest
    fresh = yield from part(_new_groups(gated, left, depths, consensus), 2, 4, STAGE)
    n_fresh = max((table.shape[1] - 1 for table in fresh.values()), default=0)
    n_former = former.bank.n_groups
    for camera in gated.views:
        own, known = gated.masks_of(camera), tables[camera.name].tocoo()
        rows, columns, counts = known.row, known.col, known.data
        if camera.name in fresh:
            # Ids of the masks that are left, ascending from 0: their rows among all masks.
            row_of = np.searchsorted(own.ids, np.union1d([0], left[camera.name]))
            new = fresh[camera.name].tocoo()
            rows = np.append(rows, row_of[new.row])
            columns, counts = np.append(columns, n_former + new.col), np.append(counts, new.data)
        shape = (len(own) + 1, n_former + 1 + n_fresh)
        tables[camera.name] = csr_matrix((counts.astype(np.float64), (rows, columns)), shape=shape)
    bank = _decided(gated, former.bank, tables, n_fresh)

    def label_map(camera: Camera) -> IntArray:
        table, masks = tables[camera.name], gated.masks_of(camera)
        merged = _of_several(table, consensus)
        shown = splat_groups(rasterizer, gated.gaussians, camera, seen) if len(merged) else None
        return voting_labels(masks, table, merged, shown)

    best = np.where(seen > 0, former.confidence * former.weight, np.float32(0))
    sums = VoteSums.started(former.labels, best, bank.n_groups, config.histogram_bytes)
    stage = sums.add_stage(gated.gaussians, gated.views, label_map, rasterizer)
    yield from part(stage, 3, 4, STAGE)
    return bank, _with_rivals(sums, former, best), best


def _with_rivals(sums: VoteSums, former: FormerGroups, best: FloatArray) -> Votes:
    """The votes, where what a former label did not have counts for the one that new views say most.

    Of former votes only those for the winner (``best`` (N,)) are known. All others were for one
    label where two meet, as at most rims. No label had more than the winner.
    """
    votes, others = sums.votes(), sums.votes(without=former.labels)
    rival = others.confidence * others.weight
    rest = np.where(best > 0, np.minimum(former.weight - best, best), 0)
    won = (rival > 0) & (rival + rest > votes.confidence * votes.weight)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(won, (rival + rest) / votes.weight, votes.confidence)
    return Votes(
        np.where(won, others.labels, votes.labels).astype(np.int32),
        np.minimum(np.where(votes.weight > 0, share, 0), 1).astype(np.float32),
        votes.weight,
    )


def _seen_labels(
    gated: GatedViews, former: FormerGroups, rasterizer: Rasterizer
) -> Stage[IntArray]:
    """Labels (N,) of the Gaussians that former masks have shown, 0 = of no mask, or hardly.

    What has no mask still gets votes from the borders of masks next to it. So the votes must weigh
    as much as a view would that shows it whole, or as a few of many views would: of as large a
    share of the former views as of the new ones, as far as these tell who sees it.
    """
    most = np.zeros((len(gated.gaussians), 1), np.float32)
    n_seeing = np.zeros(len(most), np.int32)
    for i, camera in enumerate(gated.views):
        yield Progress(STAGE, i, len(gated.views), f"what {camera.name} shows")
        weight, whole = np.zeros_like(most), np.zeros((camera.height, camera.width), np.int32)
        rasterizer.vote(gated.gaussians, camera, whole, weight)
        np.maximum(most, weight, out=most)
        n_seeing += weight[:, 0] > 0
    n_former = len({decision.view for decision in former.bank.log})
    n_views = n_former / len(gated.views) * n_seeing
    least = most[:, 0] * np.maximum(_SEEN, _SEEN_SHARE * n_views)
    is_seen = (former.confidence > 0) & (former.weight >= least)
    return np.where(is_seen, former.labels, 0).astype(np.int32)


def _known(table: LongArray, guessed: LongArray) -> BoolArray:
    """Which masks (M + 1,) are of objects that former masks showed.

    ``table`` (M + 1, G + 1) counts pixels by what was seen, ``guessed`` also by what neighbours
    labelled: the back of an object whose front is known, as far as some of it is seen, too.
    """
    n_pixels, row = table.sum(axis=1), np.arange(len(table))
    seen = table[:, 1:].sum(axis=1)
    group = two_best(table)[0]
    is_back = (seen >= _SEEN_BACK * n_pixels) & (guessed[row, group] >= _KNOWN * n_pixels)
    result: BoolArray = (seen >= _KNOWN * n_pixels) | is_back
    return result


def _of_several(table: csr_matrix, config: ConsensusConfig) -> LongArray:
    """Dense ids of the masks that show several groups, as `merged_masks` finds them by points.

    By pixels the others count together, a floor shows a little of all that stands on it, but not
    those that the view shows more of: at the rim of each object some of its floor shows.
    """
    leaders, entries = Leaders.of(table), table.tocoo()
    area = np.asarray(table.sum(axis=0)).ravel()
    smaller = area[entries.col] <= area[leaders.first[entries.row]]
    counts = np.bincount(entries.row, entries.data * smaller, table.shape[0])
    share = config.merged_share * np.maximum(leaders.total, 1)
    return np.flatnonzero((counts - leaders.n_first >= share) & (leaders.n_second >= 2))


def _pixels(labels: IntArray, shown: IntArray, n_masks: int, n_groups: int) -> LongArray:
    """How many pixels (M + 1, G + 1) of each mask show each group."""
    cells = labels.astype(np.int64) * (n_groups + 1) + shown
    counts = np.bincount(cells.ravel(), minlength=(n_masks + 1) * (n_groups + 1))
    return counts.reshape(n_masks + 1, n_groups + 1).astype(np.int64)


def _new_groups(
    gated: GatedViews,
    left: Mapping[str, IntArray],
    depths: DepthMaps,
    consensus: ConsensusConfig,
) -> Stage[dict[str, csr_matrix]]:
    """By view the table of the masks that are left and of the groups that they form."""
    views = [camera for camera in gated.views if camera.name in left]
    if not views:
        return {}
    masks = MaskSet({name: partial(left.__getitem__, name) for name in left}, gated.masks.source)
    rest = GatedViews(gated.gaussians, views, masks, gated.gate, gated.depth)
    found = yield from consensus_stage(views, rest.masks_of, depths, consensus)
    return {camera.name: table for camera, table in zip(views, found, strict=True)}


def _decided(
    gated: GatedViews, bank: MemoryBank, tables: Mapping[str, csr_matrix], n_fresh: int
) -> MemoryBank:
    """The bank with a decision for each mask of the new views."""
    log = list(bank.log)
    opened: set[int] = set()
    for camera in gated.views:
        masks, mask_of = gated.gaussians_of(camera)
        said = Leaders.of(tables[camera.name]).by_mask(masks.ids)
        n_gaussians = np.bincount(mask_of, minlength=len(masks) + 1).tolist()
        for mask, n in zip(masks.ids[1:].tolist(), n_gaussians[1:], strict=True):
            group, share, second, rival = said[mask]
            is_new = group > bank.n_groups and group not in opened
            opened.add(group)
            log.append(Decision(camera.name, mask, group, is_new, share, second, rival, n))
    return replace(bank, n_groups=bank.n_groups + n_fresh, log=tuple(log))


def _with_former(former: FormerGroups, votes: Votes, begun: FloatArray) -> Votes:
    """The votes, with the weight of former ones that they did not begin with (``begun`` (N,) of
    the label); what has no vote in them keeps the label that it had votes for."""
    best = former.confidence * former.weight
    keeps = (votes.labels == 0) & (best > 0)
    labels = np.where(keeps, former.labels, votes.labels)
    weight = votes.weight + former.weight - begun
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(keeps, best, votes.confidence * votes.weight) / weight
    confidence = np.where(weight > 0, np.minimum(share, 1), 0).astype(np.float32)
    return Votes(labels.astype(np.int32), confidence, weight)


# --- New views of a scene whose groups were edited since: they join the groups as they are now.
# `add_views_stage` works on what an association saved. Here groups come from a scene: merged,
# parted, renumbered, with ids that other splats use, and without the weight of the former votes,
# which is measured again: a pass over the former views, but no decision of them is made again.


@dataclass(frozen=True, eq=False)
class EditedGroups:
    """Groups of a scene as they are now."""

    bank: MemoryBank
    labels: IntArray  # (N,) 0 = none
    confidence: FloatArray | None  # (N,) 0..1; None: not known
    free: int  # the first id for new groups

    @property
    def by_hand(self) -> BoolArray:
        """Gaussians (N,) that were put elsewhere than the association had them.

        None in the bank of a published preset: it holds what masks claimed, not what was voted.
        """
        if self.bank.is_published:
            return np.zeros(len(self.labels), np.bool_)
        result: BoolArray = self.labels != np.maximum(self.bank.group, 0)
        return result


def with_decisions(
    former: IntArray,  # (N,) groups before, 0 = none
    found: IntArray,  # (N,) groups found again
    changed: IntArray,  # (C,) ids of former groups that a person changed, ascending
    named: Collection[int] = (),  # ids of former groups that a person named
) -> tuple[IntArray, dict[int, int]]:
    """Groups (N,) found again, with those that a person decided on as they were.

    A changed group stays, splat for splat, with a new id; so does a named one that is not found
    again. What is left of a found group that is mostly part of those is in no group: a rim, or what
    a person left out. Also the new ids by the former ones: of groups that stay, and of others that
    are the same object, IoU over a half.
    """
    old, new, both = _shared(former, found)
    of_old, of_new = np.bincount(former), np.bincount(found)
    is_same = (2 * both > of_old[old] + of_new[new] - both) & (old > 0) & (new > 0)
    lost = np.setdiff1d(np.array(sorted(named), np.int64), old[is_same])
    stay = np.union1d(changed, np.intersect1d(lost, former[former > 0])).astype(np.int32)
    first = 1 + int(found.max(initial=0))  # id of those that stay
    new_ids = dict(zip(stay.tolist(), range(first, first + len(stay)), strict=True))
    stays = np.isin(old, stay)
    taken = np.bincount(new[stays], both[stays], first)
    result = np.where(2 * taken > of_new, 0, np.arange(first))[found].astype(np.int32)
    is_kept = np.isin(former, stay)
    result[is_kept] = first + np.searchsorted(stay, former[is_kept])
    is_same &= np.isin(new, result)
    return result, dict(zip(old[is_same].tolist(), new[is_same].tolist(), strict=True)) | new_ids


def _shared(a: IntArray, b: IntArray) -> tuple[LongArray, LongArray, LongArray]:
    """Pairs of groups (P,) of two labellings (N,) that share Gaussians, how many; most first."""
    n = 1 + int(b.max(initial=0))
    pairs, both = np.unique(a.astype(np.int64) * n + b, return_counts=True)
    order = np.argsort(-both, kind="stable")
    return pairs[order] // n, pairs[order] % n, both[order]


def add_to_edited_stage(
    gaussians: Gaussians,
    cameras: Sequence[Camera],  # former views and new ones
    masks: MaskSet,
    edited: EditedGroups,
    rasterizer: Rasterizer,
    config: AssociateConfig,
) -> Stage[Association]:
    """Let views with masks that are not in the bank's log join groups that were edited.

    Ids of groups stay; new ones begin at ``edited.free``. What was put elsewhere by hand
    (`EditedGroups.by_hand`) stays there. Raises ``GagaError`` as `add_views_stage` does.
    """
    known = {decision.view for decision in edited.bank.log}
    views = views_as_masked(cameras, masks, edited.bank.preset)
    former_views = [camera for camera in views if camera.name in known]
    weight = yield from part(_weights(gaussians, former_views, masks, rasterizer), 0, 2, STAGE)
    of_masks = [np.array([(d.group, d.runner_up) for d in edited.bank.log], np.int64).ravel()]
    held = edited.bank.shared[:, 1]
    used = np.concatenate([edited.labels, edited.bank.group, [0], held, *of_masks])
    ids = np.unique(used[used >= 0]).astype(np.int32)  # there may be large gaps
    row = np.zeros(int(ids[-1]) + 1, np.int32)
    row[ids] = np.arange(len(ids), dtype=np.int32)
    own = edited.confidence
    former = FormerGroups(
        renumbered(edited.bank, row, len(ids) - 1),
        row[edited.labels],
        np.ones(len(weight), np.float32) if own is None else own,
        weight,
    )
    added = add_views_stage(gaussians, cameras, masks, former, rasterizer, config)

    def with_ids(step: Progress) -> Progress:
        """A step on the way, whose bank has the ids of the scene."""
        shown = step.payload
        if not isinstance(shown, BankSnapshot):
            return step
        back = _all_ids(ids, edited.free, shown.bank.n_groups)
        bank = renumbered(shown.bank, back, int(back[-1]))
        return replace(step, payload=replace(shown, bank=bank, keeps_ids=True))

    added = mapped(added, with_ids)
    found = yield from part(added, 1, 2, STAGE)
    back = _all_ids(ids, edited.free, found.bank.n_groups)
    n_groups = max(edited.bank.n_groups, int(back[-1]))
    bank = renumbered(found.bank, back, n_groups)
    group = np.where(edited.by_hand, edited.bank.group, bank.group).astype(np.int32)
    bank = replace(bank, group=group)  # what was put elsewhere by hand is known the next time, too
    labels = np.where(edited.by_hand, edited.labels, back[found.labels]).astype(np.int32)
    return replace(
        found,
        bank=bank,
        labels=labels,
        mask_groups={view: back[groups] for view, groups in found.mask_groups.items()},
        views_per_group=views_per_group(bank),
    )


def _weights(
    gaussians: Gaussians, views: Sequence[Camera], masks: MaskSet, rasterizer: Rasterizer
) -> Stage[FloatArray]:
    """Summed blending weight (N,) of each Gaussian over the pixels of these views in a mask."""
    weight = np.zeros((len(gaussians), 1), np.float32)
    for i, camera in enumerate(views):
        yield Progress(STAGE, i, len(views), f"the former masks of {camera.name}")
        labelled = load_labels(masks, camera)[0] > 0
        rasterizer.vote(gaussians, camera, np.where(labelled, 0, -1).astype(np.int32), weight)
    return weight[:, 0]


def _all_ids(ids: IntArray, free: int, n_groups: int) -> IntArray:
    """The ids in the scene of groups 0..n_groups: those that it has, then new ones."""
    n_new = n_groups + 1 - len(ids)
    return np.append(ids, free + np.arange(n_new, dtype=np.int32)).astype(np.int32)
