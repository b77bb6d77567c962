"""Pictures of a group: in which views it shows best, cut out square, its surroundings dimmed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray, FloatArray, IntArray, UInt8Array

MARGIN = 0.10  # of the box on each side
KEEP = 0.30  # of the surroundings; the rest is grey
_CUT = 0.35  # what a view is worth in which the group is cut by the picture's border
_MIN_SIDE = 8  # pixels; a group that is smaller in a view is not looked at
_GREY = 128


@dataclass(frozen=True)
class Shown:
    """A group in one view."""

    group: int
    view: int
    box: tuple[int, int, int, int]  # left, top, right, bottom, pixels
    score: float  # pixels, less when the border cuts the group


def shown_groups(view: int, labels: IntArray) -> tuple[Shown, ...]:
    """Where each group shows in a label map (H, W); 0 is none."""
    from scipy.ndimage import find_objects

    height, width = labels.shape
    ids, dense = np.unique(labels, return_inverse=True)
    area = np.bincount(dense.ravel(), minlength=len(ids))
    places = find_objects(dense.reshape(labels.shape) + 1)
    found = []
    for group, n, place in zip(ids, area, places, strict=True):
        if group <= 0 or place is None:
            continue
        rows, columns = place
        if min(rows.stop - rows.start, columns.stop - columns.start) < _MIN_SIDE:
            continue
        cut = rows.start == 0 or columns.start == 0 or rows.stop == height or columns.stop == width
        box = (columns.start, rows.start, columns.stop, rows.stop)
        found.append(Shown(int(group), view, box, float(n) * (_CUT if cut else 1.0)))
    return tuple(found)


def best_views(shown: Sequence[Shown], n_best: int) -> Mapping[int, tuple[Shown, ...]]:
    """Of every group the ``n_best`` views that show most of it, the best first."""
    by_group: dict[int, list[Shown]] = {}
    for one in shown:
        by_group.setdefault(one.group, []).append(one)
    order = {g: sorted(all_, key=lambda s: (-s.score, s.view)) for g, all_ in by_group.items()}
    return {group: tuple(found[:n_best]) for group, found in sorted(order.items())}


def cut_out(
    picture: UInt8Array, labels: IntArray, one: Shown, side: int
) -> tuple[UInt8Array, UInt8Array]:
    """A group cut out of a picture (H, W, 3): as it is, and with its surroundings dimmed.

    Both (side, side, 3): the box with `MARGIN` around it, made square with grey.
    """
    height, width = labels.shape
    left, top, right, bottom = one.box
    dx, dy = round(MARGIN * (right - left)), round(MARGIN * (bottom - top))
    left, top = max(0, left - dx), max(0, top - dy)
    right, bottom = min(width, right + dx), min(height, bottom + dy)
    cut = picture[top:bottom, left:right]
    own = labels[top:bottom, left:right] == one.group
    return _square(cut, side), _square(_dimmed(cut, own), side)


def _dimmed(picture: UInt8Array, own: BoolArray) -> UInt8Array:
    grey: FloatArray = KEEP * picture.astype(np.float32) + (1 - KEEP) * np.float32(_GREY)
    return np.where(own[:, :, None], picture, np.rint(grey).astype(np.uint8))


def _square(picture: UInt8Array, side: int) -> UInt8Array:
    height, width = picture.shape[:2]
    n = max(height, width)
    board = np.full((n, n, 3), _GREY, np.uint8)
    y, x = (n - height) // 2, (n - width) // 2
    board[y : y + height, x : x + width] = picture
    return np.asarray(Image.fromarray(board).resize((side, side), Image.Resampling.BICUBIC))
