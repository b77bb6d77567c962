"""The sparse-view protocol (supplement): fewer train views, and what that costs."""

from collections.abc import Sequence

import numpy as np

from gaga_core.camera import natural_order
from gaga_core.errors import GagaError

SHARES = (0.30, 0.20, 0.10, 0.05)  # of the train views, as published


def sparse_views(names: Sequence[str], share: float, seed: int) -> tuple[str, ...]:
    """A random ``share`` of the views, at least one, by name.

    The same seed gives nested choices: the views of 5 % are among those of 10 %, so the shares of
    one seed differ only in what was left out. Raises ``GagaError`` when a share is not in (0, 1].
    """
    if not 0 < share <= 1:
        raise GagaError(f"A share of {share} of the views cannot be taken. Choose one in (0, 1].")
    ordered = sorted(names, key=natural_order)
    n = min(len(ordered), max(1, round(share * len(ordered))))
    chosen = np.random.default_rng(seed).permutation(len(ordered))[:n]
    return tuple(ordered[i] for i in np.sort(chosen))


def iou_drop(iou_all: float, iou_sparse: float) -> float:
    """IoU drop = (IoU100 - IoUx) / IoU100; 0 when there was nothing to lose."""
    return (iou_all - iou_sparse) / iou_all if iou_all > 0 else 0.0
