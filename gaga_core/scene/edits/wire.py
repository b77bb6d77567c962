"""Edits as JSON and back, exactly: in histories of autosaves, and recorded in scripts.

Numbers are written so that they are read back bit for bit, sets of splats as they are stored.
"""

import base64
import binascii
import math
import zlib
from collections.abc import Callable
from typing import Any, Literal, cast, get_args, get_origin

import msgspec
import numpy as np
from msgspec import UNSET, Struct, UnsetType, field

from gaga_core.arrays import MOST_GROUP, AnyArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.json_file import explain_json_error
from gaga_core.scene.edits.values import (
    MOST_ROWS,
    AnyEdit,
    AppendCopies,
    AppendSplats,
    Edit,
    FlipState,
    Group,
    Kept,
    Row,
    SetColor,
    SetLabels,
    SetPlacement,
    SetWeight,
    parts_of,
)
from gaga_core.scene.index_set import IndexSet, PackedInts, Storage
from gaga_core.scene.named_arrays import columns_of, placements_of, splats_of

EditJson = dict[str, Any]
_ONLY_HISTORY = ("bank", "confidence", "identities", "selection")  # kinds that change no splat
# What the values of an entry can still be, once its types are right.
_DAMAGED = (
    ValueError,  # msgspec's are such
    TypeError,
    KeyError,
    OverflowError,
    MemoryError,
    RecursionError,
    zlib.error,
    binascii.Error,
)
_Ints = Literal["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64"]


class _OtherSceneError(ValueError):
    """An edit is of more splats than there are."""


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
            return SetEntry(splats.n, splats.count, indices=_packed(splats.data))
        return SetEntry(splats.n, splats.count, bits=_packed(splats.data))

    def index_set(self, most: int) -> IndexSet:
        """The set, of a scene of at most ``most`` splats; ``ValueError`` when it is damaged."""
        if self.n > most:
            raise _OtherSceneError(f"of {self.n:,} splats, here are {most:,} at most")
        if self.count > self.n:
            raise ValueError(f"a set of {self.count:,} splats of {self.n:,}")
        damaged, rows = ValueError(f"a set of {self.count} splats of {self.n}"), np.zeros(0, int)
        if not isinstance(self.runs, UnsetType):
            # Counted first, so that no more rows are made than there can be.
            if sum(abs(stop - start) for start, stop in self.runs) != self.count:
                raise damaged
            rows = np.concatenate([rows, *(np.arange(*run) for run in self.runs)])
        elif not isinstance(self.indices, UnsetType):
            rows = _unpacked(self.indices, "int32", (self.count,)).astype(np.int64)
        elif not isinstance(self.bits, UnsetType):
            bits = _unpacked(self.bits, "uint8", (-(-self.n // 8),))
            rows = np.flatnonzero(np.unpackbits(bits, count=self.n))
        inside = len(rows) == 0 or (rows[0] >= 0 and rows[-1] < self.n)
        if len(rows) != self.count or not (inside and (np.diff(rows) > 0).all()):
            raise damaged
        return IndexSet.of(rows, self.n)


class IntsEntry(Struct, frozen=True):
    """Ids of groups, or rows of the placements: one for all, or packed."""

    count: Row
    all: Group | UnsetType = UNSET
    dtype: _Ints | UnsetType = UNSET
    data: str | UnsetType = UNSET  # packed

    @staticmethod
    def of(values: PackedInts) -> "IntsEntry":
        """The form of numbers."""
        if values.data.ndim == 0:
            return IntsEntry(values.count, all=int(values.data))
        dtype = cast(_Ints, str(values.data.dtype))
        return IntsEntry(values.count, dtype=dtype, data=_packed(values.data))

    def ints(self, most: int) -> PackedInts:
        """The numbers, at most ``most``; ``ValueError`` when they are damaged."""
        if self.count > most:
            raise ValueError(f"{self.count:,} numbers, at most {most:,}")
        if not isinstance(self.all, UnsetType):
            return PackedInts(self.count, np.array(self.all, np.int32))
        if isinstance(self.dtype, UnsetType) or isinstance(self.data, UnsetType):
            raise ValueError(f"{self.count} numbers without values")
        data = _unpacked(self.data, self.dtype, (self.count,))
        if data.min(initial=0) < 0 or data.max(initial=0) > MOST_GROUP:
            raise ValueError(f"numbers outside 0 to {MOST_GROUP}")
        return PackedInts(self.count, data)


class ColumnEntry(Struct, frozen=True):
    """A column of splats."""

    name: str
    dtype: Literal["float32", "float64"] | _Ints
    shape: tuple[Row, ...]
    data: str  # packed


def to_json(edit: Edit, number: Callable[[object], int | None] = lambda _: None) -> EditJson:
    """``edit`` as values that `json.dumps` takes, for `of_json`.

    ``number`` of the memory banks, confidences and identities, which are kept apart.
    """

    def plain(value: object) -> object:
        if isinstance(value, IndexSet):
            return SetEntry.of(value)
        if isinstance(value, PackedInts):
            return IntsEntry.of(value)
        if isinstance(value, np.ndarray):
            return value.tolist()
        if not isinstance(value, Kept):
            raise TypeError(f"edit: {type(value).__name__} has no recorded form")
        if not isinstance(value.value, Gaussians):
            return number(value.value)
        columns = columns_of(value.value).items()
        return [ColumnEntry(n, cast(Any, str(c.dtype)), c.shape, _packed(c)) for n, c in columns]

    return msgspec.json.decode(msgspec.json.encode(edit, enc_hook=plain), type=EditJson)


def of_json(
    content: object,
    most_rows: int = MOST_ROWS,
    kept: Callable[[object, int], object] | None = None,
) -> Edit:
    """The edit that `to_json` wrote, of a scene of at most ``most_rows`` splats.

    ``kept`` gives the value of a type and number. Files of splats that edits added are read again.
    Raises ``GagaError`` when a file is gone, or when the content is damaged or asks for more rows:
    before memory is taken.
    """

    def value_of(kind: object, value: object) -> object:
        if kind is IndexSet:
            return msgspec.convert(value, SetEntry).index_set(most_rows)
        if kind is PackedInts:
            return msgspec.convert(value, IntsEntry).ints(most_rows)
        parameters = get_args(kind)  # of an array: shape and dtype; of what is kept: its type
        if get_origin(kind) is np.ndarray:
            return _table(value, get_args(parameters[1])[0])
        if parameters == (Gaussians,):
            columns = msgspec.convert(value, list[ColumnEntry])
            return Kept(splats_of({c.name: _unpacked(c.data, c.dtype, c.shape) for c in columns}))
        if kept is None:
            raise ValueError("a value that only an undo history has")
        return Kept(kept(parameters[0], msgspec.convert(value, Row)))

    try:
        edit: Edit = msgspec.convert(content, AnyEdit, dec_hook=value_of)
        for part in parts_of(edit):
            _check(part)
    except _DAMAGED as error:
        other = error if isinstance(error, _OtherSceneError) else error.__cause__
        if isinstance(other, _OtherSceneError):
            raise GagaError(
                f"An edit of the script was recorded on another scene ({other}). Run it on the "
                "scene that was opened then."
            ) from error
        raise GagaError(
            f"A recorded edit of the script is damaged ({explain_json_error(error)}). "
            "Record it again."
        ) from error
    return edit


def _check(edit: Edit) -> None:
    """Raise ``ValueError`` unless the values of an edit fit each other: the scene is compared when
    it is applied."""
    counts: tuple[int, ...] = ()
    if isinstance(edit, AppendSplats):
        counts = edit.added.n, len(edit.splats)
    elif isinstance(edit, AppendCopies):
        counts = edit.splats.count, edit.labels.count, edit.rows.count
    elif isinstance(edit, SetLabels):
        counts = edit.splats.count, edit.before.count, edit.after.count
    elif isinstance(edit, FlipState):
        counts = edit.n, *(splats.n for _, splats in edit.flips)
    elif isinstance(edit, SetColor):
        shares = (*(edit.before or ()), *(edit.after or ()))
        if not all(0 <= share <= 1 for share in shares):
            raise ValueError("a color outside 0 to 1")
    elif isinstance(edit, SetWeight):
        if not all(0 < w.value < np.inf for w in (edit.before, edit.after) if w is not None):
            raise ValueError("a weight that is not above 0")
    elif isinstance(edit, SetPlacement):
        _check_placement(edit)
    if len(set(counts)) > 1:
        raise ValueError(f"counts of {' and '.join(map(str, counts))}")


def _check_placement(edit: SetPlacement) -> None:
    before, after = (placements_of(vars(table)) for table in (edit.before, edit.after))
    known, fresh = edit.rows[: len(before)], edit.rows[len(before) :]
    is_right = len(edit.rows) == len(after) and (np.diff(known) > 0).all()
    is_right &= known.max(initial=-1) < edit.n_rows
    is_right &= np.array_equal(fresh, edit.n_rows + np.arange(len(fresh)))
    ways = edit.rows_from, edit.rows_to
    is_right &= len(ways[0]) == len(ways[1]) and ways[0].max(initial=-1) < edit.n_rows
    is_right &= bool(np.isin(ways[1], fresh).all())
    if not is_right or any(len(np.unique(way)) != len(way) for way in ways):
        raise ValueError("rows of the placements that do not fit each other")


def _table(value: object, dtype: type[np.generic]) -> AnyArray:
    """An array of whole numbers (R,) of rows, or of others in any shape."""
    if dtype is np.int32:
        return np.array(msgspec.convert(value, list[Row]), np.int32)
    numbers = np.array(value)
    if numbers.dtype.kind not in "iuf":
        raise ValueError("expected numbers")
    return numbers.astype(np.float64)


def script_form(content: EditJson) -> EditJson | None:
    """What a script keeps of an edit: nothing of the kinds that change no splat.

    The memory bank, confidences, identities and named selections are no part of it: a script is
    replayed to write splats.
    """
    if content.get("kind") in _ONLY_HISTORY:
        return None
    if content.get("kind") != "together":
        return {"op": "edit", **content}
    inside = content.get("edits")
    if not isinstance(inside, list) or not all(isinstance(edit, dict) for edit in inside):
        return None  # a damaged history: no script can do it again
    parts = [part for part in map(script_form, inside) if part is not None]
    for part in parts:
        del part["op"]
    return {"op": "edit", **content, "edits": parts} if parts else None


def recorded(edit: Edit) -> EditJson | None:
    """``edit`` as an operation of a script; None when it changes no splat."""
    return script_form(to_json(edit))


def _packed(array: AnyArray) -> str:
    """The bytes of an array, compressed, as text."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 1)).decode()


def _unpacked(text: str, dtype: str, shape: tuple[int, ...]) -> AnyArray:
    """An array of this shape; ``ValueError`` when ``text`` holds another number of values.

    No more memory than they need is taken, whatever the text holds.
    """
    count = math.prod(shape)
    if count > MOST_ROWS:
        raise ValueError(f"{count:,} values, at most {MOST_ROWS:,}")
    raw, size = base64.b64decode(text, validate=True), count * np.dtype(dtype).itemsize
    values = zlib.decompressobj().decompress(raw, size + 1)
    if len(values) != size:
        raise ValueError(f"not the {count} values that it announces")
    return np.frombuffer(values, dtype).reshape(shape).copy()
