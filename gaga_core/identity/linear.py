"""Rendering of features as a linear operator: F = W E, with the rows of W cached.

With the geometry frozen a feature map is linear in the encodings, so a training step needs no
rasterizer. Both W E and W^T dF are gathers: the entries are kept by pixel and by Gaussian.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray, check_shape
from gaga_core.identity.linear_kernels import D, gather, transpose
from gaga_core.kernels import run_chunks
from gaga_core.raster.base import PixelWeights

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
        transpose(
            weights.indptr,
            weights.indices,
            weights.weights,
            ends - counts,
            rows,
            row_weights,
        )
        touched = np.flatnonzero(counts).astype(np.int32)
        starts = np.append(0, ends[touched]).astype(np.int64)
        return LinearRows(n_gaussians, weights, touched, starts, rows, row_weights)

    def multiply(self, encodings: FloatArray) -> FloatArray:
        """Features F = W E (P, D) of ``encodings`` (N, D) float32; no background is added."""
        check_shape("encodings", encodings, (self.n_gaussians, D), np.float32)
        out = np.empty((len(self), D), np.float32)
        targets = np.arange(len(self), dtype=np.int32)
        weights = self.by_pixel

        def work(start: int, stop: int) -> None:
            gather(
                weights.indptr,
                weights.indices,
                weights.weights,
                encodings,
                targets,
                out,
                start,
                stop,
            )

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

        def work(start: int, stop: int) -> None:
            gather(
                self.starts,
                self.rows,
                self.row_weights,
                gradients,
                self.touched,
                result,
                start,
                stop,
            )

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
