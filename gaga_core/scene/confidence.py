"""Confidence of the splats' groups: histogram over a selection, and uncertain splats."""

import numpy as np

from gaga_core.arrays import IntArray, LongArray
from gaga_core.errors import GagaError
from gaga_core.scene.scene import Scene, State


def confidence_histogram(scene: Scene, splats: IntArray, n_bins: int = 20) -> LongArray | None:
    """Number (B,) of ``splats`` (K,) in bins of ascending confidence; None when it is unknown."""
    column = scene.confidence_of()
    if column is None:
        return None
    bins = column[splats].astype(np.int64) * n_bins // 256
    return np.bincount(bins, minlength=n_bins)


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
