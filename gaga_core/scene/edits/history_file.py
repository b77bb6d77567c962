"""An undo history as named arrays and back, bit for bit: the file history.npz of an autosave.

Edits are written as in a script (`encode_edit`), and so is what a script leaves out: memory banks,
confidences and identities as arrays of their own, named selections as sets of splats.
"""

import logging
from collections.abc import Mapping, Sequence
from typing import Annotated, cast

import msgspec
import numpy as np

from gaga_core.arrays import AnyArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.json_file import decode_json
from gaga_core.scene.edits.history import HistoryRecord
from gaga_core.scene.edits.json import (
    MOST_ROWS,
    EditJson,
    decode_edit,
    decode_set,
    encode_edit,
    encode_set,
)
from gaga_core.scene.edits.values import (
    Edit,
    Edits,
    SetBank,
    SetConfidence,
    SetIdentities,
    SetNamedSelection,
)
from gaga_core.scene.identity_arrays import identities_of, identity_arrays
from gaga_core.scene.index_set import IndexSet
from gaga_core.scene.scene import Identities

_LOG = logging.getLogger(__name__)
_ONLY_HERE = ("bank", "confidence", "identities", "selection")  # kinds that a script does not know
_EDITS = "edits"  # the array that holds the JSON


class _HistoryFile(msgspec.Struct, frozen=True):
    """Content of the array ``edits``."""

    cursor: Annotated[int, msgspec.Meta(ge=0, le=MOST_ROWS)]
    edits: list[dict[str, object]]
    forgotten: list[dict[str, object]]


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
    if isinstance(edit, Edits):
        parts = [_encoded(part, arrays, values) for part in edit.edits]
        return {"kind": "together", "title": edit.title, "edits": parts}
    if isinstance(edit, SetBank):
        pair = [_numbered(bank, arrays, values) for bank in (edit.before, edit.after)]
        return {"kind": "bank", "title": edit.title, "before": pair[0], "after": pair[1]}
    if isinstance(edit, SetConfidence):
        pair = [_numbered(column, arrays, values) for column in (edit.before, edit.after)]
        return {"kind": "confidence", "title": edit.title, "before": pair[0], "after": pair[1]}
    if isinstance(edit, SetIdentities):
        pair = [_numbered(value, arrays, values) for value in (edit.before, edit.after)]
        return {"kind": "identities", "title": edit.title, "before": pair[0], "after": pair[1]}
    if isinstance(edit, SetNamedSelection):
        sets = [None if kept is None else encode_set(kept) for kept in (edit.before, edit.after)]
        head = {"kind": "selection", "title": edit.title, "name": edit.name}
        return {**head, "before": sets[0], "after": sets[1]}
    encoded = encode_edit(edit)
    assert encoded is not None  # every other kind changes splats
    return encoded


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
    try:
        kind, title = content["kind"], str(content["title"])
        if kind == "together":
            parts = cast(Sequence[EditJson], content["edits"])
            return Edits(title, tuple(_decoded(part, arrays, banks) for part in parts))
        if kind not in _ONLY_HERE:
            return decode_edit(content)
        before, after = content["before"], content["after"]
        if kind == "bank":
            return SetBank(title, _bank(before, arrays, banks), _bank(after, arrays, banks))
        if kind == "confidence":
            return SetConfidence(title, _confidence(before, arrays), _confidence(after, arrays))
        if kind == "identities":
            return SetIdentities(title, _identities(before, arrays), _identities(after, arrays))
        return SetNamedSelection(title, str(content["name"]), _selection(before), _selection(after))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise GagaError(f"An edit of the history is damaged ({error}).") from error


def _bank(
    number: object, arrays: Mapping[str, AnyArray], banks: dict[int, MemoryBank]
) -> MemoryBank | None:
    """The bank of a number: one value for all edits that name it."""
    if not isinstance(number, int):
        return None
    if number not in banks:
        head = f"bank_{number}_"
        found = {name.removeprefix(head): a for name, a in arrays.items() if name.startswith(head)}
        banks[number] = bank_of(found)
    return banks[number]


def _identities(number: object, arrays: Mapping[str, AnyArray]) -> Identities:
    head = f"identities_{number}_"
    found = {name.removeprefix(head): a for name, a in arrays.items() if name.startswith(head)}
    rows = next((len(a) for name, a in found.items() if name != "labels_from"), 0)
    return identities_of(found, rows)


def _confidence(number: object, arrays: Mapping[str, AnyArray]) -> UInt8Array | None:
    if number is None:
        return None
    column = arrays[f"confidence_{number}"]
    if column.dtype != np.uint8 or column.ndim != 1:
        raise ValueError(f"confidence_{number}: {column.dtype} {column.shape}")
    return column


def _selection(content: object) -> IndexSet | None:
    return None if content is None else decode_set(content, MOST_ROWS)


def _script_form(content: EditJson) -> dict[str, object] | None:
    """What a script keeps of an edit: nothing of the kinds that it does not know."""
    if content.get("kind") in _ONLY_HERE:
        return None
    if content.get("kind") != "together":
        return dict(content)
    parts = [_script_form(part) for part in cast(Sequence[EditJson], content["edits"])]
    kept = [part for part in parts if part is not None]
    return {**content, "edits": kept} if kept else None
