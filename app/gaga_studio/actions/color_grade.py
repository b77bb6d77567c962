"""Recolor and grade the selection."""

from collections.abc import Sequence

from gaga_core.arrays import IntArray
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.scene import Scene
from gaga_core.scene.tint import Grade, grade_affine, mean_color, tint_affine
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session


@notifies
def recolor(session: Session, rgb: Sequence[float], opacity: float = 1.0) -> bool:
    """Give the selection this mean color, 0..1, and multiply its opacity."""
    return session.need().edit_selected(
        "Recolor", lambda scene, i, title: _recolored(scene, i, title, rgb, opacity)
    )


@notifies
def preview_recolor(session: Session, rgb: Sequence[float], opacity: float = 1.0) -> None:
    """Show the selection in this color, with its shading kept, while it is being chosen."""
    document = session.need()
    title = document.title_for("Recolor")
    document.preview(lambda scene, i: _recolored(scene, i, title, rgb, opacity))


@notifies
def grade(session: Session, wanted: Grade) -> bool:
    """Grade the colors of the selection."""
    return session.need().edit_selected(
        "Grade", lambda scene, i, title: _graded(scene, i, title, wanted)
    )


@notifies
def preview_grade(session: Session, wanted: Grade) -> None:
    """Show the selection graded while a slider is dragged."""
    document = session.need()
    title = document.title_for("Grade")
    document.preview(lambda scene, i: _graded(scene, i, title, wanted))


def _recolored(
    scene: Scene, splats: IntArray, title: str, rgb: Sequence[float], opacity: float
) -> Edit | None:
    affine = tint_affine(mean_color(scene, splats), rgb)
    return edits.recolor(scene, splats, affine, opacity, title)


def _graded(scene: Scene, splats: IntArray, title: str, wanted: Grade) -> Edit | None:
    return edits.recolor(scene, splats, grade_affine(wanted), wanted.opacity, title)


class GradeSliders:
    """Values of the sliders, and the entry that they stand for: many drags, one entry.

    A grade counts from the colors that the selection had when its sliders were first moved. As
    long as its own entry is the newest one, the next drag replaces it.
    """

    def __init__(self) -> None:
        self.value = Grade()
        self._entry: tuple[object, int] | None = None  # document and state after our entry
        self._shows = False

    def follow(self, session: Session) -> None:
        """Reset the values when another edit was done."""
        document = session.document
        if self._shows and (document is None or not document.history.is_previewing):
            self._shows = False
        if self._shows or document is None:
            return
        if self._entry != (document, document.history.state_id):
            self.value, self._entry = Grade(), None

    def show(self, session: Session, wanted: Grade) -> None:
        """Show the selection in this grade while a slider is dragged."""
        document = session.document
        if document is None or len(session.selected_indices()) == 0:
            return
        if not self._shows and self._entry == (document, document.history.state_id):
            document.undo()  # what is shown now replaces it
        self.value, self._shows, self._entry = wanted, True, None
        preview_grade(session, wanted)

    def keep(self, session: Session) -> None:
        """Make what is shown one entry: the slider was released."""
        document = session.document
        if document is None or not self._shows:
            return
        self._shows = False
        if session.commit_preview():
            self._entry = (document, document.history.state_id)

    def reset(self, session: Session) -> None:
        """Undo the grade."""
        document = session.document
        self._shows = False
        if document is None:
            return
        session.cancel_preview()
        if self._entry == (document, document.history.state_id):
            document.undo()
        self.value, self._entry = Grade(), None
