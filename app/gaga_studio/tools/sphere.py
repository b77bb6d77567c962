"""Press on a surface and drag: everything within that distance in space is selected."""

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.errors import counted
from gaga_core.scene import edits
from gaga_core.scene.selection import by_volume
from gaga_studio.features import selection
from gaga_studio.session.document import Document
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import PathShape, ViewportPoint


class SphereTool:
    """A ball around the point that was pressed."""

    name = ToolName.SPHERE
    takes_drag = True

    def __init__(self) -> None:
        self._document: Document | None = None
        self._first: ViewportPoint | None = None
        self._centre: DoubleArray = np.zeros(3)
        self._pixel = 1.0  # world length of a pixel at the centre's depth
        self._radius = 0.0  # pixels

    def click(self, session: Session, place: ViewportPoint) -> None:
        """A ball without size: the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Set the centre: the surface under the mouse."""
        found = session.pick(place.u, place.v, place.width, place.height)
        if found is None:
            session.hint = "There is no surface here. Begin on something."
            return
        self._document, self._first = session.need(), place
        self._centre = found.point
        focal = session.rig.camera(place.width, place.height).K[0, 0]
        self._pixel, self._radius = found.depth / float(focal), 0.0

    def drag(self, session: Session, place: ViewportPoint) -> None:
        """Set the radius, and show what it would select."""
        if self._first is None or self._document is None:
            return
        self._radius = float(np.hypot(place.u - self._first.u, place.v - self._first.v))
        how, chosen = self._first.how, self._inside()
        self._document.preview_with(
            lambda base: edits.select(base, chosen, how, f"Select {counted(len(chosen), 'splat')}")
        )

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Select what is in the ball, as one edit."""
        first, document = self._first, self._document
        if first is not None and document is not None:
            self.drag(session, place)
            chosen = self._inside()
            verb = "Deselect" if first.how == "remove" else "Select"
            document.select(chosen, first.how, f"{verb} {counted(len(chosen), 'splat')}")
        self._first = self._document = None

    def cancel(self, session: Session) -> None:
        """Cancel: everything is as before the press."""
        if self._document is not None:
            self._document.history.preview(None)
        self._first = self._document = None

    def overlay(self) -> PathShape | None:
        """The ball's outline."""
        if self._first is None:
            return None
        middle = (self._first.u, self._first.v)
        return PathShape((middle,), self._first.how, radius=max(self._radius, 1.0))

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        return "Press on a surface and drag a ball; Shift adds, Ctrl removes. Middle drag orbits."

    def _inside(self) -> IntArray:
        document = self._document
        assert document is not None
        scene = document.history.base
        return by_volume.in_sphere(scene, self._centre, self._radius * self._pixel)
