"""A code for each group: unit vectors of R^16, spread as far from each other as they go.

Encodings that are their group's code, with the codes as the classifier, decode to the group by one
inner product: the closed form of the paper's identity encoding, without training.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, check_shape
from gaga_core.identity.codebook_kernels import repulsion
from gaga_core.identity.linear_kernels import D

_WORK = 200_000_000  # pairs of codes to compare, all steps together: seconds for any G
_MOST_STEPS, _LEAST_STEPS = 300, 20
_FIRST_SHARPNESS, _LAST_SHARPNESS = 4.0, 60.0


@dataclass(frozen=True, eq=False)
class CodeBook:
    """Codes of the groups 0 (none) to G."""

    codes: FloatArray  # (G + 1, D) unit length
    max_cosine: float  # of the two codes that are closest to each other

    def encodings(self, labels: IntArray) -> FloatArray:
        """The code (N, D) of each label (N,) in 0..G."""
        check_shape("labels", labels, ("N",), np.int32)
        return self.codes[labels]


def code_book(n_groups: int, *, seed: int = 0) -> CodeBook:
    """Codes for ``n_groups`` groups and for "none", by repulsion from a random start.

    Each step moves every code away from the others, weighted by exp(sharpness * cosine); as the
    sharpness grows, only the nearest ones count. Same ``seed``, same codes.
    """
    if n_groups < 0:
        raise ValueError(f"n_groups: {n_groups} is negative")
    K = n_groups + 1
    codes = _unit(np.random.default_rng(seed).normal(size=(K, D)).astype(np.float32))
    if K == 1:
        return CodeBook(codes, -1.0)
    best, best_cosine = codes, 1.0
    steps = int(np.clip(_WORK // (K * K), _LEAST_STEPS, _MOST_STEPS))
    for step in range(steps):
        done = step / steps
        sharpness = _FIRST_SHARPNESS * (_LAST_SHARPNESS / _FIRST_SHARPNESS) ** done
        push = np.empty_like(codes)
        cosine = float(repulsion(codes, np.ascontiguousarray(codes.T), sharpness, push))
        if cosine < best_cosine:
            best, best_cosine = codes, cosine
        codes = _unit(codes - np.float32(0.3 * (1 - done)) * push)
    return CodeBook(best, best_cosine)


def _unit(vectors: FloatArray) -> FloatArray:
    """Each row divided by its length."""
    lengths = np.linalg.norm(vectors.astype(np.float64), axis=1, keepdims=True)
    result: FloatArray = (vectors / lengths).astype(np.float32)
    return result
