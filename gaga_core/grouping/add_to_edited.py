"""New views of a scene whose groups were edited since: they join the groups as they are now.

`add_views_stage` works on what an association saved. Here groups come from a scene: merged, parted,
renumbered, with ids that other splats use, and without the weight of the former votes, which is
measured again: a pass over the former views, but no decision of them is made again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.add_views import STAGE, FormerGroups, add_views_stage
from gaga_core.grouping.associate import AssociateConfig, Association, BankSnapshot
from gaga_core.grouping.memory_bank import Decision, MemoryBank, views_per_group
from gaga_core.grouping.views import load_labels, views_with_masks
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, mapped, part
from gaga_core.raster.base import Rasterizer


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

        None in the bank of preset "paper": it holds what masks claimed, not what was voted.
        """
        if self.bank.preset == "paper":
            return np.zeros(len(self.labels), np.bool_)
        result: BoolArray = self.labels != np.maximum(self.bank.group, 0)
        return result


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
    former_views = [c for c in views_with_masks(cameras, masks) if c.name in known]
    weight = yield from part(_weights(gaussians, former_views, masks, rasterizer), 0, 2, STAGE)
    ids = _ids(edited)
    row = np.zeros(int(ids[-1]) + 1, np.int32)
    row[ids] = np.arange(len(ids), dtype=np.int32)
    own = edited.confidence
    former = FormerGroups(
        _renumbered(edited.bank, row, len(ids) - 1),
        row[edited.labels],
        np.ones(len(weight), np.float32) if own is None else own,
        weight,
    )
    added = add_views_stage(gaussians, cameras, masks, former, rasterizer, config)
    added = mapped(added, lambda step: _with_ids(step, ids, edited.free))
    found = yield from part(added, 1, 2, STAGE)
    back = _all_ids(ids, edited.free, found.bank.n_groups)
    n_groups = max(edited.bank.n_groups, int(back[-1]))
    bank = _renumbered(found.bank, back, n_groups)
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


def _with_ids(step: Progress, ids: IntArray, free: int) -> Progress:
    """A step on the way, whose bank has the ids of the scene."""
    shown = step.payload
    if not isinstance(shown, BankSnapshot):
        return step
    back = _all_ids(ids, free, shown.bank.n_groups)
    bank = _renumbered(shown.bank, back, int(back[-1]))
    return replace(step, payload=replace(shown, bank=bank, keeps_ids=True))


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


def _ids(edited: EditedGroups) -> IntArray:
    """All ids in use, ascending, with 0: there may be large gaps."""
    of_masks = np.array([d.group for d in edited.bank.log], np.int64)
    runners = np.array([d.runner_up for d in edited.bank.log], np.int64)
    parts: list[AnyArray] = [edited.labels, edited.bank.group, of_masks, runners, np.zeros(1)]
    ids = np.unique(np.concatenate([np.unique(part) for part in parts]))
    return ids[ids >= 0].astype(np.int32)


def _all_ids(ids: IntArray, free: int, n_groups: int) -> IntArray:
    """The ids in the scene of groups 0..n_groups: those that it has, then new ones."""
    n_new = n_groups + 1 - len(ids)
    return np.append(ids, free + np.arange(n_new, dtype=np.int32)).astype(np.int32)


def _renumbered(bank: MemoryBank, to: IntArray, n_groups: int) -> MemoryBank:
    """``bank`` with the ids ``to`` of its ids."""

    def moved(decision: Decision) -> Decision:
        group, second = int(to[decision.group]), int(to[decision.runner_up])
        return replace(decision, group=group, runner_up=second)

    group = np.where(bank.group > 0, to[np.maximum(bank.group, 0)], bank.group).astype(np.int32)
    return replace(bank, group=group, n_groups=n_groups, log=tuple(map(moved, bank.log)))
