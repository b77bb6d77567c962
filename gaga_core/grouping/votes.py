"""Labels per Gaussian by vote over label maps of views.

With the geometry frozen, the label map rendered from per-Gaussian scores is linear in them, and the
score of Gaussian i for label k that fits the views best is the summed blending weight w_i over the
pixels of label k (FlashSplat, Shen et al., ECCV 2024). The label is the argmax.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import machine_memory
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import LabelFrame, Rasterizer
from gaga_core.raster.vote_slots import VoteSlots

VOID_BELOW = 0.3  # summed weight under which a pixel shows no group
LabelMap = Callable[[Camera], IntArray]  # (H, W) at the camera's size; 0 = none
# A table within it takes all labels of every Gaussian: 480,000 Gaussians and 260 groups.
HISTOGRAM_BYTES = min(1 << 29, machine_memory() // 4)
_BLOCK = 1 << 16  # Gaussians whose argmax is taken at a time, so that temporaries stay small


@dataclass(frozen=True, eq=False)
class Votes:
    """Outcome of a vote."""

    labels: IntArray  # (N,) 1..G; 0 = no labelled pixel sees it
    confidence: FloatArray  # (N,) share of the winning label in the summed weight, 0..1
    weight: FloatArray  # (N,) summed blending weight over labelled pixels


def associated_labels(labels: IntArray, group_of_mask: IntArray) -> IntArray:
    """The pseudo-label map (H, W) of a view: its masks with their groups' ids, 0 = none.

    ``labels`` (H, W) is the view's label map, ``group_of_mask`` is indexed by its ids. This is
    what Fig. 2 of the paper trains the identity encodings on.
    """
    known = np.where((labels > 0) & (labels < len(group_of_mask)), labels, 0)
    return group_of_mask[known]


@dataclass(frozen=True, eq=False)
class VoteSums:
    """Summed blending weights by Gaussian and group, that views are added to in place."""

    n_groups: int
    sums: FloatArray | VoteSlots  # (N, G), or a few groups of each Gaussian

    @staticmethod
    def empty(n: int, n_groups: int, histogram_bytes: int = HISTOGRAM_BYTES) -> "VoteSums":
        """No votes of ``n`` Gaussians for ``n_groups``.

        The table is (N, G) float32. When that would exceed ``histogram_bytes``, each Gaussian keeps
        the `SLOTS` labels that matter most for it (`VoteSlots`): the same result unless more than
        so many groups show one Gaussian.
        """
        is_table = 4 * n * n_groups <= histogram_bytes
        table = np.zeros((n, n_groups), np.float32) if is_table else VoteSlots.empty(n)
        return VoteSums(n_groups, table)

    @staticmethod
    def started(
        labels: IntArray,  # (N,) 0 = none
        weights: FloatArray,  # (N,) of that label, >= 0
        n_groups: int,
        histogram_bytes: int = HISTOGRAM_BYTES,
    ) -> "VoteSums":
        """Sums in which each Gaussian has the votes of one label already; see `empty`."""
        result = VoteSums.empty(len(labels), n_groups, histogram_bytes)
        rows = np.flatnonzero((labels > 0) & (weights > 0))
        if isinstance(result.sums, VoteSlots):
            result.sums.labels[rows, 0] = labels[rows] - 1
            result.sums.weights[rows, 0] = weights[rows]
        else:
            result.sums[rows, labels[rows] - 1] = weights[rows]
        return result

    def add_stage(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        label_map: LabelMap,
        rasterizer: Rasterizer,
    ) -> Stage[None]:
        """Add the votes of all ``cameras``; pixels of label 0 do not vote."""
        for i, camera in enumerate(cameras):
            yield Progress("Label Gaussians", i, len(cameras), f"vote, {camera.name}")
            columns = _columns(label_map(camera), self.n_groups)
            if columns is not None:
                rasterizer.vote(gaussians, camera, columns, self.sums)

    def votes(self, without: IntArray | None = None) -> Votes:
        """The outcome so far, ``without`` one label (N,) of each Gaussian: it cannot win, but its
        weight counts. Of equal weights the lower label."""
        if isinstance(self.sums, VoteSlots):
            column, best, total = self.sums.winners(None if without is None else without - 1)
            labels = column + np.int32(1)
        else:
            labels, best, total = _winners(self.sums, without)
        with np.errstate(invalid="ignore", divide="ignore"):
            confidence = np.where(total > 0, best / total, 0).astype(np.float32)
        return Votes(labels, np.minimum(confidence, 1), total)


def vote_labels(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    n_groups: int,
    rasterizer: Rasterizer,
    *,
    histogram_bytes: int = HISTOGRAM_BYTES,
) -> Stage[Votes]:
    """Vote over all ``cameras``; pixels of label 0 do not vote. Of equal weights the lower label.

    ``histogram_bytes`` as in `VoteSums.empty`.
    """
    sums = VoteSums.empty(len(gaussians), n_groups, histogram_bytes)
    yield from sums.add_stage(gaussians, cameras, label_map, rasterizer)
    return sums.votes()


def _columns(labels: IntArray, n_groups: int) -> IntArray | None:
    """Histogram column of each pixel, -1 = does not vote; None when no pixel does."""
    check_shape("labels", labels, ("H", "W"), np.int32)
    inside = (labels >= 1) & (labels <= n_groups)
    if not inside.any():
        return None
    return np.where(inside, labels - np.int32(1), np.int32(-1)).astype(np.int32)


def _winners(
    table: FloatArray, without: IntArray | None = None
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Label (N,) of the greatest sum of each row, 0 = none; that sum (N,); the sum of all (N,).
    ``without`` (N,) is a label of each row that cannot be the greatest, 0 = none."""
    n = len(table)
    labels, best, total = np.zeros(n, np.int32), np.zeros(n, np.float32), np.zeros(n, np.float32)
    for start in range(0, n if table.size else 0, _BLOCK):
        part = slice(start, start + _BLOCK)
        rows = table[part]
        total[part] = rows.sum(axis=1)
        if without is not None:
            rows, barred = rows.copy(), np.flatnonzero(without[part] > 0)
            rows[barred, without[part][barred] - 1] = 0
        column = rows.argmax(axis=1)
        best[part] = rows[np.arange(len(rows)), column]
        labels[part] = np.where(best[part] > 0, column + 1, 0)
    return labels, best, total


def splat_groups(
    rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera, labels: IntArray
) -> IntArray:
    """Group ids (H, W) of a view: the label of greatest summed blending weight at each pixel.

    Label 0 competes like a group, so unlabelled splats hide what is behind them. A pixel whose
    winner weighs less than `VOID_BELOW` shows background and is 0.
    """
    frame: LabelFrame = rasterizer.label_splat(gaussians, camera, labels)
    return np.where(frame.confidence < VOID_BELOW, np.int32(0), frame.labels)
