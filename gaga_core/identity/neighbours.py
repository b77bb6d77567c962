"""Nearest neighbours of Gaussians in space: built once, read at every step."""

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.kernels import n_threads
from gaga_core.progress import Progress, Stage

_CHUNK = 1 << 17  # queries between two chances to cancel


def nearest(
    means: FloatArray,  # (N, 3)
    k: int,
    *,
    of: BoolArray | None = None,  # (N,) queried; None = all
    among: BoolArray | None = None,  # (N,) that may be neighbours; None = all
) -> Stage[IntArray]:
    """The ``k`` nearest of each queried Gaussian (Q, k), nearest first, the Gaussian itself too.

    Queried Gaussians are taken in ascending order. Positions that are not finite have only
    themselves; when fewer than ``k`` are found, the last one is repeated. Progress counts queries.
    """
    check_shape("means", means, ("N", 3))
    if k < 1:
        raise ValueError(f"k: {k} is not positive")
    finite: BoolArray = np.isfinite(means.sum(axis=1))
    asks = np.ones(len(means), np.bool_) if of is None else of
    queries = np.flatnonzero(asks)
    answers = np.flatnonzero(finite if among is None else among & finite)
    result = np.repeat(queries.astype(np.int32)[:, None], k, axis=1)
    if len(answers) == 0 or len(queries) == 0:
        return result
    tree = cKDTree(means[answers])
    found = min(k, len(answers))
    place = np.flatnonzero(finite[queries])
    for start in range(0, len(place), _CHUNK):
        yield Progress("Find neighbours", start, len(place))
        rows = place[start : start + _CHUNK]
        _, near = tree.query(means[queries[rows]], k=found, workers=n_threads())
        ids = answers[np.reshape(near, (len(rows), found))]
        result[rows, :found] = ids
        result[rows, found:] = ids[:, -1:]
    return result


def majority(labels: IntArray, near: IntArray | LongArray) -> tuple[IntArray, FloatArray]:
    """The most frequent label among each row's neighbours (Q, k), and its share (Q,).

    Of equally frequent labels the one of the nearer neighbour.
    """
    found = labels[near]
    frequency = (found[:, :, None] == found[:, None, :]).sum(axis=2)
    best = frequency.argmax(axis=1)
    rows = np.arange(len(found))
    share = (frequency[rows, best] / near.shape[1]).astype(np.float32)
    return found[rows, best], share
