"""Rounding that suits a scene: tables of 256 numbers, palettes of SH, positions in 16 bits.

What a SOG file and a web page share.
"""

import numpy as np
from scipy.sparse import csr_array

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, IntArray, UInt8Array, UInt16Array
from gaga_core.io.packing import three_of_quats, to_bytes, unit_quats

_N_CODES = 256
_CODE_ROUNDS = 12  # of Lloyd's algorithm for a table of numbers
PALETTE = 65536  # entries at most: labels have 16 bits
_COARSE = 256  # clusters of the first level
_ROUNDS = 4  # of Lloyd's algorithm in each
_CELLS = 1 << 22  # distances that are held at once
_SAMPLE = 1 << 18  # numbers or splats that tables are made from


def log_words(means: FloatArray) -> tuple[UInt16Array, DoubleArray, DoubleArray]:
    """Positions (N, 3) in 16 bits on a scale of sign(x) ln(1 + |x|), and its ends (3,)."""
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    words = np.rint((logs - low) / np.where(high > low, high - low, 1) * 65535)
    return words.astype(np.uint16), low, high


def quat_bytes(quats: FloatArray) -> tuple[UInt8Array, UInt8Array]:
    """Place (N,) of the largest part of quaternions (N, 4), and the other three as bytes (N, 3)."""
    largest, three = three_of_quats(unit_quats(quats))
    parts = to_bytes((three * np.float32(np.sqrt(2)) * 0.5 + 0.5) * 255)
    return largest.astype(np.uint8), parts


def table_of(values: FloatArray) -> FloatArray:
    """256 numbers, ascending, near which the values lie: Lloyd's algorithm from quantiles."""
    # Sorted first: a step through channels that take turns could meet one of them alone.
    ordered = np.sort(values, axis=None)
    flat = np.append(_sampled(ordered), ordered[-1]).astype(np.float64)
    distinct = np.unique(flat)
    if len(distinct) <= _N_CODES:
        return np.pad(distinct, (0, _N_CODES - len(distinct)), mode="edge").astype(np.float32)
    even = np.linspace(flat[0], flat[-1], _N_CODES)
    table = (np.quantile(flat, np.linspace(0, 1, _N_CODES)) + even) / 2  # rare values count, too
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(_CODE_ROUNDS):
        edges = np.concatenate([[0], np.searchsorted(flat, (table[1:] + table[:-1]) / 2)])
        ends = np.concatenate([edges[1:], [len(flat)]])
        counts = ends - edges
        means = (sums[ends] - sums[edges]) / np.maximum(counts, 1)
        table = np.sort(np.where(counts > 0, means, table))
    return table.astype(np.float32)


def nearest(table: FloatArray, values: FloatArray) -> UInt8Array:
    """Place 0..255 of the nearest number of an ascending table."""
    between = (table[1:] + table[:-1]) / 2
    places: UInt8Array = np.searchsorted(between, values).astype(np.uint8)
    return places


def palette_of(rest: FloatArray) -> tuple[FloatArray, IntArray]:
    """Entries (E, S - 1, 3) and the one (N,) of each splat.

    Splats with few different SH keep them all. Else k-means in two levels: each of a few coarse
    clusters is divided into its share of the entries, so that the time grows with N alone.
    """
    flat = np.ascontiguousarray(rest.reshape(len(rest), -1), np.float32)
    entries, labels = np.unique(flat, axis=0, return_inverse=True)
    if len(entries) <= PALETTE:
        return entries.reshape(-1, *rest.shape[1:]), labels.reshape(-1).astype(np.int32)
    rng = np.random.default_rng(0)
    coarse = _closest(_means_of(_sampled(flat), _COARSE, rng), flat)
    order = np.argsort(coarse, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(coarse, minlength=_COARSE))[:-1])
    room = PALETTE - _COARSE  # a cluster has one entry at least
    found: list[FloatArray] = []
    labels, n_before = np.zeros(len(flat), np.int64), 0
    for part in (part for part in parts if len(part)):
        means = _means_of(flat[part], 1 + room * len(part) // len(flat), rng)
        labels[part] = n_before + _closest(means, flat[part])
        found.append(means)
        n_before += len(means)
    return np.concatenate(found).reshape(-1, *rest.shape[1:]), labels.astype(np.int32)


def _means_of(rows: FloatArray, k: int, rng: np.random.Generator) -> FloatArray:
    """At most ``k`` rows (K, D) near which the rows (R, D) lie: Lloyd's algorithm."""
    if len(rows) <= k:
        return rows
    means = rows[rng.permutation(len(rows))[:k]]
    for _ in range(_ROUNDS):
        near = _closest(means, rows)
        counts = np.bincount(near, minlength=k)
        belongs = csr_array((np.ones(len(rows), np.float32), (near, np.arange(len(rows)))))
        sums = belongs @ rows
        sums = np.pad(sums, ((0, k - len(sums)), (0, 0)))
        means = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], means)
        means = means.astype(np.float32)
    return means


def _closest(means: FloatArray, rows: FloatArray) -> IntArray:
    """The nearest of ``means`` (K, D) to each row (R, D)."""
    lengths = (means * means).sum(axis=1)
    step = max(_CELLS // len(means), 1)
    pieces = [
        (lengths - 2 * (rows[at : at + step] @ means.T)).argmin(axis=1)
        for at in range(0, len(rows), step)
    ]
    nearest: IntArray = np.concatenate([*pieces, np.zeros(0, np.int64)]).astype(np.int32)
    return nearest


def _sampled(rows: AnyArray) -> AnyArray:
    """At most `_SAMPLE` rows, evenly taken."""
    return rows[:: -(-len(rows) // _SAMPLE)]
