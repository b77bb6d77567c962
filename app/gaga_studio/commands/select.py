"""Select: everything that changes the selection at once."""

from gaga_studio import arranging
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
    Command("select.grow", "Grow", "Select", arranging.grow, enabled=reasons.no_selection),
    Command("select.shrink", "Shrink", "Select", arranging.shrink, enabled=reasons.no_selection),
    Command(
        "select.alike",
        "Grow to what is alike (identity)",
        "Select",
        arranging.grow_by_identity,
        enabled=reasons.no_encodings,
    ),
    Command(
        "select.keep",
        "Keep the selection",
        "Select",
        arranging.keep_next,
        enabled=reasons.no_selection,
    ),
)
