"""Training data of an identity field: rows of W and labels at sampled pixels of every view.

Pixels are stratified: the labelled pixels of a view, tile by tile, are cut into as many runs as
rows are wanted, and each run gives one at random. Rows are drawn once and kept: 16k pixels of a
view are enough for gradients that differ little from those of the whole view, and fit in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import AnyArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.linear import BYTES_PER_ENTRY, LinearRows, join_rows, take_rows
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import PixelWeights, Rasterizer

_TILE = 16
_HELD_OUT = 8  # one view in so many judges
_FEWEST = 256  # rows of a view, however little memory there is


@dataclass(frozen=True)
class RowConfig:
    """Which rows of W are kept."""

    per_view: int = 16384  # pixels of a view; 0 = all
    w_min: float = 1 / 255  # smaller weights are left out: 2 % of the sum, half of the memory
    train_void: bool = False  # pixels without a mask are trained as class 0; else left out
    memory_bytes: int = 1 << 30  # for all rows together; fewer rows are drawn to stay under it
    seed: int = 0

    def __post_init__(self) -> None:
        if self.per_view < 0 or not 0 <= self.w_min < 1 or self.memory_bytes < 1:
            raise ValueError("per_view, w_min, memory_bytes: must not be negative")


@dataclass(frozen=True, eq=False)
class ViewRows:
    """Sampled pixels of a view, in random order."""

    view: str
    weights: PixelWeights
    labels: IntArray  # (P,)


@dataclass(frozen=True, eq=False)
class Batch:
    """Rows of one training step."""

    rows: LinearRows
    labels: IntArray  # (P,)


def sample_rows(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    rasterizer: Rasterizer,
    config: RowConfig,
) -> Stage[list[ViewRows]]:
    """Rows of every view that has labelled pixels, drawn once; deterministic.

    The progress after a view carries its `ViewRows`. Raises ``GagaError`` when nothing is labelled.
    """
    views: list[ViewRows] = []
    wanted = config.per_view
    for i, camera in enumerate(cameras):
        labels = label_map(camera).ravel()
        pixels = _draw(labels, camera, wanted, np.random.default_rng([config.seed, i]), config)
        rows = None
        if len(pixels):
            weights = rasterizer.weights(gaussians, camera, pixels, w_min=config.w_min)
            rows = ViewRows(camera.name, weights, labels[pixels])
        if rows is not None and not views:
            wanted = _affordable(rows, len(cameras), config)
            kept = min(wanted or len(pixels), len(pixels))
            rows = ViewRows(camera.name, take_rows(rows.weights, 0, kept), rows.labels[:kept])
        if rows is not None:
            views.append(rows)
        yield Progress("Sample pixels", i + 1, len(cameras), camera.name, rows)
    if not views:
        raise GagaError("No pixel of the training views has a group. Associate the masks again.")
    return views


def view_batches(views: list[ViewRows], n_gaussians: int) -> list[Batch]:
    """A batch of each view, as the paper trains. Empties ``views`` to save memory."""
    batches = []
    while views:
        view = views.pop(0)
        batches.append(Batch(LinearRows.of(view.weights, n_gaussians), view.labels))
    return batches


def mixed_batches(views: Sequence[ViewRows], n_gaussians: int) -> list[Batch]:
    """As many batches as views, each with its share of the rows of all views.

    A step on such a batch is a step on all views: a few of them suffice.
    """
    n = len(views)
    batches = []
    for b in range(n):
        parts, labels = [], []
        for view in views:
            start, stop = (len(view.labels) * i // n for i in (b, b + 1))
            parts.append(take_rows(view.weights, start, stop))
            labels.append(view.labels[start:stop])
        batches.append(Batch(LinearRows.of(join_rows(parts), n_gaussians), np.concatenate(labels)))
    return batches


def held_out(n_views: int) -> list[int]:
    """Places of the views that are not trained on but judge: one in eight, the same ones always."""
    return list(range(n_views // 2 % _HELD_OUT, n_views, _HELD_OUT))


def _draw(
    labels: IntArray,  # (H * W,)
    camera: Camera,
    wanted: int,
    rng: np.random.Generator,
    config: RowConfig,
) -> LongArray:
    """Flat indices of sampled pixels in random order; all of them when ``wanted`` is 0."""
    order = _by_tile(camera.width, camera.height)
    if not config.train_void:
        order = order[labels[order] > 0]
    if 0 < wanted < len(order):
        edges = np.linspace(0, len(order), wanted + 1)
        order = order[(edges[:-1] + rng.random(wanted) * np.diff(edges)).astype(np.int64)]
    return rng.permutation(order)


def _by_tile(width: int, height: int) -> LongArray:
    """All pixels, tile after tile: neighbours in this order are neighbours in the picture."""
    pixels = np.arange(width * height, dtype=np.int64)
    rows, columns = np.divmod(pixels, width)
    tile: AnyArray = rows // _TILE * (-(-width // _TILE)) + columns // _TILE
    return np.argsort(tile, kind="stable")


def _affordable(first: ViewRows, n_views: int, config: RowConfig) -> int:
    """Rows of a view so that all views fit in memory, judged by the first; 0 = all pixels."""
    per_row = BYTES_PER_ENTRY * len(first.weights.indices) / len(first.labels) + 16
    fits = int(config.memory_bytes / (n_views * per_row))
    if fits >= len(first.labels):
        return config.per_view
    return max(fits, _FEWEST)
