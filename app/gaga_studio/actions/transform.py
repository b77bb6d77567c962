"""Move, turn, scale, mirror and copy the selection, with what lies under it."""

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.orientation import mirror_map
from gaga_core.scene.scene import Scene
from gaga_studio.actions import children
from gaga_studio.session.motion import shift
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session

_AXES = "XYZ"


@notifies
def move(session: Session, matrix: DoubleArray, verb: str = "Move") -> bool:
    """Move the selection by the world map ``matrix`` (3, 4)."""
    return children.edit_along(
        session, verb, lambda scene, splats, title: edits.transform(scene, splats, matrix, title)
    )


@notifies
def preview_move(session: Session, matrix: DoubleArray, verb: str = "Move") -> None:
    """Show the selection moved by ``matrix`` (3, 4), counted from the drag's start."""
    document, taken = session.need(), children.along(session)
    title = children.title_along(document, verb, taken.groups)
    document.history.preview_with(lambda scene: edits.transform(scene, taken.splats, matrix, title))


@notifies
def reset(session: Session) -> bool:
    """Put the selection back to where the file has it."""
    return children.edit_along(session, "Reset placement of", edits.reset_placement)


@notifies
def mirror(session: Session, axis: int) -> bool:
    """Mirror the selection in the plane through its middle, across world axis 0, 1 or 2."""
    document = session.need()

    def build(scene: Scene, splats: IntArray, title: str) -> Edit | None:
        centre = document.selected_centre()
        about = np.zeros(3) if centre is None else centre
        return edits.transform(scene, splats, mirror_map(axis, about), title)

    return children.edit_along(session, f"Mirror {_AXES[axis]}", build)


@notifies
def duplicate(session: Session) -> bool:
    """Copy the selection to its side in the picture; the copy is selected."""
    document, direction = session.need(), session.rig.sideways
    lo, hi = document.selected_box() or (np.zeros(3), np.zeros(3))
    step = shift(float(np.abs(direction) @ (hi - lo)) * direction)
    return children.edit_along(
        session,
        "Duplicate",
        lambda scene, splats, title: edits.duplicate(scene, splats, step, title=title),
    )
