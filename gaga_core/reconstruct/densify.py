"""Density control by screen gradients: clone, split, prune (Kerbl 2023, section 5.2).

A clone and its original share the opacity such that both together cover as much as the one before
(Rota Bulo 2024): the picture stays, and no later pass has to undo a sudden thickening.
"""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray, LongArray
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.raster.base import Gradients
from gaga_core.reconstruct.optimizer import Splats
from gaga_core.reconstruct.optimizer_kernels import add_view
from gaga_core.reconstruct.settings import DensityConfig

_SHRINK = 1.6  # parts of a split splat are smaller by this (Kerbl 2023)


@dataclass(frozen=True, eq=False)
class ScreenSums:
    """What density control has seen of each splat since the last time; changed in place."""

    gradient: FloatArray  # (N,) sum over views of its screen gradient, per half picture
    n_views: IntArray  # (N,) views that drew it

    @staticmethod
    def empty(n: int) -> "ScreenSums":
        """Nothing seen of ``n`` splats."""
        return ScreenSums(np.zeros(n, np.float32), np.zeros(n, np.int32))

    def add(self, gradients: Gradients) -> None:
        """Count a view."""
        add_view(gradients.indices, gradients.screen, self.gradient, self.n_views)

    def mean(self) -> FloatArray:
        """Mean screen gradient (N,) over the views that drew each splat."""
        n_views = np.maximum(self.n_views, 1).astype(np.float32)
        result: FloatArray = np.divide(self.gradient, n_views)
        return result


def quota(config: DensityConfig, n_splats: int, moment: float, step: float) -> int:
    """How many splats may be added at ``moment``, controls being ``step`` apart.

    With `DensityConfig.full_at` the room under the cap is shared among the controls until then;
    without it only the cap counts, and `DensityConfig.growth` for the strategy "mcmc".
    """
    room = max(0, config.max_splats - n_splats)
    if config.full_at <= 0 and config.strategy == "mcmc":
        return min(room, int(config.growth * n_splats))
    if config.full_at <= 0:
        return room
    n_left = max(1, int((config.full_at - moment) / step + 1e-6) + 1)
    return -(-room // n_left)


def control_density(
    splats: Splats,
    sums: ScreenSums,
    config: DensityConfig,
    extent: float,  # scene units
    n_new: int,
    rng: np.random.Generator,
) -> Splats:
    """Remove faint and huge splats; clone or split those of the largest gradients.

    At most ``n_new`` more splats than are kept. Rows that stay keep their order and what the
    optimiser knows of them; new ones are at the end.
    """
    values = splats.values
    size = values.log_scales.max(axis=1)
    keep = values.opacities > config.least_opacity
    if config.largest_size > 0:
        keep &= size < np.log(config.largest_size * extent)
    chosen = _most_needed(sums.mean(), keep, config.threshold, n_new)
    is_large = size[chosen] > np.log(config.split_size * extent)
    split, cloned = chosen[is_large], chosen[~is_large]
    keep[split] = False
    copies = values.take(cloned)
    copies = replace(copies, logit_opacities=shared_opacity(copies.logit_opacities))
    values.logit_opacities[cloned] = copies.logit_opacities
    parts = [_part(values.take(split), rng) for _ in range(2)]
    rest = splats.take(keep)
    for more in (copies, *parts):
        rest = rest.grown(more)
    return rest


def shared_opacity(logits: FloatArray) -> FloatArray:
    """Logits of the opacity that covers, twice over each other, as much as ``logits`` once."""
    # 1 - sqrt(1 - o) with 1 - o = 1 / (1 + e^x)
    through = 0.5 * np.logaddexp(0.0, logits.astype(np.float64))  # -log(1 - new)
    result: FloatArray = np.log(np.expm1(through)).astype(np.float32)
    return result


def reset_opacities(splats: Splats, opacity: float) -> None:
    """Cut opacities to ``opacity``, in place, and forget how they moved (Kerbl 2023)."""
    logits = splats.values.logit_opacities
    np.minimum(logits, np.float32(np.log(opacity / (1 - opacity))), out=logits)
    splats.first.logit_opacities[:] = 0
    splats.second.logit_opacities[:] = 0


def _most_needed(need: FloatArray, allowed: BoolArray, threshold: float, n: int) -> LongArray:
    """Ascending indices of the ``n`` largest needs above ``threshold``; ties by index."""
    candidates = np.flatnonzero(allowed & (need > threshold))
    if len(candidates) > n:
        order = np.argsort(-need[candidates], kind="stable")[:n]
        candidates = np.sort(candidates[order])
    return candidates


def _part(split: Gaussians, rng: np.random.Generator) -> Gaussians:
    """A smaller splat at a random place inside each of ``split``."""
    offsets = rng.normal(size=(len(split), 3)) * split.scales
    turned = np.einsum("nij,nj->ni", quats_to_matrices(split.quats), offsets)
    return replace(
        split,
        means=(split.means + turned).astype(np.float32),
        log_scales=split.log_scales - np.float32(np.log(_SHRINK)),
    )
