"""2D masks of the views: one label map each, loaded when asked for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gaga_core.arrays import IntArray, check_shape
from gaga_core.errors import GagaError

Loader = Callable[[], IntArray]


@dataclass(frozen=True)
class MaskSet:
    """Label maps by view name (the photo's file name): (H, W) int32, 0 = none.

    Ids of different views do not agree: they come from a 2D segmenter that sees one view at a time
    (section 3.2 of the paper starts here). Views without an entry have no masks.
    """

    loaders: Mapping[str, Loader] = field(default_factory=dict)
    source: str = ""  # where they come from, for messages
    are_regions: bool = False  # made without a model: pieces of objects (`segmentation.regions`)
    # Label maps of the same views at other levels of detail, of any size, where there are some.
    further: Mapping[str, Callable[[], Sequence[IntArray]]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.loaders)

    def __contains__(self, name: object) -> bool:
        return name in self.loaders

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the views that have masks, sorted."""
        return tuple(sorted(self.loaders))

    def load(self, name: str, width: int, height: int) -> IntArray:
        """Label map of a view at ``height`` x ``width``; nearest neighbour when sizes differ."""
        labels = self.loaders[name]()
        check_shape(f"mask {name}", labels, ("H", "W"), np.int32)
        if labels.size == 0:
            raise GagaError(f"The mask of {name} is empty. Make the masks again.")
        return resize_labels(labels, width, height)


def resize_labels(labels: IntArray, width: int, height: int) -> IntArray:
    """Nearest-neighbour resize of a label map (H, W), sampled at pixel centres."""
    if labels.shape == (height, width):
        return labels
    rows = ((np.arange(height) + 0.5) * labels.shape[0] / height).astype(np.int64)
    columns = ((np.arange(width) + 0.5) * labels.shape[1] / width).astype(np.int64)
    return np.ascontiguousarray(labels[rows[:, None], columns[None, :]])


def dense_labels(labels: IntArray) -> tuple[IntArray, IntArray]:
    """Relabel a map to 1..M in increasing order of its ids; 0 stays 0.

    Returns the dense map (H, W) and the original id of each dense one, (M + 1,), entry 0 being 0.
    """
    originals = np.unique(labels)
    originals = originals[originals > 0]
    lookup = np.concatenate([np.zeros(1, np.int64), originals])
    dense = np.searchsorted(lookup, np.maximum(labels, 0)).astype(np.int32)
    return dense, lookup.astype(np.int32)
