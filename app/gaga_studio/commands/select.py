"""Select: everything that changes the selection at once."""

from gaga_studio.actions import named_selections, selection
from gaga_studio.commands import availability
from gaga_studio.commands.base import Command

SELECT_COMMANDS: tuple[Command, ...] = (
    Command(
        "select.all", "Select all", selection.select_all, "Ctrl+A", enabled=availability.no_scene
    ),
    Command(
        "select.none",
        "Select nothing",
        selection.select_none,
        "Ctrl+Shift+A",
        ("Ctrl+D",),
        enabled=availability.no_selection,
    ),
    Command(
        "select.invert",
        "Invert selection",
        selection.select_inverse,
        "Ctrl+I",
        enabled=availability.no_scene,
    ),
    Command("select.grow", "Grow", selection.grow, enabled=availability.no_selection),
    Command("select.shrink", "Shrink", selection.shrink, enabled=availability.no_selection),
    Command(
        "select.alike",
        "Grow to what is alike (identity)",
        selection.grow_by_identity,
        enabled=availability.no_encodings,
    ),
    Command(
        "select.keep",
        "Keep the selection",
        named_selections.keep_next,
        enabled=availability.no_selection,
    ),
)
