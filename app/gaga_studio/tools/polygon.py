"""Click the corners of an outline; Enter or a double click closes it."""

from gaga_studio.features.selection import close_outline
from gaga_studio.session.session import Session
from gaga_studio.session.view import Outline, ToolName
from gaga_studio.tools.base import PathShape, ViewportPoint, region_hint

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
