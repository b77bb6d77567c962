"""Align the scene to the ground that three clicks mark."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.scene import edits
from gaga_core.scene.orientation import ground_map
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Point, ToolName

_N = 3  # points of a plane
HELP = "Choose them far apart. Drag orbits, Backspace takes one back, Esc leaves."


def begin(session: Session) -> None:
    """Start the tool without a point; the former tool returns when it ends."""
    view = session.view
    if session.tool is not ToolName.GROUND:
        view.former_tool = session.tool
    session.tool, view.ground = ToolName.GROUND, ()


def leave(session: Session) -> None:
    """Return to the former tool and forget the points."""
    session.tool, session.view.ground = session.view.former_tool, ()


def prompt(session: Session) -> str:
    """Return what to do now, in words."""
    return f"Click three points on the ground: {len(session.view.ground) + 1} of {_N}"


def add(session: Session, point: Point | None) -> bool:
    """Add a point, None where no surface is; return whether it aligned the scene (the third does).

    Three points on a line are all removed.
    """
    view = session.view
    what = prompt(session)
    session.hint = f"There is no surface here. {what}." if point is None else ""
    if point is None:
        return False
    view.ground = (*view.ground, point)
    if len(view.ground) < _N:
        return False
    points, view.ground = np.array(view.ground), ()
    if not align(session, points):
        return False
    leave(session)
    session.notify(Level.INFO, "The ground is level now, at height 0.")
    return True


def take_back(session: Session) -> None:
    """Remove the newest point."""
    session.view.ground = session.view.ground[:-1]


@notifies
def align(session: Session, points: DoubleArray) -> bool:
    """Turn and lift everything so that the plane of three ``points`` (3, 3) is the ground.

    What is hidden or locked comes along, and so do the camera (see `CameraRig.follow`),
    photos, bookmarks and the camera path.
    """
    document = session.need()
    moved = ground_map(points, session.rig.up, session.rig.seen_from)
    return document.do(edits.move_scene(document.settled().scene, moved, "Align to ground"))
