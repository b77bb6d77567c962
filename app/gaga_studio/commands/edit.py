"""Edit: undo, duplicate, delete, and what ends a gesture."""

from gaga_studio.actions import cleanup, objects, transform
from gaga_studio.commands import handlers
from gaga_studio.commands.availability import (
    no_cancel,
    no_redo,
    no_scene,
    no_selection,
    no_selection_to_clean,
    no_undo,
    nothing_to_confirm,
)
from gaga_studio.commands.base import Command, ask
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session


def _mirror(axis: int) -> Command:
    return Command(
        f"edit.mirror_{'xyz'[axis]}",
        f"Mirror across {'XYZ'[axis]}",
        lambda session: transform.mirror(session, axis),
        enabled=no_selection,
    )


EDIT_COMMANDS: tuple[Command, ...] = (
    Command(
        "edit.undo", "Undo", Session.undo, "Ctrl+Z", enabled=no_undo, describe=handlers.undo_title
    ),
    Command(
        "edit.redo",
        "Redo",
        Session.redo,
        "Ctrl+Shift+Z",
        ("Ctrl+Y",),
        enabled=no_redo,
        describe=handlers.redo_title,
    ),
    Command("edit.duplicate", "Duplicate", transform.duplicate, "Shift+D", enabled=no_selection),
    Command(
        "edit.delete",
        "Delete",
        cleanup.delete_selected,
        "Delete",
        ("Backspace",),
        enabled=no_selection_to_clean,
    ),
    *(_mirror(axis) for axis in range(3)),
    Command("edit.reduce", "Reduce splats…", ask(Request.REDUCE), enabled=no_scene),
    Command("edit.delete_floaters", "Delete floaters", objects.delete_floaters, enabled=no_scene),
    Command("edit.confirm", "Confirm", handlers.confirm, "Enter", enabled=nothing_to_confirm),
    Command("edit.cancel", "Cancel", handlers.cancel, "Escape", enabled=no_cancel),
    Command("edit.preferences", "Preferences…", ask(Request.PREFERENCES), "Ctrl+,"),
)
