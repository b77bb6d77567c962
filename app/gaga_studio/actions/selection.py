"""Select: by a click, whole objects, neighbours, similar encodings, numbers.

Numbers are ranges of columns, colors and boxes: what the "Select by" panel calls.
"""

from collections.abc import Callable, Sequence

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits import How
from gaga_core.scene.objects import group_indices, uncertain
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_value, by_volume
from gaga_core.scene.selection.by_value import Histogram
from gaga_core.scene.tint import mean_color
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.part_index import Part
from gaga_studio.session.session import NO_GROUPS, Session

# --- objects


def click(session: Session, u: float, v: float, width: int, height: int, how: How = "set") -> int:
    """Select the object at a pixel, add or remove it; return its group, 0 for none.

    To set the selection by a click on nothing, or on splats without a group, selects nothing.
    """
    found = session.pick(u, v, width, height)
    group = found.group if found is not None else 0
    session.hint = NO_GROUPS if found is not None and group == 0 else ""
    if group:
        select_groups(session, (group,), how)
    elif how == "set":
        select_none(session)
    return group


@notifies
def select_groups(session: Session, groups: Sequence[int], how: How = "set") -> bool:
    """Select whole objects, add or remove them; the first one comes into the inspector."""
    document = session.need()
    what = document.name_of(groups[0]) if len(groups) == 1 else f"{len(groups)} objects"
    verb = "Deselect" if how == "remove" else "Select"
    done = document.select(group_indices(document.scene, groups), how, f"{verb} {what}")
    if how != "remove" and groups:
        document.focus = int(groups[0])
    return done


@notifies
def select_part(session: Session, part: Part, name: str, how: How = "set") -> bool:
    """Select the splats of a part of the object ``name``; the object comes into the inspector."""
    document = session.need()
    done = document.select(part.rows, how, f"Select {part.name} of {name}")
    document.focus = part.key[0]
    return done


# --- everything


@notifies
def select_all(session: Session) -> bool:
    """Select everything that is visible and not locked."""
    document = session.need()
    return document.select(algebra.everything(document.scene), "set", "Select all")


@notifies
def select_none(session: Session) -> bool:
    """Select nothing."""
    return session.need().select(algebra.nothing(), "set", "Select nothing")


@notifies
def select_inverse(session: Session) -> bool:
    """Select what is not selected."""
    document = session.need()
    return document.select(algebra.inverted(document.scene), "set", "Invert selection")


@notifies
def select_uncertain(session: Session) -> bool:
    """Select splats of low confidence: of the selected objects, or of everything."""
    document = session.need()
    scene, groups = document.settled().scene, document.read.selected_groups()
    among = group_indices(scene, groups) if groups else algebra.everything(scene)
    threshold = document.confidence_threshold
    found = uncertain(scene, among, threshold)
    if len(found) == 0:
        session.notify(Level.HINT, f"No splat is below {100 * threshold:.0f} %.")
        return False
    return document.select(found, "set", "Select uncertain")


# --- neighbours and similar splats


@notifies
def grow(session: Session) -> bool:
    """Add the neighbours of the selection to it: one step of its own spacing."""
    # Imported when first asked for: search trees are a part of the launch time.
    from gaga_core.scene.selection.neighbourhood import grown, spacing

    return _change(
        session, "Grow the selection", lambda scene, i: grown(scene, i, spacing(scene, i))
    )


@notifies
def shrink(session: Session) -> bool:
    """Take the edge of the selection away: one step of its own spacing."""
    from gaga_core.scene.selection.neighbourhood import shrunk, spacing

    return _change(
        session, "Shrink the selection", lambda scene, i: shrunk(scene, i, spacing(scene, i))
    )


@notifies
def grow_by_identity(session: Session, likeness: float = 0.9) -> bool:
    """Add every splat whose identity encoding is similar to the selection's."""
    from gaga_core.scene.selection.neighbourhood import grown_by_identity

    def grown(scene: Scene, splats: IntArray) -> IntArray:
        names = [name for name in scene.gaussians.extra if name.startswith("obj_dc_")]
        if not names:
            raise GagaError("The splats have no identity encodings. Run gaga lift on the scene.")
        columns = [scene.gaussians.extra[name] for name in names]
        encodings = np.stack(columns, axis=1).astype(np.float32)
        return grown_by_identity(scene, splats, encodings, likeness)

    return _change(session, "Select what is alike", grown)


# --- numbers


class Histograms:
    """The histogram of the chosen column, made again when the scene changed."""

    def __init__(self) -> None:
        self._key: tuple[object, int, str] | None = None
        self._kept: Histogram | None = None

    def of(self, session: Session, name: str) -> Histogram:
        """Return the counts of a column, with those of the selection."""
        document = session.need()
        scene = document.history.base
        key = (document, scene.revision.total(), name)
        if self._kept is None or key != self._key:
            self._kept = by_value.histogram(scene, name, document.read.selected_indices())
            self._key = key
        return self._kept


def by_range(session: Session, name: str, low: float, high: float, how: How = "set") -> bool:
    """Select splats whose column lies in a range."""
    return _select(session, name, how, lambda s: by_value.in_range(s, name, low, high))


def by_color(session: Session, rgb: Sequence[float], tolerance: float, how: How = "set") -> bool:
    """Select splats of a color."""
    return _select(session, "a color", how, lambda s: by_value.like_color(s, rgb, tolerance))


def in_box(session: Session, lo: DoubleArray, hi: DoubleArray, how: How = "set") -> bool:
    """Select splats in an upright box (3,) to (3,), world."""
    return _select(session, "a box", how, lambda s: by_volume.in_box(s, box_matrix(lo, hi)))


@notifies
def crop(session: Session, lo: DoubleArray, hi: DoubleArray) -> bool:
    """Delete every splat outside an upright box that can be selected."""
    document = session.need()
    scene = document.settled().scene
    inside = by_volume.in_box(scene, box_matrix(lo, hi))
    outside = np.setdiff1d(algebra.everything(scene), inside)
    return document.do(edits.delete(scene, outside, "Crop"))


def box_matrix(lo: DoubleArray, hi: DoubleArray) -> DoubleArray:
    """Return the map (4, 4) from the unit cube to the world.

    A side is never shorter than a thousandth of the longest.
    """
    sides = np.abs(hi - lo)
    sides = np.maximum(sides, max(float(sides.max()) * 1e-3, 1e-9))
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(sides)
    matrix[:3, 3] = (lo + hi) / 2
    return matrix


def selected_color(session: Session) -> tuple[float, float, float]:
    """Return the mean color of the selection; grey when nothing is selected."""
    document = session.need()
    red, green, blue = mean_color(document.history.base, document.read.selected_indices())
    return float(red), float(green), float(blue)


@notifies
def _select(session: Session, what: str, how: How, choose: Callable[[Scene], IntArray]) -> bool:
    document = session.need()
    rows = choose(document.settled().scene)
    verb = "Deselect" if how == "remove" else "Select"
    return document.select(rows, how, f"{verb} by {what}")


def _change(session: Session, title: str, change: Callable[[Scene, IntArray], IntArray]) -> bool:
    document = session.need()
    splats = document.selected()
    return document.select(change(document.settled().scene, splats), "set", title)
