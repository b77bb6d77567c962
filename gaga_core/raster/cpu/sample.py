"""Blending weights of sampled pixels as sparse rows (rows of W)."""

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import run_chunks
from gaga_core.raster.base import PixelWeights
from gaga_core.raster.cpu import blend_kernels as kernels
from gaga_core.raster.cpu.prepare import TILES_AT_ONCE, TiledView
from gaga_core.raster.cpu.project_kernels import TILE


def sampled_weights(view: TiledView, width: int, pixels: LongArray, w_min: float) -> PixelWeights:
    """Rows in the order of ``pixels``, entries above ``w_min``: counted first, then written."""
    n_tiles_x = -(-width // TILE)
    flat = np.ascontiguousarray(pixels, np.int64)
    tile = flat // width // TILE * n_tiles_x + flat % width // TILE
    by_tile = np.lexsort((flat, tile))
    samples = flat[by_tile]
    sample_offsets = np.searchsorted(tile[by_tile], np.arange(view.n_tiles + 1)).astype(np.int64)
    row_ends = np.zeros(len(flat), np.int64)

    def run(indices: IntArray, values: FloatArray, writes: bool) -> None:
        def work(start: int, stop: int) -> None:
            kernels.sample_weights(
                view.splats,
                view.order,
                view.offsets,
                view.ids,
                samples,
                sample_offsets,
                n_tiles_x,
                width,
                w_min,
                row_ends,
                indices,
                values,
                writes,
                start,
                stop,
            )

        run_chunks(work, view.n_tiles, TILES_AT_ONCE)

    run(np.empty(0, np.int32), np.empty(0, np.float32), False)
    counts = np.empty(len(flat), np.int64)
    counts[by_tile] = row_ends
    indptr = np.append(0, np.cumsum(counts)).astype(np.int64)
    row_ends[:] = indptr[:-1][by_tile]
    indices, values = np.empty(indptr[-1], np.int32), np.empty(indptr[-1], np.float32)
    run(indices, values, True)
    return PixelWeights(indptr, indices, values)
