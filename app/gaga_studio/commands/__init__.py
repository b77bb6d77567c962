"""One table of commands behind menu, tool bar, shortcuts, shortcut sheet and palette.

A file each for the menus; a new command is one entry there.
"""

from collections.abc import Mapping

from gaga_studio.commands.base import Command as Command
from gaga_studio.commands.camera import CAMERA_COMMANDS
from gaga_studio.commands.edit import EDIT_COMMANDS
from gaga_studio.commands.file import FILE_COMMANDS
from gaga_studio.commands.help import HELP_COMMANDS
from gaga_studio.commands.keymaps import BLENDER, Keys
from gaga_studio.commands.objects import FIND_COMMANDS, OBJECTS_COMMANDS
from gaga_studio.commands.select import SELECT_COMMANDS
from gaga_studio.commands.tools import TOOLS_COMMANDS
from gaga_studio.commands.view import VIEW_COMMANDS
from gaga_studio.session.camera_rig import FLY_KEYS
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import ToolName

MENUS: Mapping[str, tuple[Command, ...]] = {
    "File": FILE_COMMANDS,
    "Edit": EDIT_COMMANDS,
    "Select": SELECT_COMMANDS,
    "Find": FIND_COMMANDS,
    "Object": OBJECTS_COMMANDS,
    "View": VIEW_COMMANDS,
    "Camera": CAMERA_COMMANDS,
    "Tools": TOOLS_COMMANDS,
    "Help": HELP_COMMANDS,
}
COMMANDS = tuple(command for menu in MENUS.values() for command in menu)
_MENU_OF = {command.id: title for title, menu in MENUS.items() for command in menu}
_BY_ID = {command.id: command for command in COMMANDS}


def _own_keys(chosen: Command) -> Keys:
    return tuple(keys for keys in (chosen.shortcut, *chosen.aliases) if keys)


PROFILES: Mapping[str, Mapping[str, Keys]] = {
    "supersplat": {c.id: _own_keys(c) for c in COMMANDS},
    "blender": {c.id: BLENDER.get(c.id, _own_keys(c)) for c in COMMANDS},
}
_BY_KEYS = {
    profile: {keys: _BY_ID[id_] for id_, listed in table.items() for keys in listed}
    for profile, table in PROFILES.items()
}


def menu_of(chosen: Command) -> str:
    """Title of the menu that a command stands in."""
    return _MENU_OF[chosen.id]


def command(command_id: str) -> Command:
    """Return the command with this id; ``KeyError`` when there is none."""
    return _BY_ID[command_id]


def for_shortcut(keys: str, session: Session) -> Command | None:
    """Return the command of a shortcut. While flying, the fly keys move the camera."""
    profile = _profile(session)
    letters = keys.removeprefix("Shift+").removeprefix("Alt+")
    if session.rig.is_flying and letters in FLY_KEYS:
        return None
    clicks_points = session.view.outline is not None or session.tool in (
        ToolName.GROUND,
        ToolName.MEASURE,
    )
    if keys == "Backspace" and clicks_points:  # it never deletes then
        return _BY_ID["tool.remove_corner"]
    return _BY_KEYS[profile].get(keys)


def keys_of(chosen: Command, session: Session) -> Keys:
    """Return every shortcut of a command in the profile that the user chose."""
    return PROFILES[_profile(session)][chosen.id]


def shortcut_of(chosen: Command, session: Session) -> str:
    """Return the shortcut that is shown for a command; "" when it has none."""
    keys = keys_of(chosen, session)
    return keys[0] if keys else ""


def _profile(session: Session) -> str:
    wanted = session.settings.keys
    return wanted if wanted in PROFILES else "supersplat"


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
