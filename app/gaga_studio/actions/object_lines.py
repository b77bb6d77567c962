"""The lines of the object list, made again only when something of them has changed."""

from gaga_core.arrays import DoubleArray
from gaga_core.grouping.levels import Levels
from gaga_core.scene.objects import ObjectTable
from gaga_studio.actions import list_filter
from gaga_studio.session.object_list import Lines, Listing, lines_of
from gaga_studio.session.part_index import PartIndex
from gaga_studio.session.scene_cache import SortKey
from gaga_studio.session.session import Session


def lines(
    session: Session, table: ObjectTable, quality: DoubleArray, sort: SortKey, falls: bool
) -> Lines:
    """Return the lines of ``table``, sorted; ``quality`` (G,) is by row, ``falls``: descending."""
    document = session.need()
    view, found = document.listing, document.search.described
    kept = list_filter.kept(session, table, quality)
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
