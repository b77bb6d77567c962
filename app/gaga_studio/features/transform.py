"""Edits of the selection: undo and redo, move, mirror and copy it, recolor and grade it."""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.geometry import quats_to_matrices
from gaga_core.kernels import is_compiled
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.free_place import step_to_free_place
from gaga_core.scene.orientation import mirror_map
from gaga_core.scene.scene import Scene
from gaga_core.scene.tint import Grade, grade_affine, mean_color, tint_affine
from gaga_studio.features import folders
from gaga_studio.features.base import Command, ask, no_selection
from gaga_studio.session.document import Build, Document
from gaga_studio.session.notices import Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName

_AXES = "XYZ"

# --- color


def _opened_cameras(document: Document) -> tuple[Sequence[Camera], bool]:
    """Return the cameras in the frame in which the scene was opened, and whether colors can be
    measured from outside without a wait for compiling."""
    return document.project.opened_views, is_compiled("window", "names")


def selected_color(session: Session) -> DoubleArray:
    """Return the mean color (3,) of the selection from outside, 0..1, as it is drawn."""
    document = session.need()
    return document.read.selected_color(*_opened_cameras(document))


@notifies
def recolor(session: Session, rgb: Sequence[float], opacity: float = 1.0) -> bool:
    """Give the selection this mean color, 0..1, and multiply its opacity."""
    return session.need().edit_selected("Recolor", _recolored(session, rgb, opacity))


@notifies
def preview_recolor(session: Session, rgb: Sequence[float], opacity: float = 1.0) -> None:
    """Show the selection in this color, with its shading kept, while it is being chosen."""
    session.need().preview_selected("Recolor", _recolored(session, rgb, opacity))


@notifies
def grade(session: Session, wanted: Grade) -> bool:
    """Grade the colors of the selection."""
    return session.need().edit_selected("Grade", _graded(wanted))


@notifies
def preview_grade(session: Session, wanted: Grade) -> None:
    """Show the selection graded while a slider is dragged."""
    session.need().preview_selected("Grade", _graded(wanted))


def _recolored(session: Session, rgb: Sequence[float], opacity: float) -> Build:
    document = session.need()
    sample, seen = document.read.seen_selection(*_opened_cameras(document))

    def build(scene: Scene, splats: IntArray, title: str) -> Edit | None:
        affine = tint_affine(mean_color(scene, sample, seen), rgb)
        return edits.recolor(scene, splats, affine, opacity, title)

    return build


def _graded(wanted: Grade) -> Build:
    affine = grade_affine(wanted)
    return lambda scene, i, title: edits.recolor(scene, i, affine, wanted.opacity, title)


class GradeSliders:
    """Values of the sliders, and the entry that they stand for: many drags, one entry.

    A grade counts from the colors that the selection had when its sliders were first moved. As
    long as its own entry is the newest one, the next drag replaces it.
    """

    def __init__(self) -> None:
        self.value = Grade()
        self._entry: tuple[object, int] | None = None  # document and state after our entry
        self._shows = False
        # The grade that what is shown took the place of, with its entry.
        self._former: tuple[Grade, tuple[object, int]] | None = None

    def follow(self, session: Session) -> None:
        """Reset the values when another edit was done."""
        document = session.document
        if self._shows and (document is None or not document.history.is_previewing):
            self._shows = False  # given up
            if self._former is not None and document is not None and document.redo():
                self.value, self._entry = self._former
            self._former = None
        if self._shows or document is None:
            return
        if self._entry != (document, document.history.state_id):
            self.value, self._entry = Grade(), None

    def show(self, session: Session, wanted: Grade) -> None:
        """Show the selection in this grade while a slider is dragged."""
        document = session.document
        if document is None or len(session.selected_indices()) == 0:
            return
        entry = (document, document.history.state_id)
        if not self._shows and self._entry == entry:
            document.undo()  # what is shown now replaces it
            self._former = self.value, entry
        self.value, self._shows, self._entry = wanted, True, None
        preview_grade(session, wanted)

    def keep(self, session: Session) -> None:
        """Make what is shown one entry: the slider was released."""
        document = session.document
        if document is None or not self._shows:
            return
        self._shows, self._former = False, None
        if session.commit_preview():
            self._entry = (document, document.history.state_id)

    def reset(self, session: Session) -> None:
        """Undo the grade."""
        document = session.document
        self._shows, self._former = False, None
        if document is None:
            return
        session.cancel_preview()
        if self._entry == (document, document.history.state_id):
            document.undo()
        self.value, self._entry = Grade(), None


# --- place


def motion(
    pivot: DoubleArray,
    move: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn_degrees: tuple[float, float, float] = (0.0, 0.0, 0.0),
    scale: float | tuple[float, float, float] = 1.0,
) -> DoubleArray:
    """Return the world map (3, 4): scale about ``pivot`` (3,), turn about x, y, z, then move."""
    linear = np.diag(np.broadcast_to(np.asarray(scale, np.float64), (3,)))
    for axis, degrees in enumerate(turn_degrees):
        half = np.radians(degrees) / 2
        quat = np.zeros((1, 4))
        quat[0, 0], quat[0, 1 + axis] = np.cos(half), np.sin(half)
        linear = quats_to_matrices(quat)[0] @ linear
    offset = np.asarray(move, np.float64) + pivot - linear @ pivot
    return np.column_stack([linear, offset])


def shift(by: DoubleArray) -> DoubleArray:
    """Return the world map (3, 4) that moves by ``by`` (3,)."""
    return np.column_stack([np.eye(3), by])


@notifies
def move(session: Session, matrix: DoubleArray, verb: str = "Move") -> bool:
    """Move the selection by the world map ``matrix`` (3, 4)."""
    return folders.edit_along(
        session, verb, lambda scene, splats, title: edits.transform(scene, splats, matrix, title)
    )


@notifies
def preview_move(session: Session, matrix: DoubleArray, verb: str = "Move") -> None:
    """Show the selection moved by ``matrix`` (3, 4), counted from the drag's start."""
    document, taken = session.need(), folders.along(session)
    title = folders.title_along(document, verb, taken.groups)
    document.preview_with(lambda scene: edits.transform(scene, taken.splats, matrix, title))


@notifies
def reset(session: Session) -> bool:
    """Put the selection back to where the file has it."""
    return folders.edit_along(session, "Reset placement of", edits.reset_placement)


@notifies
def mirror(session: Session, axis: int) -> bool:
    """Mirror the selection in the plane through its middle, across world axis 0, 1 or 2."""
    document = session.need()

    def build(scene: Scene, splats: IntArray, title: str) -> Edit | None:
        centre = document.selected_centre()
        about = np.zeros(3) if centre is None else centre
        return edits.transform(scene, splats, mirror_map(axis, about), title)

    return folders.edit_along(session, f"Mirror {_AXES[axis]}", build)


@notifies
def duplicate(session: Session) -> bool:
    """Copy the selection next to it, where it is free; the copy is selected.

    To its side in the picture where nothing around it is free.
    """
    document, sideways = session.need(), session.rig.sideways

    def build(scene: Scene, splats: IntArray, title: str) -> Edit | None:
        step = step_to_free_place(scene, splats, sideways, session.rig.up)
        if step is None:
            lo, hi = document.selected_box() or (np.zeros(3), np.zeros(3))
            step = float(np.abs(sideways) @ (hi - lo)) * sideways
        return edits.duplicate(scene, splats, shift(step), title=title)

    return folders.edit_along(session, "Duplicate", build)


@notifies
def duplicate_and_move(session: Session) -> bool:
    """Copy the selection where it is and take the move tool; the copy is selected."""
    if not folders.edit_along(
        session,
        "Duplicate",
        lambda scene, splats, title: edits.duplicate(scene, splats, title=title),
    ):
        return False
    session.tool = ToolName.MOVE
    if session.settings.keys != "blender":  # there it follows the mouse, and says so
        session.hint = "The copy stands where its original does: move it by the handles"
    return True


def _mirror(axis: int) -> Command:
    return Command(
        f"edit.mirror_{'xyz'[axis]}",
        f"Mirror across {_AXES[axis]}",
        lambda session: mirror(session, axis),
        enabled=no_selection,
    )


def _no_undo(session: Session) -> str:
    document = session.document
    return "" if document is not None and document.undo_title else "There is nothing to undo."


def _no_redo(session: Session) -> str:
    document = session.document
    return "" if document is not None and document.redo_title else "There is nothing to redo."


COMMANDS: tuple[Command, ...] = (
    Command(
        "edit.undo",
        "Undo",
        Session.undo,
        "Ctrl+Z",
        enabled=_no_undo,
        describe=lambda s: "Undo" if _no_undo(s) else f"Undo {s.need().undo_title}",
    ),
    Command(
        "edit.redo",
        "Redo",
        Session.redo,
        "Ctrl+Shift+Z",
        ("Ctrl+Y",),
        enabled=_no_redo,
        describe=lambda s: "Redo" if _no_redo(s) else f"Redo {s.need().redo_title}",
    ),
    ask("edit.recolor", "Recolor…", Request.RECOLOR, enabled=no_selection),
    Command("edit.duplicate", "Duplicate", duplicate, "Ctrl+D", ("Shift+D",), enabled=no_selection),
    Command(
        "edit.duplicate_and_move", "Duplicate and move", duplicate_and_move, enabled=no_selection
    ),
    *(_mirror(axis) for axis in range(3)),
    Command("object.reset_placement", "Reset placement", reset, enabled=no_selection),
)
