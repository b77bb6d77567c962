"""Edit: undo, duplicate, delete, and what ends a gesture."""

from gaga_studio import arranging, cleaning
from gaga_studio.commands import acts, reasons
from gaga_studio.commands.base import Command, ask


def _mirror(axis: int) -> Command:
    return Command(
        f"edit.mirror_{'xyz'[axis]}",
        f"Mirror across {'XYZ'[axis]}",
        "Edit",
        lambda session: arranging.mirror(session, axis),
        enabled=reasons.no_selection,
    )


EDIT_COMMANDS: tuple[Command, ...] = (
    Command(
        "edit.undo",
        "Undo",
        "Edit",
        lambda s: s.undo(),
        "Ctrl+Z",
        enabled=reasons.no_undo,
        describe=acts.undo_title,
    ),
    Command(
        "edit.redo",
        "Redo",
        "Edit",
        lambda s: s.redo(),
        "Ctrl+Shift+Z",
        ("Ctrl+Y",),
        enabled=reasons.no_redo,
        describe=acts.redo_title,
    ),
    Command(
        "edit.duplicate",
        "Duplicate",
        "Edit",
        lambda s: s.duplicate_selected(),
        "Shift+D",
        enabled=reasons.no_selection,
    ),
    Command(
        "edit.delete",
        "Delete",
        "Edit",
        cleaning.delete_selected,
        "Delete",
        ("Backspace",),
        enabled=reasons.no_selection_to_clean,
    ),
    *(_mirror(axis) for axis in range(3)),
    Command(
        "edit.delete_floaters",
        "Delete floaters",
        "Edit",
        arranging.delete_floaters,
        enabled=reasons.no_scene,
    ),
    Command(
        "edit.confirm",
        "Confirm",
        "Edit",
        acts.confirm,
        "Enter",
        enabled=reasons.nothing_to_confirm,
    ),
    Command("edit.cancel", "Cancel", "Edit", acts.cancel, "Escape", enabled=reasons.no_cancel),
    Command("edit.preferences", "Preferences…", "Edit", ask("preferences"), "Ctrl+,"),
)
