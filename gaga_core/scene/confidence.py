"""Confidence of the splats' groups: histogram over a selection, and uncertain splats."""

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.scene.scene import Scene, State


def confidence_histogram(scene: Scene, splats: IntArray, n_bins: int = 20) -> LongArray | None:
    """Number (B,) of ``splats`` (K,) in bins of ascending confidence; None when it is unknown."""
    column = scene.confidence_of()
    if column is None:
        return None
    bins = column[splats].astype(np.int64) * n_bins // 256
    return np.bincount(bins, minlength=n_bins)


def confidence_of_groups(scene: Scene, ids: IntArray) -> DoubleArray:
    """Mean confidence (G,), 0..1, of the splats of groups ``ids`` (G,); -1 where it is unknown.

    Deleted splats do not count.
    """
    column = scene.confidence_of()
    if column is None:
        return np.full(len(ids), -1.0)
    live = ~scene.has(State.DELETED)
    labels, n = scene.labels[live], int(ids.max(initial=0)) + 1
    total = np.bincount(labels, column[live], n)[ids]
    count = np.bincount(labels, minlength=n)[ids]
    mean: DoubleArray = np.where(count > 0, total / (255.0 * np.maximum(count, 1)), -1.0)
    return mean


def uncertain(scene: Scene, splats: IntArray, below: float) -> IntArray:
    """Those of ``splats`` (K,), locked and deleted ones aside, with a confidence under ``below``.

    Splats that no mask sees have confidence 0. Raises ``GagaError`` when confidence is unknown.
    """
    column = scene.confidence_of()
    if column is None:
        raise GagaError("How sure the splats are is not known. Use Find objects to learn it.")
    free = ~scene.has(State.LOCKED | State.DELETED)[splats]
    chosen: IntArray = splats[free & (column[splats] < below * 255)]
    return chosen
