"""Shapes drawn on the picture as masks of pixels (H, W) bool.

A pixel belongs to a shape when its centre (x + 0.5, y + 0.5) lies in it.
"""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import BoolArray

ScreenPoint = tuple[float, float]


def rectangle(corners: tuple[float, float, float, float], width: int, height: int) -> BoolArray:
    """The rectangle (u0, v0, u1, v1), pixels, any corner order: every pixel that it touches."""
    u0, v0, u1, v1 = corners
    left, right = sorted((u0, u1))
    top, bottom = sorted((v0, v1))
    mask = np.zeros((height, width), np.bool_)
    rows = slice(max(int(np.floor(top)), 0), max(int(np.ceil(bottom)), 0))
    mask[rows, max(int(np.floor(left)), 0) : max(int(np.ceil(right)), 0)] = True
    return mask


def polygon(points: Sequence[ScreenPoint], width: int, height: int) -> BoolArray:
    """The inside of a closed outline, a lasso's or a polygon's; empty under three points."""
    mask = np.zeros((height, width), np.bool_)
    if len(points) < 3:
        return mask
    # Imported when first needed: it takes a large part of a second.
    from skimage.draw import polygon as pixels_inside

    outline = np.asarray(points, np.float64) - 0.5
    shape = (height, width)
    rows, columns = pixels_inside(outline[:, 1], outline[:, 0], shape)  # type: ignore[no-untyped-call]
    mask[rows, columns] = True
    return mask


def stroke(mask: BoolArray, start: ScreenPoint, stop: ScreenPoint, radius: float) -> None:
    """Paint a round brush of ``radius`` pixels from ``start`` to ``stop`` into ``mask`` (H, W).

    A brush that is moved in many small steps paints the union of its steps.
    """
    height, width = mask.shape
    a, b = np.asarray(start, np.float64), np.asarray(stop, np.float64)
    lo = np.floor(np.minimum(a, b) - radius).astype(int)
    hi = np.ceil(np.maximum(a, b) + radius).astype(int) + 1
    left, top = max(lo[0], 0), max(lo[1], 0)
    right, bottom = min(hi[0], width), min(hi[1], height)
    if left >= right or top >= bottom:
        return
    u = np.arange(left, right) + 0.5 - a[0]
    v = (np.arange(top, bottom) + 0.5 - a[1])[:, None]
    along = b - a
    length2 = float(along @ along)
    share = np.clip((u * along[0] + v * along[1]) / length2, 0, 1) if length2 > 0 else 0.0
    near = (u - share * along[0]) ** 2 + (v - share * along[1]) ** 2 <= radius * radius
    mask[top:bottom, left:right] |= near
