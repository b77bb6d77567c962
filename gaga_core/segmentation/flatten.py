"""Scored, overlapping masks -> one label map, as the paper does (section 4.1)."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import IntArray, LongArray
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
    areas = scored.areas
    best_first = np.lexsort((np.arange(len(scored)), areas, -scored.scores))
    return _painted(scored, areas, best_first, config or FlattenConfig())


def flatten_levels(
    scored: ScoredMasks, config: FlattenConfig | None = None
) -> tuple[IntArray, IntArray] | None:
    """Label maps (H, W) int32 of wholes and of parts; None where no mask lies in another.

    The largest masks lie on top in the first map, the smallest ones in the second: of masks that
    contain each other (Segment Anything's whole, part and subpart) each pixel shows the outermost
    and the innermost. Other rules are those of `flatten`.
    """
    config, areas = config or FlattenConfig(), scored.areas
    ids = np.arange(len(scored))
    small_first = np.lexsort((ids, -scored.scores, areas))
    large_first = np.lexsort((ids, -scored.scores, -areas))
    wholes = _painted(scored, areas, large_first, config)
    parts = _painted(scored, areas, small_first, config)
    return None if _is_same_partition(wholes, parts) else (wholes, parts)


def _painted(
    scored: ScoredMasks, areas: LongArray, order: LongArray, config: FlattenConfig
) -> IntArray:
    """Dense labels (H, W) of the masks, those that come first in ``order`` (M,) on top."""
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


def _is_same_partition(one: IntArray, other: IntArray) -> bool:
    """Whether two label maps (H, W) with dense ids differ in their ids alone."""
    key = one.astype(np.int64) * (int(other.max(initial=0)) + 1) + other
    n_pairs = len(np.unique(key))
    return n_pairs == len(np.unique(one)) == len(np.unique(other))
