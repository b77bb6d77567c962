"""Drag a rectangle: what lies in it is selected, whole objects or single splats."""

from gaga_core.scene import selection
from gaga_studio.session import Session
from gaga_studio.tools.base import Place, RectShape
from gaga_studio.view import ToolName


class RectTool:
    """Selects through everything, not the visible surface only."""

    name = ToolName.RECT
    takes_drag = True

    def __init__(self) -> None:
        self._from: Place | None = None
        self._to: Place | None = None

    def click(self, session: Session, place: Place) -> None:
        """A rectangle without area: the object under the mouse."""
        session.click(place.u, place.v, place.width, place.height, place.how)

    def press(self, session: Session, place: Place) -> None:
        """First corner."""
        self._from = self._to = place

    def drag(self, session: Session, place: Place) -> None:
        """Opposite corner, for now."""
        self._to = place

    def release(self, session: Session, place: Place) -> None:
        """Select what the rectangle holds, as one edit."""
        first, document = self._from, session.document
        self._from = self._to = None
        if first is None or document is None:
            return
        scene = document.scene
        camera = session.rig.camera(place.width, place.height)
        inside = selection.in_rectangle(scene, camera, (first.u, first.v, place.u, place.v))
        if session.view.rect_takes_splats or not document.read.has_groups():
            verb = "Deselect" if first.how == "remove" else "Select"
            document.select(inside, first.how, f"{verb} {len(inside):,} splats")
            return
        groups = selection.groups_inside(scene, inside)
        document.select_groups([int(g) for g in groups], first.how)

    def cancel(self, session: Session) -> None:
        """Forget the rectangle."""
        self._from = self._to = None

    def overlay(self) -> RectShape | None:
        """The rectangle while it is drawn."""
        if self._from is None or self._to is None:
            return None
        return RectShape(self._from.u, self._from.v, self._to.u, self._to.v, self._from.how)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        what = "splats" if session.view.rect_takes_splats else "objects"
        return f"Drag a rectangle to select {what}; Shift adds, Ctrl removes. Middle drag orbits."
