"""Measure between points of the surface, set scale and origin, align to the ground."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.frame import inverse, length_text, lengths_text, metres_of
from gaga_core.scene.orientation import ground_map
from gaga_studio.features.base import Command, no_scene, nothing_pointed
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import Point, ToolName

_MOST = 3  # points: two lengths and the angle between them
HOW_TO_SCALE = "Set scale by a known length, in the menu Tools, gives them."
HELP = "Drag orbits, Backspace takes one back, Esc leaves."


@dataclass(frozen=True)
class Reading:
    """Distances and angles of the points, scene units and degrees."""

    lengths: tuple[float, ...]  # from each point to the next
    angle: float | None  # at the second of three points
    heights: tuple[float, ...]  # of the points over height 0, along up


@dataclass
class ClickedPoints:
    """Points clicked in a document with the tool Measure, or Align to ground."""

    points: tuple[Point, ...] = ()  # measured: in the frame of the opened file; ground: world
    asks_length: bool = False  # the field of the known length takes the keyboard as it comes
    former_tool: ToolName = ToolName.PICK  # that comes back after the ground tool


def clicked(session: Session) -> ClickedPoints:
    """Return the points that were clicked; none when nothing is open."""
    document = session.document
    return ClickedPoints() if document is None else document.feature(ClickedPoints)


def begin(session: Session) -> None:
    """Start the tool without a point."""
    session.tool, clicked(session).points = ToolName.MEASURE, ()
    clicked(session).asks_length = False


def begin_scale(session: Session) -> None:
    """Start the tool to type a length: two clicks, or points that are measured, then its number."""
    if session.tool is not ToolName.MEASURE:
        begin(session)
    clicked(session).asks_length = True


def leave(session: Session) -> None:
    """End the tool and forget the points; after the ground tool the former one returns."""
    is_ground = session.tool is ToolName.GROUND
    session.tool = clicked(session).former_tool if is_ground else ToolName.PICK
    clicked(session).points = ()


def prompt(session: Session) -> str:
    """Return what a click does now, in words."""
    n = len(clicked(session).points)
    what = ("a point", "a second point: a length", "a third point: an angle", "a first point again")
    return f"Click {what[n]}"


def add(session: Session, point: Point | None) -> None:
    """Add a point, None where no surface is; after three they begin again.

    Points are kept in the frame in which the scene was opened, so they follow it.
    """
    session.hint = f"There is no surface here. {prompt(session)}." if point is None else ""
    if point is None:
        return
    state, back = clicked(session), inverse(session.need().world)
    x, y, z = (float(v) for v in back[:3, :3] @ np.array(point) + back[:3, 3])
    former = () if len(state.points) == _MOST else state.points
    state.points = (*former, (x, y, z))


def take_back(session: Session) -> None:
    """Remove the newest point."""
    state = clicked(session)
    state.points = state.points[:-1]


def points(session: Session) -> DoubleArray:
    """The points (K, 3), world."""
    if session.document is None or not clicked(session).points:
        return np.zeros((0, 3))
    world = session.document.world
    found: DoubleArray = np.array(clicked(session).points) @ world[:3, :3].T + world[:3, 3]
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


def way_texts(session: Session) -> tuple[str, ...]:
    """Return of each way which points it joins and how long it is: "1 to 2: 0.42 m"."""
    found = reading(session).lengths
    return tuple(f"{i} to {i + 1}: {length(session, value)}" for i, value in enumerate(found, 1))


HEIGHTS = "Heights above the origin"
HEIGHTS_HINT = "Along up. Align to ground, in the menu Tools, makes them heights above the ground."


def height_texts(session: Session) -> tuple[str, ...]:
    """Return the height of each point, under `HEIGHTS`."""
    found = reading(session).heights
    return tuple(f"Point {i}: {length(session, value)}" for i, value in enumerate(found, 1))


def length(session: Session, value: float) -> str:
    """A length in words, in the unit of the open scene."""
    return length_text(value, is_metric=_is_metric(session))


def lengths(session: Session, values: Sequence[float] | DoubleArray) -> str:
    """Lengths (K,) next to each other, in the unit of the open scene."""
    return lengths_text([float(value) for value in values], is_metric=_is_metric(session))


def unit(session: Session) -> str:
    """What stands behind a length of the open scene: " m", or nothing."""
    return " m" if _is_metric(session) else ""


def number_format(session: Session) -> str:
    """The printf format of a length in a field, in the unit of the open scene."""
    return f"%.3f{unit(session)}"


def _is_metric(session: Session) -> bool:
    return session.document is not None and session.document.scene.frame.is_metric


@notifies
def set_scale(session: Session, metres: float) -> bool:
    """Scale everything so that the way from the first point to the second has this length.

    The origin stays, so the ground stays at height 0. A unit is a metre from then on.
    """
    return _set_scale(session, metres)


@notifies
def set_typed_scale(session: Session, typed: str) -> bool:
    """`set_scale` by a length as it was typed: "80 cm"; a number alone is metres.

    The field keeps the keyboard where it is refused: letters typed next would be shortcuts.
    """
    points = clicked(session)
    points.asks_length = True
    metres = metres_of(typed)
    if metres is None:
        raise GagaError(f'"{typed}" cannot be read. Type a length as 1.5 m, 80 cm, 12 in or 5 ft.')
    is_new = _set_scale(session, metres)
    points.asks_length = False
    return is_new


def _set_scale(session: Session, metres: float) -> bool:
    lengths = reading(session).lengths
    if not lengths:
        raise GagaError("Click two points first: the length between them is the known one.")
    return session.edit(lambda scene: edits.set_scale(scene, lengths[0], metres, np.zeros(3)))


@notifies
def set_origin_here(session: Session) -> bool:
    """Move everything so that the point of the surface that was clicked becomes the origin."""
    point, session.view.pointed = session.view.pointed, None
    if point is None:
        return False
    return session.edit(lambda scene: edits.set_origin(scene, np.array(point)))


# --- align to the ground that three clicks mark


_N = 3  # points of a plane
GROUND_HELP = "Choose them far apart. Drag orbits, Backspace takes one back, Esc leaves."


def begin_ground(session: Session) -> None:
    """Start the tool without a point; the former tool returns when it ends."""
    state = clicked(session)
    if session.tool is not ToolName.GROUND:
        state.former_tool = session.tool
    session.tool, state.points = ToolName.GROUND, ()


def ground_prompt(session: Session) -> str:
    """Return what to do now, in words."""
    return f"Click three points on the ground: {len(clicked(session).points) + 1} of {_N}"


def add_ground_point(session: Session, point: Point | None) -> bool:
    """Add a point, None where no surface is; return whether it aligned the scene (the third does).

    Three points on a line are all removed.
    """
    state = clicked(session)
    what = ground_prompt(session)
    session.hint = f"There is no surface here. {what}." if point is None else ""
    if point is None:
        return False
    state.points = (*state.points, point)
    if len(state.points) < _N:
        return False
    points, state.points = np.array(state.points), ()
    if not align(session, points):
        return False
    leave(session)
    session.notify(Level.INFO, "The ground is level now, at height 0.")
    return True


@notifies
def align(session: Session, points: DoubleArray) -> bool:
    """Turn and lift everything so that the plane of three ``points`` (3, 3) is the ground.

    What is hidden or locked comes along, and so do the camera (see `CameraRig.follow`),
    photos, bookmarks and the camera path.
    """
    moved = ground_map(points, session.rig.up, session.rig.seen_from)
    return session.edit(lambda scene: edits.move_scene(scene, moved, "Align to ground"))


def _tool(tool: ToolName, title: str, run: Callable[[Session], None]) -> Command:
    return Command(
        f"tool.{tool}", title, run, enabled=no_scene, is_on=lambda session: session.tool is tool
    )


COMMANDS: tuple[Command, ...] = (
    _tool(ToolName.MEASURE, "Measure lengths, angles and heights", begin),
    Command("tool.set_scale", "Set scale by a known length", begin_scale, enabled=no_scene),
    _tool(ToolName.GROUND, "Align to ground by three points", begin_ground),
    Command("tool.origin_here", "Set the origin here", set_origin_here, enabled=nothing_pointed),
)
