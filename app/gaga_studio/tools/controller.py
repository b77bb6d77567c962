"""Join mouse, keys, tools and camera: one call a frame for the picture."""

from collections.abc import Sequence
from dataclasses import replace

from gaga_core.arrays import DoubleArray
from gaga_studio.features import camera, measure, selection, split_view
from gaga_studio.session.notices import Level, Request, notifies
from gaga_studio.session.session import Session
from gaga_studio.session.view import ToolName
from gaga_studio.tools.base import PathShape, RectShape, Tool, ViewportPoint
from gaga_studio.tools.gestures import Act, Action, Gestures, KeyState, PointerState, fly_move
from gaga_studio.tools.move import MoveTool
from gaga_studio.tools.paint import BrushTool, CloneTool, ColorTool, EraseTool
from gaga_studio.tools.pick import GroundTool, MeasureTool, ObjectTool, PickTool
from gaga_studio.tools.region import LassoTool, PolygonTool, RectTool
from gaga_studio.tools.sphere import SphereTool

_EARLIER = "Left of the line is the scene as it was. Click right of the line."


class ToolController:
    """The tools, one of each, and the gesture that is under way."""

    def __init__(self) -> None:
        self.move_tools = {
            name: MoveTool(name) for name in (ToolName.MOVE, ToolName.ROTATE, ToolName.SCALE)
        }
        self._tools: dict[ToolName, Tool] = {
            ToolName.PICK: PickTool(),
            ToolName.OBJECT: ObjectTool(),
            ToolName.RECT: RectTool(),
            ToolName.LASSO: LassoTool(),
            ToolName.POLYGON: PolygonTool(),
            ToolName.BRUSH: BrushTool(),
            ToolName.SPHERE: SphereTool(),
            ToolName.ERASE: EraseTool(),
            ToolName.COLOR: ColorTool(),
            ToolName.CLONE: CloneTool(),
            ToolName.GROUND: GroundTool(),
            ToolName.MEASURE: MeasureTool(),
            **self.move_tools,
        }
        self._gestures = Gestures()
        self._active = ToolName.PICK

    @property
    def overlay(self) -> RectShape | PathShape | None:
        """What the tool draws over the picture now."""
        return self._tools[self._active].overlay()

    def clone_source(self, session: Session) -> DoubleArray | None:
        """Point (3,), world, that the clone brush copies from, while it is the tool."""
        tool = self.tool(session)
        return tool.source(session) if isinstance(tool, CloneTool) else None

    @property
    def is_dragging(self) -> bool:
        """Whether a drag is under way."""
        return self._gestures.is_dragging

    def tool(self, session: Session) -> Tool:
        """The active tool."""
        return self._tools[session.tool]

    def cancel(self, session: Session) -> bool:
        """Cancel the gesture without an edit (Escape); return whether there was one."""
        had = self._gestures.is_dragging or session.is_previewing
        self._gestures.cancel()
        self.tool(session).cancel(session)
        return had

    def update(
        self,
        session: Session,
        pointer: PointerState,
        keys: KeyState,
        dt: float,
        way: Sequence[PointerState] = (),
    ) -> None:
        """Do what this frame's mouse and keys mean. ``dt`` seconds since the last frame.

        ``way``: where the mouse was between the last frame and this one, in order.
        """
        if session.tool is not self._active:
            self._tools[self._active].cancel(session)
            self._gestures.cancel()
            self._active = session.tool
        if session.shown is None:
            return
        looks = session.rig.is_flying or bool(keys.held and not keys.ctrl)
        tool, is_open = self.tool(session), session.document is not None
        waits = session.document is not None and bool(session.document.waiting)
        takes_drag = tool.takes_drag and is_open and not waits
        for state in (*way, pointer):
            line = split_view.earlier_to(session, state.width, state.height)
            drags = takes_drag and state.u >= line
            for action in self._gestures.update(state, keys, tool_drags=drags, looks=looks):
                if _move_camera(session, action) or not is_open:
                    continue
                is_earlier = action.u < line
                if waits and action.act in (Act.CLICK, Act.MENU):
                    _say_that_it_waits(session)
                elif is_earlier and action.act is Act.HOVER:
                    _rest(session, tool, None)
                elif is_earlier and action.act in (Act.CLICK, Act.DOUBLE_CLICK, Act.MENU):
                    session.notify(Level.HINT, _EARLIER)
                elif is_earlier and action.act is Act.TOOL_DRAG:
                    continue  # a stroke ends at the line
                elif is_earlier and action.act is Act.TOOL_RELEASE:
                    _use(session, tool, replace(action, u=line), state)
                else:
                    _use(session, tool, action, state)
        move, speed = fly_move(keys, session.rig.is_flying)
        session.rig.fly(move, dt, speed * session.settings.fly_speed)


@notifies
def _say_that_it_waits(session: Session) -> None:
    """Leave a preview as it is that waits: a click next to it would throw its work away."""
    session.need().settled()


def _move_camera(session: Session, action: Action) -> bool:
    """Move the camera; return whether the action was the camera's."""
    rig = session.rig
    if action.act is Act.ORBIT:
        rig.orbit(action.dx, action.dy)
    elif action.act is Act.LOOK:
        rig.look(action.dx, action.dy)
    elif action.act is Act.PAN:
        rig.pan(action.dx, action.dy)
    elif action.act is Act.ZOOM:
        rig.zoom(-action.dy if session.settings.invert_zoom else action.dy)
    else:
        return False
    return True


def _use(session: Session, tool: Tool, action: Action, pointer: PointerState) -> None:
    size = pointer.width, pointer.height
    place = ViewportPoint(action.u, action.v, *size, action.how, action.alt)
    if action.act in (Act.HOVER, Act.AWAY):
        _rest(session, tool, place if action.act is Act.HOVER else None)
    elif action.act is Act.DOUBLE_CLICK:
        if isinstance(tool, PolygonTool):
            tool.double_click(session, place)
        else:
            camera.focus_at(session, place.u, place.v, place.width, place.height)
    elif action.act is Act.CLICK:
        tool.click(session, place)
    elif action.act is Act.MENU:
        _menu(session, place)
    elif action.act is Act.TOOL_PRESS:
        tool.press(session, place)
    elif action.act is Act.TOOL_DRAG:
        tool.drag(session, place)
    elif action.act is Act.TOOL_RELEASE:
        tool.release(session, place)


def _menu(session: Session, place: ViewportPoint) -> None:
    """Open the menu of the object at a right click, and select it.

    In an outline, and among points of the ground, remove one point instead. With no object there
    the menu is that of the scene.
    """
    view = session.view
    if view.outline is not None:
        view.outline = view.outline.without_last()
        return
    clicks_points = session.tool in (ToolName.GROUND, ToolName.MEASURE)
    if clicks_points and measure.clicked(session).points:
        measure.take_back(session)
        return
    found = session.pick(place.u, place.v, place.width, place.height)
    view.pointed = None if found is None else tuple(float(c) for c in found.point[:3])
    if found is not None and found.group and found.group not in session.selected_groups():
        selection.select_groups(session, (found.group,))
    is_on_object = found is not None and found.group
    session.request = Request.OBJECT_MENU if is_on_object else Request.SCENE_MENU


def _rest(session: Session, tool: Tool, place: ViewportPoint | None) -> None:
    """Handle a mouse that rests on the picture, or is elsewhere."""
    if isinstance(tool, BrushTool | PolygonTool):
        tool.hover(session, place)
    elif place is not None:
        session.hover(place.u, place.v, place.width, place.height)
    if place is None:
        session.hovering.away()
