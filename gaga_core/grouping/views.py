"""The views that take part in an association, and their label maps."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import IntArray, check_shape
from gaga_core.camera import Camera, natural_order
from gaga_core.errors import GagaError
from gaga_core.grouping.gate import ViewMasks
from gaga_core.masks import MaskSet, resize_labels


def views_with_masks(cameras: Sequence[Camera], masks: MaskSet) -> tuple[Camera, ...]:
    """The cameras that have masks, in `camera.natural_order` of their names.

    Raises ``GagaError`` if there are none.
    """
    where = f" in {masks.source}" if masks.source else ""
    if len(masks) == 0:
        raise GagaError(f"There are no masks{where}. Make masks, or choose another mask folder.")
    views = [camera for camera in cameras if camera.name in masks]
    if not views:
        raise GagaError(
            f"None of the {len(cameras)} views has masks{where}. "
            "Name each mask file like its photo, or choose another mask folder."
        )
    return tuple(sorted(views, key=lambda camera: natural_order(camera.name)))


def load_further(masks: MaskSet, camera: Camera) -> list[IntArray]:
    """Label maps of a view at other levels of detail, dense, at the camera's size."""
    maps = masks.further.get(camera.name, tuple)()
    fitting = (resize_labels(labels, camera.width, camera.height) for labels in maps)
    return [ViewMasks.of(labels).labels for labels in fitting if labels.size]


def has_further(masks: MaskSet, cameras: Sequence[Camera]) -> bool:
    """Whether a view has label maps at other levels of detail."""
    return any(len(masks.further.get(camera.name, tuple)()) > 0 for camera in cameras)


def load_labels(masks: MaskSet, camera: Camera) -> tuple[IntArray, bool]:
    """Label map of a view at the camera's size, and whether it had to be resized (nearest)."""
    labels = masks.loaders[camera.name]()
    check_shape(f"mask {camera.name}", labels, ("H", "W"), np.int32)
    if labels.size == 0:
        raise GagaError(f"The mask of {camera.name} is empty. Make the masks again.")
    fitting = resize_labels(labels, camera.width, camera.height)
    return fitting, labels.shape != fitting.shape
