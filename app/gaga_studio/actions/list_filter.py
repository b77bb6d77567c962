"""What the filter of the object list looks at, and which objects it keeps."""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.scene.objects import ObjectTable, confidence_of_groups
from gaga_studio.session.object_list import Measure, Measures, Range
from gaga_studio.session.session import Session

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


def kept(session: Session, table: ObjectTable, quality: DoubleArray) -> BoolArray | None:
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
    rows = kept(session, table, quality)
    if rows is None:
        return None

    def find() -> frozenset[int]:
        return frozenset(table.ids[rows].tolist())

    return session.need().read.once("kept groups", (table, rows.tobytes()), find)
