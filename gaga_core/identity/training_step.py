"""One training step of an identity field on cached rows: cross-entropy, its gradients, Adam."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.identity.field import IdentityField
from gaga_core.identity.linear_kernels import D, adam, layer_gradients, softmax_rows
from gaga_core.identity.rows import Batch
from gaga_core.progress import Progress, Stage
from gaga_core.threads import n_threads, run_chunks

_BLOCK = 1024  # pixels whose scores are held at a time by a thread
_ADAM_CHUNK = 1 << 18
_TINY = np.float32(1e-30)
_FLOOR = np.float32(1e-10)  # inside the logarithms of the regulariser, as published


@dataclass(frozen=True)
class IdentityRates:
    """Settings of Adam, as the published code trains."""

    encodings: float = 2.5e-3
    layer: float = 5e-4
    epsilon: float = 1e-15  # of the encodings, as 3D Gaussian Splatting trains its parameters
    layer_epsilon: float = 1e-15  # of the layer; the released code: 1e-8, the default of torch


@dataclass(eq=False)
class Training:
    """A field in training; its arrays change in place."""

    encodings: FloatArray  # (N, D)
    weight: FloatArray  # (K, D)
    bias: FloatArray  # (K,)
    moments: tuple[FloatArray, ...]  # mean and square of each of the three, in this order
    step: int = 0

    @staticmethod
    def of(field: IdentityField) -> "Training":
        """Training that begins at ``field``."""
        values = (field.encodings, field.weight, field.bias)
        moments = tuple(np.zeros_like(value) for value in values for _ in range(2))
        return Training(
            field.encodings.copy(), field.weight.copy(), field.bias.copy(), moments=moments
        )

    def field(self) -> IdentityField:
        """The present state as a value."""
        return IdentityField(self.encodings.copy(), self.weight.copy(), self.bias.copy())


@dataclass(eq=False)
class IdentityGradients:
    """Sums of gradients; the arrays are added to."""

    encodings: FloatArray  # (N, D)
    weight: FloatArray  # (K, D)
    bias: FloatArray  # (K,)

    @staticmethod
    def zeros(training: Training) -> "IdentityGradients":
        """No gradient yet."""
        values = (training.encodings, training.weight, training.bias)
        return IdentityGradients(*(np.zeros_like(value) for value in values))

    def clear(self) -> None:
        """Set all to 0."""
        for values in (self.encodings, self.weight, self.bias):
            values[:] = 0


@dataclass(frozen=True)
class Fit:
    """Accuracy of the layer on the pixels of a batch."""

    loss: float  # mean cross-entropy, nats
    accuracy: float  # share of pixels with the right label


# Sums over a block of pixels: loss, hits, and the gradients of the layer, (D, K) and (K,).
_Block = tuple[float, int, FloatArray, FloatArray]


def cross_entropy(
    training: Training,
    batch: Batch,
    gradients: IdentityGradients | None = None,
    factor: float = 1.0,
) -> Fit:
    """Mean cross-entropy of the batch's pixels; adds ``factor`` times its gradients.

    The encodings' part is written to their rows: ``gradients`` must be clear before.
    """
    features = batch.rows.multiply(training.encodings)
    slopes = np.empty_like(features)
    layer = (np.ascontiguousarray(training.weight.T), training.bias)
    blocks: list[_Block | None] = [None] * -(-len(features) // _BLOCK)

    def work(start: int, stop: int) -> None:
        blocks[start // _BLOCK] = _cross_entropy_block(
            layer,
            features[start:stop],
            batch.labels[start:stop],
            None if gradients is None else slopes[start:stop],
            factor / len(features),
        )

    run_chunks(work, len(features), _BLOCK)
    done = [block for block in blocks if block is not None]
    if gradients is not None:
        batch.rows.multiply_transposed(slopes, gradients.encodings)
        for _, _, weight_t, bias in done:
            gradients.weight += weight_t.T
            gradients.bias += bias
    n = max(len(features), 1)
    return Fit(sum(block[0] for block in done) / n, sum(block[1] for block in done) / n)


def _cross_entropy_block(
    layer: tuple[FloatArray, FloatArray],  # transposed weights (D, K), bias (K,)
    features: FloatArray,
    labels: IntArray,
    slopes: FloatArray | None,  # out: gradient of the features
    factor: float,
) -> _Block:
    weight_t, bias = layer
    weight_slope, bias_slope = np.zeros_like(weight_t), np.zeros_like(bias)
    p = np.empty((len(features), len(bias)), np.float32)
    softmax_rows(features, weight_t, bias, p)
    rows = np.arange(len(p))
    of_label = p[rows, labels]
    loss = -float(np.log(np.maximum(of_label, _TINY)).sum(dtype=np.float64))
    hits = int((p.argmax(axis=1) == labels).sum())
    if slopes is not None:
        p[rows, labels] -= 1
        p *= np.float32(factor)
        layer_gradients(p, features, weight_t, slopes, weight_slope, bias_slope)
    return loss, hits, weight_slope, bias_slope


def agreement(
    training: Training,
    near: IntArray,  # (S, k) Gaussians: a sample, and its neighbours with itself first
    factor: float,
    gradients: IdentityGradients | None = None,
) -> float:
    """3D regulariser: mean KL(p_i || p_j) over neighbours j of the sampled i, over the classes.

    Gaussian Grouping (Ye et al., ECCV 2024), `loss_cls_3d`. ``factor`` is its lambda; the result
    and the gradients added are multiplied by it. Both p_i and p_j have gradients.
    """
    n, k = near.shape
    ids, place = np.unique(near, return_inverse=True)
    place = place.reshape(near.shape)
    codes = training.encodings[ids]
    weight_t = np.ascontiguousarray(training.weight.T)
    p = np.empty((len(ids), len(training.bias)), np.float32)
    softmax_rows(codes, weight_t, training.bias, p)
    log_p = np.log(p + _FLOOR)
    # pairs[j, i]: how often j is a neighbour of the sampled i; all sums over pairs are products.
    ones = np.ones(near.size, np.float32)
    pairs = csr_matrix((ones, (place.ravel(), np.repeat(place[:, 0], k))), (len(ids), len(ids)))
    times = np.asarray(pairs.sum(axis=0)).reshape(-1, 1)  # k where i was sampled, else 0
    own = times * log_p - pairs.T @ log_p
    unit = np.float32(factor / (n * k * p.shape[1]))
    loss = float((p * own).sum(dtype=np.float64)) * float(unit)
    if gradients is None:
        return loss
    slope = unit * (own + (times * p - pairs @ p) / (p + _FLOOR))
    scores = p * (slope - (p * slope).sum(axis=1, keepdims=True))
    codes_slope, weight_slope = np.empty_like(codes), np.zeros_like(weight_t)
    layer_gradients(scores, codes, weight_t, codes_slope, weight_slope, gradients.bias)
    gradients.encodings[ids] += codes_slope
    gradients.weight += weight_slope.T
    return loss


def adam_step(training: Training, gradients: IdentityGradients, rates: IdentityRates) -> None:
    """One step of Adam on all parameters, in place."""
    training.step += 1
    root = math.sqrt(1 - 0.999**training.step)
    speed = 1 - 0.9**training.step
    values = (training.encodings, training.weight, training.bias)
    slopes = (gradients.encodings, gradients.weight, gradients.bias)
    for i, (value, slope) in enumerate(zip(values, slopes, strict=True)):
        mean, square = training.moments[2 * i : 2 * i + 2]
        rate = (rates.encodings if i == 0 else rates.layer) / speed
        a, b, c, d = (array.reshape(-1) for array in (value, mean, square, slope))
        epsilon = rates.epsilon if i == 0 else rates.layer_epsilon
        work = partial(adam, a, b, c, d, rate, root, epsilon)
        run_chunks(work, value.size, _ADAM_CHUNK)


def start_from_zeros(n_gaussians: int, n_groups: int, seed: int) -> Training:
    """The paper's start: encodings zero; the layer as torch initialises Conv2d(16, K, 1)."""
    rng = np.random.default_rng([seed, 1])
    bound = 1 / math.sqrt(D)
    K = n_groups + 1
    field = IdentityField(
        np.zeros((n_gaussians, D), np.float32),
        rng.uniform(-bound, bound, (K, D)).astype(np.float32),
        rng.uniform(-bound, bound, K).astype(np.float32),
    )
    return Training.of(field)


def batch_of_step(step: int, n_batches: int, seed: int) -> int:
    """Which batch a step takes: all of them in random order, then again in another order."""
    epoch, place = divmod(step, n_batches)
    return int(np.random.default_rng([seed, 2, epoch]).permutation(n_batches)[place])


# --- Nearest neighbours of Gaussians in space: built once, read at every step.


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
