"""Training data of an identity field: rows of W and labels at sampled pixels of every view.

All pixels of a view (`whole_views`) are what the paper trains on. A sample (`sample_rows`) is some
thirty times faster: the labelled pixels of a view, tile by tile, are cut into as many runs as rows
are wanted, and each run gives one at random. Rows are drawn once and kept: 16k pixels of a view are
enough for gradients that differ little from those of the whole view, and fit in memory.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.linear_kernels import D, gather, transpose
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import PixelWeights, Rasterizer
from gaga_core.threads import run_chunks

# --- Rendering of features as a linear operator: F = W E, with the rows of W cached.
# With the geometry frozen a feature map is linear in the encodings, so a training step needs no
# rasterizer. Both W E and W^T dF are gathers: the entries are kept by pixel and by Gaussian.


STAGE = "Sample pixels"  # of progress
BYTES_PER_ENTRY = 16  # index and weight, in both orders
_CHUNK = 2048  # lists of one piece of work


@dataclass(frozen=True, eq=False)
class LinearRows:
    """P rows of the blending matrix W (pixels x Gaussians), by pixel and by Gaussian."""

    n_gaussians: int
    by_pixel: PixelWeights
    touched: IntArray  # (T,) Gaussians with an entry, ascending
    starts: LongArray  # (T + 1,) where each one's list begins
    rows: IntArray  # (nnz,) row of W
    row_weights: FloatArray  # (nnz,)

    def __len__(self) -> int:
        return len(self.by_pixel.indptr) - 1

    @staticmethod
    def of(weights: PixelWeights, n_gaussians: int) -> "LinearRows":
        """The operator of sampled rows (`Rasterizer.weights`) of a scene of ``n_gaussians``."""
        counts = np.bincount(weights.indices, minlength=n_gaussians)
        ends = np.cumsum(counts)
        rows = np.empty(len(weights.indices), np.int32)
        row_weights = np.empty(len(weights.indices), np.float32)
        entries = weights.indptr, weights.indices, weights.weights
        transpose(*entries, ends - counts, rows, row_weights)
        touched = np.flatnonzero(counts).astype(np.int32)
        starts = np.append(0, ends[touched]).astype(np.int64)
        return LinearRows(n_gaussians, weights, touched, starts, rows, row_weights)

    def multiply(self, encodings: FloatArray) -> FloatArray:
        """Features F = W E (P, D) of ``encodings`` (N, D) float32; no background is added."""
        check_shape("encodings", encodings, (self.n_gaussians, D), np.float32)
        out = np.empty((len(self), D), np.float32)
        targets = np.arange(len(self), dtype=np.int32)
        entries = self.by_pixel.indptr, self.by_pixel.indices, self.by_pixel.weights

        def work(start: int, stop: int) -> None:
            gather(*entries, encodings, targets, out, start, stop)

        run_chunks(work, len(self), _CHUNK)
        return out

    def multiply_transposed(
        self, gradients: FloatArray, out: FloatArray | None = None
    ) -> FloatArray:
        """W^T dF (N, D) of ``gradients`` (P, D); rows of Gaussians without an entry are 0.

        With ``out``, only the rows of the Gaussians that have entries are written.
        """
        check_shape("gradients", gradients, (len(self), D), np.float32)
        result = np.zeros((self.n_gaussians, D), np.float32) if out is None else out

        entries = self.starts, self.rows, self.row_weights

        def work(start: int, stop: int) -> None:
            gather(*entries, gradients, self.touched, result, start, stop)

        run_chunks(work, len(self.touched), _CHUNK)
        return result


def take_rows(weights: PixelWeights, start: int, stop: int) -> PixelWeights:
    """Rows ``start`` to ``stop`` as views on the same memory."""
    first, last = weights.indptr[start], weights.indptr[stop]
    indptr = weights.indptr[start : stop + 1] - first
    return PixelWeights(indptr, weights.indices[first:last], weights.weights[first:last])


def join_rows(parts: Sequence[PixelWeights]) -> PixelWeights:
    """Rows of several `PixelWeights`, one after the other."""
    lengths = np.concatenate([np.diff(part.indptr) for part in parts])
    return PixelWeights(
        np.append(0, np.cumsum(lengths)).astype(np.int64),
        np.concatenate([part.indices for part in parts]),
        np.concatenate([part.weights for part in parts]),
    )


_TILE = 16
_HELD_OUT = 8  # one view in so many judges
_FEWEST = 256  # rows of a view, however little memory there is


@dataclass(frozen=True)
class RowConfig:
    """Which rows of W are kept."""

    per_view: int = 16384  # pixels of a view; 0 = all, and `memory_bytes` only limits what is kept
    w_min: float = 1 / 255  # smaller weights are left out: 2 % of the sum, half of the memory
    train_void: bool = False  # pixels without a mask are trained as class 0; else left out
    memory_bytes: int = 1 << 30  # for all rows together; fewer rows are drawn to stay under it
    seed: int = 0

    def __post_init__(self) -> None:
        if self.per_view < 0 or not 0 <= self.w_min < 1 or self.memory_bytes < 1:
            raise ValueError("per_view, w_min, memory_bytes: must not be negative")


@dataclass(frozen=True, eq=False)
class ViewRows:
    """Sampled pixels of a view."""

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
    *,
    shuffles: bool = True,
) -> Stage[list[ViewRows]]:
    """Rows of every view that has labelled pixels, drawn once; deterministic.

    They are in random order, or tile by tile: neighbours then share Gaussians, which the processor
    still has in its caches. The progress after a view carries its `ViewRows`. Raises ``GagaError``
    when nothing is labelled.
    """
    views: list[ViewRows] = []
    wanted = config.per_view
    for i, camera in enumerate(cameras):
        labels = label_map(camera).ravel()
        rng = np.random.default_rng([config.seed, i])
        pixels, rows = _draw(labels, camera, wanted, rng, config), None
        if shuffles:
            pixels = rng.permutation(pixels)
        if len(pixels):
            weights = rasterizer.weights(gaussians, camera, pixels, w_min=config.w_min)
            rows = ViewRows(camera.name, weights, labels[pixels])
        if rows is not None and not views:
            wanted = _affordable(rows, len(cameras), config)
            if 0 < wanted < len(pixels):
                pixels = pixels[np.linspace(0, len(pixels), wanted, False).astype(np.int64)]
                weights = rasterizer.weights(gaussians, camera, pixels, w_min=config.w_min)
                rows = ViewRows(camera.name, weights, labels[pixels])
        if rows is not None:
            views.append(rows)
        yield Progress(STAGE, i + 1, len(cameras), camera.name, rows)
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


@dataclass(frozen=True, eq=False)
class WholeViews(Sequence[Batch]):
    """A batch of each view with all of its pixels. As many as fit into memory are kept; the others
    are made at every use, which costs a pass over the view."""

    gaussians: Gaussians
    cameras: Sequence[Camera]
    labels: Sequence[AnyArray]  # (H * W,) of each view, unsigned
    rasterizer: Rasterizer
    config: RowConfig
    digest: str  # of all that the batches are made of
    kept: dict[int, Batch]

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def n_rows(self) -> int:
        """Pixels of all views together."""
        return sum(len(self._pixels(i)) for i in range(len(self)))

    @overload
    def __getitem__(self, at: int) -> Batch: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Batch]: ...
    def __getitem__(self, at: int | slice) -> Batch | Sequence[Batch]:
        if isinstance(at, slice):
            return [self[i] for i in range(len(self))[at]]
        i = range(len(self))[at]
        if i in self.kept:
            return self.kept[i]
        rows = self.rows(i)
        batch = Batch(LinearRows.of(rows.weights, len(self.gaussians)), rows.labels)
        held = sum(len(other.rows.rows) for other in self.kept.values())
        if BYTES_PER_ENTRY * (held + len(batch.rows.rows)) <= self.config.memory_bytes:
            self.kept[i] = batch
        return batch

    def rows(self, i: int) -> ViewRows:
        """All rows of a view."""
        pixels, camera = self._pixels(i), self.cameras[i]
        weights = self.rasterizer.weights(self.gaussians, camera, pixels, w_min=self.config.w_min)
        return ViewRows(camera.name, weights, self.labels[i][pixels].astype(np.int32))

    def _pixels(self, i: int) -> LongArray:
        labels = self.labels[i]
        return np.arange(len(labels)) if self.config.train_void else np.flatnonzero(labels)


def whole_views(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    rasterizer: Rasterizer,
    config: RowConfig,
) -> Stage[WholeViews]:
    """All pixels of every view that has labelled ones (``config.train_void``: of every view).

    The progress after the first such view carries its `ViewRows`. Raises ``GagaError`` when nothing
    is labelled.
    """
    stamp = hashlib.sha256()
    for array in (
        *(gaussians.means, gaussians.log_scales, gaussians.quats, gaussians.logit_opacities),
        *(camera.cam_from_world for camera in cameras),
        *(camera.K for camera in cameras),
    ):
        stamp.update(np.ascontiguousarray(array).data)
    chosen, maps, first = list[Camera](), list[AnyArray](), None
    for i, camera in enumerate(cameras):
        labels = label_map(camera).ravel()
        stamp.update(np.ascontiguousarray(labels).data)
        if config.train_void or labels.any():
            chosen.append(camera)
            maps.append(labels.astype(np.min_scalar_type(int(labels.max(initial=0)))))
        rows = None
        if len(chosen) == 1 and first is None:
            alone = WholeViews(gaussians, chosen, maps, rasterizer, config, "", {})
            first = rows = alone.rows(0)
        yield Progress(STAGE, i + 1, len(cameras), camera.name, rows)
    if not any(labels.any() for labels in maps):
        raise GagaError("No pixel of the training views has a group. Associate the masks again.")
    return WholeViews(gaussians, chosen, maps, rasterizer, config, stamp.hexdigest(), {})


def joined_batch(views: list[ViewRows], n_gaussians: int) -> Batch:
    """One batch of all rows of some views. Empties ``views`` to save memory."""
    weights = join_rows([view.weights for view in views])
    labels = np.concatenate([view.labels for view in views])
    views.clear()
    return Batch(LinearRows.of(weights, n_gaussians), labels)


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
    """Flat indices of sampled pixels, tile by tile; all of them when ``wanted`` is 0."""
    order = _by_tile(camera.width, camera.height)
    if not config.train_void:
        order = order[labels[order] > 0]
    if 0 < wanted < len(order):
        edges = np.linspace(0, len(order), wanted + 1)
        order = order[(edges[:-1] + rng.random(wanted) * np.diff(edges)).astype(np.int64)]
    return order


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
