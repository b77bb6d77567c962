"""Kernels of the linear operator F = W E on cached rows of W, of the layer, and of Adam.

Every output cell has one writer and every list is walked in its order, so results do not depend on
the number of threads.
"""

import math

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.kernels import exp_below_zero, kernel
from gaga_core.raster.cpu.simd_kernels import fill, load, store

D = 16  # channels of an identity encoding: one vector of `simd_kernels`
_F = np.float32
_ZERO, _ONE = _F(0), _F(1)


@kernel
def gather(
    starts: LongArray,  # (P + 1,)
    ids: IntArray,  # (nnz,) rows of `source`
    weights: FloatArray,  # (nnz,)
    source: FloatArray,  # (n, D)
    targets: IntArray,  # (P,) row of `out` of each list
    out: FloatArray,  # (m, D) written in these rows only
    start: int,
    stop: int,
) -> None:
    """out[targets[p]] = sum over list p of weight times the source row: W E, and W^T dF."""
    for p in range(start, stop):
        total = fill(_ZERO)
        for j in range(starts[p], starts[p + 1]):
            total = total + load(source, ids[j] * D) * fill(weights[j])
        store(out, targets[p] * D, total)


@kernel
def transpose(
    indptr: LongArray,  # (P + 1,)
    indices: IntArray,  # (nnz,) Gaussian
    weights: FloatArray,  # (nnz,)
    cursor: LongArray,  # (N,) where each Gaussian's list begins; moved on in place
    rows: IntArray,  # (nnz,) out: row of W
    row_weights: FloatArray,  # (nnz,) out
) -> None:
    """The same entries by Gaussian, rows ascending: a stable counting sort."""
    for p in range(indptr.shape[0] - 1):
        for j in range(indptr[p], indptr[p + 1]):
            at = cursor[indices[j]]
            rows[at] = p
            row_weights[at] = weights[j]
            cursor[indices[j]] = at + 1


@kernel
def adam(
    values: FloatArray,  # (m,) changed in place, like the next two
    mean: FloatArray,  # (m,)
    square: FloatArray,  # (m,)
    gradient: FloatArray,  # (m,)
    rate: float,  # learning rate over 1 - beta1^t
    root: float,  # sqrt(1 - beta2^t)
    epsilon: float,
    start: int,
    stop: int,
) -> None:
    """One step of Adam (Kingma 2015) with torch's placing of epsilon; betas 0.9 and 0.999."""
    by, scale, small = _F(rate), _F(1.0 / root), _F(epsilon)
    for i in range(start, stop):
        g = gradient[i]
        m = _F(0.9) * mean[i] + _F(0.1) * g
        v = _F(0.999) * square[i] + _F(0.001) * g * g
        mean[i] = m
        square[i] = v
        values[i] -= by * m / (_F(math.sqrt(v)) * scale + small)


@kernel
def softmax_rows(
    features: FloatArray,  # (P, D)
    weight_t: FloatArray,  # (D, K)
    bias: FloatArray,  # (K,)
    out: FloatArray,  # (P, K)
) -> None:
    """Softmax of the layer on each row. No BLAS: its threads would spin against our own."""
    n_classes = bias.shape[0]
    for i in range(features.shape[0]):
        p = out[i]
        for k in range(n_classes):
            p[k] = bias[k]
        for c in range(D):
            f = features[i, c]
            w = weight_t[c]
            for k in range(n_classes):
                p[k] += f * w[k]
        most = p[0]
        for k in range(n_classes):
            most = max(most, p[k])
        total = _ZERO
        for k in range(n_classes):
            e = exp_below_zero(max(_F(-87), p[k] - most))
            p[k] = e
            total += e
        by = _ONE / total
        for k in range(n_classes):
            p[k] *= by


@kernel
def layer_gradients(
    slopes: FloatArray,  # (P, K) gradient of the scores
    features: FloatArray,  # (P, D)
    weight_t: FloatArray,  # (D, K)
    features_out: FloatArray,  # (P, D) gradient of the features
    weight_out: FloatArray,  # (D, K) gradient of the weights, added to
    bias_out: FloatArray,  # (K,) gradient of the bias, added to
) -> None:
    """Backward pass of the layer."""
    n_classes = bias_out.shape[0]
    for i in range(slopes.shape[0]):
        s = slopes[i]
        for k in range(n_classes):
            bias_out[k] += s[k]
        for c in range(D):
            f = features[i, c]
            w = weight_t[c]
            o = weight_out[c]
            total = _ZERO
            for k in range(n_classes):
                total += s[k] * w[k]
                o[k] += f * s[k]
            features_out[i, c] = total


# --- Kernel that keeps every Gaussian's own label while its encoding is fitted.


@kernel
def keep_labels(
    encodings: FloatArray,  # (N, D) changed in place
    codes: FloatArray,  # (K, D) unit length
    labels: IntArray,  # (N,)
    margin: float,  # least lead of the label's score
    start: int,
    stop: int,
) -> None:
    """Move encodings back towards their label's code until that code scores highest by a margin."""
    for i in range(start, stop):
        label = labels[i]
        e, own = encodings[i], codes[label]
        share = 1.0  # of the way from the code to the encoding
        for k in range(codes.shape[0]):
            if k == label:
                continue
            at_code, here = 0.0, 0.0  # lead of the label over k
            for c in range(D):
                lead = own[c] - codes[k, c]
                at_code += lead * own[c]
                here += lead * e[c]
            least = min(margin, 0.5 * at_code)
            if here < least:
                share = min(share, (at_code - least) / (at_code - here))
        if share < 1.0:
            for c in range(D):
                e[c] = own[c] + share * (e[c] - own[c])


# --- Kernel of the code book's repulsion.


@kernel
def repulsion(
    codes: FloatArray,  # (K, D) unit length
    codes_t: FloatArray,  # (D, K) the same
    sharpness: float,
    push: FloatArray,  # (K, D) out: mean of the other codes, the nearest weighted most
) -> np.float32:
    """Direction that each code is pushed away from; returns the greatest cosine of two codes."""
    K = codes.shape[0]
    row = np.empty(K, np.float32)
    sharp, greatest = _F(sharpness), -_ONE
    for i in range(K):
        for k in range(K):
            row[k] = _ZERO
        for c in range(D):
            f = codes[i, c]
            for k in range(K):
                row[k] += f * codes_t[c, k]
        row[i] = _F(-2)  # itself: under any cosine
        nearest = _F(-2)
        for k in range(K):
            nearest = max(nearest, row[k])
        greatest = max(greatest, nearest)
        total = _ZERO
        for k in range(K):
            e = exp_below_zero(max(_F(-87), sharp * (row[k] - nearest)))
            row[k] = e
            total += e
        total -= row[i]
        row[i] = _ZERO
        for c in range(D):
            away = _ZERO
            for k in range(K):
                away += row[k] * codes_t[c, k]
            push[i, c] = away / total
    return greatest
