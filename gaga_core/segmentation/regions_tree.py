"""The tree of the weights-free regions: superpixels merged pair by pair, and where to stop."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.segmentation import regions_merge_kernels as kernels
from gaga_core.segmentation import regions_tree_kernels

_LAB = np.array([0.62, 1.9, 1.9], np.float32)  # lightness changes with shading, hue less
_BINS = 6  # of lightness; two more for each of a and b
# How much a merge's shape favours it (fitted to photos of objects on a table and to drawn scenes):
# start, log share of the smaller and of the larger, how much better than the smaller the union
# fills its box, how well it does, log of its raggedness, share of the smaller's and of the larger's
# border that vanishes. With depth the creases suffice: cost alone decides.
_COLOR_GRANTS = np.array([0.73, 0.166, -0.25, 1.46, -1.31, 0.327, 0.7, 0.74])
_SHAPE_GRANTS = np.array([np.log(4.2), 0, 0, 0, 0, 0, 0, 0])


def merged(
    lab: FloatArray,
    pieces: IntArray,
    n: int,
    cues: FloatArray,
    weights: DoubleArray,
    details: Sequence[float],
) -> list[IntArray]:
    """Regions (H, W) of the ``n`` superpixels ``pieces`` (H, W) at each of ``details``.

    Ids >= 0, not dense. ``lab`` (H, W, 3) float32, ``cues`` (1 or 2, H, W) float32: contour and
    crease at each pixel, ``weights`` (6,) of the cost, in the order of `regions_merge_kernels`.
    Those of a higher detail lie within those of a lower one.
    """
    flat = pieces.ravel()
    area = np.bincount(flat, minlength=n).astype(np.float32)
    sums = [np.bincount(flat, lab[..., c].ravel(), n) * _LAB[c] for c in range(3)]
    color = np.column_stack(sums).astype(np.float32)
    bins, n_bins = _color_bins(lab)
    histogram = np.zeros((n, n_bins), np.float32)
    kernels.add_histograms(pieces, bins, histogram)
    length, strength = np.zeros((n, n), np.float32), np.zeros((len(cues), n, n), np.float32)
    kernels.add_borders(pieces, cues, length, strength)
    at_first, border = area.copy(), length.sum(axis=1)
    joined, costs = np.empty((n - 1, 2), np.int32), np.empty(n - 1, np.float32)
    common = np.empty(n - 1, np.float32)
    made = kernels.merge_all(
        area, color, histogram, length, strength, weights, joined, costs, common
    )
    grants = _COLOR_GRANTS if len(cues) == 1 else _SHAPE_GRANTS
    found = []
    for detail in details:
        parent = np.arange(n, dtype=np.int32)
        regions_tree_kernels.cut(
            joined[:made],
            costs,
            common,
            at_first.copy(),
            border.copy(),
            _edges(pieces, n),
            _boxes(pieces, n),
            grants,
            -np.log(detail),
            parent,
        )
        while not np.array_equal(parent, parent[parent]):
            parent = parent[parent]
        found.append(parent[pieces])
    return found


def _edges(pieces: IntArray, n: int) -> FloatArray:
    """Pixels of each piece along the edge of the picture, (n,); corners count twice."""
    sides = (pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1])
    return np.bincount(np.concatenate(sides), minlength=n).astype(np.float32)


def _boxes(pieces: IntArray, n: int) -> IntArray:
    """First and last column, first and last row of each piece, (n, 4)."""
    from scipy import ndimage

    found = ndimage.find_objects(pieces + 1, max_label=n)
    spans = [(x.start, x.stop - 1, y.start, y.stop - 1) for y, x in found]
    return np.array(spans, np.int32)


def _color_bins(lab: FloatArray) -> tuple[IntArray, int]:
    """Bin of each pixel among those that occur, and their number."""
    n = _BINS + 2
    lightness = np.clip(lab[..., 0] / 100 * _BINS, 0, _BINS - 1).astype(np.int64)
    a = np.clip((lab[..., 1] + 60) / 120 * n, 0, n - 1).astype(np.int64)
    b = np.clip((lab[..., 2] + 60) / 120 * n, 0, n - 1).astype(np.int64)
    used, bins = np.unique((lightness * n + a) * n + b, return_inverse=True)
    return bins.reshape(lab.shape[:2]).astype(np.int32), len(used)
