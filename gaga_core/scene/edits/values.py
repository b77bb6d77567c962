"""The edits of undo entries: values, each with its exact inverse.

One description serves undo, autosaves and scripts: an edit is a msgspec struct whose field ``kind``
names it in files, written and read by `gaga_core.scene.edits.wire`.

Columns of a scene are replaced, never written in place: a worker thread or an export that holds a
shallow copy of the scene (``dataclasses.replace(scene)``) keeps a consistent snapshot for free. It
also means that an edit that fails half-way has changed nothing.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Generic, Self, TypeVar

import numpy as np
from msgspec import Meta, Struct, field

from gaga_core.arrays import MOST_GROUP, AnyArray, FloatArray, IntArray, LongArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.io.files import is_file
from gaga_core.io.json_file import PathText
from gaga_core.io.splats.splat_files import is_same_model, model_fingerprint, read_splats_stage
from gaga_core.io.splats.spz import OURS, SilentAxes
from gaga_core.progress import Stage, run_stage
from gaga_core.scene.folders import Folders
from gaga_core.scene.frame import Frame
from gaga_core.scene.index_set import IndexSet, PackedInts
from gaga_core.scene.scene import RGB, Added, Identities, Placements, Scene, State, Weight

_K = TypeVar("_K", int, str)
_V = TypeVar("_V")
_T = TypeVar("_T")
MOST_ROWS = (1 << 31) - 1  # rows are int32
Row = Annotated[int, Meta(ge=0, le=MOST_ROWS)]
Group = Annotated[int, Meta(ge=0, le=MOST_GROUP)]
Bits = Annotated[int, Meta(ge=0, le=255)]  # of `State`
FrameRows = tuple[tuple[float, float, float, float], ...]  # of a matrix (4, 4); none = not moved


class Kept(Generic[_T]):
    """A frozen value of the scene that many edits share."""

    def __init__(self, value: _T) -> None:
        self.value = value


class Edit(Struct, frozen=True, eq=False, tag_field="kind"):
    """A change of a scene and its inverse. ``revert`` after ``apply`` restores every bit."""

    title: str  # what the user did: "Recolor"

    @property
    def nbytes(self) -> int:
        """Bytes that this edit holds."""
        return sum(_size(getattr(self, name)) for name in self.__struct_fields__ if name != "title")

    def apply(self, scene: Scene) -> None:
        """Make the change; on an exception the scene is as before."""
        self._write(scene, forth=True)

    def revert(self, scene: Scene) -> None:
        """Take the change back."""
        self._write(scene, forth=False)

    def _write(self, scene: Scene, *, forth: bool) -> None:
        raise NotImplementedError


def _size(value: object) -> int:
    """Bytes of a value of an edit; a memory bank takes about 100 a decision."""
    if isinstance(value, Kept):
        value = value.value
    if isinstance(value, MemoryBank):
        return value.group.nbytes + 100 * len(value.log)
    if isinstance(value, str):
        return len(value)
    if isinstance(value, tuple):
        return sum(map(_size, value))
    if isinstance(value, Mapping):
        return sum(map(_size, value.values()))
    if is_dataclass(value) and not hasattr(value, "nbytes"):
        return sum(_size(getattr(value, item.name)) for item in fields(value))
    return int(getattr(value, "nbytes", 8))


if TYPE_CHECKING:
    _Parts = tuple[Edit, ...]
else:  # as msgspec reads them
    _Parts = tuple["AnyEdit", ...]


class Edits(Edit, frozen=True, tag="together"):
    """Several edits as one: applied in order, reverted in reverse."""

    edits: _Parts

    def _write(self, scene: Scene, *, forth: bool) -> None:
        before = dict(vars(scene))  # columns are replaced, never written in place
        try:
            for edit in self.edits if forth else reversed(self.edits):
                (edit.apply if forth else edit.revert)(scene)
        except BaseException:  # all or none; the revision has grown, so mirrors look again
            vars(scene).update(before)
            raise


def together(title: str, edits: Iterable[Edit | None]) -> Edit | None:
    """One edit of those that change something; None when none does."""
    real = tuple(edit for edit in edits if edit is not None)
    return Edits(title, real) if real else None


def parts_of(edit: Edit) -> Iterator[Edit]:
    """The edits that an edit is made of, in order; of one alone itself."""
    if isinstance(edit, Edits):
        for part in edit.edits:
            yield from parts_of(part)
    else:
        yield edit


def is_selection(edit: Edit) -> bool:
    """Whether an edit changes what is selected and nothing else."""
    return all(
        isinstance(part, FlipState) and all(bits == State.SELECTED for bits, _ in part.flips)
        for part in parts_of(edit)
    )


# --- columns of splats --------------------------------------------------------------------------


class FlipState(Edit, frozen=True, tag="flip"):
    """State bits that flip, and on which splats; its own inverse."""

    n: Row  # splats of the scene
    flips: tuple[tuple[Bits, IndexSet], ...]

    @staticmethod
    def of(title: str, changed: UInt8Array) -> "FlipState | None":
        """The edit that flips the bits ``changed`` (N,) of each splat; None when all are 0."""
        kinds = np.flatnonzero(np.bincount(changed, minlength=256)[1:]) + 1
        n = len(changed)
        flips = [(int(k), IndexSet.of(np.flatnonzero(changed == k), n)) for k in kinds]
        return FlipState(title, n, tuple(flips)) if flips else None

    def _write(self, scene: Scene, *, forth: bool) -> None:
        check_length(scene, self.n)
        state = scene.state.copy()
        for bits, splats in self.flips:
            if splats.count > self.n // 16:
                state ^= splats.mask().view(np.uint8) * np.uint8(bits)
            else:
                state[splats.indices()] ^= np.uint8(bits)
        scene.state = state
        scene.revision.state += 1


def after_selections(selections: Iterable[Edit], edit: Edit) -> Edit:
    """``edit`` with ``selections`` (see `is_selection`) made first, as one flip: each is its own
    inverse, so that their order does not matter, and what is made twice is not made."""
    parts = [part for whole in (*selections, edit) for part in parts_of(whole)]
    n_first = next(i for i, part in enumerate(parts) if not is_selection(part))
    flips = [part for part in parts[:n_first] if isinstance(part, FlipState)]
    changed = np.zeros(flips[0].n, np.uint8)
    for bits, splats in (one for flip in flips for one in flip.flips):
        changed ^= splats.mask().view(np.uint8) * np.uint8(bits)
    made = together(edit.title, (FlipState.of("Select", changed), *parts[n_first:]))
    assert made is not None
    return made


class SetLabels(Edit, frozen=True, tag="labels"):
    """Group ids of some splats."""

    splats: IndexSet
    before: PackedInts
    after: PackedInts

    def _write(self, scene: Scene, *, forth: bool) -> None:
        check_length(scene, self.splats.n)
        labels = scene.labels.copy()
        labels[self.splats.indices()] = (self.after if forth else self.before).data
        scene.labels = labels
        scene.revision.labels += 1


# --- fields of the scene that are replaced ------------------------------------------------------


class SetField(Edit, frozen=True):
    """Another value of the field of the scene that the edit's tag names."""

    before: Any
    after: Any

    @classmethod
    def of(cls, title: str, before: object, after: object) -> Self:
        """The edit from a frozen value to another one; None = there is none."""
        return cls(title, *(None if value is None else Kept(value) for value in (before, after)))

    def _write(self, scene: Scene, *, forth: bool) -> None:
        value = self.after if forth else self.before
        value = value.value if isinstance(value, Kept) else value
        field_name = str(self.__struct_config__.tag)
        if (lengths := _lengths_of(value)) - {scene.n_opened}:
            raise ValueError(f"{field_name} of {max(lengths)} splats, {scene.n_opened} were opened")
        setattr(scene, field_name, value)
        if field_name == "frame":
            scene.revision.placements += 1
        else:
            scene.revision.labels += 1


def _lengths_of(value: object) -> set[int]:
    """How many splats of the opened file the columns of a field's value have."""
    columns: tuple[AnyArray | None, ...] = ()
    if isinstance(value, Identities):
        other = value.other
        columns = (value.colors, *((other.labels, other.confidence) if other else ()))
    elif isinstance(value, np.ndarray):
        columns = (value,)
    return {len(column) for column in columns if column is not None}


class SetBank(SetField, frozen=True, tag="bank"):
    """The memory bank whose log explains the labels."""

    before: Kept[MemoryBank] | None
    after: Kept[MemoryBank] | None


class SetConfidence(SetField, frozen=True, tag="confidence"):
    """Confidence of the splats' groups, by row of the opened file."""

    before: Kept[UInt8Array] | None
    after: Kept[UInt8Array] | None


class SetIdentities(SetField, frozen=True, tag="identities"):
    """Source of the labels, and labels of the other source."""

    before: Kept[Identities]
    after: Kept[Identities]


class SetFrame(SetField, frozen=True, tag="frame"):
    """Motion of the whole scene."""

    before: Frame
    after: Frame


# --- tables by group or name --------------------------------------------------------------------


def with_entries(table: Mapping[_K, _V], changes: Mapping[_K, _V | None]) -> dict[_K, _V]:
    """``table`` with other values of some keys, in order; None takes a key out."""
    kept = {key: value for key, value in table.items() if key not in changes}
    kept.update((key, value) for key, value in changes.items() if value is not None)
    return {key: kept[key] for key in sorted(kept)}


class SetNames(Edit, frozen=True, tag="names"):
    """Names of groups; None = the group has no name of its own."""

    before: tuple[tuple[Group, str | None], ...]
    after: tuple[tuple[Group, str | None], ...]

    @staticmethod
    def of(
        scene: Scene, names: Mapping[int, str | None], title: str = "Rename"
    ) -> "SetNames | None":
        """The edit that gives groups these names; None when nothing would change."""
        now = scene.names
        after = tuple((group, name) for group, name in names.items() if now.get(group) != name)
        return SetNames(title, tuple((g, now.get(g)) for g, _ in after), after) if after else None

    def _write(self, scene: Scene, *, forth: bool) -> None:
        scene.names = with_entries(scene.names, dict(self.after if forth else self.before))
        scene.revision.names += 1


class SetColor(Edit, frozen=True, tag="color"):
    """A group's color in lists and in the group render mode; None = the palette's."""

    group: Group
    before: RGB | None
    after: RGB | None

    def _write(self, scene: Scene, *, forth: bool) -> None:
        color = self.after if forth else self.before
        scene.colors = with_entries(scene.colors, {self.group: color})
        scene.revision.names += 1


class SetWeight(Edit, frozen=True, tag="weight"):
    """Mass or density of a group in simulations; None = the density of an export."""

    group: Group
    before: Weight | None
    after: Weight | None

    def _write(self, scene: Scene, *, forth: bool) -> None:
        weight = self.after if forth else self.before
        scene.weights = with_entries(scene.weights, {self.group: weight})
        scene.revision.names += 1


class SetNamedSelection(Edit, frozen=True, tag="selection"):
    """A named selection; None = there is none of that name."""

    name: str
    before: IndexSet | None
    after: IndexSet | None

    def _write(self, scene: Scene, *, forth: bool) -> None:
        kept = self.after if forth else self.before
        scene.named_selections = with_entries(scene.named_selections, {self.name: kept})
        scene.revision.names += 1


class SetFolders(Edit, frozen=True, tag="folders"):
    """Which folders there are, and groups that go into another folder, or under another group."""

    before: tuple[str, ...]  # paths
    after: tuple[str, ...]
    # Group, folder before and after; None = in none, or under another group.
    moved: tuple[tuple[Group, str | None, str | None], ...]
    # Group, the group that it lies under before and after; None = none. Older scripts lack it.
    parents: tuple[tuple[Group, Group | None, Group | None], ...] = ()

    def _write(self, scene: Scene, *, forth: bool) -> None:
        now = scene.folders
        home = with_entries(now.home, {g: (old, new)[forth] for g, old, new in self.moved})
        parent = with_entries(now.parent, {g: (old, new)[forth] for g, old, new in self.parents})
        scene.folders = Folders(self.after if forth else self.before, home, parent)
        scene.revision.names += 1


# --- placements ---------------------------------------------------------------------------------


class SetPlacement(Edit, frozen=True, tag="placement"):
    """Rows of the placement table that change or are appended, and splats that move to them.

    A splat of ``moved`` goes from ``rows_from[i]`` to ``rows_to[i]``. The targets are rows that
    this edit appends, so no other splat uses them and the way back is unique.
    """

    n_rows: Row  # of the table before
    rows: IntArray  # (C,) rows with new values, sorted; those from n_rows on are appended
    before: Placements  # values of the rows that existed
    after: Placements  # values of all C rows
    moved: IndexSet
    rows_from: IntArray  # (R,)
    rows_to: IntArray  # (R,)

    def same_rows(self, other: "SetPlacement") -> bool:
        """Whether the two differ in the values of their rows at most (frames of one drag)."""
        return (
            self.n_rows == other.n_rows
            and np.array_equal(self.rows, other.rows)
            and np.array_equal(self.rows_from, other.rows_from)
            and np.array_equal(self.rows_to, other.rows_to)
            and self.moved.equals(other.moved)
        )

    def rewrite(self, scene: Scene) -> None:
        """Write the new values only: the scene already stands on these rows (see `same_rows`)."""
        scene.placements = _with_rows(scene.placements, self.rows, self.after)
        scene.revision.placements += 1

    def _write(self, scene: Scene, *, forth: bool) -> None:
        check_length(scene, self.moved.n)
        index, n_rows = scene.placement, self.n_rows
        n_after = max(n_rows, int(self.rows.max(initial=-1)) + 1)
        _check_table(scene, n_rows if forth else n_after)
        if self.moved.count:
            ways = self.rows_from, self.rows_to
            start, stop = ways if forth else ways[::-1]
            target = np.arange(max(start.max(), stop.max()) + 1, dtype=np.int32)
            target[start] = stop
            splats = self.moved.indices()
            index = index.copy()
            index[splats] = target[index[splats]]
        if forth:
            table = _resized(scene.placements, n_after)
            table = _with_rows(table, self.rows, self.after)
        else:
            table = _resized(scene.placements, n_rows)
            table = _with_rows(table, self.rows[: len(self.before)], self.before)
        if index is not scene.placement or not forth:
            _check_rows(index, len(table))
        scene.placements = table
        scene.revision.placements += 1
        if index is not scene.placement:
            scene.placement = index
            scene.revision.placement += 1


def _check_table(scene: Scene, n_rows: int) -> None:
    """Raise ``ValueError`` when an edit was made for a table of another length."""
    if len(scene.placements) != n_rows:
        raise ValueError("other things were moved in it")


def _check_rows(rows: IntArray, n_rows: int) -> None:
    """Raise ``ValueError`` when a splat would stand on a placement that is not there."""
    if (last := rows.max(initial=-1)) >= n_rows:
        raise ValueError(f"splats stand on placement {last} of {n_rows}")


def _of_columns(make: Callable[..., AnyArray], *tables: Placements) -> Placements:
    """A table whose columns ``make`` makes of those of the others."""
    names = ("matrix", "color", "opacity")
    return Placements(*(make(*(getattr(table, name) for table in tables)) for name in names))


def take_rows(table: Placements, rows: IntArray) -> Placements:
    """The chosen rows of a placement table, as a copy."""
    return _of_columns(lambda column: column[rows], table)


def _resized(table: Placements, n_rows: int) -> Placements:
    """The first rows of a table; identities at its end where there are not as many."""
    fresh = Placements.identity(max(n_rows - len(table), 0))
    return _of_columns(lambda old, new: np.concatenate([old[:n_rows], new]), table, fresh)


def _with_rows(table: Placements, rows: IntArray, values: Placements) -> Placements:
    def written(column: AnyArray, of_rows: AnyArray) -> AnyArray:
        column = column.copy()
        column[rows] = of_rows
        return column

    return _of_columns(written, table, values)


# --- splats that are added ----------------------------------------------------------------------


class Append(Edit, frozen=True):
    """Splats at the end of the scene."""

    labels: PackedInts  # of the added splats
    state: Bits

    def _extend(self, scene: Scene, splats: Gaussians, rows: IntArray, source: LongArray) -> None:
        """Append ``splats`` (K,) with their ``rows`` (K,) of the placements and ``source`` (K,)."""
        kept, k = len(scene), len(splats)
        gaussians = joined(scene.gaussians, splats)
        labels = np.concatenate([scene.labels, self.labels.values()])
        placement = np.concatenate([scene.placement, rows])
        state = np.concatenate([scene.state, np.full(k, self.state, np.uint8)])
        source = np.concatenate([scene.source, source])
        scene.gaussians, scene.labels, scene.placement = gaussians, labels, placement
        scene.state, scene.source = state, source
        _bump_splats(scene, kept)

    def _cut(self, scene: Scene, n: int) -> None:
        """Leave the first ``n`` splats."""
        scene.gaussians = first_rows(scene.gaussians, n)
        scene.labels, scene.placement = scene.labels[:n], scene.placement[:n]
        scene.state, scene.source = scene.state[:n], scene.source[:n]
        _bump_splats(scene, n)


class AppendCopies(Append, frozen=True, tag="copies"):
    """Copies of some splats; the parameters are read from the originals."""

    splats: IndexSet
    rows: PackedInts  # placement rows of the copies

    def _write(self, scene: Scene, *, forth: bool) -> None:
        n = self.splats.n
        check_length(scene, n if forth else n + self.splats.count)
        if forth:
            chosen, rows = self.splats.indices(), self.rows.values()
            _check_rows(rows, len(scene.placements))
            copies, source = scene.gaussians.take(chosen), scene.source[chosen]
            self._extend(scene, copies, rows, source)
        else:
            self._cut(scene, n)


class AppendSplats(Append, frozen=True):
    """Splats that no edit of the scene has, on a placement row of their own.

    SH get the higher degree of the two, columns that one side lacks are zero there.
    """

    first: Row  # row of the first one among the rows of all files, see `Scene.source`
    n: Row  # splats of the scene before
    n_rows: Row  # of its placement table
    n_sh: Row  # SH coefficients
    columns: tuple[str, ...]  # names of its extra columns

    @property
    def added(self) -> Added:
        """What the scene notes of them."""
        raise NotImplementedError

    @property
    def splats(self) -> Gaussians:
        """The splats. Raises ``GagaError`` when the file that has them is gone or changed."""
        raise NotImplementedError

    def _write(self, scene: Scene, *, forth: bool) -> None:
        check_length(scene, self.n if forth else self.n + self.labels.count)
        table, g = scene.placements, scene.gaussians
        _check_table(scene, self.n_rows if forth else self.n_rows + 1)
        if forth and self.first != scene.n_rows_of_files:
            raise ValueError(f"row {self.first} is not the first after {scene.n_rows_of_files}")
        if forth:
            rows = np.full(self.labels.count, self.n_rows, np.int32)
            source = np.arange(self.first, self.first + self.labels.count, dtype=np.int64)
            added, table = self.added, _resized(table, len(table) + 1)
            self._extend(scene, self.splats, rows, source)
            scene.added = (*scene.added, added)
        else:
            last = [(item.first, item.n) for item in scene.added[-1:]]
            if last != [(self.first, self.labels.count)]:  # its file may lie elsewhere by now
                raise ValueError("these splats were not added last")
            _check_rows(scene.placement[: self.n], self.n_rows)
            g = first_rows(g, self.n)
            extra = MappingProxyType({name: g.extra[name] for name in self.columns})
            g = replace(g, sh=np.ascontiguousarray(g.sh[:, : self.n_sh]), extra=extra)
            self._cut(scene, self.n)
            scene.gaussians = g
            scene.added, table = scene.added[:-1], _resized(table, self.n_rows)
        scene.placements = table
        scene.revision.placements += 1


class AppendMade(AppendSplats, frozen=True, tag="made"):
    """Splats that an edit made: the project and scripts keep them themselves."""

    made: Kept[Gaussians] = field(name="splats")
    frame: FrameRows = ()  # how the scene had been moved by then; older scripts lack it
    merged: bool = False  # made of splats that were deleted for it; older scripts lack it

    @property
    def added(self) -> Added:
        n = self.labels.count
        return Added("", "", self.first, n, frame=self.frame, is_merged=self.merged)

    @property
    def splats(self) -> Gaussians:
        return self.made.value


class AppendFile(AppendSplats, frozen=True, dict=True, tag="append"):
    """Splats of another file, which a recording names by its path and fingerprint."""

    path: PathText
    fingerprint: str
    axes: SilentAxes = "RUB"  # of an .spz that does not say its own; older scripts took RUB
    # How the scene had been moved by then, as if also turned by the inverse of what stood the file
    # upright; older scripts lack it.
    frame: FrameRows = ()

    @cached_property
    def splats(self) -> Gaussians:
        return run_stage(read_added_stage(Path(self.path), self.fingerprint, self.axes))[0]

    @property
    def nbytes(self) -> int:
        return _size(self.splats) + self.labels.nbytes  # kept for redo

    @property
    def added(self) -> Added:
        origin = self.path, self.fingerprint, self.first, self.labels.count
        return Added(*origin, self.axes, self.frame)


AnyEdit = (
    FlipState
    | SetLabels
    | SetNames
    | SetColor
    | SetWeight
    | SetFolders
    | SetPlacement
    | AppendCopies
    | AppendFile
    | AppendMade
    | SetFrame
    | SetBank
    | SetConfidence
    | SetIdentities
    | SetNamedSelection
    | Edits
)


def _bump_splats(scene: Scene, kept: int) -> None:
    """The splats from row ``kept`` on changed, so every other column did."""
    scene.revision.splats_changed(kept)
    scene.revision.labels += 1
    scene.revision.state += 1
    scene.revision.placement += 1


def read_added_stage(
    path: Path, digest: str = "", axes: str = OURS
) -> Stage[tuple[Gaussians, str]]:
    """Splats of a file to be added, and its fingerprint; with ``digest``: it must be that one.

    ``axes``: of an .spz that does not say its own.

    Raises ``GagaError`` with one sentence when the file is gone, changed or damaged.
    """
    path = Path(path).absolute()
    if digest and not is_file(path):
        raise GagaError(f"The added splats are gone: {path}. Put the file back.")
    found = model_fingerprint(path)
    if digest and not is_same_model(path, digest):
        raise GagaError(f"{path} changed since its splats were added. Put the previous file back.")
    return (yield from read_splats_stage(path, axes)), found


def joined(first: Gaussians, then: Gaussians) -> Gaussians:
    """Splats of two files as one set; comments are those of the first.

    SH get the higher degree of the two. A column that one side lacks is zero there; one that both
    have keeps the dtype of the first.
    """
    n_sh = max(first.sh.shape[1], then.sh.shape[1])
    names = [*first.extra, *(name for name in then.extra if name not in first.extra)]
    extra = {name: _column([first, then], name) for name in names}
    return replace(
        first,
        means=np.concatenate([first.means, then.means]),
        quats=np.concatenate([first.quats, then.quats]),
        log_scales=np.concatenate([first.log_scales, then.log_scales]),
        logit_opacities=np.concatenate([first.logit_opacities, then.logit_opacities]),
        sh=np.concatenate([_with_sh(first.sh, n_sh), _with_sh(then.sh, n_sh)]),
        extra=MappingProxyType(extra),
    )


def _with_sh(sh: FloatArray, n_sh: int) -> FloatArray:
    if sh.shape[1] == n_sh:
        return sh
    return np.concatenate([sh, np.zeros((len(sh), n_sh - sh.shape[1], 3), np.float32)], axis=1)


def _column(parts: Sequence[Gaussians], name: str) -> AnyArray:
    dtype = next(part.extra[name].dtype for part in parts if name in part.extra)
    columns = [part.extra.get(name, np.zeros(len(part), dtype)) for part in parts]
    with np.errstate(invalid="ignore"):
        return np.concatenate([column.astype(dtype, copy=False) for column in columns])


def first_rows(g: Gaussians, n: int) -> Gaussians:
    """The first ``n`` rows; columns are views."""
    return replace(
        g,
        means=g.means[:n],
        quats=g.quats[:n],
        log_scales=g.log_scales[:n],
        logit_opacities=g.logit_opacities[:n],
        sh=g.sh[:n],
        extra=MappingProxyType({name: column[:n] for name, column in g.extra.items()}),
    )


def check_length(scene: Scene, n: int) -> None:
    """Raise ``ValueError`` when an edit was made for a scene of another length."""
    if len(scene) != n:
        raise ValueError(f"of {n:,} splats, not {len(scene):,}")
