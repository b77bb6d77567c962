"""Move, rotate or scale the selection with handles that the window draws."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_studio.features import selection, transform
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import ClickTool, ViewportPoint

_VERBS = {ToolName.MOVE: "Move", ToolName.ROTATE: "Rotate", ToolName.SCALE: "Scale"}


class MoveTool(ClickTool):
    """A drag of the handles: ``begin``, any number of ``move_to``, then ``finish`` or ``cancel``.

    Clicks select, as with the pick tool; drags next to the handles orbit.
    """

    def __init__(self, name: ToolName = ToolName.MOVE) -> None:
        self.name = name
        self._start: DoubleArray | None = None

    @property
    def is_dragging(self) -> bool:
        """Whether a handle is held."""
        return self._start is not None

    def handles(self, session: Session) -> DoubleArray | None:
        """Pose of the handles, (4, 4) world; None when nothing is selected."""
        document = session.document
        centre = document.selected_centre() if document is not None else None
        if centre is None:
            return None
        matrix = np.eye(4)
        pivot = session.view.pivot
        matrix[:3, 3] = centre if pivot is None else pivot
        if session.view.local_axes and document is not None:
            matrix[:3, :3] = document.selected_axes()
        return matrix

    def begin(self, session: Session) -> None:
        """Begin a drag of a handle."""
        self._start = self.handles(session)

    def move_to(self, session: Session, handles: DoubleArray) -> None:
        """Show the selection at the handles' new matrix (4, 4), world."""
        if self._start is not None:
            motion = (handles @ np.linalg.inv(self._start))[:3]
            transform.preview_move(session, motion, _VERBS[self.name])

    def finish(self, session: Session) -> bool:
        """End the drag: one edit, if anything moved."""
        self._start = None
        return session.commit_preview()

    def cancel(self, session: Session) -> None:
        """Cancel (Escape): the selection stays where it was."""
        if self.is_dragging:
            session.cancel_preview()
        self._start = None

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        if self.handles(session) is not None:
            return f"Drag a handle to {_VERBS[self.name].lower()} the selection, Esc cancels."
        return f"Click an object to {_VERBS[self.name].lower()} it."
