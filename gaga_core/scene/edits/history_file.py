"""An undo history as named arrays and back, bit for bit: the file history.npz of an autosave.

Edits are written as in a script (`encode_edit`), and so is what a script leaves out: memory banks,
confidences and identities as arrays of their own, named selections as sets of splats.
"""

import logging
from collections.abc import Mapping, Sequence
from typing import Annotated, cast

import msgspec
import numpy as np
from msgspec import Struct

from gaga_core.arrays import AnyArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.json_file import decode_json
from gaga_core.scene.edits.history import HistoryRecord
from gaga_core.scene.edits.json import decode_edit, encode_edit
from gaga_core.scene.edits.packed_entries import MOST_ROWS, SetEntry
from gaga_core.scene.edits.values import (
    Edit,
    Edits,
    SetBank,
    SetConfidence,
    SetIdentities,
    SetNamedSelection,
)
from gaga_core.scene.identity_arrays import identities_of, identity_arrays
from gaga_core.scene.scene import Identities

_LOG = logging.getLogger(__name__)
EditJson = Mapping[str, object]
_Number = Annotated[int, msgspec.Meta(ge=0, le=MOST_ROWS)]  # of a bank or column in the file
_ONLY_HERE = ("bank", "confidence", "identities", "selection")  # kinds that a script does not know
_EDITS = "edits"  # the array that holds the JSON


class _HistoryFile(Struct, frozen=True):
    """Content of the array ``edits``."""

    cursor: Annotated[int, msgspec.Meta(ge=0, le=MOST_ROWS)]
    edits: list[dict[str, object]]
    forgotten: list[dict[str, object]]


class _Together(Struct, frozen=True, tag_field="kind", tag="together"):
    """Several edits that are one."""

    title: str
    edits: list[dict[str, object]]


class _BankEntry(Struct, frozen=True, tag_field="kind", tag="bank"):
    """Another memory bank; null = none."""

    title: str
    before: _Number | None
    after: _Number | None


class _ConfidenceEntry(Struct, frozen=True, tag_field="kind", tag="confidence"):
    """Other confidences; null = none."""

    title: str
    before: _Number | None
    after: _Number | None


class _IdentitiesEntry(Struct, frozen=True, tag_field="kind", tag="identities"):
    """Another source of labels."""

    title: str
    before: _Number
    after: _Number


class _SelectionEntry(Struct, frozen=True, tag_field="kind", tag="selection"):
    """Another named selection; null = none."""

    title: str
    name: str
    before: SetEntry | None
    after: SetEntry | None


_Entry = _Together | _BankEntry | _ConfidenceEntry | _IdentitiesEntry | _SelectionEntry
_KINDS: Mapping[str, type[_Entry]] = {
    "together": _Together,
    "bank": _BankEntry,
    "confidence": _ConfidenceEntry,
    "identities": _IdentitiesEntry,
    "selection": _SelectionEntry,
}


def history_arrays(record: HistoryRecord) -> dict[str, AnyArray]:
    """The history as named arrays, for `history_of`. No pickles."""
    arrays: dict[str, AnyArray] = {}
    values: dict[int, int] = {}  # number in the file of each value, by its id()
    encoded = [_encoded(edit, arrays, values) for edit in record.edits]
    content = _HistoryFile(record.cursor, encoded, list(record.forgotten))
    arrays[_EDITS] = np.frombuffer(msgspec.json.encode(content), np.uint8)
    return arrays


def history_of(arrays: Mapping[str, AnyArray]) -> tuple[HistoryRecord, int]:
    """The history of `history_arrays`, and how many of its oldest entries are left out.

    Files of splats that edits added are read again. What cannot be made again is left out, with
    what can only be undone or redone through it; a script still has it. Raises ``GagaError`` when
    the arrays are damaged.
    """
    if _EDITS not in arrays:
        raise GagaError("The history of the autosave is damaged: it has no edits.")
    content = decode_json(arrays[_EDITS].tobytes(), _HistoryFile, "The history", "")
    if content.cursor > len(content.edits):
        raise GagaError("The history of the autosave is damaged: its cursor is behind its edits.")
    banks: dict[int, MemoryBank] = {}
    edits: list[Edit] = []
    first = 0
    for i, encoded in enumerate(content.edits):
        try:
            edits.append(_decoded(encoded, arrays, banks))
        except GagaError as error:
            _LOG.warning("history: %s", error)
            if i >= content.cursor:
                break
            edits, first = [], i + 1
    lost = [_script_form(encoded) for encoded in content.edits[:first]]
    forgotten = [*content.forgotten, *({"op": "edit", **edit} for edit in lost if edit is not None)]
    return HistoryRecord(tuple(edits), content.cursor - first, tuple(forgotten)), first


def _encoded(edit: Edit, arrays: dict[str, AnyArray], values: dict[int, int]) -> dict[str, object]:
    entry: Struct
    if isinstance(edit, Edits):
        entry = _Together(edit.title, [_encoded(part, arrays, values) for part in edit.edits])
    elif isinstance(edit, SetBank):
        banks = (_numbered(bank, arrays, values) for bank in (edit.before, edit.after))
        entry = _BankEntry(edit.title, *banks)
    elif isinstance(edit, SetConfidence):
        columns = (_numbered(column, arrays, values) for column in (edit.before, edit.after))
        entry = _ConfidenceEntry(edit.title, *columns)
    elif isinstance(edit, SetIdentities):
        both = (_numbered(value, arrays, values) or 0 for value in (edit.before, edit.after))
        entry = _IdentitiesEntry(edit.title, *both)
    elif isinstance(edit, SetNamedSelection):
        sets = (None if kept is None else SetEntry.of(kept) for kept in (edit.before, edit.after))
        entry = _SelectionEntry(edit.title, edit.name, *sets)
    else:
        encoded = encode_edit(edit)
        assert encoded is not None  # every other kind changes splats
        return encoded
    return cast(dict[str, object], msgspec.to_builtins(entry))


def _numbered(
    value: MemoryBank | Identities | UInt8Array | None,
    arrays: dict[str, AnyArray],
    values: dict[int, int],
) -> int | None:
    """Number of a bank, column or identities in the file; each is written once."""
    if value is None:
        return None
    if id(value) not in values:
        number = values[id(value)] = len(values)
        if isinstance(value, MemoryBank):
            arrays |= {f"bank_{number}_{name}": a for name, a in bank_arrays(value).items()}
        elif isinstance(value, Identities):
            arrays |= {
                f"identities_{number}_{name}": a for name, a in identity_arrays(value).items()
            }
        else:
            arrays[f"confidence_{number}"] = value
    return values[id(value)]


def _decoded(
    content: EditJson, arrays: Mapping[str, AnyArray], banks: dict[int, MemoryBank]
) -> Edit:
    kind = _KINDS.get(str(content.get("kind")))
    if kind is None:
        return decode_edit(content)
    try:
        entry = msgspec.convert(content, kind)
        if isinstance(entry, _Together):
            parts = (_decoded(part, arrays, banks) for part in entry.edits)
            return Edits(entry.title, tuple(parts))
        if isinstance(entry, _BankEntry):
            both = (_bank(number, arrays, banks) for number in (entry.before, entry.after))
            return SetBank(entry.title, *both)
        if isinstance(entry, _ConfidenceEntry):
            columns = (_confidence(number, arrays) for number in (entry.before, entry.after))
            return SetConfidence(entry.title, *columns)
        if isinstance(entry, _IdentitiesEntry):
            values = (_identities(number, arrays) for number in (entry.before, entry.after))
            return SetIdentities(entry.title, *values)
        sets = (
            None if kept is None else kept.index_set(MOST_ROWS)
            for kept in (entry.before, entry.after)
        )
        return SetNamedSelection(entry.title, entry.name, *sets)
    except (KeyError, ValueError, RecursionError) as error:  # msgspec's are ValueErrors
        raise GagaError(f"An edit of the history is damaged ({error}).") from error


def _bank(
    number: int | None, arrays: Mapping[str, AnyArray], banks: dict[int, MemoryBank]
) -> MemoryBank | None:
    """The bank of a number: one value for all edits that name it."""
    if number is None:
        return None
    if number not in banks:
        head = f"bank_{number}_"
        found = {name.removeprefix(head): a for name, a in arrays.items() if name.startswith(head)}
        banks[number] = bank_of(found)
    return banks[number]


def _identities(number: int, arrays: Mapping[str, AnyArray]) -> Identities:
    head = f"identities_{number}_"
    found = {name.removeprefix(head): a for name, a in arrays.items() if name.startswith(head)}
    rows = next((len(a) for name, a in found.items() if name != "labels_from"), 0)
    return identities_of(found, rows)


def _confidence(number: int | None, arrays: Mapping[str, AnyArray]) -> UInt8Array | None:
    if number is None:
        return None
    column = arrays[f"confidence_{number}"]
    if column.dtype != np.uint8 or column.ndim != 1:
        raise ValueError(f"confidence_{number}: {column.dtype} {column.shape}")
    return column


def _script_form(content: EditJson) -> dict[str, object] | None:
    """What a script keeps of an edit: nothing of the kinds that it does not know."""
    if content.get("kind") in _ONLY_HERE:
        return None
    if content.get("kind") != "together":
        return dict(content)
    parts = [_script_form(part) for part in cast(Sequence[EditJson], content["edits"])]
    kept = [part for part in parts if part is not None]
    return {**content, "edits": kept} if kept else None
