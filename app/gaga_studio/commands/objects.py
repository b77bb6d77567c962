"""Object: what is done with objects."""

from gaga_studio.actions import (
    association_repair,
    cleanup,
    files,
    masks,
    objects,
    quality,
    search,
    selection,
)
from gaga_studio.commands import availability, handlers
from gaga_studio.commands.base import Command, ask
from gaga_studio.session.requests import Request

OBJECTS_COMMANDS: tuple[Command, ...] = (
    Command(
        "object.masks",
        "Make masks…",
        ask(Request.MAKE_MASKS),
        "Ctrl+M",
        enabled=availability.no_photos_for_masks,
    ),
    Command(
        "object.masks_quick",
        "Make masks without a model (regions)",
        masks.make,
        enabled=availability.no_photos_for_masks,
    ),
    Command(
        "object.import_masks",
        "Import masks from a folder…",
        ask(Request.IMPORT_MASK_FOLDER),
        enabled=availability.no_views,
    ),
    Command(
        "object.import_masks_file",
        "Import masks from a file…",
        ask(Request.IMPORT_MASK_FILE),
        enabled=availability.no_views,
    ),
    Command(
        "object.associate",
        "Find objects (associate masks)",
        files.associate,
        "Ctrl+G",
        enabled=availability.no_masks,
    ),
    Command(
        "object.find",
        "Find an object…",
        ask(Request.FIND),
        "Ctrl+F",
        enabled=availability.no_groups,
    ),
    Command(
        "object.find_in_view",
        "Find it in this view",
        ask(Request.FIND_IN_VIEW),
        enabled=availability.no_detection,
    ),
    Command("object.index", "Index this scene", search.index, enabled=availability.not_indexable),
    Command(
        "object.name_all", "Name the objects", search.name_all, enabled=availability.not_nameable
    ),
    Command("object.hide", "Hide", objects.hide, "H", enabled=availability.no_selection),
    Command(
        "object.isolate",
        "Isolate",
        cleanup.isolate_selected,
        "/",
        enabled=availability.no_selection_to_clean,
    ),
    Command(
        "object.show_all",
        "Show all",
        objects.show_all,
        "Shift+H",
        ("Alt+H",),
        enabled=availability.nothing_hidden,
    ),
    Command(
        "object.rename", "Rename", ask(Request.RENAME), "F2", enabled=availability.not_one_object
    ),
    Command(
        "object.merge", "Merge into one", objects.merge, enabled=availability.not_several_objects
    ),
    Command(
        "object.separate",
        "Separate into an object of its own",
        objects.separate,
        "Shift+P",
        enabled=availability.no_selection,
    ),
    Command(
        "object.split",
        "Split into parts that do not touch",
        objects.split,
        enabled=availability.not_one_object,
    ),
    Command(
        "object.split_masks",
        "Split into the two things that its masks show",
        association_repair.split_by_masks,
        enabled=availability.not_one_object_with_masks,
    ),
    Command(
        "object.uncertain",
        "Select uncertain splats",
        selection.select_uncertain,
        enabled=availability.no_confidence,
    ),
    Command(
        "object.quality",
        "Measure the quality of the objects",
        quality.measure,
        enabled=availability.no_bank,
    ),
    Command(
        "object.worst_view",
        "Go to the worst view",
        quality.worst_view,
        enabled=availability.no_quality,
    ),
    Command("object.lock", "Lock", objects.lock, enabled=availability.no_selection),
    Command(
        "object.unlock_all", "Unlock all", objects.unlock_all, enabled=availability.nothing_locked
    ),
    Command("object.clean", "Clean up", cleanup.start, enabled=availability.not_cleanable),
    Command(
        "object.clean_apply", "Apply the cleaning", cleanup.apply, enabled=availability.no_cleaning
    ),
    Command(
        "object.clean_first",
        "Always clean first",
        handlers.toggle_clean_first,
        is_on=lambda s: s.settings.clean_first,
    ),
)
