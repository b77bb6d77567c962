"""Tools of clicks: pick an object, align the ground, measure, and the tool Object."""

from dataclasses import replace

from gaga_studio.features import measure, object_list, selection
from gaga_studio.features.find import click_object
from gaga_studio.session.session import Session
from gaga_studio.session.view import Point, ToolName
from gaga_studio.tools.base import BoxDrag, ClickTool, ViewportPoint


class PickTool(ClickTool):
    """The default tool."""

    name = ToolName.PICK

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Select the object under the mouse; again: a part of it, with Alt what it is a part of.

        Where there are no objects, as the tool Object does.
        """
        if click_object.first_click(session, place):
            return
        at = place.u, place.v, place.width, place.height
        found = session.pick(*at) if place.how == "set" else None
        if found is None or not object_list.click_again(session, found.splat, up=place.alt):
            selection.click(session, *at, place.how)

    def hint(self, session: Session) -> str:
        """What a click does now."""
        has_parts, has_more = object_list.clicks_again(session)
        ways = ["Again: a part"] * has_parts + ["Alt: more"] * has_more
        again = f" {', '.join(ways)}." if ways else ""
        return f"Click selects the object, Shift adds, Ctrl removes.{again} Drag orbits."


# --- Click three points of the ground; drags orbit.

_LEAST = 0.25  # opacity of a pixel at which it counts as a surface


def surface_point(session: Session, place: ViewportPoint) -> Point | None:
    """The point of the surface under the mouse, world; None where there is none."""
    found = session.pick(place.u, place.v, place.width, place.height)
    if found is None or found.weights.sum() < _LEAST:
        return None
    x, y, z = (float(value) for value in found.point)
    return x, y, z


class GroundTool(ClickTool):
    """The points (``measure.ClickedPoints``) are points in the world, so the camera may move.

    The window marks them (``ui.viewport.overlays``); the end of the tool forgets them.
    """

    name = ToolName.GROUND

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add the surface point; the third one aligns the scene."""
        measure.add_ground_point(session, surface_point(session, place))

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{measure.ground_prompt(session)}  ·  {measure.GROUND_HELP}"


# --- Click points of the surface and read their distances; drags orbit.


class MeasureTool(ClickTool):
    """The points are ``measure.ClickedPoints``; ``ui.viewport.overlays`` marks them."""

    name = ToolName.MEASURE

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add the surface point."""
        measure.add(session, surface_point(session, place))

    def hint(self, session: Session) -> str:
        """What a click does now."""
        return f"{measure.prompt(session)}  ·  {measure.HELP}"


# --- Click an object to select it, with or without groups; drag a box around it.


class ObjectTool(BoxDrag):
    """Every click changes the answer; what is known of the clicks is in ``ClickState``."""

    name = ToolName.OBJECT

    def click(self, session: Session, place: ViewportPoint) -> None:
        """Add what is under the mouse to the object; with Alt or Ctrl take it away."""
        is_on = not (place.alt or place.how == "remove")
        click_object.click(session, place.u, place.v, place.width, place.height, is_on=is_on)

    def press(self, session: Session, place: ViewportPoint) -> None:
        """Set the first corner of a box, which always begins an object."""
        super().press(session, replace(place, how="set"))

    def release(self, session: Session, place: ViewportPoint) -> None:
        """Begin an object with what the box holds."""
        first = self._from
        self.cancel(session)
        if first is not None:
            corners = (first.u, first.v, place.u, place.v)
            click_object.box(session, corners, place.width, place.height)

    def hint(self, session: Session) -> str:
        """What a click or drag does now."""
        return click_object.prompt(session)
