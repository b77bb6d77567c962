"""Click points of the surface and read what lies between them; drags orbit."""

from gaga_studio.features import measure
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import ClickTool, ViewportPoint
from gaga_studio.tools.ground import surface_point


class MeasureTool(ClickTool):
    """The points are ``measure.ClickedPoints``; the window marks them (``measure_overlay``)."""

    name = ToolName.MEASURE

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add the surface point."""
        measure.add(session, surface_point(session, place))

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{measure.prompt(session)}  ·  {measure.HELP}"
