"""The growth of a saved memory bank: which Gaussians each view gave to which group (figure 2)."""

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, IntArray, LongArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.gate import ViewMasks, gaussians_of_masks, open_bounds
from gaga_core.grouping.gate_kernels import take_free
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.grouping.views import GatedViews
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer

STAGE = "Replay the memory bank"


@dataclass(frozen=True, eq=False)
class BankGrowth:
    """The bank after each of its V views. Step 0 is empty, step V + 1 is what was saved in the end.

    A Gaussian that a view gave to a group stays there until the last step, in which the votes of
    all views decide.
    """

    views: tuple[str, ...]  # V names, in the order of the association
    n_decisions: IntArray  # (V + 1,) entries of the log made up to each step
    n_groups: IntArray  # (V + 1,) groups that have a mask up to each step
    taken_by: IntArray  # (N,) group that got the Gaussian, 0 = none
    taken_at: IntArray  # (N,) step 1..V at which; V + 1 where no view did
    labels: IntArray  # (N,) as saved, 0 = none

    @property
    def last_step(self) -> int:
        """The step at which the groups are the saved ones."""
        return len(self.views) + 1

    def labels_at(self, step: int) -> IntArray:
        """Group (N,) of each Gaussian after ``step``, 0 = not known yet.

        Raises ``ValueError`` when there is no such step.
        """
        if not 0 <= step <= self.last_step:
            raise ValueError(f"step: {step} is not in 0..{self.last_step}")
        if step == self.last_step:
            return self.labels
        return np.where(self.taken_at <= step, self.taken_by, np.int32(0))


def growth_stage(
    gated: GatedViews,
    bank: MemoryBank,
    labels: IntArray,  # (N,) as saved
    rasterizer: Rasterizer,
) -> Stage[BankGrowth]:
    """Replay the decisions in the log of a bank, view after view.

    Each mask gives its group the Gaussians behind it that no group owns yet, as when the bank was
    filled (section 3.2); what is decided is read, not decided again. Depth maps of views that
    ``gated`` has not rendered yet are rendered: one each. Raises ``GagaError`` when a view of the
    log has no masks any more.
    """
    cameras = {camera.name: camera for camera in gated.views}
    by_view = [(view, list(log)) for view, log in groupby(bank.log, lambda d: d.view)]
    group = np.full(len(gated.gaussians), -1, np.int32)
    taken_at = np.full(len(group), len(by_view) + 1, np.int32)
    n_decisions, n_groups, known = [0], [0], set[int]()
    for i, (view, decisions) in enumerate(by_view):
        camera = cameras.get(view)
        if camera is None:
            raise GagaError(f"{view} no longer has masks. Choose the masks of this bank.")
        yield Progress(STAGE, i, len(by_view), view)
        masks, mask_of = gated.rendered(camera, rasterizer)
        was_free = group < 0
        group_of = {decision.mask: decision.group for decision in decisions} | {0: 0}
        of_mask = [group_of.get(mask, 0) for mask in masks.ids.tolist()]
        take_free(mask_of, np.array(of_mask, np.int32), group)
        taken_at[was_free & (group >= 0)] = i + 1
        known |= {decision.group for decision in decisions if decision.group > 0}
        n_decisions.append(n_decisions[-1] + len(decisions))
        n_groups.append(len(known))
    return BankGrowth(
        views=tuple(view for view, _ in by_view),
        n_decisions=np.array(n_decisions, np.int32),
        n_groups=np.array(n_groups, np.int32),
        taken_by=np.maximum(group, np.int32(0)),
        taken_at=taken_at,
        labels=labels.astype(np.int32),
    )


# --- The Gaussians of one mask with and without the depth gate (figure 3), and their groups.


@dataclass(frozen=True, eq=False)
class MaskSplats:
    """The Gaussians behind a mask. ``gated`` is a subset of ``behind``."""

    gated: BoolArray  # (N,) G(m): the depth gate of section 3.2 lets them through
    behind: BoolArray  # (N,) everything whose centre projects into the mask, at any depth

    def of(self, has_gate: bool) -> BoolArray:
        """The Gaussians (N,) that count, with the gate or without."""
        return self.gated if has_gate else self.behind


def mask_splats(gated: GatedViews, camera: Camera, mask: int) -> MaskSplats:
    """Find the Gaussians of the mask with id ``mask`` in the label map of a rendered view.

    Raises ``GagaError`` when the view has no such mask any more.
    """
    masks, mask_of = gated.gaussians_of(camera)
    at = int(np.searchsorted(masks.ids, mask))
    if mask <= 0 or at >= len(masks.ids) or masks.ids[at] != mask:
        raise GagaError(f"{camera.name} no longer has mask {mask}. Use the masks of this bank.")
    behind = gaussians_of_masks(gated.gaussians.means, camera, masks, open_bounds(masks))
    return MaskSplats(mask_of == at, behind == at)


def shares_of_groups(
    labels: IntArray,  # (N,) 0 = none
    chosen: BoolArray,  # (N,)
) -> dict[int, float]:
    """Share of the chosen Gaussians that each group owns, descending; 0 is those of no group.

    The overlap of section 3.2 with each group, #(G(m) and G_i) / #G(m), so they add up to 1. Of
    equal shares the older group comes first. Empty when nothing is chosen.
    """
    check_shape("chosen", chosen, labels.shape, np.bool_)
    counts = np.bincount(labels[chosen], minlength=1)
    return _shares(np.arange(len(counts)), counts)


def shares_of_pixels(
    masks: ViewMasks,
    seen: IntArray,  # (H, W) group that each pixel shows, 0 = none
) -> dict[int, dict[int, float]]:
    """By id of each mask, the share of its pixels that show each group, as `shares_of_groups`."""
    check_shape("seen", seen, masks.labels.shape, np.int32)
    groups, columns = np.unique(seen, return_inverse=True)
    cells = masks.labels.ravel().astype(np.int64) * len(groups) + columns.ravel()
    counts = np.bincount(cells, minlength=(len(masks) + 1) * len(groups)).reshape(-1, len(groups))
    ids = masks.ids.tolist()
    return {ids[m]: _shares(groups, counts[m]) for m in range(1, len(ids))}


def _shares(
    groups: AnyArray,  # (G,) ascending
    counts: LongArray,  # (G,)
) -> dict[int, float]:
    total = max(int(counts.sum()), 1)
    order = np.argsort(-counts, kind="stable")
    return {int(groups[at]): int(counts[at]) / total for at in order if counts[at] > 0}
