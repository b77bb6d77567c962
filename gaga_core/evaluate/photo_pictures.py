"""Pictures of what is true of a photo: its true map in colors, and where groups are wrong."""

from pathlib import Path

import numpy as np

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.color import group_palette
from gaga_core.errors import GagaError
from gaga_core.io.masks import label_files_of, read_labels
from gaga_core.masks import resize_labels

TRUTH = Path("gt") / "instance"  # where a scene folder has its true maps
# Right, wrong and missing pixels: told apart by color-blind eyes, too.
_VERDICTS = np.array([[0, 0, 0], [70, 130, 180], [214, 50, 40], [250, 190, 50]], np.float32)
_SHARES = np.array([0.0, 0.35, 0.85, 0.85], np.float32)  # of those colors over the gray photo
_GRAY = 0.6  # brightness of the photo under them


def true_labels(folder: Path, name: str, side: int) -> IntArray:
    """The true map (H, W) int32 of the view ``name``, no side longer than ``side`` pixels.

    ``GagaError`` when ``folder`` has none.
    """
    path = label_files_of(folder, [name]).get(name) if folder.is_dir() else None
    if path is None:
        raise GagaError(f"There is no true map of {name} in {folder}.")
    labels = read_labels(path)
    height, width = labels.shape
    scale = min(1.0, side / max(height, width))
    return resize_labels(labels, max(round(width * scale), 1), max(round(height * scale), 1))


def truth_picture(folder: Path, name: str, side: int) -> UInt8Array:
    """The true map (H, W, 3) of a view in colors; black where nothing is. See `true_labels`."""
    labels = true_labels(folder, name, side)
    colors = group_palette(int(labels.max(initial=0)))
    colors[0] = 0
    picture: UInt8Array = (colors[labels] * 255).astype(np.uint8)
    return picture


def error_picture(photo: UInt8Array, groups: IntArray, truth: IntArray) -> tuple[UInt8Array, float]:
    """The photo (H, W, 3) in gray with right, wrong and missing pixels colored, and the share that
    is right. ``groups`` and ``truth`` are ids (H, W), 0 = none; see `error_map`."""
    from gaga_core.evaluate.error_map import error_map

    found = error_map(groups, truth)
    gray = photo.mean(axis=2, keepdims=True) * _GRAY
    share = _SHARES[found.verdicts][..., None]
    picture = gray * (1 - share) + _VERDICTS[found.verdicts] * share
    return np.clip(picture, 0, 255).astype(np.uint8), found.share_right
