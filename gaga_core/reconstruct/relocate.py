"""Density control as sampling: 3D Gaussian Splatting as Markov Chain Monte Carlo (Kheradmand 2024).

Splats that have faded are moved to living ones, drawn in proportion to opacity; new ones are born
there too; and faint splats walk at random, so that they find what no splat shows yet.
"""

import math

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, LongArray
from gaga_core.geometry import quats_to_matrices
from gaga_core.reconstruct.optimizer import COLUMNS, Splats
from gaga_core.reconstruct.settings import DensityConfig

_MOST_COPIES = 51  # of one splat at a time
_BASE_RATE = 1.6e-4  # rate of means that the noise of the publication is a multiple of
_FAINT = 0.1  # splats above this opacity do not walk: the gate is under 1e-4
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
    rows = np.flatnonzero(values.logit_opacities < np.log(_FAINT / (1 - _FAINT)))
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
    result: FloatArray = np.log(opacity / (1 - opacity)).astype(np.float32)
    return result


def _forget(splats: Splats, rows: LongArray) -> None:
    for part in (splats.first, splats.second):
        for name in COLUMNS:
            getattr(part, name)[rows] = 0
