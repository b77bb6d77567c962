"""Undo and redo: a list of edits and a cursor, bounded in bytes, not in number.

As named arrays and back, bit for bit, it is the file history.npz of an autosave: edits are written
as in a script, and so is what a script leaves out; memory banks, confidences and identities are
arrays of their own, each written once.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from msgspec import Struct

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.grouping.bank_file import bank_arrays, bank_of
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.arrays_file import Column, checked
from gaga_core.io.json_file import decode_json
from gaga_core.scene.edits.values import Edit, Row, SetPlacement, after_selections, is_selection
from gaga_core.scene.edits.wire import EditJson, of_json, recorded, script_form, to_json
from gaga_core.scene.named_arrays import identities_of, identity_arrays
from gaga_core.scene.scene import Identities, Scene

DEFAULT_BUDGET = 1_024_000_000  # bytes; what the settings of the window start with, too


@dataclass(frozen=True)
class HistoryEntry:
    """One line of the history panel."""

    title: str
    nbytes: int
    done: bool  # False: undone, waiting for redo
    is_selection: bool = False  # changes what is selected and nothing else


@dataclass(frozen=True, eq=False)
class _Step:
    edit: Edit
    serial: int  # names the state after it
    nbytes: int

    @staticmethod
    def of(edit: Edit, serial: int) -> "_Step":
        return _Step(edit, serial, edit.nbytes)


@dataclass(frozen=True, eq=False)
class HistoryRecord:
    """A history as values, which a worker may write to a file."""

    edits: tuple[Edit, ...]  # oldest first
    cursor: int  # how many of them are done
    forgotten: tuple[EditJson, ...]  # recorded form of what undo has forgotten


class History:
    """The only one who applies edits to ``scene``.

    A preview is an edit that is applied but has no entry: the frames of a drag. An edit built
    while a preview is on must be built against `base`, the scene without it (`preview_with` does).
    """

    def __init__(self, scene: Scene, budget_bytes: int = DEFAULT_BUDGET) -> None:
        self._scene = scene
        self._budget = budget_bytes
        self._steps: list[_Step] = []
        self._cursor = 0
        self._serial = 0  # of the newest step ever made
        self._base_serial = 0  # of the state before the oldest step that is kept
        self._preview: Edit | None = None
        self._base: Scene | None = None
        self._dropped: list[EditJson] = []  # recorded form of what undo has forgotten

    # --- reading

    @property
    def cursor(self) -> int:
        """Number of entries that are done."""
        return self._cursor

    @property
    def can_undo(self) -> bool:
        """Whether there is an entry to undo."""
        return self._cursor > 0

    @property
    def can_redo(self) -> bool:
        """Whether there is an entry to redo."""
        return self._cursor < len(self._steps)

    @property
    def undo_title(self) -> str:
        """Title of what `undo` would take back; empty if nothing."""
        return self._steps[self._cursor - 1].edit.title if self.can_undo else ""

    @property
    def redo_title(self) -> str:
        """Title of what `redo` would do again; empty if nothing."""
        return self._steps[self._cursor].edit.title if self.can_redo else ""

    @property
    def state_id(self) -> int:
        """Number of the present state: equal again after undo and redo (0 = as opened).

        "Unsaved" is ``state_id`` differing from its value when the project was saved.
        """
        return self._steps[self._cursor - 1].serial if self._cursor else self._base_serial

    @property
    def nbytes(self) -> int:
        """Bytes of all entries."""
        return sum(step.nbytes for step in self._steps)

    @property
    def budget(self) -> int:
        """Bytes that the entries may hold; the oldest are forgotten first."""
        return self._budget

    def set_budget(self, budget_bytes: int) -> None:
        """Hold at most so many bytes from now on; undone entries go before done ones."""
        if budget_bytes <= 0:
            raise ValueError(f"budget_bytes: expected more than 0, got {budget_bytes}")
        self._budget = budget_bytes
        self._keep_budget()

    @property
    def is_previewing(self) -> bool:
        """Whether a preview is applied."""
        return self._preview is not None

    @property
    def preview_edit(self) -> Edit | None:
        """The edit that is shown as a preview."""
        return self._preview

    @property
    def base(self) -> Scene:
        """The scene without the preview (a snapshot while one is on, else the scene itself)."""
        return self._scene if self._base is None else self._base

    @property
    def state_ids(self) -> tuple[int, ...]:
        """`state_id` before the oldest entry and after each one."""
        return (self._base_serial, *(step.serial for step in self._steps))

    def record(self) -> HistoryRecord:
        """The entries and the cursor as values, for `resume`."""
        edits = tuple(step.edit for step in self._steps)
        return HistoryRecord(edits, self._cursor, tuple(self._dropped))

    def entries(self) -> tuple[HistoryEntry, ...]:
        """All entries, oldest first."""
        return tuple(
            HistoryEntry(step.edit.title, step.nbytes, i < self._cursor, is_selection(step.edit))
            for i, step in enumerate(self._steps)
        )

    @property
    def is_recorded(self) -> bool:
        """Whether `recorded` has an edit."""
        return self.can_undo or len(self._dropped) > 0

    def recorded(self) -> list[EditJson]:
        """All that is done since the scene was opened, as a script for ``gaga edit``.

        What the byte budget has taken from undo is still here, in its packed form.
        """
        return [*self._dropped, *_recorded(self._steps[: self._cursor])]

    # --- changing

    def do(self, edit: Edit | None) -> bool:
        """Apply ``edit`` and make it an entry; None does nothing.

        What was undone is forgotten, unless ``edit`` only selects: redo brings back the selection
        that there was, and goes on from there, bit for bit.
        """
        self.preview(None)
        if edit is None:
            return False
        edit.apply(self._scene)
        self._push(edit)
        return True

    def undo(self) -> str | None:
        """Take the newest entry back; its title, or None if there is none."""
        self.preview(None)
        if not self.can_undo:
            return None
        edit = self._steps[self._cursor - 1].edit
        with _damage(edit):
            edit.revert(self._scene)
        self._cursor -= 1
        return edit.title

    def redo(self) -> str | None:
        """Do the next undone entry again; its title, or None if there is none."""
        self.preview(None)
        if not self.can_redo:
            return None
        edit = self._steps[self._cursor].edit
        with _damage(edit):
            edit.apply(self._scene)
        self._cursor += 1
        return edit.title

    def go_to(self, cursor: int) -> None:
        """Undo or redo until ``cursor`` entries are done (a click in the history panel)."""
        if not 0 <= cursor <= len(self._steps):
            raise ValueError(f"cursor: expected 0..{len(self._steps)}, got {cursor}")
        while self._cursor > cursor:
            self.undo()
        while self._cursor < cursor:
            self.redo()

    def resume(self, record: HistoryRecord) -> None:
        """Take the entries of another history, whose scene was what this one is now, bit for bit.

        `state_ids` are 0, 1, 2 and so on then. Raises ``ValueError`` when there are entries here.
        """
        if self._serial:
            raise ValueError("resume: expected a history without entries")
        self._steps = [_Step.of(edit, i + 1) for i, edit in enumerate(record.edits)]
        self._cursor, self._serial = record.cursor, len(record.edits)
        self._dropped = list(record.forgotten)
        self.set_budget(self._budget)

    def clear(self) -> None:
        """Forget all entries; the scene stays as it is, and so does the recording."""
        self.preview(None)
        self._dropped = self.recorded()
        self._base_serial = self.state_id
        self._steps.clear()
        self._cursor = 0

    # --- preview

    def preview(self, edit: Edit | None) -> None:
        """Replace the preview by ``edit`` (built against `base`); None drops it."""
        former = self._preview
        if (
            isinstance(former, SetPlacement)
            and isinstance(edit, SetPlacement)
            and former.same_rows(edit)
        ):
            # A drag: only numbers of a few rows change, so the columns of all splats stay put.
            edit.rewrite(self._scene)
            self._preview = edit
            return
        if former is not None:
            former.revert(self._scene)
            self._preview = self._base = None
        if edit is not None:
            base = replace(self._scene)
            edit.apply(self._scene)
            self._preview, self._base = edit, base

    def preview_with(self, build: Callable[[Scene], Edit | None]) -> None:
        """Replace the preview by the edit that ``build`` makes of the scene without it."""
        self.preview(build(self.base))

    def commit_preview(self) -> bool:
        """Make the preview an entry (it is applied already); False if there is none."""
        edit = self._preview
        if edit is None:
            return False
        self._preview = self._base = None
        self._push(edit)
        return True

    def _push(self, edit: Edit) -> None:
        undone = self._steps[self._cursor :] if is_selection(edit) else []
        self._serial += 1
        self._steps[self._cursor :] = [_Step.of(edit, self._serial), *_after(edit, undone)]
        self._cursor += 1
        self._keep_budget()

    def _keep_budget(self) -> None:
        """Forget what was undone, then the oldest; the newest entry always stays."""
        total = self.nbytes
        if total > self._budget:
            del self._steps[self._cursor :]
            total = self.nbytes
        dropped = 0
        while total > self._budget and dropped < len(self._steps) - 1:
            total -= self._steps[dropped].nbytes
            dropped += 1
        if dropped:
            self._base_serial = self._steps[dropped - 1].serial
            self._dropped += _recorded(self._steps[:dropped])
            del self._steps[:dropped]
            self._cursor = max(self._cursor - dropped, 0)


def _after(selection: Edit, undone: Sequence[_Step]) -> list[_Step]:
    """What can still be redone after a selection: all from the first edit of ``undone`` on.

    That one takes the selection back first, and makes the selections that it was made after.
    """
    first = next((i for i, step in enumerate(undone) if not is_selection(step.edit)), None)
    if first is None:
        return []
    step = undone[first]
    edit = after_selections((selection, *(former.edit for former in undone[:first])), step.edit)
    return [_Step.of(edit, step.serial), *undone[first + 1 :]]


@contextmanager
def _damage(edit: Edit) -> Iterator[None]:
    """Turn what a step raises that came with a damaged history into one sentence."""
    try:
        yield
    except (ValueError, TypeError, LookupError, OverflowError, MemoryError) as error:
        raise GagaError(
            f'The step "{edit.title}" is damaged ({error}), so it changes nothing. '
            "Continue from here: a new edit replaces it."
        ) from error


def _recorded(steps: Iterable[_Step]) -> list[EditJson]:
    return [edit for edit in (recorded(step.edit) for step in steps) if edit is not None]


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
