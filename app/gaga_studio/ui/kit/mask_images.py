"""Photos and masks as pictures: what the film strip and the memory bank show.

The functions here only read files and mix colors; they run in the image store's thread.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray, UInt8Array
from gaga_core.color import group_palette
from gaga_core.io.images import read_rgb
from gaga_core.masks import Loader, resize_labels

THUMBNAIL = 256  # longest side in pixels
LARGE = 640

Colors = Mapping[int, tuple[float, float, float]]

_EDGE = np.array([255, 255, 255], np.uint8)
_REST = 0.35  # brightness of the masks that are not meant
_TINT = 0.55  # share of the group's color over the photo


def photo(path: Path, side: int) -> UInt8Array:
    """The photo (H, W, 3), shrunk to ``side``."""
    return read_rgb(path, side)


def photo_with_masks(
    path: Path, load: Loader, groups: IntArray | None, side: int, own: Colors
) -> UInt8Array:
    """The photo with each mask tinted: in its group's color when ``groups`` knows it by mask id."""
    picture = photo(path, side)
    labels = _fitting(load, picture)
    color = _colors(labels, groups, own)
    tinted = picture * (1 - _TINT) + color * (255 * _TINT)
    mixed = np.where((labels > 0)[..., None], tinted, picture)
    return np.clip(mixed, 0, 255).astype(np.uint8)


def photo_with_outline(path: Path, load: Loader, mask_id: int, side: int) -> UInt8Array:
    """The photo, darker around one mask, with that mask's outline."""
    picture = photo(path, side)
    inside = _fitting(load, picture) == mask_id
    shaded = np.where(inside[..., None], picture, (picture * 0.55).astype(np.uint8))
    shaded[_edge(inside)] = _EDGE
    return shaded


def masks_with_highlight(
    load: Loader, groups: IntArray | None, mask_id: int, side: int, own: Colors
) -> UInt8Array:
    """The label map of a view in group colors, one mask bright and the others dim."""
    labels = load()
    height, width = labels.shape
    scale = min(1.0, side / max(height, width))
    labels = resize_labels(labels, max(round(width * scale), 1), max(round(height * scale), 1))
    inside = labels == mask_id
    color = _colors(labels, groups, own) * 255
    mixed = np.where(inside[..., None], color, color * _REST)
    mixed[labels <= 0] = 26
    picture = mixed.astype(np.uint8)
    picture[_edge(inside)] = _EDGE
    return picture


def _fitting(load: Loader, picture: UInt8Array) -> IntArray:
    return resize_labels(load(), picture.shape[1], picture.shape[0])


def _colors(labels: IntArray, groups: IntArray | None, own: Colors) -> FloatArray:
    """Colors (H, W, 3), 0..1: by group where it is known, else by the mask's own id.

    ``own`` are colors that a person gave groups.
    """
    ids = np.maximum(labels, 0)
    if groups is not None and len(groups):
        ids = np.where(ids < len(groups), groups[np.minimum(ids, len(groups) - 1)], 0)
    palette = group_palette(int(ids.max(initial=0)))
    for group, rgb in own.items() if groups is not None else ():
        if group < len(palette):
            palette[group] = rgb
    result: FloatArray = palette[ids]
    return result


def _edge(inside: BoolArray) -> BoolArray:
    """The pixels (H, W) of a region that touch its outside."""
    core = inside.copy()
    core[1:] &= inside[:-1]
    core[:-1] &= inside[1:]
    core[:, 1:] &= inside[:, :-1]
    core[:, :-1] &= inside[:, 1:]
    return inside & ~core
