"""What the object list shows of a document: which folders are open, what is left out, its lines."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.scene.folders import Folders, is_inside, parent_of, parents_of
from gaga_core.scene.objects import ObjectTable
from gaga_studio.session.part_index import Part, PartKey
from gaga_studio.session.scene_cache import natural

Measure = Literal["size", "splats", "confidence", "quality"]
Measures = Mapping[Measure, DoubleArray]  # (G,) each, -1 = unknown
Range = tuple[float, float]


@dataclass(frozen=True)
class ListFilter:
    """What objects must be like to be listed: nothing, or a range of some measures."""

    ranges: Mapping[Measure, Range] = field(default_factory=dict)

    @property
    def is_on(self) -> bool:
        """Whether it can leave anything out."""
        return bool(self.ranges)

    def within(self, measure: Measure, wanted: Range, whole: Range) -> "ListFilter":
        """The same with a range of one measure; ``whole`` is that of all objects."""
        rest = {name: kept for name, kept in self.ranges.items() if name != measure}
        is_all = wanted[0] <= whole[0] and wanted[1] >= whole[1]
        return ListFilter(rest if is_all else {**rest, measure: wanted})

    def keeps(self, table: ObjectTable, measures: Measures) -> BoolArray:
        """Rows (G,) of objects that are in all ranges; what is unknown is in none."""
        kept: BoolArray = table.ids > 0
        for measure, (low, high) in self.ranges.items():
            value = measures[measure]
            kept &= (value >= low) & (value <= high)
        return kept


@dataclass(frozen=True, slots=True)
class Line:
    """One line of the list: an object, a folder, a part, or the head of the background."""

    kind: Literal["object", "folder", "part", "background"]
    depth: int = 0
    row: int = -1  # of the table, of an object and of what a part is a part of
    folder: str = ""
    is_open: bool = False  # of a folder, or of an object that others lie under
    has_children: bool = False  # that are listed, or would be if it were open
    part: Part | None = None


@dataclass(frozen=True, eq=False)
class Lines:
    """All lines, from top to bottom."""

    lines: tuple[Line, ...]
    groups: tuple[int, ...]  # of each line; -1 where it is no object
    shown: tuple[int, ...]  # groups of the lines of objects
    depth: int  # of the deepest line
    n_background: int
    n_kept: int  # objects that the filter keeps


@dataclass(frozen=True, eq=False)
class FolderSums:
    """What is in a folder and in all that lie in it."""

    n_objects: int
    n_splats: int
    n_selected: int
    n_hidden: int
    n_locked: int


@dataclass
class ObjectListView:
    """What a document's list remembers; nothing of it is saved."""

    closed: frozenset[str] = frozenset()  # folders
    closed_groups: frozenset[int] = frozenset()  # objects, of those that others lie under
    open_parts: frozenset[PartKey] = frozenset()  # objects and parts whose parts are shown
    filter: ListFilter = field(default_factory=ListFilter)
    chosen: tuple[str, ...] = ()  # folders that were clicked, see `actions.folders.chosen`
    chosen_with: object = None  # the selection that this made

    def toggle(self, folder: str) -> None:
        """Open or close a folder."""
        self.closed = self.closed ^ {folder}

    def toggle_parts(self, key: PartKey) -> None:
        """Show or hide the parts of an object or a part."""
        self.open_parts = self.open_parts ^ {key}

    def toggle_group(self, group: int, is_open: bool) -> None:
        """Open or close an object that others lie under, with its parts."""
        self.closed_groups = (
            self.closed_groups | {group} if is_open else (self.closed_groups - {group})
        )
        parts = self.open_parts - {(group,)}
        self.open_parts = parts if is_open else parts | {(group,)}

    def reveal_group(self, folders: Folders, group: int) -> None:
        """Open all that a group lies in or under."""
        self.closed_groups = self.closed_groups.difference(folders.above(group))
        self.reveal(folders.places.get(group, ""))

    def reveal(self, folder: str) -> None:
        """Open a folder and all that it lies in; "" is the top."""
        self.closed = self.closed - {folder, *parents_of(folder)}

    def follow(self, before: str, after: str) -> None:
        """A folder has another path now."""

        def moved(path: str) -> str:
            return after + path[len(before) :] if is_inside(path, before) else path

        self.closed = frozenset(map(moved, self.closed))
        self.chosen = tuple(map(moved, self.chosen))


@dataclass(frozen=True, eq=False)
class Listing:
    """What `lines_of` puts into lines."""

    table: ObjectTable
    rows: Sequence[int]  # of the table, in the order of the list
    folders: Folders
    kept: BoolArray | None  # (G,) by the filter; None: it is off
    behind: frozenset[int]  # groups that are background
    folds_background: bool
    falls: bool  # sorted by name, the last first
    parts: Callable[[Part | int], Sequence[Part]] | None  # None: no levels


def lines_of(listing: Listing, view: ObjectListView) -> Lines:
    """The lines: folders by name, then objects; then the background, what is in no group last.

    While a filter is on, folders are open, and those without a kept object are left out.
    """
    maker = _LineMaker(listing, view)
    maker.folder("", 0)
    n_background = maker.background()
    lines = tuple(maker.lines)
    ids = listing.table.ids
    groups = tuple(int(ids[x.row]) if x.kind == "object" else -1 for x in lines)
    kept = listing.kept
    return Lines(
        lines,
        groups,
        tuple(group for group in groups if group >= 0),
        max((line.depth for line in lines), default=0),
        n_background,
        int(np.count_nonzero(ids > 0) if kept is None else np.count_nonzero(kept)),
    )


class _LineMaker:
    def __init__(self, listing: Listing, view: ObjectListView) -> None:
        self._listing, self._view = listing, view
        self.lines: list[Line] = []
        table, order, kept = listing.table, listing.folders, listing.kept
        ids = table.ids.tolist()
        rows = [row for row in listing.rows if kept is None or kept[row]]
        self._inside: dict[str, list[int]] = {}  # rows by folder
        self._under: dict[int, list[int]] = {}  # rows by the listed group that they lie under
        self._behind: list[int] = []
        self._rest: list[int] = []
        has_objects = any(ids[row] and ids[row] not in listing.behind for row in rows)
        listed = {ids[row] for row in rows} if order.parent else set()
        for row in rows:
            if above := order.nearest(ids[row], listed):
                self._under.setdefault(above, []).append(row)
        for row in rows:
            group = ids[row]
            folder = order.places.get(group, "")
            if not group:
                self._rest.append(row)
            elif order.nearest(group, listed):
                continue
            elif (
                not folder and group in listing.behind and group not in self._under and has_objects
            ):
                self._behind.append(row)
            else:
                self._inside.setdefault(folder, []).append(row)
        self._children: dict[str, list[str]] = {}
        for path in self._shown_folders():
            self._children.setdefault(parent_of(path), []).append(path)
        for paths in self._children.values():
            paths.sort(key=natural, reverse=listing.falls)

    def _shown_folders(self) -> Sequence[str]:
        if self._listing.kept is None:
            return self._listing.folders.paths
        full = {above for path in self._inside for above in (path, *parents_of(path))}
        return [path for path in self._listing.folders.paths if path in full]

    def folder(self, path: str, depth: int) -> None:
        """Lines of all that is in a folder; "" is the top."""
        for inner in self._children.get(path, ()):
            is_open = self._listing.kept is not None or inner not in self._view.closed
            self.lines.append(Line("folder", depth, folder=inner, is_open=is_open))
            if is_open:
                self.folder(inner, depth + 1)
        for row in self._inside.get(path, ()):
            self._object(row, depth, path)

    def background(self) -> int:
        """Lines of the background and of what is in no group; how many are background."""
        if self._behind:
            self.lines.append(Line("background"))
            for row in () if self._listing.folds_background else self._behind:
                self._object(row, 0, "")
        for row in self._rest:
            self._object(row, 0, "")
        return len(self._behind)

    def _object(self, row: int, depth: int, folder: str) -> None:
        """Lines of an object and of all that lies under it: not recursive, chains may be long."""
        left = [(row, depth)]
        while left:
            row, depth = left.pop()
            group = int(self._listing.table.ids[row])
            below = self._under.get(group, ())
            is_open = self._listing.kept is not None or group not in self._view.closed_groups
            shows, has = is_open and bool(below), bool(below)
            self.lines.append(Line("object", depth, row, folder, is_open=shows, has_children=has))
            if (group,) in self._view.open_parts:
                self._parts(group, row, depth + 1)
            if shows:
                left += [(child, depth + 1) for child in reversed(below)]

    def _parts(self, whole: Part | int, row: int, depth: int) -> None:
        if self._listing.parts is None:
            return
        for part in self._listing.parts(whole):
            self.lines.append(Line("part", depth, row, part=part))
            if part.key in self._view.open_parts:
                self._parts(part, row, depth + 1)


def folder_sums(table: ObjectTable, folders: Folders) -> dict[str, FolderSums]:
    """Sums over the objects of each folder, by its path."""
    number = {path: i for i, path in enumerate(folders.paths)}
    places = folders.places
    groups = np.fromiter(places, np.int64, len(places))
    inside = np.fromiter((number[path] for path in places.values()), np.int64, len(groups))
    rows = np.minimum(np.searchsorted(table.ids, groups), max(len(table) - 1, 0))
    is_there = table.ids[rows] == groups if len(table) else np.zeros(len(groups), np.bool_)
    rows, inside = rows[is_there], inside[is_there]
    columns = (table.counts, table.n_selected, table.n_hidden, table.n_locked)
    values = np.stack([np.ones(len(rows), np.int64), *(column[rows] for column in columns)], axis=1)
    sums = np.zeros((len(number), 5), np.int64)
    np.add.at(sums, inside, values)
    for path in reversed(folders.paths):  # what lies in a folder comes after it
        if parent_of(path):
            sums[number[parent_of(path)]] += sums[number[path]]
    return {path: FolderSums(*sums[i].tolist()) for path, i in number.items()}
