"""Select: everything that changes the selection at once."""

from gaga_studio.commands import acts, reasons
from gaga_studio.commands.base import Command

SELECT_COMMANDS: tuple[Command, ...] = (
    Command(
        "select.all", "Select all", "Select", acts.select_all, "Ctrl+A", enabled=reasons.no_scene
    ),
    Command(
        "select.none",
        "Select nothing",
        "Select",
        acts.select_none,
        "Ctrl+Shift+A",
        ("Ctrl+D",),
        enabled=reasons.no_selection,
    ),
    Command(
        "select.invert",
        "Invert selection",
        "Select",
        acts.select_inverse,
        "Ctrl+I",
        enabled=reasons.no_scene,
    ),
)
