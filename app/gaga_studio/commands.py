"""One table of commands behind menu, tool bar, shortcuts, shortcut sheet and palette."""

from collections.abc import Callable
from dataclasses import dataclass

from gaga_studio import cleaning
from gaga_studio import command_acts as acts
from gaga_studio.input import FLY_KEYS
from gaga_studio.session import Session
from gaga_studio.view import Mode, ToolName

Reason = Callable[[Session], str]
GROUPS = ("File", "Edit", "Select", "Object", "View", "Tools", "Help")


def _always(_: Session) -> str:
    return ""


@dataclass(frozen=True)
class Command:
    """Something that a person can do from anywhere.

    Shortcuts are written as on the keys, by character: "Ctrl+Shift+Z", "Delete", "/"; modifiers in
    the order Ctrl, Shift, Alt.
    """

    id: str
    title: str
    group: str  # of GROUPS: the menu
    run: Callable[[Session], object]
    shortcut: str = ""
    aliases: tuple[str, ...] = ()
    enabled: Reason = _always  # "" when it can be run, else why not
    is_on: Callable[[Session], bool] | None = None  # of what can be switched on and off
    describe: Callable[[Session], str] | None = None  # title of the moment: "Undo Move mug"

    def title_now(self, session: Session) -> str:
        """Title for the menu at this moment."""
        return self.describe(session) if self.describe is not None else self.title


def _ask(request: str) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        session.request = request

    return run


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
        enabled=acts.no_scene,
        is_on=lambda session: session.tool is tool,
    )


def _mode(mode: Mode, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.mode = mode

    return Command(
        f"view.{mode}",
        title,
        "View",
        run,
        enabled=acts.no_groups if mode is Mode.GROUPS else acts.no_scene,
        is_on=lambda session: session.view.mode is mode,
    )


def _axis(axis: str) -> Command:
    return Command(
        f"view.{axis}",
        f"From the {axis}",
        "View",
        lambda session: session.rig.look_along(axis),
        enabled=acts.no_scene,
    )


COMMANDS: tuple[Command, ...] = (
    Command("file.open_folder", "Open scene folder…", "File", _ask("open_folder"), "Ctrl+O"),
    Command("file.open_file", "Open splat file…", "File", _ask("open_file"), "Ctrl+Shift+O"),
    Command("file.demo", "Open the demo", "File", lambda s: s.open_demo(), enabled=acts.busy),
    Command(
        "file.save", "Save project", "File", lambda s: s.save(), "Ctrl+S", enabled=acts.not_saveable
    ),
    Command(
        "file.save_as",
        "Save project as…",
        "File",
        _ask("save_as"),
        "Ctrl+Shift+S",
        enabled=acts.not_saveable,
    ),
    Command(
        "file.export_scene",
        "Export scene…",
        "File",
        _ask("export_scene"),
        "Ctrl+Shift+E",
        enabled=acts.not_saveable,
    ),
    Command(
        "file.export_selected",
        "Export selection…",
        "File",
        _ask("export_selected"),
        enabled=acts.not_exportable_selection,
    ),
    Command(
        "file.export_objects",
        "Export objects…",
        "File",
        _ask("export_objects"),
        enabled=acts.not_exportable_objects,
    ),
    Command(
        "file.close", "Close", "File", lambda s: s.close(), "Ctrl+W", enabled=acts.not_saveable
    ),
    Command("file.quit", "Quit", "File", lambda s: s.quit(), "Ctrl+Q"),
    Command(
        "edit.undo",
        "Undo",
        "Edit",
        lambda s: s.undo(),
        "Ctrl+Z",
        enabled=acts.no_undo,
        describe=acts.undo_title,
    ),
    Command(
        "edit.redo",
        "Redo",
        "Edit",
        lambda s: s.redo(),
        "Ctrl+Shift+Z",
        ("Ctrl+Y",),
        enabled=acts.no_redo,
        describe=acts.redo_title,
    ),
    Command(
        "edit.duplicate",
        "Duplicate",
        "Edit",
        lambda s: s.duplicate_selected(),
        "Shift+D",
        enabled=acts.no_selection,
    ),
    Command(
        "edit.delete",
        "Delete",
        "Edit",
        cleaning.delete_selected,
        "Delete",
        ("Backspace",),
        enabled=acts.no_selection_to_clean,
    ),
    Command("edit.cancel", "Cancel", "Edit", acts.cancel, "Escape", enabled=acts.no_cancel),
    Command("edit.preferences", "Preferences…", "Edit", _ask("preferences"), "Ctrl+,"),
    Command("select.all", "Select all", "Select", acts.select_all, "Ctrl+A", enabled=acts.no_scene),
    Command(
        "select.none",
        "Select nothing",
        "Select",
        acts.select_none,
        "Ctrl+Shift+A",
        ("Ctrl+D",),
        enabled=acts.no_selection,
    ),
    Command(
        "select.invert",
        "Invert selection",
        "Select",
        acts.select_inverse,
        "Ctrl+I",
        enabled=acts.no_scene,
    ),
    Command(
        "object.associate",
        "Find objects (associate masks)",
        "Object",
        lambda s: s.associate(),
        "Ctrl+G",
        enabled=acts.no_masks,
    ),
    Command(
        "object.hide",
        "Hide",
        "Object",
        lambda s: s.hide_selected(),
        "H",
        enabled=acts.no_selection,
    ),
    Command(
        "object.isolate",
        "Isolate",
        "Object",
        cleaning.isolate_selected,
        "/",
        enabled=acts.no_selection_to_clean,
    ),
    Command(
        "object.show_all",
        "Show all",
        "Object",
        lambda s: s.show_all(),
        "Shift+H",
        ("Alt+H",),
        enabled=acts.nothing_hidden,
    ),
    Command("object.rename", "Rename", "Object", _ask("rename"), "F2", enabled=acts.not_one_object),
    Command(
        "object.merge",
        "Merge into one",
        "Object",
        acts.merge,
        enabled=acts.not_several_objects,
    ),
    Command("object.clean", "Clean up", "Object", cleaning.start, enabled=acts.not_cleanable),
    Command(
        "object.clean_apply",
        "Apply the cleaning",
        "Object",
        cleaning.apply,
        "Enter",
        enabled=acts.no_cleaning,
    ),
    Command(
        "object.clean_first",
        "Always clean first",
        "Object",
        acts.toggle_clean_first,
        is_on=lambda s: s.settings.clean_first,
    ),
    _mode(Mode.COLOR, "Color"),
    _mode(Mode.GROUPS, "Groups"),
    _mode(Mode.DEPTH, "Depth"),
    Command(
        "view.next_mode", "Next render mode", "View", acts.next_mode, "M", enabled=acts.no_scene
    ),
    Command(
        "view.frame_selected",
        "Focus the selection",
        "View",
        acts.frame_selected,
        "F",
        enabled=acts.no_scene,
    ),
    Command(
        "view.frame_all",
        "Show the whole scene",
        "View",
        acts.frame_all,
        "Shift+F",
        ("Home",),
        enabled=acts.no_scene,
    ),
    *(_axis(axis) for axis in ("front", "back", "left", "right", "top", "bottom")),
    Command(
        "view.next_photo", "Next photo", "View", acts.next_view, "Right", enabled=acts.no_photos
    ),
    Command(
        "view.previous_photo",
        "Previous photo",
        "View",
        acts.previous_view,
        "Left",
        enabled=acts.no_photos,
    ),
    Command(
        "view.fly",
        "Fly",
        "View",
        acts.toggle_flying,
        "V",
        enabled=acts.no_scene,
        is_on=lambda s: s.rig.is_flying,
    ),
    Command(
        "view.frusta",
        "Cameras of the photos",
        "View",
        acts.toggle_frusta,
        "C",
        enabled=acts.no_photos,
        is_on=lambda s: s.view.show_frusta,
    ),
    Command(
        "view.outline",
        "Outline of the selection",
        "View",
        acts.toggle_outline,
        enabled=acts.no_scene,
        is_on=lambda s: s.view.show_outline,
    ),
    Command(
        "view.panels",
        "Panels",
        "View",
        acts.toggle_panels,
        "Tab",
        is_on=lambda s: s.view.show_panels,
    ),
    Command(
        "view.info", "Figures", "View", acts.toggle_info, "I", is_on=lambda s: s.view.show_info
    ),
    _tool(ToolName.PICK, "Pick objects"),
    _tool(ToolName.RECT, "Select by rectangle", "R"),
    _tool(ToolName.MOVE, "Move", "1"),
    _tool(ToolName.ROTATE, "Rotate", "2"),
    _tool(ToolName.SCALE, "Scale", "3"),
    Command(
        "tool.rect_splats",
        "Rectangle takes single splats",
        "Tools",
        acts.toggle_rect_splats,
        is_on=lambda s: s.view.rect_takes_splats,
    ),
    Command(
        "job.cancel",
        "Cancel the running task",
        "Tools",
        lambda s: s.jobs.cancel(),
        enabled=acts.idle,
    ),
    Command("help.palette", "Find a command…", "Help", _ask("palette"), "F3", ("Ctrl+P",)),
    Command("help.shortcuts", "Keys and mouse", "Help", _ask("shortcuts"), "F1"),
    Command("help.about", "About gaga-studio", "Help", _ask("about")),
)
_BY_ID = {command.id: command for command in COMMANDS}
_BY_SHORTCUT = {
    keys: command for command in COMMANDS for keys in (command.shortcut, *command.aliases) if keys
}


def command(command_id: str) -> Command:
    """The command with this id; ``KeyError`` when there is none."""
    return _BY_ID[command_id]


def for_shortcut(keys: str, session: Session) -> Command | None:
    """The command of a shortcut. While flying, the fly keys are the camera's, Shift or not."""
    letters = keys.removeprefix("Shift+").removeprefix("Alt+")
    if session.rig.is_flying and letters in FLY_KEYS:
        return None
    return _BY_SHORTCUT.get(keys)


def run(command_id: str, session: Session) -> bool:
    """Run a command if it can be run; a disabled one leaves its reason as the hint."""
    chosen = _BY_ID[command_id]
    reason = chosen.enabled(session)
    if reason:
        session.hint = reason
        return False
    session.hint = ""
    chosen.run(session)
    return True
