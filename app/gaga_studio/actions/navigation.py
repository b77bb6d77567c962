"""Move the camera to: training views one after the other, an object, the whole scene."""

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.scene.objects import group_indices
from gaga_core.scene.selection.bounds import splat_box
from gaga_studio.session.session import Session


def go_to_view(session: Session, index: int) -> None:
    """Fly to the camera of a photo (its place in ``session.cameras``)."""
    session.active_view = index
    session.rig.go_to(session.cameras[index])


def view_index(session: Session, name: str) -> int | None:
    """Return the index of the photo ``name`` in ``session.cameras``; None if there is none."""
    names = [camera.name for camera in session.cameras]
    return names.index(name) if name in names else None


def next_view(session: Session, step: int) -> None:
    """Fly to the next (1) or previous (-1) photo, cyclically."""
    if session.cameras:
        at = session.active_view if session.active_view is not None else -step
        go_to_view(session, (at + step) % len(session.cameras))


def frame_all(session: Session) -> None:
    """Show everything that is visible."""
    if session.scene is not None:
        _frame(session, None)


def frame_selected(session: Session) -> None:
    """Show the selection; everything when nothing is selected."""
    if session.document is None:
        return
    indices = session.document.read.selected_indices()
    _frame(session, indices if len(indices) else None)


def frame_group(session: Session, group: int) -> None:
    """Show one object."""
    if session.scene is not None:
        _frame(session, group_indices(session.scene, group))


def focus_at(session: Session, u: float, v: float, width: int, height: int) -> bool:
    """Make the surface at a pixel the pivot of the camera (double click)."""
    found = session.pick(u, v, width, height)
    if found is not None:
        session.rig.set_pivot(found.point)
    return found is not None


def _frame(session: Session, indices: IntArray | None) -> None:
    scene = session.scene
    if scene is None or (indices is not None and len(indices) == 0):
        return
    lo, hi = splat_box(scene, indices, 0.98 if indices is not None else 0.9)
    session.rig.focus((lo + hi) / 2, float(np.linalg.norm(hi - lo)) / 2)
