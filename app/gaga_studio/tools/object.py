"""Click a thing to select it, whatever groups there are; drag a box around it."""

from gaga_studio.features.find import click_object
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import RectShape, ViewportPoint


class ObjectTool:
    """Every click changes the answer; what is known of the clicks is in ``ClickState``."""

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
