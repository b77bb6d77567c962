"""Click an object to select it whole; drags orbit."""

from gaga_studio.session import Session
from gaga_studio.tools.base import Place, RectShape
from gaga_studio.view import ToolName


class PickTool:
    """The default tool."""

    name = ToolName.PICK
    takes_drag = False

    def click(self, session: Session, place: Place) -> None:
        """Select the object under the mouse."""
        session.click(place.u, place.v, place.width, place.height, place.how)

    def press(self, session: Session, place: Place) -> None:
        """Drags are the camera's."""

    def drag(self, session: Session, place: Place) -> None:
        """Drags are the camera's."""

    def release(self, session: Session, place: Place) -> None:
        """Drags are the camera's."""

    def cancel(self, session: Session) -> None:
        """Nothing to cancel."""

    def overlay(self) -> RectShape | None:
        """Nothing to draw."""
        return None

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return "Click selects the object, Shift adds, Ctrl removes. Drag orbits."
