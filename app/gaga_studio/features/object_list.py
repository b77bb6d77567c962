"""The object list: its filter, lines, parts of objects, and pictures of objects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.grouping.levels import Levels
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import How
from gaga_core.scene.edits.objects import parting
from gaga_core.scene.folders import Folders, is_inside, parent_of, parents_of
from gaga_core.scene.object_picture import (
    MOST_DRAWN,
    ObjectDrawing,
    ObjectView,
    object_drawing,
    object_view,
)
from gaga_core.scene.objects import ObjectTable, confidence_of_groups, group_indices
from gaga_core.scene.scene import Scene, State
from gaga_studio.features.base import Command, no_confidence, no_selection
from gaga_studio.features.find.memory_bank import quality_column
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.document import Document
from gaga_studio.session.notices import notifies
from gaga_studio.session.scene_cache import SortKey, natural
from gaga_studio.session.session import Session

# --- parts

PartKey = tuple[int, ...]  # an object: (group,); its second part: (group, 1); the first in it ...


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an object, or of another part."""

    key: PartKey
    rows: IntArray  # (K,) splats, not deleted
    level: int  # that made it a part

    @property
    def name(self) -> str:
        """Its name in the list."""
        return f"part {self.key[-1] + 1}"


class PartIndex:
    """The parts of one state of the groups: of a scene with ``levels``."""

    def __init__(self, scene: Scene, levels: Levels) -> None:
        self._levels, self._source = levels, scene.source
        self._has_levels = scene.source < levels.labels.shape[1]  # not what was added since
        rows = np.flatnonzero(~scene.has(State.DELETED) & (scene.labels > 0)).astype(np.int32)
        rows = rows[np.argsort(scene.labels[rows], kind="stable")]
        groups, starts = np.unique(scene.labels[rows], return_index=True)
        self._rows = dict(zip(groups.tolist(), np.split(rows, starts[1:]), strict=len(groups) > 0))
        self._known: dict[PartKey, tuple[Part, ...]] = {}
        self._wholes: dict[int, tuple[IntArray, ...]] = {}

    def parts(self, whole: Part | int) -> tuple[Part, ...]:
        """The parts of an object (a group) or of a part, the largest first; () when it is one."""
        key = whole.key if isinstance(whole, Part) else (whole,)
        if key not in self._known:
            rows = whole.rows if isinstance(whole, Part) else self._known_rows(whole)
            first = whole.level + 1 if isinstance(whole, Part) else 0
            self._known[key] = self._cut(key, rows, first) if len(rows) else ()
        return self._known[key]

    def ways(self, group: int, splat: int) -> list[tuple[str, IntArray]]:
        """What a splat of a group is in, coarse to fine, with the splats (K,), ascending: what the
        group is joined with, the group itself ("") and its parts, by their names."""
        found = [("more", rows) for rows in self.wholes(group)]
        found.append(("", np.sort(self._rows[group])))
        whole: Part | int = group
        while parts := [p for p in self.parts(whole) if splat in p.rows]:
            whole = parts[0]
            found.append((parts[0].name, np.sort(parts[0].rows)))
        return found

    @cached_property
    def _every(self) -> IntArray:
        """Splats (K,) of all objects, ascending, that have levels."""
        return np.sort(np.concatenate([self._known_rows(group) for group in self._rows]))

    def wholes(self, group: int) -> tuple[IntArray, ...]:
        """Splats (K,), ascending, of what a group is joined with, coarse to fine."""
        if group not in self._wholes:
            known, found = self._known_rows(group), [np.sort(self._rows[group])]
            for labels in self._levels.labels[::-1] if len(known) else ():
                parent = int(np.bincount(labels[self._source[known]]).argmax())
                rows = self._every[labels[self._source[self._every]] == parent]
                if parent and len(rows) > len(found[0]) and np.isin(found[0], rows).mean() > 0.5:
                    found.insert(0, np.union1d(rows, found[0]).astype(np.int32))
            self._wholes[group] = tuple(found[:-1])
        return self._wholes[group]

    def _known_rows(self, group: int) -> IntArray:
        """Splats (K,) of a group that have levels."""
        rows = self._rows.get(group, np.zeros(0, np.int32))
        return rows[self._has_levels[rows]]

    def _cut(self, key: PartKey, rows: IntArray, first: int) -> tuple[Part, ...]:
        cut = parting(self._levels, self._source[rows], first)
        if cut is None:
            return ()
        return tuple(
            Part((*key, i), rows[cut.part_of == i], cut.level) for i in range(len(cut.ids))
        )


# --- lines

Measure = Literal["size", "splats", "confidence", "quality"]
Measures = Mapping[Measure, DoubleArray]  # (G,) each, -1 = unknown
Range = tuple[float, float]


@dataclass(frozen=True)
class ListFilter:
    """Conditions for objects to be listed: none, or ranges of some measures."""

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
    background: tuple[int, ...]  # groups in the background, whether they are folded or not
    n_kept: int  # objects that the filter keeps


@dataclass(frozen=True, eq=False)
class FolderSums:
    """The content of a folder and of its subfolders."""

    n_objects: int
    n_splats: int
    n_selected: int
    n_hidden: int
    n_locked: int


@dataclass
class ObjectListView:
    """State of a document's list; it is not saved."""

    closed: frozenset[str] = frozenset()  # folders
    closed_groups: frozenset[int] = frozenset()  # objects, of those that others lie under
    open_parts: frozenset[PartKey] = frozenset()  # objects and parts whose parts are shown
    filter: ListFilter = field(default_factory=ListFilter)
    chosen: tuple[str, ...] = ()  # folders that were clicked, see `folders.chosen`
    chosen_with: object = None  # the selection that this made

    def toggle(self, folder: str) -> None:
        """Open or close a folder."""
        self.closed = self.closed ^ {folder}

    def toggle_parts(self, key: PartKey) -> None:
        """Show or hide the parts of an object or a part."""
        self.open_parts = self.open_parts ^ {key}

    def toggle_group(self, group: int, is_open: bool) -> None:
        """Open or close an object with others under it, and its parts."""
        self.closed_groups = (
            self.closed_groups | {group} if is_open else (self.closed_groups - {group})
        )
        parts = self.open_parts - {(group,)}
        self.open_parts = parts if is_open else parts | {(group,)}

    def reveal_group(self, folders: Folders, group: int) -> None:
        """Open all folders and objects that a group is in or under."""
        self.closed_groups = self.closed_groups.difference(folders.above(group))
        self.reveal(folders.places.get(group, ""))

    def reveal(self, folder: str) -> None:
        """Open a folder and all folders above it; "" is the top."""
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
    folded: frozenset[int]  # of them, those without a line
    falls: bool  # sorted by name, the last first
    parts: Callable[[Part | int], Sequence[Part]] | None  # None: no levels


def lines_of(listing: Listing, view: ObjectListView) -> Lines:
    """The lines: folders by name, then objects; then the background, what is in no group last.

    While a filter is on, folders are open, and those without a kept object are left out.
    """
    maker = _LineMaker(listing, view)
    maker.folder("", 0)
    background = maker.background()
    lines = tuple(maker.lines)
    ids = listing.table.ids
    groups = tuple(int(ids[x.row]) if x.kind == "object" else -1 for x in lines)
    kept = listing.kept
    return Lines(
        lines,
        groups,
        tuple(group for group in groups if group >= 0),
        max((line.depth for line in lines), default=0),
        background,
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

    def background(self) -> tuple[int, ...]:
        """Lines of the background and of what is in no group; the groups of the background."""
        if self._behind:
            self.lines.append(Line("background"))
        groups = tuple(int(self._listing.table.ids[row]) for row in self._behind)
        for row, group in zip(self._behind, groups, strict=True):
            if group not in self._listing.folded:
                self._object(row, 0, "")
        for row in self._rest:
            self._object(row, 0, "")
        return groups

    def _object(self, row: int, depth: int, folder: str) -> None:
        """Lines of an object and of all objects under it: not recursive, chains may be long."""
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


# --- The filter of the object list: its criteria, and the objects it keeps.


_FULL: Range = (0.0, 1.0)  # of shares


def measures(session: Session, table: ObjectTable) -> Measures:
    """Return what is known of the rows (G,) of ``table``."""
    document = session.need()
    scene = document.scene
    revision = scene.revision
    key = (revision.splats, revision.labels, document.read.n_splats(), table.ids.tobytes())
    sure = document.read.once(
        "confidence of groups", key, lambda: confidence_of_groups(scene, table.ids)
    )
    return {
        "size": 2.0 * table.radius,
        "splats": table.counts.astype(np.float64),
        "confidence": sure,
        "quality": quality_column(session, table),
    }


def whole_range(table: ObjectTable, measure: Measure, values: DoubleArray) -> Range | None:
    """Return the range in which all objects are; None when nothing is known of them."""
    known = values[(table.ids > 0) & (values >= 0)]
    if len(known) == 0:
        return None
    if measure in ("confidence", "quality"):
        return _FULL
    low, high = float(known.min()), float(known.max())
    return (np.floor(low * 1000) / 1000, np.ceil(high * 1000) / 1000)


def kept_rows(session: Session, table: ObjectTable) -> BoolArray | None:
    """Return which rows (G,) the filter keeps; None while it is off."""
    wanted = session.need().feature(ObjectListView).filter
    if not wanted.is_on:
        return None
    found = measures(session, table)
    key = (table, wanted, found["quality"].tobytes())
    return session.need().read.once("kept", key, lambda: wanted.keeps(table, found))


def kept_groups(session: Session, table: ObjectTable) -> frozenset[int] | None:
    """Return the groups of the rows that the filter keeps; None while it is off."""
    rows = kept_rows(session, table)
    if rows is None:
        return None

    def find() -> frozenset[int]:
        return frozenset(table.ids[rows].tolist())

    return session.need().read.once("kept groups", (table, rows.tobytes()), find)


UNSURE = 0.5  # confidence up to which an object is unsure: as likely as not it is something else


@notifies
def list_unsure(session: Session) -> None:
    """List only the objects of low confidence, for a decision by hand; again: list all."""
    view = session.need().feature(ObjectListView)
    view.filter = ListFilter() if is_unsure(session) else ListFilter({"confidence": (0.0, UNSURE)})


def is_unsure(session: Session) -> bool:
    """Whether only objects of low confidence are listed."""
    if session.document is None:
        return False
    ranges = session.document.feature(ObjectListView).filter.ranges
    return ranges == {"confidence": (0.0, UNSURE)}


def select_whole(session: Session) -> bool:
    """Select what the selected object or part is a part of, as an Alt click does."""
    return click_again(session, int(session.selected_indices()[0]), up=True)


def _no_whole(session: Session) -> str:
    if reason := no_selection(session):
        return reason
    first = int(session.selected_indices()[0])
    is_whole = _way_from(session, first, up=True) is None
    return "The selection is not a part of a larger object." if is_whole else ""


COMMANDS: tuple[Command, ...] = (
    Command("select.whole", "Select what it is a part of", select_whole, enabled=_no_whole),
    Command(
        "object.list_unsure",
        "List unsure objects only",
        list_unsure,
        enabled=no_confidence,
        is_on=is_unsure,
    ),
)


# --- lines of a session


def lines(
    session: Session, table: ObjectTable, sort: SortKey, falls: bool, renamed: int | None = None
) -> Lines:
    """Return the lines of ``table``, sorted; ``falls``: descending.

    The group whose name is typed (``renamed``) is neither filtered out nor folded away; what is
    selected is not folded away.
    """
    document = session.need()
    view, found = document.feature(ObjectListView), document.feature(SearchState).described
    kept, quality = kept_rows(session, table), quality_column(session, table)
    behind = found.description.background if found is not None else frozenset()
    if renamed is not None and kept is not None:
        kept = kept | (table.ids == renamed)  # a copy: it is shared
    stays = {*table.ids[table.n_selected > 0].tolist(), renamed}
    listing = Listing(
        table=table,
        rows=document.read.listed(table, "", sort, falls, quality).tolist(),
        folders=document.scene.folders,
        kept=kept,
        behind=behind,
        folded=behind - stays if session.settings.folds_background else frozenset(),
        falls=falls and sort == "name",
        parts=None if (index := part_index(session)) is None else index.parts,
    )
    key = (
        table.ids.tobytes(),
        tuple(listing.rows),
        listing.folders,
        None if kept is None else kept.tobytes(),
        (listing.behind, listing.folded, listing.falls),
        (view.closed, view.closed_groups, view.open_parts, index),
    )
    return document.read.once("lines", key, lambda: lines_of(listing, view))


def part_index(session: Session) -> PartIndex | None:
    """Return the parts of the objects; None where the groups have no levels, or are being made."""
    levels = levels_of(session)
    if levels is None or session.live is not None:
        return None
    document = session.need()
    scene, revision = document.scene, document.scene.revision
    key = (revision.splats, revision.labels, document.read.n_splats(), levels)
    return document.read.once("parts", key, lambda: PartIndex(scene, levels))


def levels_of(session: Session) -> Levels | None:
    """The levels of the open scene; None where its groups have none."""
    bank = session.scene.bank if session.scene is not None else None
    return None if bank is None else bank.levels


def clicks_again(session: Session) -> tuple[bool, bool]:
    """Whether a click on what is selected finds parts of it, and an Alt click what it is a part of.

    Both as long as not one whole object is selected, in a scene with levels.
    """
    index, groups = part_index(session), session.selected_groups()
    if index is None:
        return False, False
    if len(groups) != 1 or session.need().read.selects_parts():
        return True, True
    return bool(index.parts(groups[0])), bool(index.wholes(groups[0]))


@notifies
def select_part(session: Session, part: Part, name: str, how: How = "set") -> bool:
    """Select the splats of a part of the object ``name``; the object comes into the inspector."""
    document = session.need()
    done = document.select(part.rows, how, f"Select {part.name} of {name}")
    document.focus = part.key[0]
    return done


@notifies
def click_again(session: Session, splat: int, *, up: bool = False) -> bool:
    """Select the part of the selected object or part that holds ``splat``, one level of detail
    finer; ``up``: what the selection is a part of, one level coarser.

    Return whether there is one: not where the groups have no levels, and downwards not where
    something else is selected.
    """
    found = _way_from(session, splat, up=up)
    if found is None:
        return False
    title, rows = found
    document = session.need()
    done = document.select(rows, "set", title)
    document.focus = int(document.scene.labels[splat])
    return done


def _way_from(session: Session, splat: int, *, up: bool) -> tuple[str, IntArray] | None:
    """What `click_again` selects: the title of the step and the splats (K,)."""
    index, document = part_index(session), session.need()
    group = int(document.scene.labels[splat])
    if index is None or not group:
        return None
    name, ways = document.name_of(group), index.ways(group, splat)
    chosen = document.read.selected_indices()
    at = next((k for k, (_, rows) in enumerate(ways) if np.array_equal(rows, chosen)), None)
    object_at = next(k for k, (part, _) in enumerate(ways) if part == "")
    to = (object_at if at is None else at) - 1 if up else len(ways) if at is None else at + 1
    if not 0 <= to < len(ways):
        return None
    part, rows = ways[to]
    title = f"Select {part} of {name}" if to > object_at else f"Select {name}"
    return title if to >= object_at else f"Select more than {name}", rows


# --- pictures of objects

SMALL, LARGE = 96, 320  # pixels, in the list and in its tooltip

Load = Callable[[], ObjectDrawing]


def picture_request(
    session: Session, table: ObjectTable, row: int, side: int = SMALL
) -> tuple[str, Load | None] | None:
    """Return key and loader of the picture of a row of the list; None if there is none yet.

    Without a loader only a picture that was drawn before can be shown.
    """
    document = session.document
    group = int(table.ids[row])
    if document is None or group == 0:
        return None
    if session.live is not None and not session.live.keeps_ids:
        return None
    digest = document.feature(SearchState).digest_of(group)
    if digest is None:
        return None
    key = f"object {digest:x} {side}"
    if not _may_draw(session, document):
        return key, None
    # Columns are never written in place: a snapshot. What the picture takes is left to the loader,
    # which is called once, while this is asked for every row in every frame.
    revision = document.scene.revision.total()
    scene = document.read.once("snapshot", revision, lambda: replace(document.scene))
    return key, partial(_drawn, scene, table, row, session.cameras, session.rig.up, side)


def _may_draw(session: Session, document: Document) -> bool:
    """Whether digests are those of the scene, and nothing goes on that drawing would delay."""
    is_busy = session.is_previewing or session.live is not None or session.rig.is_moving
    return not is_busy and document.feature(SearchState).has_looks


def _view(table: ObjectTable, row: int, cameras: Sequence[Camera], up: DoubleArray) -> ObjectView:
    """From where the object of a row is drawn."""
    extent = np.linalg.norm(table.hi[row] - table.lo[row]) / 2
    radius = float(max(min(table.radius[row] * 1.2, extent), 1e-6))
    return object_view(table.centre[row], radius, cameras, up)


def _drawn(
    scene: Scene,
    table: ObjectTable,
    row: int,
    cameras: Sequence[Camera],
    up: DoubleArray,
    side: int,
) -> ObjectDrawing:
    """The object and nothing else, (side, side); drawn by OpenGL, which waits for no compiler."""
    rows = group_indices(scene, int(table.ids[row]))
    splats = bake(scene, indices=rows[:: max(-(-len(rows) // MOST_DRAWN), 1)])
    return object_drawing(splats, _view(table, row, cameras, up), side)
