"""Tools that select a region of the picture: rectangle, lasso and polygon."""

from gaga_core.scene.selection import by_screen
from gaga_studio.features import selection
from gaga_studio.features.selection import Region, close_outline
from gaga_studio.session.session import Session
from gaga_studio.session.view import Outline, ToolName
from gaga_studio.tools.base import BoxDrag, PathShape, ViewportPoint, region_hint

# --- Drag a rectangle: it selects whole objects or single splats.


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


def _is_near(corner: tuple[float, float], place: ViewportPoint) -> bool:
    return max(abs(corner[0] - place.u), abs(corner[1] - place.v)) <= _NEAR


def _pose(session: Session, width: int, height: int) -> bytes:
    """Return the pose of the picture: an outline belongs to one."""
    return session.rig.camera(width, height).cam_from_world.tobytes()
