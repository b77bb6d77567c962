"""Find and Object: how objects are found in masks, and what is done with those that are there."""

from gaga_core.scene.scene import LabelSource
from gaga_studio.actions import (
    associate,
    association_repair,
    children,
    cleanup,
    click_object,
    detail,
    fill,
    folders,
    identities,
    masks,
    models,
    objects,
    quality,
    search,
    selection,
    transform,
)
from gaga_studio.commands import handlers
from gaga_studio.commands.availability import (
    no_bank,
    no_cleaning,
    no_clicks,
    no_confidence,
    no_detection,
    no_filling,
    no_folder_of_selection,
    no_groups,
    no_identities,
    no_masks,
    no_new_views,
    no_quality,
    no_selection,
    no_selection_to_clean,
    no_views,
    not_cleanable,
    not_in_folder,
    not_indexable,
    not_liftable,
    not_nameable,
    not_one_object,
    not_one_object_or_folder,
    not_one_object_with_levels,
    not_one_object_with_masks,
    not_several_objects,
    not_under_an_object,
    nothing_hidden,
    nothing_locked,
)
from gaga_studio.commands.base import Command, ask
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session


def _labels(source: LabelSource) -> Command:
    def is_on(session: Session) -> bool:
        return session.scene is not None and session.scene.identities.source == source

    def run(session: Session) -> None:
        identities.use_labels(session, source)

    title = f"Labels by {source}"
    return Command(f"object.labels_{source}", title, run, enabled=no_identities, is_on=is_on)


FIND_COMMANDS: tuple[Command, ...] = (
    Command(
        "object.masks",
        "Make masks…",
        ask(Request.MAKE_MASKS),
        "Ctrl+M",
        enabled=masks.no_photos,
    ),
    Command(
        "object.masks_quick",
        "Make masks without a model (regions)",
        masks.make,
        enabled=masks.no_photos,
    ),
    Command(
        "object.masks_model",
        "Make masks with a model",
        models.make_masks,
        enabled=models.why_no_masks,
        describe=models.title,
    ),
    Command("object.models", "Models…", ask(Request.MODELS)),
    Command(
        "object.import_masks",
        "Import masks from a folder…",
        ask(Request.IMPORT_MASK_FOLDER),
        enabled=no_views,
    ),
    Command(
        "object.import_masks_file",
        "Import masks from a file…",
        ask(Request.IMPORT_MASK_FILE),
        enabled=no_views,
    ),
    Command(
        "object.associate",
        "Find objects (associate masks)",
        associate.associate,
        "Ctrl+G",
        enabled=no_masks,
    ),
    Command(
        "object.find_settings",
        "Find objects with settings…",
        ask(Request.FIND_OBJECTS),
        enabled=no_masks,
    ),
    Command(
        "object.add_views",
        "Add new photos and masks…",
        ask(Request.ADD_VIEWS),
        enabled=no_new_views,
    ),
    Command("object.lift", "Lift groups to identities", identities.lift, enabled=not_liftable),
    _labels("votes"),
    _labels("identities"),
    Command("object.find", "Find an object…", ask(Request.FIND), "Ctrl+F", enabled=no_groups),
    Command(
        "object.find_in_view",
        "Find it in this view",
        ask(Request.FIND_IN_VIEW),
        enabled=no_detection,
    ),
    Command("object.index", "Index this scene", search.index, enabled=not_indexable),
    Command("object.name_all", "Name the objects", search.name_all, enabled=not_nameable),
    Command(
        "object.quality", "Measure the quality of the objects", quality.measure, enabled=no_bank
    ),
    Command("object.worst_view", "Go to the worst view", quality.worst_view, enabled=no_quality),
    Command(
        "object.uncertain",
        "Select uncertain splats",
        selection.select_uncertain,
        enabled=no_confidence,
    ),
)
OBJECTS_COMMANDS: tuple[Command, ...] = (
    Command("object.hide", "Hide", objects.hide, "H", enabled=no_selection),
    Command(
        "object.isolate", "Isolate", cleanup.isolate_selected, "/", enabled=no_selection_to_clean
    ),
    Command(
        "object.show_all",
        "Show all",
        objects.show_all,
        "Shift+H",
        ("Alt+H",),
        enabled=nothing_hidden,
    ),
    Command("object.lock", "Lock", objects.lock, enabled=no_selection),
    Command("object.unlock_all", "Unlock all", objects.unlock_all, enabled=nothing_locked),
    Command("object.reset_placement", "Reset placement", transform.reset, enabled=no_selection),
    Command("object.rename", "Rename", ask(Request.RENAME), "F2", enabled=not_one_object_or_folder),
    Command("object.folder", "New folder", folders.new_folder, "Ctrl+Shift+G", enabled=no_groups),
    Command("object.folder_out", "Take out of the folder", folders.take_out, enabled=not_in_folder),
    Command(
        "object.folder_delete",
        "Delete the folder, keep its objects",
        folders.delete_chosen,
        enabled=no_folder_of_selection,
    ),
    Command(
        "object.leave_parent",
        "Take out from under its object",
        children.take_out,
        enabled=not_under_an_object,
    ),
    Command(
        "object.children_go_along",
        "Children go along",
        handlers.toggle_children_go_along,
        is_on=lambda s: s.settings.children_go_along,
    ),
    Command(
        "object.make", "Make an object of the clicks", click_object.make_object, enabled=no_clicks
    ),
    Command("object.merge", "Merge into one", objects.merge, enabled=not_several_objects),
    Command(
        "object.separate",
        "Separate into an object of its own",
        objects.separate,
        "Shift+P",
        enabled=no_selection,
    ),
    Command(
        "object.split", "Split into parts that do not touch", objects.split, enabled=not_one_object
    ),
    Command(
        "object.split_here",
        "Split here (one level finer)",
        detail.split_here,
        enabled=not_one_object_with_levels,
    ),
    Command(
        "object.join_here",
        "Join here (one level coarser)",
        detail.join_here,
        enabled=not_one_object_with_levels,
    ),
    Command(
        "object.split_masks",
        "Split into the two things that its masks show",
        association_repair.split_by_masks,
        enabled=not_one_object_with_masks,
    ),
    Command(
        "object.fill", "Delete and fill", fill.start, enabled=fill.why_not, describe=fill.title
    ),
    Command("object.fill_apply", "Apply the filling", fill.apply, enabled=no_filling),
    Command(
        "object.fill_lighten",
        "Take off its shadow",
        fill.switch_lighten,
        enabled=no_filling,
        is_on=lambda s: (found := fill.shown(s)) is not None and found.lighten,
    ),
    Command(
        "object.fill_continue",
        "Color holes from their surroundings",
        fill.continue_colors,
        is_on=lambda s: not s.settings.inpainting_model,
    ),
    Command(
        "object.fill_model",
        "Color holes by an inpainting model…",
        ask(Request.INPAINTING_MODEL),
        enabled=fill.why_no_model,
        is_on=lambda s: bool(s.settings.inpainting_model),
    ),
    Command("object.clean", "Clean up", cleanup.start, enabled=not_cleanable),
    Command("object.clean_apply", "Apply the cleaning", cleanup.apply, enabled=no_cleaning),
    Command(
        "object.clean_first",
        "Always clean first",
        handlers.toggle_clean_first,
        is_on=lambda s: s.settings.clean_first,
    ),
)
