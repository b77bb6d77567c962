"""Sets of splats and their values, stored as small as they go.

An undo entry of a million splats must stay under a byte a splat, and an entry of a few hundred
under a few hundred bytes: each set picks the smallest of three forms (runs, list, bits), as
SuperSplat (runs) and LichtFeld Studio (sparse or dense by size) do.
"""

from enum import Enum

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, IntArray, LongArray


class Storage(Enum):
    """Storage form of an `IndexSet`."""

    RUNS = "runs"  # (R, 2) int32 start, stop
    LIST = "list"  # (K,) int32
    BITS = "bits"  # ceil(n / 8) bytes


class IndexSet:
    """A set of ``count`` rows of a table of ``n`` rows, in the smallest form; never changed."""

    def __init__(self, n: int, count: int, form: Storage, data: AnyArray) -> None:
        self.n, self.count, self.form, self.data = n, count, form, data

    @staticmethod
    def of(indices: IntArray | LongArray, n: int) -> "IndexSet":
        """The set of ``indices`` (K,), which are sorted, unique and in 0..n-1."""
        count = len(indices)
        starts = np.flatnonzero(np.diff(indices, prepend=-2) != 1)
        sizes = {Storage.RUNS: 8 * len(starts), Storage.LIST: 4 * count, Storage.BITS: (n + 7) // 8}
        form = min(sizes, key=lambda f: sizes[f])
        if form is Storage.RUNS:
            lasts = np.append(starts[1:], count)[: len(starts)] - 1
            data: AnyArray = np.stack([indices[starts], indices[lasts] + 1], axis=1)
            return IndexSet(n, count, form, data.astype(np.int32))
        if form is Storage.LIST:
            return IndexSet(n, count, form, indices.astype(np.int32))
        mask = np.zeros(n, np.bool_)
        mask[indices] = True
        return IndexSet(n, count, form, np.packbits(mask))

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return int(self.data.nbytes)

    def mask(self) -> BoolArray:
        """The set as (n,) bool."""
        if self.form is Storage.BITS:
            return np.unpackbits(self.data, count=self.n).view(np.bool_)
        mask = np.zeros(self.n, np.bool_)
        if self.form is Storage.RUNS and len(self.data) < 64:
            for start, stop in self.data:
                mask[start:stop] = True
        else:
            mask[self.indices()] = True
        return mask

    def indices(self) -> IntArray:
        """The set as sorted (K,) int32."""
        if self.form is Storage.LIST:
            return self.data
        if self.form is Storage.BITS:
            return np.flatnonzero(self.mask()).astype(np.int32)
        # Steps of one inside a run, a jump at each start: the cumulative sum is the list.
        steps = np.ones(self.count, np.int32)
        if len(self.data):
            starts, stops = self.data[:, 0], self.data[:, 1]
            at = np.cumsum(stops - starts)[:-1]
            steps[0] = starts[0]
            steps[at] = starts[1:] - stops[:-1] + 1
        return np.cumsum(steps, dtype=np.int32)

    def equals(self, other: "IndexSet") -> bool:
        """Whether both hold the same rows of a table of the same length."""
        return (
            self.n == other.n
            and self.count == other.count
            and self.form is other.form
            and np.array_equal(self.data, other.data)
        )


class PackedInts:
    """Int32 values (K,), as one number when all agree, else in the smallest integer type.

    ``data`` () or (K,) is never changed.
    """

    def __init__(self, count: int, data: AnyArray) -> None:
        self.count, self.data = count, data

    @staticmethod
    def of(values: IntArray) -> "PackedInts":
        """Pack ``values`` (K,)."""
        if len(values) == 0:
            return PackedInts(0, np.zeros((), np.int32))
        low, high = int(values.min()), int(values.max())
        if low == high:
            return PackedInts(len(values), np.array(low, np.int32))
        dtype = np.promote_types(np.min_scalar_type(low), np.min_scalar_type(high))
        return PackedInts(len(values), values.astype(dtype))

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return int(self.data.nbytes)

    def values(self) -> IntArray:
        """The values (K,) int32."""
        return np.broadcast_to(self.data, (self.count,)).astype(np.int32)


def sorted_indices(indices: AnyArray, n: int) -> LongArray:
    """Sorted unique rows (K,) of ``indices``: (n,) bool, or (K,) integers in any order.

    Raises ``ValueError`` when a row is outside 0..n-1.
    """
    if indices.dtype == np.bool_:
        if indices.shape != (n,):
            raise ValueError(f"indices: expected ({n},) bool, got {indices.shape}")
        return np.flatnonzero(indices)
    rows: LongArray = np.asarray(indices, np.int64).ravel()
    if len(rows) > 1 and not (rows[1:] > rows[:-1]).all():
        rows = np.unique(rows)
    if len(rows) and (rows[0] < 0 or rows[-1] >= n):
        raise ValueError(f"indices: expected rows of 0..{n - 1}, got {rows[0]}..{rows[-1]}")
    return rows
