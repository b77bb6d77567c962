"""Select: everything that changes the selection at once."""

from gaga_studio.actions import objects
from gaga_studio.commands import availability, handlers
from gaga_studio.commands.base import Command

SELECT_COMMANDS: tuple[Command, ...] = (
    Command(
        "select.all",
        "Select all",
        "Select",
        handlers.select_all,
        "Ctrl+A",
        enabled=availability.no_scene,
    ),
    Command(
        "select.none",
        "Select nothing",
        "Select",
        handlers.select_none,
        "Ctrl+Shift+A",
        ("Ctrl+D",),
        enabled=availability.no_selection,
    ),
    Command(
        "select.invert",
        "Invert selection",
        "Select",
        handlers.select_inverse,
        "Ctrl+I",
        enabled=availability.no_scene,
    ),
    Command("select.grow", "Grow", "Select", objects.grow, enabled=availability.no_selection),
    Command("select.shrink", "Shrink", "Select", objects.shrink, enabled=availability.no_selection),
    Command(
        "select.alike",
        "Grow to what is alike (identity)",
        "Select",
        objects.grow_by_identity,
        enabled=availability.no_encodings,
    ),
    Command(
        "select.keep",
        "Keep the selection",
        "Select",
        objects.keep_next,
        enabled=availability.no_selection,
    ),
)
