"""Drag a rectangle: what lies in it is selected, whole objects or single splats."""

from gaga_core.scene.selection import by_screen
from gaga_studio.features import selection
from gaga_studio.features.selection import Region
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import RectShape, ViewportPoint, region_hint


class RectTool:
    """Two corners."""

    name = ToolName.RECT
    takes_drag = True

    def __init__(self) -> None:
        self._region: Region | None = None
        self._from: ViewportPoint | None = None
        self._to: ViewportPoint | None = None

    def click(self, session: Session, place: ViewportPoint) -> None:
        """A rectangle without area: the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Set the first corner."""
        self._region = Region(session, place)
        self._from = self._to = place

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Set the opposite corner, for now."""
        self._to = place

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Select what the rectangle holds, as one edit."""
        region, first = self._region, self._from
        self._region = self._from = self._to = None
        if region is None or first is None:
            return
        height, width = region.shape
        corners = (first.u, first.v, place.u, place.v)
        region.take(by_screen.rectangle(corners, width, height))

    def cancel(self, session: Session) -> None:
        """Forget the rectangle."""
        self._region = self._from = self._to = None

    def overlay(self) -> RectShape | None:
        """The rectangle while it is drawn."""
        if self._from is None or self._to is None:
            return None
        return RectShape(self._from.u, self._from.v, self._to.u, self._to.v, self._from.how)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return region_hint(session, "Drag a rectangle")
