"""Move, rotate or scale the selection with handles that the window draws."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
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
        self.start: DoubleArray | None = None  # (4, 4) pose of the handles before the drag, world

    @property
    def is_dragging(self) -> bool:
        """Whether a handle is held."""
        return self.start is not None

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
        self.start = self.handles(session)

    def move_to(self, session: Session, handles: DoubleArray) -> None:
        """Show the selection at the handles' new matrix (4, 4), world."""
        if self.start is not None:
            motion = (handles @ np.linalg.inv(self.start))[:3]
            transform.preview_move(session, motion, _VERBS[self.name])

    def finish(self, session: Session) -> bool:
        """End the drag: one edit, if anything moved."""
        self.start = None
        return session.commit_preview()

    def cancel(self, session: Session) -> None:
        """Cancel (Escape): the selection stays where it was."""
        if self.is_dragging:
            session.cancel_preview()
        self.start = None

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select the object under the mouse."""
        selection.click(session, place.u, place.v, place.width, place.height, place.how)

    def hint(self, session: Session) -> str:
        """What a drag does now."""
        if self.handles(session) is not None:
            return f"Drag a handle to {_VERBS[self.name].lower()} the selection, Esc cancels."
        return f"Click an object to {_VERBS[self.name].lower()} it."


# --- G, R and S of Blender: the selection follows the mouse until Enter or a click; Escape cancels.


@dataclass(frozen=True, eq=False)
class FollowTransform:
    """A move, rotation or scaling that follows the mouse, or a typed amount."""

    name: ToolName
    start: tuple[float, float]  # of the mouse, pixels of the picture
    handles: DoubleArray  # (4, 4) pose of the pivot, world
    axis: int | None = None  # 0, 1 or 2 of the handles; None: in the plane of the picture
    typed: str = ""  # amount: scene units, degrees or a factor

    def with_key(self, key: str) -> "FollowTransform":
        """Return what it is after X, Y, Z, a digit, ".", "-" or "Backspace"."""
        if key in "XYZ":
            axis = "XYZ".index(key)
            return replace(self, axis=None if axis == self.axis else axis)
        if key == "Backspace":
            return replace(self, typed=self.typed[:-1])
        if key == "-":
            return replace(
                self, typed=self.typed[1:] if self.typed[:1] == "-" else f"-{self.typed}"
            )
        return replace(self, typed=self.typed + key)

    @property
    def hint(self) -> str:
        """ "Move 0.5 along X: Enter applies, Esc cancels"."""
        way = "about" if self.name is ToolName.ROTATE else "along"
        axis = "" if self.axis is None else f" {way} {'XYZ'[self.axis]}"
        what = " ".join(filter(None, (_VERBS[self.name], self.typed))) + axis
        return f"{what}: Enter applies, Esc cancels. X, Y, Z: axis; digits: how much."

    def show(self, session: Session, camera: Camera, at: tuple[float, float]) -> None:
        """Show the selection as it is with the mouse at pixel ``at``."""
        transform.preview_move(session, self.motion(camera, at), _VERBS[self.name])

    def motion(self, camera: Camera, at: tuple[float, float]) -> DoubleArray:
        """World map (3, 4) of the selection with the mouse at pixel ``at`` of ``camera``."""
        pivot, axes = self.handles[:3, 3], self.handles[:3, :3]
        linear, shift = np.eye(3), np.zeros(3)
        centre = camera.project(pivot[None])[0][0]
        start, now = np.array(self.start), np.array(at)
        amount = self._amount()
        if self.name is ToolName.MOVE:
            shift = self._shift(camera, centre, now - start, amount)
        elif self.name is ToolName.ROTATE:
            forward = camera.cam_from_world[2, :3]
            axis = forward if self.axis is None else axes[:, self.axis]
            a, b = start - centre, now - centre
            turned = np.arctan2(b[1], b[0]) - np.arctan2(a[1], a[0])
            angle = np.radians(amount) if amount is not None else turned
            sign = 1.0 if amount is not None or axis @ forward >= 0 else -1.0
            linear = _rotation(axis, sign * angle)
        else:
            reach = max(float(np.linalg.norm(start - centre)), 1.0)  # pixels
            far = float(np.linalg.norm(now - centre)) / reach
            factors = np.full(3, far if amount is None else amount)
            if self.axis is not None:
                factors = np.where(np.arange(3) == self.axis, factors, 1.0)
            linear = axes @ np.diag(np.where(factors == 0, 1e-6, factors)) @ axes.T
        return np.column_stack([linear, pivot + shift - linear @ pivot])

    def _amount(self) -> float | None:
        try:
            return float(self.typed)
        except ValueError:  # nothing yet, or only a sign
            return None

    def _shift(
        self, camera: Camera, centre: DoubleArray, way: DoubleArray, amount: float | None
    ) -> DoubleArray:
        pivot, axes = self.handles[:3, 3], self.handles[:3, :3]
        if amount is not None:
            return amount * axes[:, self.axis or 0]
        depth = float(camera.cam_from_world[2] @ np.append(pivot, 1.0))
        if self.axis is None:
            there = camera.unproject(float(centre[0] + way[0]), float(centre[1] + way[1]), depth)
            return there - camera.unproject(float(centre[0]), float(centre[1]), depth)
        unit = 1e-3 * abs(depth) * axes[:, self.axis]
        along = camera.project((pivot + unit)[None])[0][0] - centre  # pixels of that way
        share = float(way @ along) / max(float(along @ along), 1e-9)
        return share * unit


def _rotation(axis: DoubleArray, angle: float) -> DoubleArray:
    """Rotation (3, 3) by ``angle`` radians about ``axis`` (3,): Rodrigues' formula."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
