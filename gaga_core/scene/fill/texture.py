"""Continue a texture into a hole by copies of small pieces of what is around it.

Exemplar-based inpainting (Criminisi, Perez & Toyama 2004): pieces on the rim of the hole are filled
first where most around them is known, each with the piece of the known part that fits best there.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray

_HALF = 4  # cells from the middle of a piece to its side
_MOST_PIECES = 6000  # known pieces that are compared


def synthesized(texture: DoubleArray, known: BoolArray, hole: BoolArray) -> DoubleArray:
    """``texture`` (H, W, C) with the cells of ``hole`` (H, W) filled; zero where nothing fits."""
    side = 2 * _HALF + 1
    if min(known.shape) < side:
        return texture
    whole = sliding_window_view(known & ~hole, (side, side)).all(axis=(2, 3))
    places = np.argwhere(whole)
    if len(places) == 0:
        return texture
    places = places[:: max(1, len(places) // _MOST_PIECES)]
    windows = sliding_window_view(texture, (side, side), axis=(0, 1))  # (h, w, C, side, side)
    pieces = windows[places[:, 0], places[:, 1]].transpose(0, 2, 3, 1).reshape(len(places), -1)
    squares = pieces**2
    result, filled, left = texture.copy(), known & ~hole, hole.copy()
    result[~filled] = 0
    share = ndimage.uniform_filter(filled.astype(float), side)
    while left.any():
        rim = left & ndimage.binary_dilation(filled)
        if not rim.any():
            break
        at = np.argmax(np.where(rim, share, -1))
        row, column = np.unravel_index(at, left.shape)
        top = int(np.clip(row - _HALF, 0, left.shape[0] - side))
        start = int(np.clip(column - _HALF, 0, left.shape[1] - side))
        window = (slice(top, top + side), slice(start, start + side))
        mask = filled[window]
        weights = np.repeat(mask.ravel(), texture.shape[2]).astype(float)
        target = result[window].ravel() * weights
        cost = squares @ weights - 2 * (pieces @ target)
        best = pieces[np.argmin(cost)].reshape(side, side, -1)
        fresh = left[window]
        result[window][fresh] = best[fresh]
        filled[window] |= fresh
        left[window] = False
        around = (
            slice(max(0, top - side), top + 2 * side),
            slice(max(0, start - side), start + 2 * side),
        )
        share[around] = ndimage.uniform_filter(filled[around].astype(float), side)
    return result
