"""Tools that select a region of the picture: rectangle, lasso, polygon and brush."""

from concurrent.futures import Future, ThreadPoolExecutor
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.raster import choose
from gaga_core.scene import edits
from gaga_core.scene.bake import bake
from gaga_core.scene.edits import How
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra, by_screen
from gaga_studio.actions import selection
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Outline, ToolName
from gaga_studio.tools.base import BoxDrag, PathShape, ViewportPoint, region_hint

if TYPE_CHECKING:
    from gaga_core.scene.selection.by_screen import Screen

_LONGEST = 480  # longest side, pixels, of the depth picture

_worker = ThreadPoolExecutor(1, thread_name_prefix="surface")


class Region:
    """One gesture's view of the scene: from the press to the release."""

    def __init__(
        self, session: Session, place: ViewportPoint, *, surface_only: bool = False
    ) -> None:
        """``surface_only``: single splats of the visible surface, whatever the options say."""
        document = session.need()
        self._document = document
        self._camera = session.rig.camera(place.width, place.height)
        self._scene = document.settled().scene
        takes_splats = surface_only or session.view.takes_splats
        self._whole = not takes_splats and document.read.has_groups()
        self._depth: Future[FloatArray] | None = None
        self._through: Screen | None = None
        self._surface: Screen | None = None
        if surface_only or session.view.visible_only:
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

    def preview(self, mask: BoolArray) -> None:
        """Show what ``mask`` (H, W) would select; the surface as soon as it is known."""
        if not self.is_known:
            return
        chosen, title = self._chosen(mask)
        self._document.history.preview_with(
            lambda base: edits.select(base, chosen, self.how, title)
        )

    def take(self, mask: BoolArray) -> bool:
        """Select what ``mask`` (H, W) covers, as one edit."""
        self._document.history.preview(None)
        chosen, title = self._chosen(mask)
        return self._document.select(chosen, self.how, title)

    def splats(self, mask: BoolArray) -> IntArray:
        """Splats (K,) that ``mask`` (H, W) covers."""
        return self._screen().inside(mask)

    def cancel(self) -> None:
        """Cancel: everything is as before the gesture."""
        self._document.history.preview(None)

    def _chosen(self, mask: BoolArray) -> tuple[IntArray, str]:
        splats = self._screen().inside(mask)
        verb = "Deselect" if self.how == "remove" else "Select"
        if not self._whole:
            return splats, f"{verb} {len(splats):,} splats"
        groups = algebra.groups_inside(self._scene, splats)
        rows = algebra.group_indices(self._scene, groups)
        if len(groups) == 1:
            return rows, f"{verb} {self._document.name_of(int(groups[0]))}"
        return rows, f"{verb} {len(groups)} objects"

    def _screen(self) -> "Screen":
        # Imported when first asked for: numba is a good part of the launch time.
        from gaga_core.scene.selection.by_screen import screen

        # Of an object all splats count, seen or not.
        if self._depth is None or self._whole:
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


# --- Drag a rectangle: what lies in it is selected, whole objects or single splats.


class RectTool(BoxDrag):
    """Two corners."""

    name = ToolName.RECT

    def __init__(self) -> None:
        super().__init__()
        self._region: Region | None = None

    def click(self, session: Session, place: ViewportPoint) -> None:
        """A rectangle without area: the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Set the first corner."""
        self._region = Region(session, place)
        super().press(session, place)

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Select what the rectangle holds, as one edit."""
        region, first = self._region, self._from
        self.cancel(session)
        if region is not None and first is not None:
            height, width = region.shape
            corners = (first.u, first.v, place.u, place.v)
            region.take(by_screen.rectangle(corners, width, height))

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return region_hint(session, "Drag a rectangle")


# --- Draw an outline around what is to be selected.

_FINEST = 2.0  # pixels between two corners of the outline


class LassoTool:
    """A free line that closes itself."""

    name = ToolName.LASSO
    takes_drag = True

    def __init__(self) -> None:
        self._region: Region | None = None
        self._points: list[tuple[float, float]] = []

    def click(self, session: Session, place: ViewportPoint) -> None:
        """An outline without area: the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """The outline begins."""
        self._region = Region(session, place)
        self._points = [(place.u, place.v)]

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """The outline goes on."""
        if self._region is None:
            return
        u, v = self._points[-1]
        if max(abs(place.u - u), abs(place.v - v)) >= _FINEST:
            self._points.append((place.u, place.v))

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Close the outline and select what it holds, as one edit."""
        region, points = self._region, self._points
        self.cancel(session)
        if region is not None:
            height, width = region.shape
            region.take(by_screen.polygon(points, width, height))

    def cancel(self, session: Session) -> None:
        """Forget the outline."""
        self._region, self._points = None, []

    def overlay(self) -> PathShape | None:
        """The outline while it is drawn."""
        if self._region is None:
            return None
        return PathShape(tuple(self._points), self._region.how, is_closed=True)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return region_hint(session, "Draw around")


# --- Click the corners of an outline; Enter or a double click closes it.

_NEAR = 8.0  # pixels from the first corner at which a click closes the outline


class PolygonTool:
    """The corners are kept in ``view.outline``, where commands reach them too."""

    name = ToolName.POLYGON
    takes_drag = True

    def __init__(self) -> None:
        self._shown: Outline | None = None
        self._at: tuple[float, float] | None = None  # the mouse

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add a corner; on the first one, close the outline."""
        outline = session.view.outline
        pose = _pose(session, place.width, place.height)
        if outline is None or outline.pose != pose:
            outline = Outline((), place.width, place.height, place.how, pose)
        if len(outline.points) > 2 and _is_near(outline.points[0], place):
            session.view.outline = outline
            close_outline(session)
        else:
            session.view.outline = outline.with_corner((place.u, place.v))
        self._shown = session.view.outline

    def double_click(self, session: Session, place: ViewportPoint) -> None:
        """Add the last corner and close the outline."""
        if session.view.outline is not None:
            close_outline(session)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """A drag sets a corner where it begins."""
        self.click(session, place)

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """The next corner is where the drag ends."""
        self.hover(session, place)

    def release(self, session: Session, place: ViewportPoint) -> None:
        """A corner where the drag ends."""
        self.click(session, place)

    def cancel(self, session: Session) -> None:
        """Forget the outline."""
        session.view.outline = self._shown = None

    def hover(self, session: Session, place: ViewportPoint | None) -> None:
        """The line from the last corner follows the mouse; a camera that moved ends the outline."""
        outline = session.view.outline
        if outline is not None and outline.pose != _pose(session, outline.width, outline.height):
            session.view.outline = outline = None
        self._shown = outline
        self._at = None if place is None else (place.u, place.v)

    def overlay(self) -> PathShape | None:
        """The outline, with a line to the mouse."""
        if self._shown is None:
            return None
        points = self._shown.points + ((self._at,) if self._at is not None else ())
        return PathShape(points, self._shown.how, is_closed=len(points) > 2, has_corners=True)

    def hint(self, session: Session) -> str:
        """What a click does now."""
        if session.view.outline is None:
            return region_hint(session, "Click the corners of an outline")
        return "Click the next corner. Enter or a double click closes, Backspace takes one back."


def close_outline(session: Session) -> None:
    """Select what the outline holds, as one edit."""
    outline, session.view.outline = session.view.outline, None
    if outline is None or len(outline.points) < 3:
        return
    first = outline.points[0]
    region = Region(session, ViewportPoint(*first, outline.width, outline.height, outline.how))
    region.take(by_screen.polygon(outline.points, outline.width, outline.height))


def _is_near(corner: tuple[float, float], place: ViewportPoint) -> bool:
    return max(abs(corner[0] - place.u), abs(corner[1] - place.v)) <= _NEAR


def _pose(session: Session, width: int, height: int) -> bytes:
    """Return the pose of the picture: an outline belongs to one."""
    return session.rig.camera(width, height).cam_from_world.tobytes()


# --- Paint over what is to be selected; the selection follows the brush.

_SHARE = 0.5  # of the time that the preview of a stroke may take at most


class BrushTool:
    """A round brush; ``view.brush_radius`` pixels of the screen."""

    name = ToolName.BRUSH
    takes_drag = True

    def __init__(self) -> None:
        self._region: Region | None = None
        self._mask: BoolArray = np.zeros((0, 0), np.bool_)
        self._last = (0.0, 0.0)
        self._at: tuple[float, float] | None = None  # where the resting brush is shown
        self._radius = 0.0
        self._next = 0.0  # when the preview may be made again

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select what the brush covers, once."""
        self.press(session, place)
        self.release(session, place)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Begin a stroke."""
        self._region = Region(session, place)
        self._mask = np.zeros(self._region.shape, np.bool_)
        self._radius = session.view.brush_radius
        self._last, self._next = (place.u, place.v), 0.0
        self._paint(place)

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Continue the stroke, and show what it selects."""
        if self._region is None:
            return
        self._paint(place)
        start = perf_counter()
        if start >= self._next:
            self._region.preview(self._mask)
            spent = perf_counter() - start
            self._next = perf_counter() + spent / _SHARE

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Select what was painted over, as one edit."""
        region, self._region = self._region, None
        if region is not None:
            self._paint(place)
            region.take(self._mask)

    def cancel(self, session: Session) -> None:
        """Cancel: everything is as before the stroke."""
        region, self._region = self._region, None
        if region is not None:
            region.cancel()

    def hover(self, session: Session, place: ViewportPoint | None) -> None:
        """Show the brush at the mouse."""
        self._radius = session.view.brush_radius
        self._at = None if place is None else (place.u, place.v)

    def overlay(self) -> PathShape | None:
        """The brush."""
        at = self._last if self._region is not None else self._at
        how = self._region.how if self._region is not None else "set"
        return None if at is None else PathShape((at,), how, radius=self._radius)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return region_hint(session, "Paint") + " [ and ] change the size."

    def _paint(self, place: ViewportPoint) -> None:
        by_screen.stroke(self._mask, self._last, (place.u, place.v), self._radius)
        self._last = (place.u, place.v)
