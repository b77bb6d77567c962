"""Continue a texture into a hole by copies of small pieces of what is around it.

Exemplar-based inpainting (Criminisi, Perez & Toyama 2004): pieces on the rim of the hole are filled
first where most around them is known, each with the piece of the known part that fits best there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.scene.fill.smooth import smooth_base

_TRIAL = 0.28  # sizes of the hole: radius of one that is cut to compare styles
_N_TRIALS = 3
_USUAL = 0.9  # factor of the error of the first style: the other one must be clearly better
_MOST_PIECES = 6000  # known pieces that are compared


@dataclass(frozen=True)
class Style:
    """How a surface is continued: what is coarser than ``base`` smoothly, the rest by pieces."""

    base: float  # cells
    half: int  # cells from the middle of a piece to its side


STYLES = (Style(3.0, 4), Style(12.0, 7))  # noise and grain; stripes and checks


def continued_color(color: DoubleArray, known: BoolArray, hole: BoolArray) -> DoubleArray:
    """``color`` (H, W, C) with the ``hole`` (H, W) filled, in the style that does best elsewhere.

    Styles are compared on smaller holes that are cut into the known part.
    """
    trials = _trials(known, hole)
    errors = [
        sum(_error(style, color, known & ~trial, trial) for trial in trials) for style in STYLES
    ]
    errors[0] *= _USUAL
    return _in_style(STYLES[int(np.argmin(errors))], color, known, hole)


def _error(style: Style, color: DoubleArray, known: BoolArray, trial: BoolArray) -> float:
    wrong = _in_style(style, color, known, trial) - color
    return float((wrong[trial] ** 2).mean())


def _in_style(style: Style, color: DoubleArray, known: BoolArray, hole: BoolArray) -> DoubleArray:
    base = smooth_base(color, known, hole, style.base)
    detail = synthesized(color - base, known, hole, style.half)
    return np.where(hole[:, :, None], base + detail, color)


def _trials(known: BoolArray, hole: BoolArray) -> list[BoolArray]:
    """Discs (H, W) of known cells, far from each other, as large as fit, up to the hole's half."""
    radius = _TRIAL * np.sqrt(hole.sum())
    room = ndimage.distance_transform_edt(np.pad(known, 1))[1:-1, 1:-1]
    rows, columns = np.indices(known.shape)
    found: list[BoolArray] = []
    for _ in range(_N_TRIALS):
        row, column = np.unravel_index(np.argmax(np.minimum(room, radius)), known.shape)
        away = np.hypot(rows - row, columns - column)
        size = min(radius, 0.8 * float(room[row, column]))
        if size < 3:
            break
        found.append(known & (away < size))
        room = np.where(away < 2 * radius, 0.0, room)
    return found


def synthesized(texture: DoubleArray, known: BoolArray, hole: BoolArray, half: int) -> DoubleArray:
    """``texture`` (H, W, C) with the cells of ``hole`` (H, W) filled; zero where nothing fits.

    ``half``: cells from the middle of a copied piece to its side.
    """
    side = 2 * half + 1
    result, filled, left = texture.copy(), known & ~hole, hole.copy()
    result[~filled] = 0
    if min(known.shape) < side:
        return result
    whole = sliding_window_view(filled, (side, side)).all(axis=(2, 3))
    places = np.argwhere(whole)
    if len(places) == 0:
        return result
    places = places[:: max(1, len(places) // _MOST_PIECES)]
    windows = sliding_window_view(texture, (side, side), axis=(0, 1))  # (h, w, C, side, side)
    pieces = windows[places[:, 0], places[:, 1]].transpose(0, 2, 3, 1).reshape(len(places), -1)
    squares = pieces**2
    share = ndimage.uniform_filter(filled.astype(float), side)
    while left.any():
        rim = left & ndimage.binary_dilation(filled)
        if not rim.any():
            break
        at = np.argmax(np.where(rim, share, -1))
        row, column = np.unravel_index(at, left.shape)
        top = int(np.clip(row - half, 0, left.shape[0] - side))
        start = int(np.clip(column - half, 0, left.shape[1] - side))
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
