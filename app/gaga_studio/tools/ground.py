"""Click three points of the ground; drags orbit."""

from gaga_studio.features import measure
from gaga_studio.session.session import Session
from gaga_studio.session.view import Point, ToolName
from gaga_studio.tools.base import ClickTool, ViewportPoint

_LEAST = 0.25  # opacity of a pixel at which it counts as a surface


def surface_point(session: Session, place: ViewportPoint) -> Point | None:
    """The point of the surface under the mouse, world; None where there is none."""
    found = session.pick(place.u, place.v, place.width, place.height)
    if found is None or found.weights.sum() < _LEAST:
        return None
    x, y, z = (float(value) for value in found.point)
    return x, y, z


class GroundTool(ClickTool):
    """The points (``measure.ClickedPoints``) are points in the world, so the camera may move.

    The window marks them (``ui.viewport.ground_overlay``); the end of the tool forgets them.
    """

    name = ToolName.GROUND

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add the surface point; the third one aligns the scene."""
        measure.add_ground_point(session, surface_point(session, place))

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{measure.ground_prompt(session)}  ·  {measure.GROUND_HELP}"
