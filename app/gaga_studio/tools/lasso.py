"""Draw an outline around what is to be selected."""

from gaga_core.scene.selection import by_screen
from gaga_studio.features import selection
from gaga_studio.features.selection import Region
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import PathShape, ViewportPoint, region_hint

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
