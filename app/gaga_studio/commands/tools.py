"""Tools: the tool bar's tools, and the running task."""

from collections.abc import Callable

from gaga_studio.actions import align_ground, click_model, click_object, measure
from gaga_studio.commands import handlers
from gaga_studio.commands.availability import idle, no_corner, no_scene, nothing_pointed
from gaga_studio.commands.base import Command, switch
from gaga_studio.session import upright
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import ToolName


def _take(tool: ToolName) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        session.tool = tool

    return run


def _tool(tool: ToolName, title: str, shortcut: str = "") -> Command:
    return Command(
        f"tool.{tool}",
        title,
        _take(tool),
        shortcut,
        enabled=no_scene,
        is_on=lambda session: session.tool is tool,
    )


TOOLS_COMMANDS: tuple[Command, ...] = (
    _tool(ToolName.PICK, "Pick objects"),
    Command(
        "tool.object",
        "Select an object by clicks",
        click_object.begin,
        "O",
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.OBJECT,
    ),
    _tool(ToolName.RECT, "Select by rectangle", "R"),
    _tool(ToolName.LASSO, "Select by lasso", "L"),
    _tool(ToolName.POLYGON, "Select by polygon", "P"),
    _tool(ToolName.BRUSH, "Select by brush", "B"),
    _tool(ToolName.SPHERE, "Select by sphere"),
    _tool(ToolName.ERASE, "Erase with a brush"),
    _tool(ToolName.COLOR, "Color with a brush"),
    _tool(ToolName.CLONE, "Clone with a brush"),
    _tool(ToolName.MOVE, "Move", "1"),
    _tool(ToolName.ROTATE, "Rotate", "2"),
    _tool(ToolName.SCALE, "Scale", "3"),
    Command(
        "tool.ground",
        "Align to ground by three points",
        align_ground.begin,
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.GROUND,
    ),
    Command(upright.COMMAND, "Turn upright", upright.turn, enabled=no_scene),
    Command(
        "tool.measure",
        "Measure lengths, angles and heights",
        measure.begin,
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.MEASURE,
    ),
    Command(
        "tool.origin_here", "Set the origin here", measure.set_origin_here, enabled=nothing_pointed
    ),
    switch("tool.snap", "Handles snap to steps", "snaps"),
    switch("tool.local_axes", "Handles along the object's own axes", "local_axes", "Shift+C"),
    Command(
        "tool.set_pivot",
        "Set the pivot at the camera's focus",
        handlers.set_pivot,
        enabled=no_scene,
    ),
    Command(
        "tool.pivot_here", "Set the pivot here", handlers.set_pivot_here, enabled=nothing_pointed
    ),
    Command("tool.reset_pivot", "Pivot in the middle of the selection", handlers.reset_pivot),
    switch("tool.splats", "Select single splats, not objects", "takes_splats"),
    switch("tool.visible_only", "Select the visible surface only", "visible_only"),
    Command(
        "tool.click_model",
        "Clicks of the tool Object ask a model",
        click_model.switch,
        enabled=click_model.why_none,
        is_on=lambda session: click_model.chosen(session) is not None,
    ),
    Command("tool.smaller_brush", "Smaller brush", handlers.smaller_brush, "["),
    Command("tool.larger_brush", "Larger brush", handlers.larger_brush, "]"),
    Command(
        "tool.remove_corner",
        "Take back the last corner",
        handlers.remove_corner,
        enabled=no_corner,
        describe=handlers.remove_title,
    ),
    Command("job.cancel", "Cancel the running task", lambda s: s.jobs.cancel(), enabled=idle),
)
