"""One table of commands behind menu, tool bar, shortcuts, shortcut sheet and palette.

A file each for the menus; a new command is one entry there.
"""

from gaga_studio.commands.base import Command
from gaga_studio.commands.edit import EDIT_COMMANDS
from gaga_studio.commands.file import FILE_COMMANDS
from gaga_studio.commands.help import HELP_COMMANDS
from gaga_studio.commands.objects import OBJECTS_COMMANDS
from gaga_studio.commands.select import SELECT_COMMANDS
from gaga_studio.commands.tools import TOOLS_COMMANDS
from gaga_studio.commands.view import VIEW_COMMANDS
from gaga_studio.input import FLY_KEYS
from gaga_studio.session import Session

__all__ = ["COMMANDS", "GROUPS", "Command", "command", "for_shortcut", "run"]

GROUPS = ("File", "Edit", "Select", "Object", "View", "Tools", "Help")
COMMANDS: tuple[Command, ...] = (
    *FILE_COMMANDS,
    *EDIT_COMMANDS,
    *SELECT_COMMANDS,
    *OBJECTS_COMMANDS,
    *VIEW_COMMANDS,
    *TOOLS_COMMANDS,
    *HELP_COMMANDS,
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
    if keys == "Backspace" and session.view.outline is not None:
        return _BY_ID["tool.remove_corner"]
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
