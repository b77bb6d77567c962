"""Votes: labels of pixels summed into the Gaussians that show there (W^T of one-hot labels)."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import n_threads, run_chunks
from gaga_core.raster.cpu import label_kernels as kernels
from gaga_core.raster.cpu.prepare import TILES_AT_ONCE, TiledView
from gaga_core.raster.cpu.project_kernels import TILE
from gaga_core.raster.vote_slots import VoteSlots

_BATCH = 1 << 23  # partial sums held at a time: 32 MiB


@dataclass(frozen=True, eq=False)
class _TileLabels:
    """The label map of a view, numbered again in each tile."""

    local: IntArray  # (n_tiles, TILE, TILE) position in `found`; -1 = ignore
    found: IntArray  # (n_tiles, TILE * TILE) label of each position
    n_found: LongArray  # (n_tiles,)


def add_votes(view: TiledView, labels: IntArray, histogram: FloatArray | VoteSlots) -> None:
    """histogram[i, k] += sum of w_i over the pixels of ``labels`` (H, W) that are k >= 0.

    Many tiles show one splat. So a batch of tiles is summed in parallel, each tile for itself, and
    then the sums are added tile by tile, in parallel over splats: no atomics, no dependence of the
    result on the number of threads.
    """
    size = np.array([labels.shape[1], labels.shape[0]], np.int64)
    tiles = _number_labels(labels, view.n_tiles)
    n_sums = np.cumsum(np.append(0, np.diff(view.offsets) * tiles.n_found))
    first = 0
    while first < view.n_tiles:
        last = int(np.searchsorted(n_sums, n_sums[first] + _BATCH, side="right")) - 1
        last = min(view.n_tiles, max(last, first + 1))
        sum_offsets = n_sums[first : last + 1] - n_sums[first]
        sums = _sum_tiles(view, tiles, size, first, sum_offsets)
        _add_sums(view, tiles, first, sum_offsets, sums, histogram)
        first = last


def _number_labels(labels: IntArray, n_tiles: int) -> _TileLabels:
    local = np.empty((n_tiles, TILE, TILE), np.int32)
    found = np.empty((n_tiles, TILE * TILE), np.int32)
    n_found = np.zeros(n_tiles, np.int64)

    def work(start: int, stop: int) -> None:
        kernels.tile_labels(labels, local, found, n_found, start, stop)

    run_chunks(work, n_tiles, TILES_AT_ONCE)
    return _TileLabels(local, found, n_found)


def _sum_tiles(
    view: TiledView, tiles: _TileLabels, size: LongArray, first: int, sum_offsets: LongArray
) -> FloatArray:
    """Sums of each (splat, label) of the batch of tiles that begins at ``first``."""
    sums = np.zeros(sum_offsets[-1], np.float32)

    def work(start: int, stop: int) -> None:
        kernels.vote_tiles(
            view.splats,
            view.offsets,
            view.ids,
            tiles.local,
            tiles.n_found,
            sum_offsets,
            first,
            size,
            sums,
            start,
            stop,
        )

    run_chunks(work, len(sum_offsets) - 1, TILES_AT_ONCE)
    return sums


def _add_sums(
    view: TiledView,
    tiles: _TileLabels,
    first: int,
    sum_offsets: LongArray,
    sums: FloatArray,
    histogram: FloatArray | VoteSlots,
) -> None:
    batch = (view.order, view.offsets, view.ids, tiles.found, tiles.n_found, sum_offsets, first)

    def work(start: int, stop: int) -> None:
        if isinstance(histogram, VoteSlots):
            slots = (histogram.labels, histogram.weights, histogram.lost)
            kernels.add_sums_to_slots(*batch, sums, *slots, start, stop)
        else:
            kernels.add_sums(*batch, sums, histogram, start, stop)

    n = len(view.order)
    run_chunks(work, n, max(1, -(-n // n_threads())))
