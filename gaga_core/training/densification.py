"""Density control by screen gradients: clone, split, prune (Kerbl 2023, section 5.2).

A clone and its original share the opacity such that both together cover as much as the one before
(Rota Bulo 2024): the picture stays, and no later pass has to undo a sudden thickening.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.raster.base import Gradients
from gaga_core.training.losses_kernels import add_view
from gaga_core.training.optimizer import COLUMNS, Splats
from gaga_core.training.settings import DensityConfig

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
        return np.divide(self.gradient, n_views)


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
    return np.log(np.expm1(through)).astype(np.float32)


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


# --- Density control as sampling: 3D Gaussian Splatting as Markov Chain Monte Carlo (Kheradmand
# 2024).
# Splats that have faded are moved to living ones, drawn in proportion to opacity; new ones are
# born there too; and faint splats walk at random, so that they find what no splat shows yet.


_MOST_COPIES = 51  # of one splat at a time
_BASE_RATE = 1.6e-4  # rate of means that the noise of the publication is a multiple of
_FAINT_OPACITY = 0.1  # splats above this opacity do not walk: the gate is under 1e-4
_GATE = 100.0


def relocate_and_grow(
    splats: Splats, config: DensityConfig, n_new: int, rng: np.random.Generator
) -> Splats:
    """Move the faded splats onto living ones, and give birth to ``n_new`` (equation 9).

    Each group of splats that now lie on one another covers as much as the one before. Rows keep
    their place, new ones are at the end; what the optimiser knew of rows touched is forgotten.
    """
    opacities = splats.values.opacities.astype(np.float64)
    faded = opacities <= config.least_opacity
    if faded.all():
        return splats
    moved = np.flatnonzero(faded)
    sources = _draw(opacities, ~faded, len(moved), rng)
    _share(splats, sources, config.least_opacity)
    for name in COLUMNS:
        column = getattr(splats.values, name)
        column[moved] = column[sources]
    _forget(splats, np.concatenate([sources, moved]))
    if n_new == 0:
        return splats
    opacities = splats.values.opacities.astype(np.float64)
    sources = _draw(opacities, np.ones(len(splats), np.bool_), n_new, rng)
    _share(splats, sources, config.least_opacity)
    _forget(splats, sources)
    return splats.grown(splats.values.take(sources))


def walk(
    splats: Splats, config: DensityConfig, decay: float, extent: float, rng: np.random.Generator
) -> None:
    """Move faint splats at random along their own axes, in place (equation 8).

    ``decay`` is the rate of means as a share of that at the start, ``extent`` the size of the scene
    in scene units: the walk is the same whatever the unit is.
    """
    values = splats.values
    rows = np.flatnonzero(values.logit_opacities < np.log(_FAINT_OPACITY / (1 - _FAINT_OPACITY)))
    faint = values.take(rows)
    gate = 1 / (1 + np.exp(_GATE * (faint.opacities.astype(np.float64) - config.least_opacity)))
    length = config.noise * walk_rate(decay, extent) * gate
    axes = quats_to_matrices(faint.quats) * faint.scales[:, None]  # columns: axis x its length
    steps = rng.standard_normal((len(rows), 3)) * length[:, None]
    moved = np.einsum("nij,nkj,nk->ni", axes, axes, steps)
    values.means[rows] += moved.astype(np.float32)


def walk_rate(decay: float, extent: float) -> float:
    """What `DensityConfig.noise` is a multiple of, as a share of a splat's covariance."""
    return _BASE_RATE * decay / extent


def shared(opacities: DoubleArray, copies: LongArray) -> tuple[DoubleArray, DoubleArray]:
    """Opacity and scale factor (N,) of each of ``copies`` splats that together draw what one of
    ``opacities`` drew (equation 9)."""
    new = 1 - (1 - opacities) ** (1 / copies)
    total = np.zeros(len(opacities))
    most = int(copies.max(initial=1))
    for i in range(1, most + 1):
        inner = np.zeros(len(opacities))
        for k in range(i):
            inner += (-1) ** k * math.comb(i - 1, k) / math.sqrt(k + 1) * new ** (k + 1)
        total += np.where(i <= copies, inner, 0.0)
    return new, opacities / np.maximum(total, 1e-12)


def _draw(opacities: DoubleArray, alive: BoolArray, n: int, rng: np.random.Generator) -> LongArray:
    """``n`` indices of splats that are ``alive``, in proportion to opacity, with repetition."""
    weights = np.where(alive, opacities, 0.0)
    return rng.choice(len(weights), size=n, p=weights / weights.sum()).astype(np.int64)


def _share(splats: Splats, sources: LongArray, least: float) -> None:
    """Make each source one of 1 + (times it was drawn) equal splats, in place."""
    rows, drawn = np.unique(sources, return_counts=True)
    copies = np.minimum(drawn + 1, _MOST_COPIES)
    values = splats.values
    opacity, factor = shared(values.opacities[rows].astype(np.float64), copies)
    opacity = np.clip(opacity, least, 1 - 1e-6)
    values.logit_opacities[rows] = _logit(opacity)
    values.log_scales[rows] += np.log(factor)[:, None].astype(np.float32)


def _logit(opacity: DoubleArray) -> FloatArray:
    return np.log(opacity / (1 - opacity)).astype(np.float32)


def _forget(splats: Splats, rows: LongArray) -> None:
    for part in (splats.first, splats.second):
        for name in COLUMNS:
            getattr(part, name)[rows] = 0
