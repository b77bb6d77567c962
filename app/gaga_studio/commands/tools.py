"""Tools: the tool bar's tools, and the running task."""

from collections.abc import Callable

from gaga_studio import grounding
from gaga_studio.commands import acts, reasons
from gaga_studio.commands.base import Command
from gaga_studio.session import Session
from gaga_studio.view import ToolName


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
        enabled=reasons.no_scene,
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
        grounding.begin,
        enabled=reasons.no_scene,
        is_on=lambda session: session.tool is ToolName.GROUND,
    ),
    Command(
        "tool.snap",
        "Handles snap to steps",
        "Tools",
        acts.toggle_snap,
        is_on=lambda s: s.view.snaps,
    ),
    Command(
        "tool.local_axes",
        "Handles along the object's own axes",
        "Tools",
        acts.toggle_local_axes,
        "Shift+C",
        is_on=lambda s: s.view.local_axes,
    ),
    Command(
        "tool.set_pivot",
        "Set the pivot at the camera's focus",
        "Tools",
        acts.set_pivot,
        enabled=reasons.no_scene,
    ),
    Command(
        "tool.pivot_here",
        "Set the pivot here",
        "Tools",
        acts.set_pivot_here,
        enabled=reasons.nothing_pointed,
    ),
    Command(
        "tool.reset_pivot",
        "Pivot in the middle of the selection",
        "Tools",
        acts.reset_pivot,
    ),
    Command(
        "tool.splats",
        "Select single splats, not objects",
        "Tools",
        acts.toggle_splats,
        is_on=lambda s: s.view.takes_splats,
    ),
    Command(
        "tool.visible_only",
        "Select the visible surface only",
        "Tools",
        acts.toggle_visible_only,
        is_on=lambda s: s.view.visible_only,
    ),
    Command("tool.smaller_brush", "Smaller brush", "Tools", acts.smaller_brush, "["),
    Command("tool.larger_brush", "Larger brush", "Tools", acts.larger_brush, "]"),
    Command(
        "tool.remove_corner",
        "Take back the last corner",
        "Tools",
        acts.remove_corner,
        enabled=reasons.no_corner,
        describe=acts.remove_title,
    ),
    Command(
        "job.cancel",
        "Cancel the running task",
        "Tools",
        lambda s: s.jobs.cancel(),
        enabled=reasons.idle,
    ),
)
