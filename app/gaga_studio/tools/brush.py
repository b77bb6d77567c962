"""Paint over what is to be selected; the selection follows the brush."""

from time import perf_counter

import numpy as np

from gaga_core.arrays import BoolArray
from gaga_core.scene.selection import by_screen
from gaga_studio.features.selection import Region
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import PathShape, ViewportPoint, region_hint

_SHARE = 0.5  # of the time that the preview of a stroke may take at most


class BrushTool:
    """A round brush; ``view.brush_radius`` pixels of the screen."""

    name = ToolName.BRUSH
    takes_drag = True

    def __init__(self) -> None:
        self._region: Region | None = None
        self._mask: BoolArray = np.zeros((0, 0), np.bool_)
        self._last = (0.0, 0.0)
        self._at: tuple[float, float] | None = None  # where the resting brush is shown
        self._radius = 0.0
        self._next = 0.0  # when the preview may be made again

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select what the brush covers, once."""
        self.press(session, place)
        self.release(session, place)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Begin a stroke."""
        self._region = Region(session, place)
        self._mask = np.zeros(self._region.shape, np.bool_)
        self._radius = session.view.brush_radius
        self._last, self._next = (place.u, place.v), 0.0
        self._paint(place)

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Continue the stroke, and show what it selects."""
        if self._region is None:
            return
        self._paint(place)
        start = perf_counter()
        if start >= self._next:
            self._region.preview(self._mask)
            spent = perf_counter() - start
            self._next = perf_counter() + spent / _SHARE

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Select what was painted over, as one edit."""
        region, self._region = self._region, None
        if region is not None:
            self._paint(place)
            region.take(self._mask)

    def cancel(self, session: Session) -> None:
        """Cancel: everything is as before the stroke."""
        region, self._region = self._region, None
        if region is not None:
            region.cancel()

    def hover(self, session: Session, place: ViewportPoint | None) -> None:
        """Show the brush at the mouse."""
        self._radius = session.view.brush_radius
        self._at = None if place is None else (place.u, place.v)

    def overlay(self) -> PathShape | None:
        """The brush."""
        at = self._last if self._region is not None else self._at
        how = self._region.how if self._region is not None else "set"
        return None if at is None else PathShape((at,), how, radius=self._radius)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return region_hint(session, "Paint") + " [ and ] change the size."

    def _paint(self, place: ViewportPoint) -> None:
        by_screen.stroke(self._mask, self._last, (place.u, place.v), self._radius)
        self._last = (place.u, place.v)
