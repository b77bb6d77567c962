"""Scored, overlapping masks -> one label map, as the paper does (section 4.1)."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.errors import GagaError
from gaga_core.segmentation.base import ScoredMasks

MOST_LABELS = 65535  # of a 16-bit label map


@dataclass(frozen=True)
class FlattenConfig:
    """Which masks stay when they are painted over each other."""

    min_score: float = 0.5
    """Confidence under which a mask is left out (section 4.1). 0..1."""
    min_visible: float = 0.10
    """A mask of which this share or less is left uncovered is dropped; its pixels become none, as
    in the published code. 0..1; 0 keeps all that can be seen."""

    def __post_init__(self) -> None:
        if not 0 <= self.min_visible < 1:
            raise ValueError(f"min_visible: expected 0 <= x < 1, got {self.min_visible}")


def flatten(scored: ScoredMasks, config: FlattenConfig | None = None) -> IntArray:
    """Label map (H, W) int32 of ``scored``: 0 = none, 1 = the most confident mask, dense.

    Masks are painted from the least to the most confident, so that the most confident lies on top;
    of equal ones the smaller. Raises ``GagaError`` when more masks stay than 16 bits hold.
    """
    config = config or FlattenConfig()
    areas = scored.areas
    order = np.lexsort((np.arange(len(scored)), areas, -scored.scores))  # the best first
    order = order[(scored.scores[order] >= config.min_score) & (areas[order] > 0)]
    painted = np.zeros((scored.height, scored.width), np.int32)
    for rank in range(len(order), 0, -1):
        x0, y0, x1, y1 = scored.boxes[order[rank - 1]]
        painted[y0:y1, x0:x1][scored.crops[order[rank - 1]]] = rank
    visible = np.bincount(painted.ravel(), minlength=len(order) + 1)[1:]
    stays = visible > config.min_visible * areas[order]
    n_labels = int(stays.sum())
    if n_labels > MOST_LABELS:
        raise GagaError(
            f"There are {n_labels} masks in one picture, a label map holds {MOST_LABELS}. "
            "Raise the least confidence."
        )
    lookup = np.zeros(len(order) + 1, np.int32)
    lookup[1:][stays] = np.arange(1, n_labels + 1)
    labels: IntArray = lookup[painted]
    return labels
