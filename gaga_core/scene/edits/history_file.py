"""An undo history as named arrays and back, bit for bit: the file history.npz of an autosave.

Edits are written as in a script, and so is what a script leaves out; memory banks, confidences and
identities are arrays of their own, each written once.
"""

import logging
from collections.abc import Mapping

import msgspec
import numpy as np
from msgspec import Struct

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.arrays_file import Column, checked
from gaga_core.io.json_file import decode_json
from gaga_core.scene.edits.history import HistoryRecord
from gaga_core.scene.edits.values import Edit, Row
from gaga_core.scene.edits.wire import EditJson, of_json, script_form, to_json
from gaga_core.scene.named_arrays import identities_of, identity_arrays
from gaga_core.scene.scene import Identities

_LOG = logging.getLogger(__name__)
_EDITS = "edits"  # the array that holds the JSON


class _HistoryFile(Struct, frozen=True):
    """Content of the array ``edits``."""

    cursor: Row
    edits: list[EditJson]
    forgotten: list[EditJson]


def history_arrays(record: HistoryRecord) -> dict[str, AnyArray]:
    """The history as named arrays, for `history_of`. No pickles."""
    arrays: dict[str, AnyArray] = {}
    numbers: dict[int, int] = {}  # number in the file of each value, by its id()

    def number(value: object) -> int:
        if id(value) not in numbers:
            n = numbers[id(value)] = len(numbers)
            if isinstance(value, MemoryBank):
                arrays.update({f"bank_{n}_{name}": a for name, a in bank_arrays(value).items()})
            elif isinstance(value, Identities):
                found = identity_arrays(value).items()
                arrays.update({f"identities_{n}_{name}": a for name, a in found})
            else:
                arrays[f"confidence_{n}"] = np.asarray(value)
        return numbers[id(value)]

    encoded = [to_json(edit, number) for edit in record.edits]
    content = _HistoryFile(record.cursor, encoded, list(record.forgotten))
    arrays[_EDITS] = np.frombuffer(msgspec.json.encode(content), np.uint8)
    return arrays


def history_of(arrays: Mapping[str, AnyArray]) -> tuple[HistoryRecord, int]:
    """The history of `history_arrays`, and how many of its oldest entries are left out.

    Files of splats that edits added are read again. What cannot be made again is left out, with
    what can only be undone or redone through it; a script still has it. Raises ``GagaError`` when
    the arrays are damaged.
    """
    try:
        raw = checked(arrays, {_EDITS: Column(np.uint8, ("bytes",))})[_EDITS].tobytes()
    except ValueError as error:
        raise GagaError(f"The history of the autosave is damaged ({error}).") from error
    content = decode_json(raw, _HistoryFile, "The history", "")
    if content.cursor > len(content.edits):
        raise GagaError("The history of the autosave is damaged: its cursor is behind its edits.")
    values: dict[tuple[str, int], object] = {}

    def kept(kind: object, number: int) -> object:
        """The value of a number: one for all edits that name it."""
        key = str(kind), number
        if key not in values:
            values[key] = _kept(kind, number, arrays)
        return values[key]

    edits: list[Edit] = []
    first = 0
    for i, encoded in enumerate(content.edits):
        try:
            edits.append(of_json(encoded, kept=kept))
        except GagaError as error:
            _LOG.warning("history: %s", error)
            if i >= content.cursor:
                break
            edits, first = [], i + 1
    lost = [edit for edit in map(script_form, content.edits[:first]) if edit is not None]
    forgotten = (*content.forgotten, *lost)
    return HistoryRecord(tuple(edits), content.cursor - first, forgotten), first


def _kept(kind: object, number: int, arrays: Mapping[str, AnyArray]) -> object:
    """A value of a type and number. Raises ``KeyError`` or ``ValueError`` when it is damaged."""
    if kind not in (MemoryBank, Identities):
        name = f"confidence_{number}"
        return checked(arrays, {name: Column(np.uint8, ("M",))})[name]
    head = f"{'bank' if kind is MemoryBank else 'identities'}_{number}_"
    found = {name.removeprefix(head): a for name, a in arrays.items() if name.startswith(head)}
    if kind is MemoryBank:
        return bank_of(found)
    return identities_of(found)
