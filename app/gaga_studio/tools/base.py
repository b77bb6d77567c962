"""The interface of a tool, which takes the left drag of the picture or only clicks."""

from dataclasses import dataclass
from typing import Protocol

from gaga_core.scene.edits import How
from gaga_studio.features import selection
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.session.view import ViewportPoint as ViewportPoint


@dataclass(frozen=True)
class RectShape:
    """A rectangle to draw over the picture, pixels, any corner order."""

    u0: float
    v0: float
    u1: float
    v1: float
    how: How


@dataclass(frozen=True)
class PathShape:
    """A line over the picture, pixels; of one point with a radius: a circle."""

    points: tuple[tuple[float, float], ...]
    how: How
    is_closed: bool = False
    has_corners: bool = False  # shown as handles
    radius: float = 0.0


class Tool(Protocol):
    """A gesture shows what it does, commits one edit on release, and none on cancel."""

    name: ToolName
    takes_drag: bool  # the left drag is the tool's; else it orbits

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Handle a press that did not move."""
        ...

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Begin a drag."""
        ...

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Continue a drag."""
        ...

    def release(self, session: Session, place: ViewportPoint) -> None:
        """End a drag."""
        ...

    def cancel(self, session: Session) -> None:
        """Cancel (Escape): everything is as before the press."""
        ...

    def overlay(self) -> RectShape | PathShape | None:
        """Return what to draw over the picture now."""
        ...

    def hint(self, session: Session) -> str:
        """Return what a click or drag does now, for the status line."""
        ...


class ClickTool:
    """Base of tools that only take clicks: drags move the camera."""

    takes_drag = False

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Do nothing: drags move the camera."""

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Do nothing: drags move the camera."""

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Do nothing: drags move the camera."""

    def cancel(self, session: Session) -> None:
        """Do nothing: there is no gesture."""

    def overlay(self) -> RectShape | None:
        """Draw nothing."""
        return None


class BoxDrag:
    """Base of tools whose drag has two corners."""

    takes_drag = True

    def __init__(self) -> None:
        self._from: ViewportPoint | None = None
        self._to: ViewportPoint | None = None

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Set the first corner."""
        self._from = self._to = place

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Set the opposite corner, for now."""
        self._to = place

    def cancel(self, session: Session) -> None:
        """Forget the box."""
        self._from = self._to = None

    def overlay(self) -> RectShape | None:
        """The box while it is drawn."""
        if self._from is None or self._to is None:
            return None
        return RectShape(self._from.u, self._from.v, self._to.u, self._to.v, self._from.how)


def region_hint(session: Session, act: str) -> str:
    """Return what a gesture that selects a region does, in words."""
    what = "visible splats" if session.view.visible_only else "splats"
    if not selection.takes_splats(session):
        what = "objects"
    return f"{act} to select {what}; Shift adds, Ctrl removes. Middle drag orbits."
