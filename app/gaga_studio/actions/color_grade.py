"""The grade that sliders hold: many drags, one entry of the history.

A grade counts from the colors that the selection had when its sliders were first moved. As long as
its own entry is the newest one, the next drag replaces it.
"""

from gaga_core.scene.grade import Grade
from gaga_studio.actions import objects
from gaga_studio.session.session import Session


class Grading:
    """Values of the sliders, and the entry that they stand for."""

    def __init__(self) -> None:
        self.value = Grade()
        self._entry: tuple[object, int] | None = None  # document and state after our entry
        self._shows = False

    def follow(self, session: Session) -> None:
        """Forget the values when something else was done since."""
        document = session.document
        if self._shows and (document is None or not document.history.is_previewing):
            self._shows = False
        if self._shows or document is None:
            return
        if self._entry != (document, document.history.state_id):
            self.value, self._entry = Grade(), None

    def show(self, session: Session, grade: Grade) -> None:
        """The selection in this grade, while a slider is dragged."""
        document = session.document
        if document is None or len(session.selected_indices()) == 0:
            return
        if not self._shows and self._entry == (document, document.history.state_id):
            document.undo()  # its place is taken by what is shown now
        self.value, self._shows, self._entry = grade, True, None
        objects.preview_grade(session, grade)

    def keep(self, session: Session) -> None:
        """The slider was let go: one entry."""
        document = session.document
        if document is None or not self._shows:
            return
        self._shows = False
        if session.commit_preview():
            self._entry = (document, document.history.state_id)

    def reset(self, session: Session) -> None:
        """Take the grade back."""
        document = session.document
        self._shows = False
        if document is None:
            return
        session.cancel_preview()
        if self._entry == (document, document.history.state_id):
            document.undo()
        self.value, self._entry = Grade(), None
