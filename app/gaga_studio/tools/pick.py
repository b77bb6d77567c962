"""Click an object to select it whole; drags orbit."""

from gaga_studio.actions import align_ground, click_object, measure, selection
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Point, ToolName
from gaga_studio.tools.base import ClickTool, RectShape, ViewportPoint

# --- Click an object to select it whole; drags orbit.


class PickTool(ClickTool):
    """The default tool."""

    name = ToolName.PICK

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return "Click selects the object, Shift adds, Ctrl removes. Drag orbits."


# --- Click three points of the ground; drags orbit.


_LEAST = 0.25  # opacity of a pixel at which it counts as a surface


def surface_point(session: Session, place: ViewportPoint) -> Point | None:
    """The point of the surface under the mouse, world; None where there is none."""
    found = session.pick(place.u, place.v, place.width, place.height)
    if found is None or found.weights.sum() < _LEAST:
        return None
    x, y, z = (float(value) for value in found.point)
    return x, y, z


class GroundTool(ClickTool):
    """The points are kept in ``view.ground``: they are points in the world, so the camera may move.

    The window marks them (``ui.viewport.ground_overlay``); the end of the tool forgets them.
    """

    name = ToolName.GROUND

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add the surface point; the third one aligns the scene."""
        align_ground.add(session, surface_point(session, place))

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{align_ground.prompt(session)}  ·  {align_ground.HELP}"


# --- Click points of the surface and read what lies between them; drags orbit.


class MeasureTool(ClickTool):
    """The points are kept in ``view.measured``; the window marks them (``measure_overlay``)."""

    name = ToolName.MEASURE

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add the surface point."""
        measure.add(session, surface_point(session, place))

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{measure.prompt(session)}  ·  {measure.HELP}"


# --- Click a thing to select it, whatever groups there are; drag a box around it.


class ObjectTool:
    """Every click changes the answer; what is known of the clicks is in ``document.clicks``."""

    name = ToolName.OBJECT
    takes_drag = True

    def __init__(self) -> None:
        self._from: ViewportPoint | None = None
        self._to: ViewportPoint | None = None

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add what is under the mouse to the object; with Alt or Ctrl take it away."""
        is_on = not (place.alt or place.how == "remove")
        click_object.click(session, place.u, place.v, place.width, place.height, is_on=is_on)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Set the first corner of a box."""
        self._from = self._to = place

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Set the opposite corner, for now."""
        self._to = place

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Begin an object with what the box holds."""
        first, self._from, self._to = self._from, None, None
        if first is not None:
            corners = (first.u, first.v, place.u, place.v)
            click_object.box(session, corners, place.width, place.height)

    def cancel(self, session: Session) -> None:
        """Forget the box."""
        self._from = self._to = None

    def overlay(self) -> RectShape | None:
        """The box while it is drawn."""
        if self._from is None or self._to is None:
            return None
        return RectShape(self._from.u, self._from.v, self._to.u, self._to.v, "set")

    def hint(self, session: Session) -> str:
        """What a click or drag does now."""
        return click_object.prompt(session)
