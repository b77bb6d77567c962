"""Click three points of the ground; drags orbit, so that each can be seen well."""

from gaga_studio import grounding
from gaga_studio.session import Session
from gaga_studio.tools.base import Place, RectShape
from gaga_studio.view import ToolName

_LEAST = 0.25  # opacity of a pixel from which it shows a surface, not a haze


class GroundTool:
    """The points are kept in ``view.ground``: they stand in space, so the camera may move."""

    name = ToolName.GROUND
    takes_drag = False

    def click(self, session: Session, place: Place) -> None:
        """The surface there is a point of the ground; the third one lays the scene level."""
        found = session.pick(place.u, place.v, place.width, place.height)
        if found is None or found.weights.sum() < _LEAST:
            grounding.add(session, None)
            return
        x, y, z = (float(value) for value in found.point)
        grounding.add(session, (x, y, z))

    def press(self, session: Session, place: Place) -> None:
        """Drags are the camera's."""

    def drag(self, session: Session, place: Place) -> None:
        """Drags are the camera's."""

    def release(self, session: Session, place: Place) -> None:
        """Drags are the camera's."""

    def cancel(self, session: Session) -> None:
        """The points stay: the tool's end forgets them."""

    def overlay(self) -> RectShape | None:
        """The window marks the points, wherever the camera stands (``ui.ground``)."""
        return None

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{grounding.prompt(session)}  ·  {grounding.HELP}"
