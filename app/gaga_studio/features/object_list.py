"""What the filter of the object list looks at, and which objects it keeps."""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.grouping.levels import Levels
from gaga_core.scene.objects import ObjectTable, confidence_of_groups
from gaga_studio.session.object_list import Lines, Listing, Measure, Measures, Range, lines_of
from gaga_studio.session.part_index import PartIndex
from gaga_studio.session.scene_cache import SortKey
from gaga_studio.session.session import Session

# --- What the filter of the object list looks at, and which objects it keeps.


_FULL: Range = (0.0, 1.0)  # of shares


def measures(session: Session, table: ObjectTable, quality: DoubleArray) -> Measures:
    """Return what is known of the rows (G,) of ``table``; ``quality`` (G,) is measured before."""
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
        "quality": quality,
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


def kept_rows(session: Session, table: ObjectTable, quality: DoubleArray) -> BoolArray | None:
    """Return which rows (G,) the filter keeps; None while it is off."""
    wanted = session.need().listing.filter
    if not wanted.is_on:
        return None
    found = measures(session, table, quality)
    key = (table, wanted, quality.tobytes())
    return session.need().read.once("kept", key, lambda: wanted.keeps(table, found))


def kept_groups(
    session: Session, table: ObjectTable, quality: DoubleArray
) -> frozenset[int] | None:
    """Return the groups of the rows that the filter keeps; None while it is off."""
    rows = kept_rows(session, table, quality)
    if rows is None:
        return None

    def find() -> frozenset[int]:
        return frozenset(table.ids[rows].tolist())

    return session.need().read.once("kept groups", (table, rows.tobytes()), find)


# --- The lines of the object list, made again only when something of them has changed.


def lines(
    session: Session, table: ObjectTable, quality: DoubleArray, sort: SortKey, falls: bool
) -> Lines:
    """Return the lines of ``table``, sorted; ``quality`` (G,) is by row, ``falls``: descending."""
    document = session.need()
    view, found = document.listing, document.search.described
    kept = kept_rows(session, table, quality)
    listing = Listing(
        table=table,
        rows=document.read.listed(table, "", sort, falls, quality).tolist(),
        folders=document.scene.folders,
        kept=kept,
        behind=found.description.background if found is not None else frozenset(),
        folds_background=session.settings.folds_background,
        falls=falls and sort == "name",
        parts=None if (index := part_index(session)) is None else index.parts,
    )
    key = (
        table.ids.tobytes(),
        tuple(listing.rows),
        listing.folders,
        None if kept is None else kept.tobytes(),
        (listing.behind, listing.folds_background, listing.falls),
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
    """The levels of the open scene; None where its groups have none, or while they are made."""
    if session.scene is None or session.jobs.running is not None:
        return None
    bank = session.scene.bank
    return None if bank is None else bank.levels
