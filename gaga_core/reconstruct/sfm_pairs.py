"""Which photos to match when there are too many for all pairs: those that look alike.

Each photo becomes one vector: its local features, summed relative to the nearest of a few centres
that are learned from the photos themselves (VLAD, Jegou 2010). No vocabulary has to be shipped.
"""

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial.distance import cdist

from gaga_core.arrays import AnyArray, DoubleArray

_CENTRES = 64
_SAMPLE = 20_000  # features that the centres are learned from
_PER_PHOTO = 800  # strongest features of a photo that describe it


def similar_pairs(
    descriptors: Sequence[AnyArray],  # (F, 128) of each photo
    neighbours: int,
    seed: int = 0,
) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of each photo and the ``neighbours`` that look most like it.

    Neighbours by name are among them too: photos are mostly taken in a walk.
    """
    n = len(descriptors)
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(n, i + 1 + neighbours // 4))}
    vectors = photo_vectors(descriptors, seed)
    alike = vectors @ vectors.T
    np.fill_diagonal(alike, -np.inf)
    for i in range(n):
        for j in np.argsort(-alike[i], kind="stable")[: min(neighbours, n - 1)]:
            pairs.add((min(i, int(j)), max(i, int(j))))
    return sorted(pairs)


def photo_vectors(descriptors: Sequence[AnyArray], seed: int = 0) -> DoubleArray:
    """One vector a photo (n, centres * 128): unit length, or zero for a photo without features."""
    rng = np.random.default_rng(seed)
    some = [np.asarray(d[:_PER_PHOTO], np.float64) for d in descriptors]
    each = max(1, _SAMPLE // max(1, len(some)))
    sample = np.concatenate([d[rng.permutation(len(d))[:each]] for d in some])
    k = max(1, min(_CENTRES, len(sample) // 10))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a centre that nothing is near to
        centres = kmeans2(sample, k, iter=10, minit="points", rng=rng, missing="warn")[0]
    vectors = np.zeros((len(some), k * sample.shape[1]))
    for i, d in enumerate(some):
        if len(d) == 0:
            continue
        nearest = cdist(d, centres, "sqeuclidean").argmin(axis=1)
        sums = np.zeros_like(centres)
        np.add.at(sums, nearest, d - centres[nearest])
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
        vectors[i] = (np.sign(sums) * np.sqrt(np.abs(sums))).ravel()
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    return vectors
