"""Edits as JSON and back, exactly: the operation "edit" of a script, which the window records.

Numbers are written so that they are read back bit for bit, sets of splats as they are stored. The
memory bank, confidences, identities and named selections are no part of it: a script is replayed to
write splats.
"""

import binascii
import zlib
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta, Struct

from gaga_core.arrays import AnyArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.json_file import PathText, explain_json_error
from gaga_core.io.splats.spz import SilentAxes
from gaga_core.progress import run_stage
from gaga_core.scene.edits.append import read_added_stage
from gaga_core.scene.edits.append_values import AppendSplats
from gaga_core.scene.edits.folder_values import SetFolders
from gaga_core.scene.edits.frame import SetFrame
from gaga_core.scene.edits.packed_entries import (
    MOST_ROWS,
    ColumnType,
    IntsEntry,
    Row,
    SetEntry,
    TableEntry,
    packed,
    unpacked,
)
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
from gaga_core.scene.frame import Frame
from gaga_core.scene.scene import RGB, Added, State
from gaga_core.scene.splat_columns import columns_of, splats_of

_Row = tuple[float, float, float, float]
FrameRows = tuple[_Row, ...]  # of a matrix (4, 4); none = not moved
_Bits = Annotated[int, Meta(ge=0, le=255)]  # of a state
# What the values of an entry can still be, once its types are right.
_DAMAGED = (
    ValueError,
    KeyError,
    OverflowError,
    MemoryError,
    RecursionError,
    zlib.error,
    binascii.Error,
)


class EditEntry(Struct, frozen=True, tag_field="kind"):
    """An edit as it is recorded."""

    title: str

    def decoded(self, most: int) -> Edit:
        """The edit, of a scene of at most ``most`` splats; ``ValueError`` when it is damaged."""
        raise NotImplementedError


class FlipEntry(EditEntry, frozen=True, tag="flip"):
    """Bits of the state that change."""

    n: Row
    flips: list[tuple[_Bits, SetEntry]]

    def decoded(self, most: int) -> Edit:
        if self.n > most:
            raise ValueError(f"{self.n:,} splats, at most {most:,}")
        flips = tuple((bits, splats.index_set(most)) for bits, splats in self.flips)
        return FlipState(self.title, self.n, flips)


class LabelsEntry(EditEntry, frozen=True, tag="labels"):
    """Groups of splats."""

    splats: SetEntry
    before: IntsEntry
    after: IntsEntry

    def decoded(self, most: int) -> Edit:
        splats = self.splats.index_set(most)
        return SetLabels(self.title, splats, self.before.ints(most), self.after.ints(most))


class NamesEntry(EditEntry, frozen=True, tag="names"):
    """Names of groups; null = none."""

    before: list[tuple[Row, str | None]]
    after: list[tuple[Row, str | None]]

    def decoded(self, most: int) -> Edit:
        return SetNames(self.title, tuple(self.before), tuple(self.after))


class ColorEntry(EditEntry, frozen=True, tag="color"):
    """The chosen color of a group; null = none."""

    group: Row
    before: RGB | None
    after: RGB | None

    def decoded(self, most: int) -> Edit:
        return SetColor(self.title, self.group, self.before, self.after)


class FoldersEntry(EditEntry, frozen=True, tag="folders"):
    """All folders, and the groups that go into another one or under another group; null = none."""

    before: list[str]
    after: list[str]
    moved: list[tuple[Row, str | None, str | None]]
    parents: list[tuple[Row, Row | None, Row | None]] = []  # older scripts lack it

    def decoded(self, most: int) -> Edit:
        before, after = tuple(self.before), tuple(self.after)
        return SetFolders(self.title, before, after, tuple(self.moved), tuple(self.parents))


class PlacementEntry(EditEntry, frozen=True, tag="placement"):
    """Rows of the table of placements, and the splats that move to other rows."""

    n_rows: Row
    rows: list[Row]
    before: TableEntry
    after: TableEntry
    moved: SetEntry
    rows_from: list[Row]
    rows_to: list[Row]

    def decoded(self, most: int) -> Edit:
        rows, rows_from, rows_to = (
            np.array(values, np.int32) for values in (self.rows, self.rows_from, self.rows_to)
        )
        return SetPlacement(
            title=self.title,
            n_rows=self.n_rows,
            rows=rows,
            before=self.before.table(),
            after=self.after.table(),
            moved=self.moved.index_set(most),
            rows_from=rows_from,
            rows_to=rows_to,
        )


class CopiesEntry(EditEntry, frozen=True, tag="copies"):
    """Duplicates."""

    splats: SetEntry
    labels: IntsEntry
    rows: IntsEntry
    state: _Bits

    def decoded(self, most: int) -> Edit:
        splats, state = self.splats.index_set(most), State(self.state)
        return AppendCopies(self.title, splats, self.labels.ints(most), self.rows.ints(most), state)


class AddedEntry(EditEntry, frozen=True):
    """Splats that are added, whatever they are read from."""

    first: Row
    n: Row
    n_rows: Row
    n_sh: Row
    columns: list[str]
    labels: IntsEntry
    state: _Bits

    def edit(self, splats: Gaussians, added: Added) -> AppendSplats:
        """The edit that adds ``splats``; ``ValueError`` when their labels are not as many."""
        labels = self.labels.ints(MOST_ROWS)
        if labels.count != len(splats):
            raise ValueError(f"{labels.count} labels for {len(splats)} splats")
        return AppendSplats(
            title=self.title,
            n=self.n,
            n_rows=self.n_rows,
            n_sh=self.n_sh,
            columns=tuple(self.columns),
            splats=splats,
            labels=labels,
            added=added,
            state=State(self.state),
        )


class AppendEntry(AddedEntry, frozen=True, tag="append"):
    """Splats of another file, which is named by its path and fingerprint."""

    path: PathText
    fingerprint: str
    axes: SilentAxes = "RUB"  # of an .spz that does not say its own; older scripts took RUB
    frame: FrameRows = ()  # how the scene had been moved by then; older scripts lack it

    def decoded(self, most: int) -> Edit:
        path = Path(self.path)
        splats, _ = run_stage(read_added_stage(path, self.fingerprint, self.axes))
        origin = str(path), self.fingerprint, self.first, len(splats)
        return self.edit(splats, Added(*origin, self.axes, self.frame))


class ColumnEntry(Struct, frozen=True):
    """A column of splats."""

    name: str
    dtype: ColumnType
    shape: tuple[Row, ...]
    data: str  # packed


class MadeEntry(AddedEntry, frozen=True, tag="made"):
    """Splats that an edit made, with all their columns."""

    splats: list[ColumnEntry]
    frame: FrameRows = ()  # how the scene had been moved by then; older scripts lack it
    merged: bool = False  # made of splats that were deleted for it; older scripts lack it

    def decoded(self, most: int) -> Edit:
        splats = splats_of({c.name: unpacked(c.data, c.dtype, c.shape) for c in self.splats})
        added = Added("", "", self.first, len(splats), frame=self.frame, is_merged=self.merged)
        return self.edit(splats, added)


class FrameState(Struct, frozen=True):
    """How the whole scene was moved."""

    world: tuple[_Row, _Row, _Row, _Row]
    is_metric: bool

    @staticmethod
    def of(frame: Frame) -> "FrameState":
        """The form of a frame."""
        a, b, c, d = frame.world.tolist()
        return FrameState((tuple(a), tuple(b), tuple(c), tuple(d)), frame.is_metric)

    def frame(self) -> Frame:
        """The frame; ``ValueError`` when it is none."""
        return Frame(np.array(self.world, np.float64), self.is_metric)


class FrameEntry(EditEntry, frozen=True, tag="frame"):
    """A motion of the whole scene."""

    before: FrameState
    after: FrameState

    def decoded(self, most: int) -> Edit:
        return SetFrame(self.title, self.before.frame(), self.after.frame())


class TogetherEntry(EditEntry, frozen=True, tag="together"):
    """Several edits that are one."""

    edits: list["AnyEntry"]

    def decoded(self, most: int) -> Edit:
        return Edits(self.title, tuple(entry.decoded(most) for entry in self.edits))


AnyEntry = (
    FlipEntry
    | LabelsEntry
    | NamesEntry
    | ColorEntry
    | FoldersEntry
    | PlacementEntry
    | CopiesEntry
    | AppendEntry
    | MadeEntry
    | FrameEntry
    | TogetherEntry
)


def encode_edit(edit: Edit) -> dict[str, object] | None:
    """``edit`` as values that `json.dumps` takes; None when it changes no splat.

    Raises ``TypeError`` for a kind of edit that has no form here.
    """
    entry = _entry(edit)
    if entry is None:
        return None
    return msgspec.json.decode(msgspec.json.encode(entry), type=dict[str, object])


def decode_edit(content: object, most_rows: int = MOST_ROWS) -> Edit:
    """The edit that `encode_edit` wrote, of a scene of at most ``most_rows`` splats.

    Raises ``GagaError`` when the content is damaged or asks for more rows: before memory is taken.
    """
    try:
        entry: AnyEntry = msgspec.convert(content, AnyEntry)
        return entry.decoded(most_rows)
    except _DAMAGED as error:  # msgspec's are ValueErrors
        raise GagaError(
            f"A recorded edit of the script is damaged ({explain_json_error(error)}). "
            "Record it again."
        ) from error


def _entry(edit: Edit) -> AnyEntry | None:
    if isinstance(edit, SetBank | SetConfidence | SetIdentities | SetNamedSelection):
        return None
    if isinstance(edit, Edits):
        parts = [entry for entry in map(_entry, edit.edits) if entry is not None]
        return TogetherEntry(edit.title, parts) if parts else None
    if isinstance(edit, FlipState):
        flips = [(int(bits), SetEntry.of(splats)) for bits, splats in edit.flips]
        return FlipEntry(edit.title, edit.n, flips)
    if isinstance(edit, SetLabels):
        before, after = IntsEntry.of(edit.before), IntsEntry.of(edit.after)
        return LabelsEntry(edit.title, SetEntry.of(edit.splats), before, after)
    if isinstance(edit, SetNames):
        return NamesEntry(edit.title, list(edit.before), list(edit.after))
    if isinstance(edit, SetColor):
        return ColorEntry(edit.title, edit.group, edit.before, edit.after)
    if isinstance(edit, SetPlacement):
        return PlacementEntry(
            edit.title,
            edit.n_rows,
            edit.rows.tolist(),
            TableEntry.of(edit.before),
            TableEntry.of(edit.after),
            SetEntry.of(edit.moved),
            edit.rows_from.tolist(),
            edit.rows_to.tolist(),
        )
    return _rare_entry(edit)


def _rare_entry(edit: Edit) -> AnyEntry:
    if isinstance(edit, AppendCopies):
        labels, rows = IntsEntry.of(edit.labels), IntsEntry.of(edit.rows)
        return CopiesEntry(edit.title, SetEntry.of(edit.splats), labels, rows, int(edit.state))
    if isinstance(edit, AppendSplats):
        return _append_entry(edit)
    if isinstance(edit, SetFolders):
        before, after = list(edit.before), list(edit.after)
        return FoldersEntry(edit.title, before, after, list(edit.moved), list(edit.parents))
    if isinstance(edit, SetFrame):
        return FrameEntry(edit.title, FrameState.of(edit.before), FrameState.of(edit.after))
    raise TypeError(f"edit: {type(edit).__name__} has no recorded form")


def _append_entry(edit: AppendSplats) -> AppendEntry | MadeEntry:
    added, labels = edit.added, IntsEntry.of(edit.labels)
    sizes = added.first, edit.n, edit.n_rows, edit.n_sh, list(edit.columns)
    common = edit.title, *sizes, labels, int(edit.state)
    if added.is_made:
        columns = [_column_entry(*column) for column in columns_of(edit.splats).items()]
        return MadeEntry(*common, columns, added.frame, added.is_merged)
    return AppendEntry(*common, added.path, added.fingerprint, added.axes, added.frame)


def _column_entry(name: str, column: AnyArray) -> ColumnEntry:
    dtype: ColumnType = str(column.dtype)  # type: ignore[assignment]
    return ColumnEntry(name, dtype, column.shape, packed(column))
