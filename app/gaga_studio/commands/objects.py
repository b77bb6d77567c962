"""Object: what is done with objects."""

from gaga_studio import arranging, cleaning, stages
from gaga_studio.commands import acts, reasons
from gaga_studio.commands.base import Command, ask

OBJECTS_COMMANDS: tuple[Command, ...] = (
    Command(
        "object.associate",
        "Find objects (associate masks)",
        "Object",
        stages.associate,
        "Ctrl+G",
        enabled=reasons.no_masks,
    ),
    Command(
        "object.hide",
        "Hide",
        "Object",
        lambda s: s.hide_selected(),
        "H",
        enabled=reasons.no_selection,
    ),
    Command(
        "object.isolate",
        "Isolate",
        "Object",
        cleaning.isolate_selected,
        "/",
        enabled=reasons.no_selection_to_clean,
    ),
    Command(
        "object.show_all",
        "Show all",
        "Object",
        lambda s: s.show_all(),
        "Shift+H",
        ("Alt+H",),
        enabled=reasons.nothing_hidden,
    ),
    Command(
        "object.rename", "Rename", "Object", ask("rename"), "F2", enabled=reasons.not_one_object
    ),
    Command(
        "object.merge",
        "Merge into one",
        "Object",
        acts.merge,
        enabled=reasons.not_several_objects,
    ),
    Command(
        "object.separate",
        "Separate into an object of its own",
        "Object",
        arranging.separate,
        "Shift+P",
        enabled=reasons.no_selection,
    ),
    Command(
        "object.split",
        "Split into parts that do not touch",
        "Object",
        arranging.split,
        enabled=reasons.not_one_object,
    ),
    Command("object.lock", "Lock", "Object", arranging.lock, enabled=reasons.no_selection),
    Command(
        "object.unlock_all",
        "Unlock all",
        "Object",
        arranging.unlock_all,
        enabled=reasons.nothing_locked,
    ),
    Command("object.clean", "Clean up", "Object", cleaning.start, enabled=reasons.not_cleanable),
    Command(
        "object.clean_apply",
        "Apply the cleaning",
        "Object",
        cleaning.apply,
        enabled=reasons.no_cleaning,
    ),
    Command(
        "object.clean_first",
        "Always clean first",
        "Object",
        acts.toggle_clean_first,
        is_on=lambda s: s.settings.clean_first,
    ),
)
