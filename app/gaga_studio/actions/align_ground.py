"""Three clicks that say where the ground is: the points so far, and what the third one does."""

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.scene import edits
from gaga_core.scene.arrange import ground_map
from gaga_core.scene.selection import algebra
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import Point, ToolName

_N = 3  # points of a plane
HELP = "Choose them far apart. Drag orbits, Backspace takes one back, Esc leaves."


def begin(session: Session) -> None:
    """Take the tool, without a point; the former tool comes back when it ends."""
    view = session.view
    if session.tool is not ToolName.GROUND:
        view.former_tool = session.tool
    session.tool, view.ground = ToolName.GROUND, ()


def leave(session: Session) -> None:
    """Go back to the former tool; the points are forgotten."""
    session.tool, session.view.ground = session.view.former_tool, ()


def prompt(session: Session) -> str:
    """What to do now, in words."""
    return f"Click three points on the ground: {len(session.view.ground) + 1} of {_N}"


def add(session: Session, point: Point | None) -> bool:
    """One more point, None where no surface is; whether it was the third and the scene lies level.

    Three points on a line are all taken back.
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
    session.notify(Level.INFO, _told(session))
    return True


def take_back(session: Session) -> None:
    """Forget the newest point."""
    session.view.ground = session.view.ground[:-1]


@notifies
def align(session: Session, points: DoubleArray) -> bool:
    """Turn and lift everything so that the plane of three ``points`` (3, 3) is the ground.

    What is hidden or locked comes along, and so does the camera (see `CameraRig.follow`).
    """
    document = session.need()
    moved = ground_map(points, session.rig.up, session.rig.seen_from)
    scene = document.settled().scene
    edit = edits.transform(scene, algebra.whole(scene), moved, "Align to ground")
    return document.do(edit, turned=moved)


def _told(session: Session) -> str:
    done = "The ground is level now, at height 0."
    if not session.cameras:
        return done
    return f"{done} The photos stay as they were taken, so they no longer match the picture."
