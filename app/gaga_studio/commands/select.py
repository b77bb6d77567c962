"""Select: everything that changes the selection at once."""

from gaga_studio.actions import children, named_selections, selection
from gaga_studio.commands.availability import no_encodings, no_scene, no_selection, nothing_under
from gaga_studio.commands.base import Command

SELECT_COMMANDS: tuple[Command, ...] = (
    Command("select.all", "Select all", selection.select_all, "Ctrl+A", enabled=no_scene),
    Command(
        "select.none",
        "Select nothing",
        selection.select_none,
        "Ctrl+Shift+A",
        ("Ctrl+D",),
        enabled=no_selection,
    ),
    Command(
        "select.invert", "Invert selection", selection.select_inverse, "Ctrl+I", enabled=no_scene
    ),
    Command("select.grow", "Grow", selection.grow, enabled=no_selection),
    Command("select.shrink", "Shrink", selection.shrink, enabled=no_selection),
    Command(
        "select.alike",
        "Grow to what is alike (identity)",
        selection.grow_by_identity,
        enabled=no_encodings,
    ),
    Command(
        "select.children",
        "Select with children",
        children.select_with_children,
        enabled=nothing_under,
    ),
    Command("select.keep", "Keep the selection", named_selections.keep_next, enabled=no_selection),
)
