"""View and tools: what the color of splats means, how they are drawn, the active tool, its pivot
and brush, and the window's own commands."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gaga_core.color import luminance
from gaga_core.scene.edits.objects import NO_IDENTITIES
from gaga_core.scene.scene import State
from gaga_core.scene.tint import mean_color
from gaga_studio.features import level_of_detail, objects, selection, upright
from gaga_studio.features.base import (
    Command,
    Reason,
    ask,
    first_of,
    needs,
    no_confidence,
    no_groups,
    no_photos,
    no_scene,
    nothing_pointed,
    switch,
)
from gaga_studio.features.folders import no_folders
from gaga_studio.session.notices import Request
from gaga_studio.session.session import Session
from gaga_studio.session.settings import DEFAULT_BACKGROUND
from gaga_studio.session.view import CentreColors, Mode, SplatLook, ToolName

_BACKGROUNDS = (DEFAULT_BACKGROUND, "#000000", "#808080", "#ffffff")  # theme, black, gray, white
_OTHERWISE = (0.5, 0.5, 0.5)
_SMALLEST_BRUSH, _LARGEST_BRUSH = 2.0, 400.0  # pixels

no_identity_colors = needs(
    lambda session: session.need().scene.identities.colors is not None, NO_IDENTITIES
)
_NEEDS = {
    Mode.GROUPS: no_groups,
    Mode.MASK: no_groups,
    Mode.CONFIDENCE: no_confidence,
    Mode.IDENTITY: no_identity_colors,
}


def next_mode(session: Session) -> None:
    """Switch to the next mode that has something to show, cyclically."""
    modes = list(Mode)
    current = modes.index(session.view.mode)
    for mode in (*modes[current + 1 :], *modes):
        if not _NEEDS.get(mode, no_scene)(session):
            session.view.mode = mode
            return


def next_background(session: Session) -> None:
    """Switch to the next background: that of the theme, black, gray, white."""
    now = session.settings.background
    at = _BACKGROUNDS.index(now) if now in _BACKGROUNDS else -1
    color = _BACKGROUNDS[(at + 1) % len(_BACKGROUNDS)]
    session.change_settings(replace(session.settings, background=color))


_SEEN = 1.6  # contrast of what is isolated with its background (WCAG 2.2), else that is gray


def background_of(session: Session) -> tuple[float, float, float]:
    """Return the background of the picture: gray where what is isolated would vanish before it."""
    chosen, document = session.view.background, session.document
    if session.view.mode is not Mode.COLOR or document is None or not objects.isolated(session):
        return chosen
    scene = document.scene
    hidden = (State.HIDDEN, State.DELETED)

    def mean() -> float:
        shown = np.flatnonzero(~np.any([scene.has(state) for state in hidden], axis=0))
        return luminance(mean_color(scene, shown))

    revision = scene.revision
    key = (revision.splats, revision.state, revision.placement, revision.placements)
    low, high = sorted((document.read.once("shown luminance", key, mean), luminance(chosen)))
    is_seen = (high + 0.05) / (low + 0.05) >= _SEEN
    return chosen if is_seen else _OTHERWISE


def _mode(mode: Mode, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.mode = mode

    needed = _NEEDS.get(mode, no_scene)
    return Command(f"view.{mode}", title, run, enabled=needed, is_on=lambda s: s.view.mode is mode)


def _centres(colors: CentreColors, title: str, enabled: Reason) -> Command:
    def run(session: Session) -> None:
        view = session.view
        is_on = view.centre_colors is colors
        view.centre_colors = CentreColors.OWN if is_on else colors
        if not is_on:
            view.mode = Mode.CENTRES

    return Command(
        f"view.{colors}_centres",
        title,
        run,
        enabled=enabled,
        is_on=lambda session: session.view.centre_colors is colors,
    )


def _look(look: SplatLook, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.look = look

    return Command(
        f"view.look_{look}", title, run, enabled=no_scene, is_on=lambda s: s.view.look is look
    )


# --- panels


def _panel(name: str) -> Command:
    id_ = f"panel.{name.lower().replace(' ', '_')}"
    return Command(id_, name, lambda session: session.view.ask_for_panel(name))


# Of the list of commands alone: History and Timeline have commands in menus.
PANELS = tuple(
    map(
        _panel,
        ("Objects", "Inspector", "Select by", "Memory bank", "Views", "Camera path", "Bookmarks"),
    )
)

# --- tools


def _tool(tool: ToolName, title: str, shortcut: str = "") -> Command:
    def run(session: Session) -> None:
        session.tool = tool

    return Command(
        f"tool.{tool}", title, run, shortcut, enabled=no_scene, is_on=lambda s: s.tool is tool
    )


def _brush(factor: float) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        radius = session.view.brush_radius * factor
        session.view.brush_radius = min(max(radius, _SMALLEST_BRUSH), _LARGEST_BRUSH)

    return run


def set_pivot(session: Session) -> None:
    """Turn and scale about the point that the camera turns around (double click sets it)."""
    x, y, z = (float(value) for value in session.rig.pose.pivot)
    session.view.pivot = (x, y, z)


def set_pivot_here(session: Session) -> None:
    """Turn and scale about the point of the surface that was clicked."""
    if session.view.pointed is not None:
        x, y, z = session.view.pointed
        session.view.pivot = (x, y, z)


def reset_pivot(session: Session) -> None:
    """Turn and scale about the middle of the selection."""
    session.view.pivot = None


def toggle_first_steps(session: Session) -> None:
    """Show or hide the card of five steps."""
    put_away = not session.settings.first_steps_done
    session.change_settings(replace(session.settings, first_steps_done=put_away))


def _not_running(session: Session) -> str:
    return "" if session.jobs.running is not None else "Nothing is running."


COMMANDS: tuple[Command, ...] = (
    _mode(Mode.COLOR, "Color"),
    _mode(Mode.GROUPS, "Groups"),
    _mode(Mode.DEPTH, "Depth"),
    _mode(Mode.CONFIDENCE, "Confidence"),
    _mode(Mode.CENTRES, "Centres"),
    _mode(Mode.RINGS, "Rings"),
    _mode(Mode.MASK, "Mask of the object"),
    _mode(Mode.IDENTITY, "Identity encodings"),
    Command("view.next_mode", "Next render mode", next_mode, "M", enabled=no_scene),
    _centres(CentreColors.GROUPS, "Centres in the colors of their groups", no_groups),
    _centres(
        CentreColors.IDENTITY, "Centres in the colors of their identities", no_identity_colors
    ),
    switch(
        "view.folder_colors",
        "Groups in the colors of their folders",
        "folder_colors",
        enabled=no_folders,
    ),
    _look(SplatLook.AUTO, "Look that the file specifies"),
    _look(SplatLook.CLASSIC, "Classic look"),
    _look(SplatLook.ANTIALIASED, "Antialiased look (mip)"),
    Command("view.background", "Next background color", next_background),
    switch("view.frusta", "Cameras of the photos", "show_frusta", "C", enabled=no_photos),
    switch("view.outline", "Outline of the selection", "show_outline", enabled=no_scene),
    switch("view.box", "Box of the selection", "show_box", enabled=no_scene),
    switch("view.lod", "Level of detail", "uses_lod", enabled=level_of_detail.no_tree),
    Command(
        level_of_detail.COMMAND,
        "Build level of detail",
        level_of_detail.build,
        enabled=level_of_detail.not_buildable,
    ),
    switch("view.panels", "Panels", "show_panels", "Tab"),
    switch("view.info", "Figures", "show_info", "I"),
    switch("view.cube", "View cube", "show_cube"),
    _tool(ToolName.PICK, "Pick objects"),
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
        upright.COMMAND,
        "Turn upright",
        upright.turn,
        enabled=upright.why_not_turned,
        is_on=upright.is_turned,
    ),
    Command(
        upright.LEAVE,
        "It is upright",
        upright.leave,
        enabled=upright.why_not_left,
        is_on=upright.is_left,
    ),
    switch("tool.snap", "Handles snap to steps", "snaps"),
    switch("tool.local_axes", "Handles along the object's own axes", "local_axes", "Shift+C"),
    Command("tool.set_pivot", "Set the pivot at the camera's focus", set_pivot, enabled=no_scene),
    Command("tool.pivot_here", "Set the pivot here", set_pivot_here, enabled=nothing_pointed),
    Command("tool.reset_pivot", "Pivot in the middle of the selection", reset_pivot),
    switch(
        "tool.splats",
        "Select single splats, not objects",
        "takes_splats",
        enabled=first_of(no_scene, selection.why_splats),
        is_on=selection.takes_splats,
    ),
    switch(
        "tool.visible_only",
        "Select the visible surface only",
        "visible_only",
        enabled=selection.why_so_deep,
        is_on=selection.takes_surface,
    ),
    Command("tool.smaller_brush", "Smaller brush", _brush(1 / 1.25), "["),
    Command("tool.larger_brush", "Larger brush", _brush(1.25), "]"),
    Command(
        "job.cancel", "Cancel the running task", lambda s: s.jobs.cancel(), enabled=_not_running
    ),
    ask("edit.preferences", "Preferences…", Request.PREFERENCES, "Ctrl+,"),
    ask("view.panels_back", "Put panels back", Request.PANELS_BACK),
    ask("view.history", "History", Request.HISTORY, enabled=no_scene),
    ask("help.palette", "Find a command…", Request.COMMAND_LIST, "F3", ("Ctrl+P",)),
    ask("help.shortcuts", "Keys and mouse", Request.SHORTCUTS, "F1"),
    Command(
        "help.first_steps",
        "First steps",
        toggle_first_steps,
        is_on=lambda s: not s.settings.first_steps_done,
    ),
    ask("help.about", "About gaga-studio", Request.ABOUT),
)
