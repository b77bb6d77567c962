"""Kernels of votes that keep a few labels for each Gaussian."""

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.kernels import kernel


@kernel
def add_to_slot(
    labels: IntArray,  # (N, K) label of each slot, -1 = free
    weights: FloatArray,  # (N, K)
    lost: FloatArray,  # (N,) weight of what has no slot
    i: int,
    label: int,
    weight: float,
) -> None:
    """Add to the slot of a label, or open one; a new label takes the place of the smallest one when
    it weighs more, else it is lost."""
    smallest = 0
    for s in range(labels.shape[1]):
        if labels[i, s] == label:
            weights[i, s] += weight
            return
        if labels[i, s] < 0:
            labels[i, s], weights[i, s] = label, weight
            return
        if weights[i, s] < weights[i, smallest]:
            smallest = s
    if weight > weights[i, smallest]:
        lost[i] += weights[i, smallest]
        labels[i, smallest], weights[i, smallest] = label, weight
    else:
        lost[i] += weight


@kernel
def add_rows(
    rows: IntArray,  # (n,)
    columns: IntArray,  # (k,) labels
    added: FloatArray,  # (n, k)
    labels: IntArray,
    weights: FloatArray,
    lost: FloatArray,
) -> None:
    """Add a dense table of some Gaussians and some labels."""
    for r in range(len(rows)):
        for c in range(len(columns)):
            if added[r, c] > 0:
                add_to_slot(labels, weights, lost, rows[r], columns[c], added[r, c])


@kernel
def add_ones(
    rows: IntArray,  # (n,)
    values: IntArray,  # (n,) labels
    labels: IntArray,
    weights: FloatArray,
    lost: FloatArray,
) -> None:
    """One vote of one label for each of some Gaussians."""
    for r in range(len(rows)):
        add_to_slot(labels, weights, lost, rows[r], values[r], 1.0)
