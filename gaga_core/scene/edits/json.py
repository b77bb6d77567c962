"""Edits as JSON and back, exactly: the operation "edit" of a script, which the window records.

Numbers are written so that they are read back bit for bit, sets of splats as they are stored. The
memory bank, confidences, identities and named selections are no part of it: a script is replayed to
write splats.
"""

import base64
import binascii
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.scene.edits.append import read_added_stage
from gaga_core.scene.edits.append_values import AppendSplats
from gaga_core.scene.edits.placement_values import AppendCopies, SetPlacement
from gaga_core.scene.edits.values import (
    Edit,
    Edits,
    FlipState,
    SetBank,
    SetColor,
    SetConfidence,
    SetIdentities,
    SetLabels,
    SetNamedSelection,
    SetNames,
)
from gaga_core.scene.index_set import IndexSet, PackedInts, Storage
from gaga_core.scene.scene import RGB, Added, Placements, State

EditJson = Mapping[str, object]
MOST_ROWS = (1 << 31) - 1  # rows are int32
_MOST_BITS = 255  # of a state
_DAMAGED = (
    KeyError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
    MemoryError,
    RecursionError,
    zlib.error,
    binascii.Error,
)
_DTYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64")


def encode_edit(edit: Edit) -> dict[str, object] | None:
    """``edit`` as values that `json.dumps` takes; None when it changes no splat.

    Raises ``TypeError`` for a kind of edit that has no form here.
    """
    if isinstance(edit, SetBank | SetConfidence | SetIdentities | SetNamedSelection):
        return None
    if isinstance(edit, Edits):
        parts = [part for part in map(encode_edit, edit.edits) if part is not None]
        return {"kind": "together", "title": edit.title, "edits": parts} if parts else None
    head = {"kind": _kind(edit), "title": edit.title}
    if isinstance(edit, FlipState):
        flips = [[bits, encode_set(splats)] for bits, splats in edit.flips]
        return {**head, "n": edit.n, "flips": flips}
    if isinstance(edit, SetLabels):
        ints = {"before": _ints(edit.before), "after": _ints(edit.after)}
        return {**head, "splats": encode_set(edit.splats), **ints}
    if isinstance(edit, SetNames):
        return {
            **head,
            "before": list(map(list, edit.before)),
            "after": list(map(list, edit.after)),
        }
    if isinstance(edit, SetColor):
        return {**head, "group": edit.group, "before": edit.before, "after": edit.after}
    if isinstance(edit, SetPlacement):
        return {
            **head,
            "n_rows": edit.n_rows,
            "rows": edit.rows.tolist(),
            "before": _table(edit.before),
            "after": _table(edit.after),
            "moved": encode_set(edit.moved),
            "rows_from": edit.rows_from.tolist(),
            "rows_to": edit.rows_to.tolist(),
        }
    if isinstance(edit, AppendSplats):
        return {**head, **_appended(edit)}
    assert isinstance(edit, AppendCopies)
    ints = {"labels": _ints(edit.labels), "rows": _ints(edit.rows)}
    return {**head, "splats": encode_set(edit.splats), **ints, "state": int(edit.state)}


def decode_edit(content: object, most_rows: int = MOST_ROWS) -> Edit:
    """The edit that `encode_edit` wrote, of a scene of at most ``most_rows`` splats.

    Raises ``GagaError`` when the content is damaged or asks for more rows: before memory is taken.
    """
    try:
        return _decoded(cast(EditJson, content), most_rows)
    except _DAMAGED as error:
        raise GagaError(
            f"A recorded edit of the script is damaged ({error}). Record it again."
        ) from error


def _decoded(content: EditJson, most: int) -> Edit:
    kind, title = content["kind"], str(content["title"])
    if kind == "together":
        return Edits(
            title,
            tuple(_decoded(part, most) for part in cast(Sequence[EditJson], content["edits"])),
        )
    if kind == "flip":
        flips = cast(Sequence[Sequence[object]], content["flips"])
        return FlipState(
            title,
            _count(content["n"], most),
            tuple((_count(bits, _MOST_BITS), decode_set(splats, most)) for bits, splats in flips),
        )
    if kind == "names":
        return SetNames(title, _names(content["before"]), _names(content["after"]))
    if kind == "color":
        before, after = _color(content["before"]), _color(content["after"])
        return SetColor(title, _count(content["group"]), before, after)
    if kind == "labels":
        return SetLabels(
            title,
            decode_set(content["splats"], most),
            _ints_of(content["before"], most),
            _ints_of(content["after"], most),
        )
    if kind == "copies":
        return AppendCopies(
            title,
            decode_set(content["splats"], most),
            _ints_of(content["labels"], most),
            _ints_of(content["rows"], most),
            State(_count(content["state"], _MOST_BITS)),
        )
    if kind == "append":
        return _append_of(title, content)
    if kind == "placement":
        return SetPlacement(
            title=title,
            n_rows=_count(content["n_rows"]),
            rows=_rows(content["rows"]),
            before=_table_of(content["before"]),
            after=_table_of(content["after"]),
            moved=decode_set(content["moved"], most),
            rows_from=_rows(content["rows_from"]),
            rows_to=_rows(content["rows_to"]),
        )
    raise ValueError(f"kind {kind!r}")


_KINDS: Mapping[type, str] = {
    FlipState: "flip",
    SetLabels: "labels",
    SetNames: "names",
    SetColor: "color",
    SetPlacement: "placement",
    AppendCopies: "copies",
    AppendSplats: "append",
}


def _kind(edit: Edit) -> str:
    if type(edit) not in _KINDS:
        raise TypeError(f"edit: {type(edit).__name__} has no recorded form")
    return _KINDS[type(edit)]


def _appended(edit: AppendSplats) -> dict[str, object]:
    """The splats are named, not written: by their file and its fingerprint."""
    added = edit.added
    return {
        "path": added.path,
        "fingerprint": added.fingerprint,
        "first": added.first,
        "n": edit.n,
        "n_rows": edit.n_rows,
        "n_sh": edit.n_sh,
        "columns": list(edit.columns),
        "labels": _ints(edit.labels),
        "state": int(edit.state),
    }


def _append_of(title: str, content: EditJson) -> AppendSplats:
    path, digest = Path(str(content["path"])), str(content["fingerprint"])
    splats, _ = run_stage(read_added_stage(path, digest))
    labels = _ints_of(content["labels"], MOST_ROWS)
    if labels.count != len(splats):
        raise ValueError(f"{labels.count} labels for {len(splats)} splats")
    return AppendSplats(
        title=title,
        n=_count(content["n"]),
        n_rows=_count(content["n_rows"]),
        n_sh=_count(content["n_sh"]),
        columns=tuple(map(str, cast(Sequence[object], content["columns"]))),
        splats=splats,
        labels=labels,
        added=Added(str(path), digest, _count(content["first"]), len(splats)),
        state=State(_count(content["state"], _MOST_BITS)),
    )


# --- arrays -------------------------------------------------------------------------------------


def _packed(array: AnyArray) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).tobytes(), 1)).decode()


def _unpacked(text: object, dtype: str, count: int) -> AnyArray:
    """``count`` values; no more memory than they need is taken, whatever the text holds."""
    packed, size = (
        base64.b64decode(cast(str, text), validate=True),
        count * np.dtype(dtype).itemsize,
    )
    raw = zlib.decompressobj().decompress(packed, size + 1)
    if len(raw) != size:
        raise ValueError(f"not the {count} values that it announces")
    array: AnyArray = np.frombuffer(raw, dtype).copy()
    return array


def encode_set(splats: IndexSet) -> dict[str, object]:
    """A set of splats as it is stored."""
    values: object = splats.data.tolist() if splats.form is Storage.RUNS else _packed(splats.data)
    return {"n": splats.n, "count": splats.count, splats.form.value: values}


def decode_set(content: object, most: int) -> IndexSet:
    """The set of `encode_set`, of a scene of at most ``most`` splats.

    Raises ``ValueError``, ``KeyError`` or ``TypeError`` when it is damaged.
    """
    values = cast(EditJson, content)
    n = _count(values["n"], most)
    count = _count(values["count"], n)
    if "runs" in values:
        runs = np.asarray(values["runs"], np.int64).reshape(-1, 2)
        if (runs < 0).any() or (runs > n).any() or (runs[:, 1] - runs[:, 0]).sum() != count:
            raise ValueError(f"a set of {count} splats of {n}")
        pieces = [np.arange(start, stop) for start, stop in runs]
        rows = np.concatenate([np.zeros(0, np.int64), *pieces])
    elif "list" in values:
        rows = _unpacked(values["list"], "int32", count).astype(np.int64)
    else:
        rows = np.flatnonzero(
            np.unpackbits(_unpacked(values["bits"], "uint8", -(-n // 8)), count=n)
        )
    ordered = len(rows) == 0 or (rows[0] >= 0 and rows[-1] < n and bool((np.diff(rows) > 0).all()))
    if not ordered or len(rows) != count:
        raise ValueError(f"a set of {count} splats of {n}")
    return IndexSet.of(rows, n)


def _ints(values: PackedInts) -> dict[str, object]:
    if values.data.ndim == 0:
        return {"count": values.count, "all": int(values.data)}
    return {"count": values.count, "dtype": str(values.data.dtype), "data": _packed(values.data)}


def _ints_of(content: object, most: int) -> PackedInts:
    values = cast(EditJson, content)
    count = _count(values["count"], most)
    if "all" in values:
        return PackedInts(count, np.array(values["all"], np.int32))
    if values["dtype"] not in _DTYPES:
        raise ValueError(f"dtype {values['dtype']!r}")
    return PackedInts(count, _unpacked(values["data"], str(values["dtype"]), count))


def _table(table: Placements) -> dict[str, object]:
    return {
        "matrix": table.matrix.tolist(),
        "color": table.color.tolist(),
        "opacity": table.opacity.tolist(),
    }


def _table_of(content: object) -> Placements:
    values = cast(EditJson, content)
    opacity = np.asarray(values["opacity"], np.float64).reshape(-1)
    shape = (len(opacity), 3, 4)
    matrix = np.asarray(values["matrix"], np.float64).reshape(shape)
    return Placements(matrix, np.asarray(values["color"], np.float64).reshape(shape), opacity)


def _rows(content: object) -> IntArray:
    rows = np.asarray(content, np.int64).reshape(-1)
    if (rows < 0).any():
        raise ValueError("a negative row")
    return rows.astype(np.int32)


def _color(content: object) -> RGB | None:
    if content is None:
        return None
    red, green, blue = (float(value) for value in cast(Sequence[float], content))
    return red, green, blue


def _names(content: object) -> tuple[tuple[int, str | None], ...]:
    pairs = cast(Sequence[Sequence[object]], content)
    return tuple((_count(group), None if name is None else str(name)) for group, name in pairs)


def _count(value: object, most: int = MOST_ROWS) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise ValueError(f"{value!r} where a whole number up to {most:,} belongs")
    return value
