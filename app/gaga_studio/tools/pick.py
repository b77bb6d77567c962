"""Click an object to select it whole; drags orbit."""

from gaga_studio.features import selection
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import ClickTool, ViewportPoint


class PickTool(ClickTool):
    """The default tool."""

    name = ToolName.PICK

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return "Click selects the object, Shift adds, Ctrl removes. Drag orbits."
