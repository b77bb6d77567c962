"""Labels per Gaussian by vote over label maps of views.

With the geometry frozen, the label map rendered from per-Gaussian scores is linear in them, and the
score of Gaussian i for label k that fits the views best is the summed blending weight w_i over the
pixels of label k (FlashSplat, Shen et al., ECCV 2024). The label is the argmax.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import LabelFrame, Rasterizer

VOID_BELOW = 0.3  # summed weight under which a pixel shows no group
LabelMap = Callable[[Camera], IntArray]  # (H, W) at the camera's size; 0 = none


def _memory() -> int:
    """Bytes of this machine's memory; 4 GiB where the system does not say."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return 4 << 30


# A vote that fits goes over the views once: 3 million Gaussians and 300 groups take 3.6 GB.
HISTOGRAM_BYTES = min(4 << 30, _memory() // 4)
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

    The histogram is (N, K) float32. When all groups at once would exceed ``histogram_bytes``, the
    groups are taken in blocks, each with its own pass over the views: slower, the same result.
    """
    n = len(gaussians)
    best = np.zeros(n, np.float32)
    total = np.zeros(n, np.float32)
    labels = np.zeros(n, np.int32)
    width = max(1, min(n_groups, histogram_bytes // max(4 * n, 1)))
    blocks = range(1, n_groups + 1, width)
    for block, first in enumerate(blocks):
        count = min(width, n_groups + 1 - first)
        histogram = np.zeros((n, count), np.float32)
        for i, camera in enumerate(cameras):
            message = f"vote, {camera.name}"
            done = block * len(cameras) + i
            yield Progress("Label Gaussians", done, len(blocks) * len(cameras), message)
            columns = _columns(label_map(camera), first, count)
            if columns is not None:
                rasterizer.vote(gaussians, camera, columns, histogram)
        _merge(histogram, first, best, total, labels)
    with np.errstate(invalid="ignore", divide="ignore"):
        confidence = np.where(total > 0, best / total, 0).astype(np.float32)
    return Votes(labels, np.minimum(confidence, 1), total)


def _columns(labels: IntArray, first: int, count: int) -> IntArray | None:
    """Histogram column of each pixel, -1 = does not vote; None when no pixel does."""
    check_shape("labels", labels, ("H", "W"), np.int32)
    inside = (labels >= first) & (labels < first + count)
    if not inside.any():
        return None
    return np.where(inside, labels - np.int32(first), np.int32(-1)).astype(np.int32)


def _merge(
    histogram: FloatArray,  # (N, K) of labels first, first + 1, ...
    first: int,
    best: FloatArray,  # (N,) changed in place, like the next two
    total: FloatArray,
    labels: IntArray,
) -> None:
    """Take one block of labels into the running argmax."""
    for start in range(0, len(histogram), _BLOCK):
        part = slice(start, start + _BLOCK)
        rows = histogram[part]
        column = rows.argmax(axis=1)
        weight = rows[np.arange(len(rows)), column]
        total[part] += rows.sum(axis=1)
        wins = weight > best[part]
        best[part][wins] = weight[wins]
        labels[part][wins] = column[wins].astype(np.int32) + first


def splat_groups(
    rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera, labels: IntArray
) -> IntArray:
    """Group ids (H, W) of a view: the label of greatest summed blending weight at each pixel.

    Label 0 competes like a group, so unlabelled splats hide what is behind them. A pixel whose
    winner weighs less than `VOID_BELOW` shows background and is 0.
    """
    frame: LabelFrame = rasterizer.label_splat(gaussians, camera, labels)
    return np.where(frame.confidence < VOID_BELOW, np.int32(0), frame.labels)
