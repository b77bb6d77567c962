"""Votes of many labels in little memory: each Gaussian keeps the few labels that vote for it.

A table of all Gaussians and all labels is nearly empty, because a Gaussian shows in masks of what
is at its place. As long as no more labels than there are slots vote for one, the sums are the same
as in a table. Beyond that the smallest sums are given up.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, check_shape
from gaga_core.raster.cpu.blend_kernels import add_ones, add_rows
from gaga_core.threads import run_chunks

SLOTS = 16  # labels of one Gaussian
_BLOCK = 1 << 16  # Gaussians in one piece of work


@dataclass(frozen=True, eq=False)
class VoteSlots:
    """Summed weights by label, a few of each Gaussian. Arrays are changed in place."""

    labels: IntArray  # (N, K) -1 = free
    weights: FloatArray  # (N, K)
    lost: FloatArray  # (N,) weight of labels that found no slot

    @staticmethod
    def empty(n: int, n_slots: int = SLOTS) -> "VoteSlots":
        """No votes for ``n`` Gaussians."""
        return VoteSlots(
            np.full((n, n_slots), -1, np.int32),
            np.zeros((n, n_slots), np.float32),
            np.zeros(n, np.float32),
        )

    def __len__(self) -> int:
        return len(self.labels)

    def add(self, rows: IntArray, columns: IntArray, added: FloatArray) -> None:
        """Add ``added`` (n, k) for Gaussians ``rows`` (n,), each once, and labels ``columns``
        (k,)."""
        check_shape("added", added, (len(rows), len(columns)), np.float32)
        rows = np.require(rows, np.int32, ["C", "W"])
        columns = np.require(columns, np.int32, ["C", "W"])
        added = np.require(added, np.float32, ["C", "W"])

        def work(start: int, stop: int) -> None:
            part = slice(start, stop)
            add_rows(rows[part], columns, added[part], self.labels, self.weights, self.lost)

        run_chunks(work, len(rows), _BLOCK)

    def add_one(self, rows: IntArray, labels: IntArray) -> None:
        """One vote for Gaussians ``rows`` (n,), each once, of its own label (n,) each."""
        rows = np.require(rows, np.int32, ["C", "W"])
        labels = np.require(labels, np.int32, ["C", "W"])

        def work(start: int, stop: int) -> None:
            part = slice(start, stop)
            add_ones(rows[part], labels[part], self.labels, self.weights, self.lost)

        run_chunks(work, len(rows), _BLOCK)

    def winners(self, without: IntArray | None = None) -> tuple[IntArray, FloatArray, FloatArray]:
        """The label (N,) of the greatest sum, the lower one on a tie, -1 = no votes; its sum (N,);
        the sum of all votes (N,). ``without`` (N,) is a label of each that cannot win."""
        best, label = np.zeros(len(self), np.float32), np.full(len(self), -1, np.int32)
        total = self.lost.copy()
        for s in range(self.labels.shape[1]):
            value, own = self.weights[:, s], self.labels[:, s]
            wins = (own >= 0) & ((value > best) | ((value == best) & (own < label)))
            if without is not None:
                wins &= own != without
            best, label = np.where(wins, value, best), np.where(wins, own, label)
            total += value
        return label, best, total
