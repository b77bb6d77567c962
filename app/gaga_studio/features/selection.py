"""Select: by a click, whole objects, neighbours, similar encodings, numbers.

Numbers are ranges of columns, colors and boxes: what the "Select by" panel calls.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import How
from gaga_core.scene.objects import group_indices, uncertain
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection import algebra, by_value, by_volume
from gaga_core.scene.selection.by_value import Histogram
from gaga_studio.features.base import (
    Command,
    first_of,
    needs,
    no_confidence,
    no_scene,
    no_selection,
)
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName, ViewportPoint

if TYPE_CHECKING:
    from gaga_core.scene.selection.by_screen import Screen

# --- objects

NO_OBJECT = "This belongs to no object. Make it one with the tool Object (O)."
NO_OBJECTS = (
    "These splats belong to no object. Make them one with the tool Object (O), or switch on "
    "Select single splats, not objects."
)
LESS_THAN_HALF = (
    "No object is at least half inside. Draw around more of it, or switch on Select single "
    "splats, not objects."
)


def locked_hint(name: str) -> str:
    """What a gesture on something locked is answered with: ``name`` of it."""
    return f"Locked: {name}. The lock in its row of Objects or Unlock all frees it."


def click(session: Session, u: float, v: float, width: int, height: int, how: How = "set") -> int:
    """Select the object at a pixel, add or remove it; return its group, 0 for none.

    To set the selection by a click on nothing, or on splats without a group, selects nothing.
    """
    found = session.pick(u, v, width, height)
    group = found.group if found is not None else 0
    if group:
        select_groups(session, (group,), how)
        return group
    if how == "set":
        select_none(session)
    session.hint = NO_OBJECT if found is not None else ""
    return group


@notifies
def select_groups(session: Session, groups: Sequence[int], how: How = "set") -> bool:
    """Select whole objects, add or remove them; the first one comes into the inspector.

    Where all of them are locked, the hint says so.
    """
    document, verb = session.need(), "Deselect" if how == "remove" else "Select"
    title = f"{verb} {document.titled(*groups)}"
    splats = group_indices(document.scene, groups)
    done = document.select(splats, how, title)
    is_kept = how != "remove" and len(splats) > 0
    is_kept = is_kept and bool(document.scene.has(State.LOCKED)[splats].all())
    session.hint = locked_hint(document.names_of(groups)) if is_kept else ""
    if how != "remove" and groups:
        document.focus = int(groups[0])
    return done


# --- all splats


@dataclass
class Uncertain:
    """Which splats of a document count as uncertain."""

    threshold: float = 0.6  # of confidence


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
    threshold = document.feature(Uncertain).threshold
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
    """Select splats whose column is in a range."""
    return _select(session, name, how, lambda s: by_value.in_range(s, name, low, high))


def by_color(session: Session, rgb: Sequence[float], tolerance: float, how: How = "set") -> bool:
    """Select splats of a color."""
    return _select(session, "a color", how, lambda s: by_value.like_color(s, rgb, tolerance))


def in_box(session: Session, lo: DoubleArray, hi: DoubleArray, how: How = "set") -> bool:
    """Select splats in an upright box (3,) to (3,), world."""
    return _select(session, "a box", how, lambda s: by_volume.in_box(s, box_matrix(lo, hi)))


def box_around(session: Session) -> tuple[DoubleArray, DoubleArray]:
    """Corners lo, hi (3,), world, of an upright box that holds every selected splat, or every
    visible one where nothing is selected: to crop to it deletes none of these."""
    scene, chosen = session.need().scene, session.selected_indices()
    rows = chosen if len(chosen) else np.flatnonzero(scene.visible).astype(np.int32)
    points = algebra.world_means(scene, rows).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) == 0:
        return np.full(3, -0.5), np.full(3, 0.5)
    lo, hi = points.min(axis=0), points.max(axis=0)
    rim = _BOX_RIM * max(float((hi - lo).max()), 1e-9)
    return lo - rim, hi + rim


@notifies
def crop(session: Session, lo: DoubleArray, hi: DoubleArray) -> bool:
    """Delete every splat outside an upright box that can be selected."""
    scene = session.need().settled().scene
    inside = by_volume.in_box(scene, box_matrix(lo, hi))
    outside = np.setdiff1d(algebra.everything(scene), inside)
    return session.edit(lambda scene: edits.delete(scene, outside, "Crop"))


_BOX_RIM = 1e-4  # of the longest side: splats on a face are inside, as float32 rounds


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


# --- named selections


@notifies
def keep_selection(session: Session, name: str) -> bool:
    """Keep the selection under a name."""
    splats = session.need().selected()
    return session.edit(lambda scene: edits.keep_selection(scene, name, splats))


def keep_next_selection(session: Session) -> bool:
    """Keep the selection under the next free name: "set 3"."""
    kept = session.scene.named_selections if session.scene is not None else {}
    name = next(f"set {i}" for i in range(1, len(kept) + 2) if f"set {i}" not in kept)
    done = keep_selection(session, name)
    if done:
        where = "Named selections are at the end of the panel Select by."
        session.notify(Level.INFO, f"Kept the selection as “{name}”. {where}")
    return done


@notifies
def select_named(session: Session, name: str, how: How = "set") -> bool:
    """Select what is kept under a name."""
    document = session.need()
    rows = edits.named_selection(document.settled().scene, name)
    return document.select(rows, how, f"Select {name}")


@notifies
def forget_named(session: Session, name: str) -> bool:
    """Forget a named selection."""
    return session.edit(lambda scene: edits.forget_selection(scene, name))


# --- regions of the picture

# Of the splats in the middle of a stroke: fewer are of what shows through, or of an edge.
_LEAST_SEEN = 0.02
_LONGEST = 480  # longest side, pixels, of the depth picture

_worker = ThreadPoolExecutor(1, thread_name_prefix="surface")
_WHOLE = "An object is always selected whole, including its hidden parts."
_PAINTS = "The brush takes the objects whose visible surface it goes over."


def why_splats(session: Session) -> str:
    """Why tools that select regions take single splats, whatever is chosen; "" where they can take
    whole objects."""
    document = session.document
    has_groups = document is not None and document.read.has_groups()
    return "" if has_groups else session.no_groups_text


def takes_splats(session: Session) -> bool:
    """Whether they take single splats, not whole objects."""
    return session.view.takes_splats or bool(why_splats(session))


def why_so_deep(session: Session) -> str:
    """Why they take the visible surface alone, or all behind it, whatever is chosen; "" where
    either can be had."""
    if takes_splats(session):
        return ""
    return _PAINTS if session.tool is ToolName.BRUSH else _WHOLE


def takes_surface(session: Session) -> bool:
    """Whether they take what the visible surface shows alone."""
    if takes_splats(session):
        return session.view.visible_only
    return session.tool is ToolName.BRUSH


class Region:
    """One gesture's view of the scene: from the press to the release."""

    def __init__(
        self,
        session: Session,
        place: ViewportPoint,
        *,
        surface_only: bool = False,
        paints: bool = False,
    ) -> None:
        """``surface_only``: single splats of the visible surface, whatever the options say.

        ``paints``: of whole objects those whose visible surface it goes over, see `chosen`.
        """
        document = session.need()
        self._session, self._document = session, document
        self._camera = session.rig.camera(place.width, place.height)
        self._scene = document.settled().scene
        self._whole = not surface_only and not takes_splats(session)
        self._depth: Future[FloatArray] | None = None
        self._through: Screen | None = None
        self._surface: Screen | None = None
        self._paints = paints and self._whole
        if surface_only or self._paints or session.view.visible_only:
            self._depth = _worker.submit(_median_depth, self._scene, self._camera)
        self.how: How = place.how

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the picture."""
        return self._camera.height, self._camera.width

    @property
    def is_known(self) -> bool:
        """Whether the visible surface is there, if it counts: until then `splats` waits for it."""
        return self._depth is None or self._depth.done()

    def take(self, mask: BoolArray) -> bool:
        """Select what ``mask`` (H, W) covers, as one edit."""
        self._document.history.preview(None)
        chosen, title = self.chosen(mask)
        self.say_why_nothing(mask)
        return self._document.select(chosen, self.how, title)

    def say_why_nothing(self, mask: BoolArray, middle: BoolArray | None = None) -> None:
        """Hint at what keeps ``mask`` from anything: all that it would choose is locked, belongs to
        no object, or is less than half of one."""
        self._session.hint = ""
        if self.how == "remove" or len(self.chosen(mask, middle)[0]):
            return
        free = copy(self)
        free._through = free._surface = None
        free._scene = replace(self._scene, state=self._scene.state & ~np.uint8(State.LOCKED))
        rows, _ = free.chosen(mask, middle)
        groups = np.unique(self._scene.labels[rows])
        groups = groups[groups > 0]
        if len(groups):
            self._session.hint = locked_hint(self._document.names_of(groups.tolist()))
        elif len(rows):
            self._session.hint = locked_hint(counted(len(rows), "splat"))
        elif len(covered := free.splats(mask)):
            # A brush takes what its middle sees, however little of it: that is of no object.
            is_of_some = not self._paints and bool(self._scene.labels[covered].any())
            self._session.hint = LESS_THAN_HALF if is_of_some else NO_OBJECTS

    def splats(self, mask: BoolArray) -> IntArray:
        """Splats (K,) that ``mask`` (H, W) covers."""
        return self._screen().inside(mask)

    def chosen(self, mask: BoolArray, middle: BoolArray | None = None) -> tuple[IntArray, str]:
        """What ``mask`` (H, W) selects (K,), and the title of that edit.

        Where it paints objects these are the ones that are seen in the ``middle`` of the stroke.
        """
        verb = "Deselect" if self.how == "remove" else "Select"
        if self._paints and middle is not None:
            splats = self._screen().inside(middle)
            splats = splats if len(splats) else self._screen().inside(mask)
            seen = np.bincount(self._scene.labels[splats])
            groups = algebra.rows_of(seen >= max(_LEAST_SEEN * int(seen.sum()), 1))
            groups = groups[groups > 0]
        else:
            splats = self._screen().inside(mask)
            if not self._whole:
                return splats, f"{verb} {counted(len(splats), 'splat')}"
            groups = algebra.groups_inside(self._scene, splats)
        rows = group_indices(self._scene, groups)
        if len(groups) == 1:
            return rows, f"{verb} {self._document.name_of(int(groups[0]))}"
        return rows, f"{verb} {counted(len(groups), 'object')}"

    def _screen(self) -> "Screen":
        # Imported when first asked for: numba is a good part of the launch time.
        from gaga_core.scene.selection.by_screen import screen

        # Of an object all splats count, seen or not, but under a brush.
        if self._depth is None or (self._whole and not self._paints):
            self._through = self._through or screen(self._scene, self._camera)
            return self._through
        self._surface = self._surface or screen(self._scene, self._camera, self._depth.result())
        return self._surface


def _median_depth(scene: Scene, camera: Camera) -> FloatArray:
    """Render the median depth (H, W) at the camera's size, from a smaller picture."""
    shrink = min(1.0, _LONGEST / max(camera.width, camera.height))
    width, height = max(round(camera.width * shrink), 1), max(round(camera.height * shrink), 1)
    plain = bake(scene)
    depth = choose("cpu").render(plain, camera.resized(width, height)).median_depth
    rows = (np.arange(camera.height) + 0.5) * height / camera.height
    columns = (np.arange(camera.width) + 0.5) * width / camera.width
    result: FloatArray = depth[rows.astype(int)[:, None], columns.astype(int)]
    return result


def close_outline(session: Session) -> None:
    """Select what the outline holds, as one edit."""
    outline, session.view.outline = session.view.outline, None
    if outline is None or len(outline.points) < 3:
        return
    from gaga_core.scene.selection import by_screen

    first = outline.points[0]
    region = Region(session, ViewportPoint(*first, outline.width, outline.height, outline.how))
    region.take(by_screen.polygon(outline.points, outline.width, outline.height))


_no_encodings = first_of(
    no_selection,
    needs(
        lambda session: "obj_dc_0" in session.need().scene.gaussians.extra,
        "The splats have no identity encodings. Run gaga lift on the scene and export them.",
    ),
)
COMMANDS: tuple[Command, ...] = (
    Command("select.all", "Select all", select_all, "Ctrl+A", enabled=no_scene),
    Command(
        "select.none",
        "Select nothing",
        select_none,
        "Ctrl+Shift+A",
        enabled=no_selection,
    ),
    Command("select.invert", "Invert selection", select_inverse, "Ctrl+I", enabled=no_scene),
    Command("select.grow", "Grow", grow, enabled=no_selection),
    Command("select.shrink", "Shrink", shrink, enabled=no_selection),
    Command(
        "select.alike", "Grow to similar splats (identity)", grow_by_identity, enabled=_no_encodings
    ),
    Command("select.keep", "Keep the selection", keep_next_selection, enabled=no_selection),
    Command("object.uncertain", "Select uncertain splats", select_uncertain, enabled=no_confidence),
)
