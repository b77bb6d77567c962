"""Tools: the tool bar's tools, and the running task."""

from collections.abc import Callable

from gaga_studio.actions import align_ground
from gaga_studio.commands import availability, handlers
from gaga_studio.commands.base import Command
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
        "Tools",
        _take(tool),
        shortcut,
        enabled=availability.no_scene,
        is_on=lambda session: session.tool is tool,
    )


TOOLS_COMMANDS: tuple[Command, ...] = (
    _tool(ToolName.PICK, "Pick objects"),
    _tool(ToolName.RECT, "Select by rectangle", "R"),
    _tool(ToolName.LASSO, "Select by lasso", "L"),
    _tool(ToolName.POLYGON, "Select by polygon", "P"),
    _tool(ToolName.BRUSH, "Select by brush", "B"),
    _tool(ToolName.SPHERE, "Select by sphere"),
    _tool(ToolName.MOVE, "Move", "1"),
    _tool(ToolName.ROTATE, "Rotate", "2"),
    _tool(ToolName.SCALE, "Scale", "3"),
    Command(
        "tool.ground",
        "Align to ground by three points",
        "Tools",
        align_ground.begin,
        enabled=availability.no_scene,
        is_on=lambda session: session.tool is ToolName.GROUND,
    ),
    Command(
        "tool.snap",
        "Handles snap to steps",
        "Tools",
        handlers.toggle_snap,
        is_on=lambda s: s.view.snaps,
    ),
    Command(
        "tool.local_axes",
        "Handles along the object's own axes",
        "Tools",
        handlers.toggle_local_axes,
        "Shift+C",
        is_on=lambda s: s.view.local_axes,
    ),
    Command(
        "tool.set_pivot",
        "Set the pivot at the camera's focus",
        "Tools",
        handlers.set_pivot,
        enabled=availability.no_scene,
    ),
    Command(
        "tool.pivot_here",
        "Set the pivot here",
        "Tools",
        handlers.set_pivot_here,
        enabled=availability.nothing_pointed,
    ),
    Command(
        "tool.reset_pivot",
        "Pivot in the middle of the selection",
        "Tools",
        handlers.reset_pivot,
    ),
    Command(
        "tool.splats",
        "Select single splats, not objects",
        "Tools",
        handlers.toggle_splats,
        is_on=lambda s: s.view.takes_splats,
    ),
    Command(
        "tool.visible_only",
        "Select the visible surface only",
        "Tools",
        handlers.toggle_visible_only,
        is_on=lambda s: s.view.visible_only,
    ),
    Command("tool.smaller_brush", "Smaller brush", "Tools", handlers.smaller_brush, "["),
    Command("tool.larger_brush", "Larger brush", "Tools", handlers.larger_brush, "]"),
    Command(
        "tool.remove_corner",
        "Take back the last corner",
        "Tools",
        handlers.remove_corner,
        enabled=availability.no_corner,
        describe=handlers.remove_title,
    ),
    Command(
        "job.cancel",
        "Cancel the running task",
        "Tools",
        lambda s: s.jobs.cancel(),
        enabled=availability.idle,
    ),
)
