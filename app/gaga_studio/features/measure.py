"""Measure between points of the surface, and set the scale from a length that is known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.frame import inverse, length_text, lengths_text
from gaga_core.scene.orientation import ground_map
from gaga_studio.features.base import Command, no_scene, nothing_pointed
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import Point, ToolName

# --- Measure between points of the surface, and set the scale from a length that is known.


_MOST = 3  # points: two lengths and the angle between them
HELP = "Drag orbits, Backspace takes one back, Esc leaves."


@dataclass(frozen=True)
class Reading:
    """What lies between the points, scene units and degrees."""

    lengths: tuple[float, ...]  # from each point to the next
    angle: float | None  # at the second of three points
    heights: tuple[float, ...]  # of the points over height 0, along up


def begin(session: Session) -> None:
    """Start the tool without a point."""
    session.tool, session.view.measured = ToolName.MEASURE, ()


def leave(session: Session) -> None:
    """End the tool and forget the points."""
    session.tool, session.view.measured = ToolName.PICK, ()


def prompt(session: Session) -> str:
    """Return what a click does now, in words."""
    n = len(session.view.measured)
    what = ("a point", "a second point: a length", "a third point: an angle", "a first point again")
    return f"Click {what[n]}"


def add(session: Session, point: Point | None) -> None:
    """Add a point, None where no surface is; after three they begin again.

    Points are kept in the frame in which the scene was opened, so they follow it.
    """
    session.hint = f"There is no surface here. {prompt(session)}." if point is None else ""
    if point is None:
        return
    view, back = session.view, inverse(session.need().world)
    x, y, z = (float(v) for v in back[:3, :3] @ np.array(point) + back[:3, 3])
    former = () if len(view.measured) == _MOST else view.measured
    view.measured = (*former, (x, y, z))


def take_back(session: Session) -> None:
    """Remove the newest point."""
    session.view.measured = session.view.measured[:-1]


def points(session: Session) -> DoubleArray:
    """The points (K, 3), world."""
    if session.document is None or not session.view.measured:
        return np.zeros((0, 3))
    world = session.document.world
    found: DoubleArray = np.array(session.view.measured) @ world[:3, :3].T + world[:3, 3]
    return found


def reading(session: Session) -> Reading:
    """Return the lengths, angle and heights of the points."""
    places = points(session)
    ways = np.diff(places, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    angle = None
    if len(ways) == 2 and lengths.all():
        cosine = float(-ways[0] @ ways[1] / (lengths[0] * lengths[1]))
        angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    heights = places @ session.rig.up
    return Reading(tuple(lengths.tolist()), angle, tuple(heights.tolist()))


def length(session: Session, value: float) -> str:
    """A length in words, in the unit of the open scene."""
    return length_text(value, is_metric=_is_metric(session))


def lengths(session: Session, values: Sequence[float] | DoubleArray) -> str:
    """Lengths (K,) next to each other, in the unit of the open scene."""
    return lengths_text([float(value) for value in values], is_metric=_is_metric(session))


def _is_metric(session: Session) -> bool:
    return session.document is not None and session.document.scene.frame.is_metric


@notifies
def set_scale(session: Session, metres: float) -> bool:
    """Scale everything so that the way from the first point to the second has this length.

    The origin stays, so the ground stays at height 0. A unit is a metre from then on.
    """
    document, lengths = session.need(), reading(session).lengths
    if not lengths:
        raise GagaError("Click two points first: the length between them is the known one.")
    scene = document.settled().scene
    return document.do(edits.set_scale(scene, lengths[0], metres, np.zeros(3)))


@notifies
def set_origin_here(session: Session) -> bool:
    """Move everything so that the point of the surface that was clicked becomes the origin."""
    document, point = session.need(), session.view.pointed
    if point is None:
        return False
    session.view.pointed = None
    return document.do(edits.set_origin(document.settled().scene, np.array(point)))


# --- Align the scene to the ground that three clicks mark.


_N = 3  # points of a plane
GROUND_HELP = "Choose them far apart. Drag orbits, Backspace takes one back, Esc leaves."


def begin_ground(session: Session) -> None:
    """Start the tool without a point; the former tool returns when it ends."""
    view = session.view
    if session.tool is not ToolName.GROUND:
        view.former_tool = session.tool
    session.tool, view.ground = ToolName.GROUND, ()


def leave_ground(session: Session) -> None:
    """Return to the former tool and forget the points."""
    session.tool, session.view.ground = session.view.former_tool, ()


def ground_prompt(session: Session) -> str:
    """Return what to do now, in words."""
    return f"Click three points on the ground: {len(session.view.ground) + 1} of {_N}"


def add_ground_point(session: Session, point: Point | None) -> bool:
    """Add a point, None where no surface is; return whether it aligned the scene (the third does).

    Three points on a line are all removed.
    """
    view = session.view
    what = ground_prompt(session)
    session.hint = f"There is no surface here. {what}." if point is None else ""
    if point is None:
        return False
    view.ground = (*view.ground, point)
    if len(view.ground) < _N:
        return False
    points, view.ground = np.array(view.ground), ()
    if not align(session, points):
        return False
    leave_ground(session)
    session.notify(Level.INFO, "The ground is level now, at height 0.")
    return True


def take_back_ground_point(session: Session) -> None:
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


COMMANDS: tuple[Command, ...] = (
    Command(
        "tool.measure",
        "Measure lengths, angles and heights",
        begin,
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.MEASURE,
    ),
    Command(
        "tool.ground",
        "Align to ground by three points",
        begin_ground,
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.GROUND,
    ),
    Command("tool.origin_here", "Set the origin here", set_origin_here, enabled=nothing_pointed),
)
