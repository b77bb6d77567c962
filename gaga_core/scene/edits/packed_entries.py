"""The recorded forms of arrays, sets of splats and tables: what msgspec checks when one is read."""

import base64
import math
import zlib
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType, field

from gaga_core.arrays import AnyArray
from gaga_core.scene.index_set import IndexSet, PackedInts, Storage
from gaga_core.scene.scene import Placements

MOST_ROWS = (1 << 31) - 1  # rows are int32
Row = Annotated[int, Meta(ge=0, le=MOST_ROWS)]
_Int32 = Annotated[int, Meta(ge=-(1 << 31), le=(1 << 31) - 1)]
_DType = Literal["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64"]
ColumnType = Literal[  # of a column of splats
    "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64"
]
_Four = tuple[float, float, float, float]
_Affine = tuple[_Four, _Four, _Four]


class SetEntry(Struct, frozen=True):
    """A set of splats as it is stored: one of its three forms is there."""

    n: Row  # of the scene
    count: Row
    runs: list[tuple[Row, Row]] | UnsetType = UNSET  # start, stop
    indices: str | UnsetType = field(default=UNSET, name="list")  # packed int32
    bits: str | UnsetType = UNSET  # packed, of all n

    @staticmethod
    def of(splats: IndexSet) -> "SetEntry":
        """The form of a set."""
        if splats.form is Storage.RUNS:
            return SetEntry(splats.n, splats.count, runs=splats.data.tolist())
        if splats.form is Storage.LIST:
            return SetEntry(splats.n, splats.count, indices=packed(splats.data))
        return SetEntry(splats.n, splats.count, bits=packed(splats.data))

    def index_set(self, most: int) -> IndexSet:
        """The set, of a scene of at most ``most`` splats; ``ValueError`` when it is damaged."""
        if self.n > most or self.count > self.n:
            raise ValueError(f"a set of {self.count:,} splats of {self.n:,}, at most {most:,}")
        rows = self._rows()
        is_sorted = bool((np.diff(rows) > 0).all())
        inside = len(rows) == 0 or (rows[0] >= 0 and rows[-1] < self.n)
        if len(rows) != self.count or not (is_sorted and inside):
            raise ValueError(f"a set of {self.count} splats of {self.n}")
        return IndexSet.of(rows, self.n)

    def _rows(self) -> AnyArray:
        if not isinstance(self.runs, UnsetType):
            if sum(stop - start for start, stop in self.runs) != self.count or any(
                start > stop or stop > self.n for start, stop in self.runs
            ):
                raise ValueError(f"a set of {self.count} splats of {self.n}")
            pieces = [np.arange(start, stop) for start, stop in self.runs]
            return np.concatenate([np.zeros(0, np.int64), *pieces])
        if not isinstance(self.indices, UnsetType):
            return _unpacked(self.indices, "int32", self.count).astype(np.int64)
        if isinstance(self.bits, UnsetType):
            raise ValueError("a set without rows")
        bits = _unpacked(self.bits, "uint8", -(-self.n // 8))
        return np.flatnonzero(np.unpackbits(bits, count=self.n))


class IntsEntry(Struct, frozen=True):
    """Whole numbers: one for all, or packed."""

    count: Row
    all: _Int32 | UnsetType = UNSET
    dtype: _DType | UnsetType = UNSET
    data: str | UnsetType = UNSET  # packed

    @staticmethod
    def of(values: PackedInts) -> "IntsEntry":
        """The form of numbers."""
        if values.data.ndim == 0:
            return IntsEntry(values.count, all=int(values.data))
        dtype: _DType = str(values.data.dtype)  # type: ignore[assignment]
        return IntsEntry(values.count, dtype=dtype, data=packed(values.data))

    def ints(self, most: int) -> PackedInts:
        """The numbers, at most ``most``; ``ValueError`` when they are damaged."""
        if self.count > most:
            raise ValueError(f"{self.count:,} numbers, at most {most:,}")
        if not isinstance(self.all, UnsetType):
            return PackedInts(self.count, np.array(self.all, np.int32))
        if isinstance(self.dtype, UnsetType) or isinstance(self.data, UnsetType):
            raise ValueError(f"{self.count} numbers without values")
        return PackedInts(self.count, _unpacked(self.data, self.dtype, self.count))


class TableEntry(Struct, frozen=True):
    """Rows of the table of placements."""

    matrix: list[_Affine]
    color: list[_Affine]
    opacity: list[float]

    @staticmethod
    def of(table: Placements) -> "TableEntry":
        """The form of a table."""
        return TableEntry(table.matrix.tolist(), table.color.tolist(), table.opacity.tolist())

    def table(self) -> Placements:
        """The table; ``ValueError`` when its columns differ in length."""
        n = len(self.opacity)
        if len(self.matrix) != n or len(self.color) != n:
            raise ValueError(f"{len(self.matrix)}, {len(self.color)} and {n} rows")
        shape = (n, 3, 4)
        matrix = np.array(self.matrix, np.float64).reshape(shape)
        color = np.array(self.color, np.float64).reshape(shape)
        return Placements(matrix, color, np.array(self.opacity, np.float64))


def packed(array: AnyArray) -> str:
    """The bytes of an array, compressed, as text."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 1)).decode()


def unpacked(text: str, dtype: str, shape: tuple[int, ...]) -> AnyArray:
    """An array of this shape; ``ValueError`` when ``text`` holds another number of values."""
    count = math.prod(shape)
    if count > MOST_ROWS:
        raise ValueError(f"{count:,} values, at most {MOST_ROWS:,}")
    return _unpacked(text, dtype, count).reshape(shape)


def _unpacked(text: str, dtype: str, count: int) -> AnyArray:
    """``count`` values; no more memory than they need is taken, whatever the text holds."""
    raw, size = base64.b64decode(text, validate=True), count * np.dtype(dtype).itemsize
    values = zlib.decompressobj().decompress(raw, size + 1)
    if len(values) != size:
        raise ValueError(f"not the {count} values that it announces")
    array: AnyArray = np.frombuffer(values, dtype).copy()
    return array
