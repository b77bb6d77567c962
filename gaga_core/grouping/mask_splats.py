"""The Gaussians of one mask with the depth gate and without it (figure 3), and whose they are."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.grouping.gate import gaussians_of_masks, open_bounds
from gaga_core.grouping.gated_views import GatedViews


@dataclass(frozen=True, eq=False)
class MaskSplats:
    """Who lies behind a mask. ``gated`` is a subset of ``behind``."""

    gated: BoolArray  # (N,) G(m): the depth gate of section 3.2 lets them through
    behind: BoolArray  # (N,) everything whose centre projects into the mask, at any depth

    def of(self, has_gate: bool) -> BoolArray:
        """Who counts (N,) with the gate or without."""
        return self.gated if has_gate else self.behind


def mask_splats(gated: GatedViews, camera: Camera, mask: int) -> MaskSplats:
    """Find the Gaussians of the mask with id ``mask`` in the label map of a rendered view.

    Raises ``GagaError`` when the view has no such mask any more.
    """
    masks, mask_of = gated.gaussians_of(camera)
    at = int(np.searchsorted(masks.ids, mask))
    if mask <= 0 or at >= len(masks.ids) or masks.ids[at] != mask:
        raise GagaError(f"{camera.name} has no mask {mask} any more. Use the masks of this bank.")
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
    total = max(int(counts.sum()), 1)
    order = np.argsort(-counts, kind="stable")
    return {int(group): int(counts[group]) / total for group in order if counts[group] > 0}
