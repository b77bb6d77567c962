"""Handlers that change the view or need several actions, and titles that change."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from gaga_core.scene.scene import LabelSource, State
from gaga_studio.features import (
    camera,
    cleanup,
    fill,
    folders,
    measure,
    object_list,
    objects,
    reconstruction,
    selection,
    split_view,
    transform,
)
from gaga_studio.features.base import Command, Reason, ask, switch
from gaga_studio.features.blender_keys import BLENDER, Keys
from gaga_studio.features.find import association, click_object, masks, memory_bank, search
from gaga_studio.features.selection import close_outline
from gaga_studio.session import level_of_detail, upright
from gaga_studio.session.camera_rig import FLY_KEYS
from gaga_studio.session.notices import NothingSelectedError
from gaga_studio.session.requests import Request
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import (
    CentreColors,
    Mode,
    PhotoCompareMode,
    Side,
    SplatLook,
    ToolName,
)

# --- Handlers that change the view or need several actions, and titles that change.


# --- titles


def undo_title(session: Session) -> str:
    """ "Undo Move chair"."""
    history = session.history
    return f"Undo {history.undo_title}" if history is not None and history.can_undo else "Undo"


def redo_title(session: Session) -> str:
    """ "Redo Move chair"."""
    history = session.history
    return f"Redo {history.redo_title}" if history is not None and history.can_redo else "Redo"


def remove_title(session: Session) -> str:
    """ "Take back the last point" while points are clicked."""
    on_ground = session.tool in (ToolName.GROUND, ToolName.MEASURE)
    return "Take back the last point" if on_ground else "Take back the last corner"


# --- handlers


def cancel(session: Session) -> None:
    """End what is active: a drag, flying, the tool, or the selection."""
    if session.is_previewing:
        session.cancel_preview()
    elif session.rig.is_flying:
        session.rig.is_flying = False
    elif session.view.outline is not None:
        session.view.outline = None
    elif session.tool is ToolName.GROUND:
        measure.leave_ground(session)
    elif session.tool is ToolName.MEASURE:
        measure.leave(session)
    elif click_object.is_clicking(session):
        click_object.clear(session)
    elif session.tool is not ToolName.PICK:
        session.tool = ToolName.PICK
    else:
        selection.select_none(session)


def toggle_clean_first(session: Session) -> None:
    """Switch cleaning of objects before they are isolated, deleted or exported."""
    settings = session.settings
    session.change_settings(replace(settings, clean_first=not settings.clean_first))


def toggle_children_go_along(session: Session) -> None:
    """Switch whether what lies under an object is moved, deleted, copied and exported with it."""
    settings = session.settings
    session.change_settings(replace(settings, children_go_along=not settings.children_go_along))


def toggle_flying(session: Session) -> None:
    """Orbit or fly."""
    session.rig.is_flying = not session.rig.is_flying


def smaller_brush(session: Session) -> None:
    """Make the brush a quarter smaller."""
    session.view.brush_radius = max(session.view.brush_radius / 1.25, 2.0)


def larger_brush(session: Session) -> None:
    """Make the brush a quarter larger."""
    session.view.brush_radius = min(session.view.brush_radius * 1.25, 400.0)


def confirm(session: Session) -> None:
    """Confirm what waits: the outline, the clicked object, the filling or the cleaning."""
    if session.view.outline is not None:
        close_outline(session)
    elif click_object.is_clicking(session):
        click_object.make_object(session)
    elif not fill.apply(session):
        cleanup.apply(session)


def remove_corner(session: Session) -> None:
    """Remove the last corner of the outline, or the last point that was clicked."""
    if session.tool is ToolName.GROUND:
        measure.take_back_ground_point(session)
    elif session.tool is ToolName.MEASURE:
        measure.take_back(session)
    elif session.view.outline is not None:
        session.view.outline = session.view.outline.without_last()


def toggle_first_steps(session: Session) -> None:
    """Show or hide the card of five steps."""
    put_away = not session.settings.first_steps_done
    session.change_settings(replace(session.settings, first_steps_done=put_away))


def set_pivot(session: Session) -> None:
    """Turn and scale about the point that the camera turns around (double click sets it)."""
    x, y, z = (float(value) for value in session.rig.pose.pivot)
    session.view.pivot = (x, y, z)


def set_pivot_here(session: Session) -> None:
    """Turn and scale about the point of the surface that was clicked."""
    if session.view.pointed is not None:
        x, y, z = session.view.pointed
        session.view.pivot = (x, y, z)


def reset_pivot(session: Session) -> None:
    """Turn and scale about the middle of the selection."""
    session.view.pivot = None


# --- Why a command cannot be run now: "" when it can.


def no_scene(session: Session) -> str:
    """Needs an open scene."""
    return "" if session.document is not None else "No scene is open."


def busy(session: Session) -> str:
    """Needs the job runner."""
    job = session.jobs.running
    return "" if job is None else f"{job.title} is still running."


def idle(session: Session) -> str:
    """Needs a running job."""
    return "" if session.jobs.running is not None else "Nothing is running."


def not_saveable(session: Session) -> str:
    """Needs a scene and the job runner."""
    return no_scene(session) or busy(session)


def no_selection(session: Session) -> str:
    """Needs a selection."""
    if session.document is None or len(session.selected_indices()):
        return no_scene(session)
    return str(NothingSelectedError())


def no_selection_to_clean(session: Session) -> str:
    """Needs a selection, and the job runner when it is to be cleaned first."""
    return no_selection(session) or (busy(session) if session.settings.clean_first else "")


def not_cleanable(session: Session) -> str:
    """Needs one selected object and the job runner."""
    return not_one_object(session) or busy(session)


def no_cleaning(session: Session) -> str:
    """Needs the preview of a cleaning."""
    if cleanup.shown(session) is not None:
        return ""
    return no_scene(session) or "There is no preview of a cleaning. Use Clean up first."


def no_filling(session: Session) -> str:
    """Needs the preview of a filled hole."""
    if fill.shown(session) is not None:
        return ""
    return no_scene(session) or "There is no preview of a filling. Use Delete and fill first."


def no_clicks(session: Session) -> str:
    """Needs splats that were selected with the tool Object."""
    if click_object.has_clicks(session):
        return no_selection(session)
    return no_scene(session) or "Nothing was clicked. Click with the tool Object (O) first."


def not_exportable_selection(session: Session) -> str:
    """Needs a selection and the job runner."""
    return no_selection(session) or busy(session)


def no_groups(session: Session) -> str:
    """Needs objects."""
    if session.document is None:
        return no_scene(session)
    if session.live is not None or session.document.read.has_groups():
        return ""
    return "There are no groups yet. Use Find objects to make them."


def no_folders(session: Session) -> str:
    """Needs a folder in the object list."""
    scene = session.scene
    if scene is not None and scene.folders.paths:
        return ""
    return no_scene(session) or "There are no folders yet. Select objects, then use New folder."


def no_folder_of_selection(session: Session) -> str:
    """Needs a folder that is chosen in the list, or whose objects are selected."""
    if no_folders(session) or folders.of_selection(session):
        return no_folders(session)
    return "Choose a folder in the list, or an object that is in one."


def not_in_folder(session: Session) -> str:
    """Needs selected objects or a chosen folder that lie in a folder."""
    if no_folders(session) or folders.can_take_out(session):
        return no_folders(session)
    return "What is selected lies in no folder."


def not_under_an_object(session: Session) -> str:
    """Needs a selected object that lies under another one."""
    if folders.can_leave_parent(session):
        return ""
    return no_selection(session) or "What is selected lies under no object. Drag it onto one."


def nothing_under(session: Session) -> str:
    """Needs a selected object under which others lie."""
    if folders.has_children(session):
        return ""
    return no_selection(session) or "Nothing lies under this object. Drag another one onto it."


def no_confidence(session: Session) -> str:
    """Needs the confidence of the splats."""
    scene = session.scene
    if scene is not None and scene.confidence is not None:
        return ""
    return no_scene(session) or "The confidence of the groups is not known. Use Find objects."


def no_identity_colors(session: Session) -> str:
    """Needs identity encodings."""
    scene = session.scene
    if scene is not None and scene.identities.colors is not None:
        return ""
    return no_scene(session) or association.NO_IDENTITIES


def no_identities(session: Session) -> str:
    """Needs labels by votes and by identities, to choose from."""
    scene = session.scene
    if scene is not None and scene.identities.other is not None:
        return ""
    return no_scene(session) or association.NO_IDENTITIES


def not_liftable(session: Session) -> str:
    """Needs groups of masks, the masks, and the job runner."""
    return no_bank(session) or no_masks(session)


def not_exportable_objects(session: Session) -> str:
    """Needs objects and the job runner."""
    return no_groups(session) or busy(session)


def no_masks(session: Session) -> str:
    """Needs masks and the job runner."""
    return not_saveable(session) or _no_masks(session)


def no_new_views(session: Session) -> str:
    """Needs views with masks that took no part in the objects, and the job runner."""
    return no_masks(session) or memory_bank.why_no_new_views(session)


def _no_masks(session: Session) -> str:
    if len(session.masks):
        return ""
    return "This scene has no masks. Use Make masks, or Import masks."


def no_views(session: Session) -> str:
    """Needs views, and the job runner."""
    return no_photos(session) or busy(session)


def not_exportable_masks(session: Session) -> str:
    """Needs objects, views and the job runner."""
    return no_groups(session) or no_views(session)


def not_indexable(session: Session) -> str:
    """Needs objects, views, a model of words and pictures, and the job runner."""
    return not_exportable_masks(session) or search.no_embedder()


def not_nameable(session: Session) -> str:
    """Needs an index of the scene, and the job runner."""
    return not_exportable_objects(session) or search.no_index(session)


def no_detection(session: Session) -> str:
    """Needs a text in the search box, a detector, and the job runner."""
    return no_groups(session) or search.no_detector() or search.no_question(session)


def not_one_object(session: Session) -> str:
    """Needs exactly one selected object."""
    reason = no_selection(session)
    if reason:
        return reason
    n = len(session.selected_groups())
    return "" if n == 1 else f"{n} objects are selected. Select one." if n else "Select an object."


def not_one_object_or_folder(session: Session) -> str:
    """Needs exactly one selected object, or one chosen folder."""
    return "" if len(folders.chosen(session)) == 1 else not_one_object(session)


def not_one_object_with_levels(session: Session) -> str:
    """Needs exactly one selected object, in a scene whose objects have levels of detail."""
    reason = not_one_object(session)
    if reason or object_list.levels_of(session) is not None:
        return reason
    return "These objects have no levels of detail: those of regions and of Segment Anything have."


def no_bank(session: Session) -> str:
    """Needs a memory bank with masks, and the job runner."""
    return no_shown_bank(session) or no_masks(session)


def no_shown_bank(session: Session) -> str:
    """Needs a memory bank with masks: enough to look at it, whatever else runs."""
    if session.scene is None:
        return no_scene(session)
    if session.scene.bank is None:
        return "Nothing is known of the masks behind these objects. Use Find objects first."
    return _no_masks(session)


def not_replayable(session: Session) -> str:
    """Needs a memory bank with masks and the job runner, or an open replay."""
    return "" if memory_bank.timeline_of(session).is_open else no_bank(session)


def not_one_object_with_masks(session: Session) -> str:
    """Needs one selected object that several masks joined, and the job runner."""
    reason = not_one_object(session) or no_bank(session)
    if reason:
        return reason
    n_masks = len(session.decisions(session.selected_groups()[0]))
    return "" if n_masks > 1 else "This object has no masks that could be told apart."


def no_quality(session: Session) -> str:
    """Needs the measured quality of the object in the inspector."""
    reason = no_scene(session)
    if reason or memory_bank.quality_of(session, session.focus) is not None:
        return reason
    if not session.focus:
        return not_one_object(session)
    return "Nothing is measured of this object. Use Measure the quality of the objects first."


def not_several_objects(session: Session) -> str:
    """Needs two selected objects or more."""
    reason = no_selection(session)
    if reason or len(session.selected_groups()) > 1:
        return reason
    return "Select two objects or more: Shift adds to the selection."


def nothing_hidden(session: Session) -> str:
    """Needs something hidden."""
    if session.scene is None:
        return no_scene(session)
    bits = np.uint8(State.HIDDEN | State.DELETED)
    is_hidden = ((session.scene.state & bits) == np.uint8(State.HIDDEN)).any()
    return "" if is_hidden else "Nothing is hidden."


def nothing_locked(session: Session) -> str:
    """Needs something locked."""
    if session.scene is None:
        return no_scene(session)
    return "" if session.scene.has(State.LOCKED).any() else "Nothing is locked."


def no_encodings(session: Session) -> str:
    """Needs a selection of splats with identity encodings."""
    reason = no_selection(session)
    if reason or session.scene is None:
        return reason
    if "obj_dc_0" in session.scene.gaussians.extra:
        return ""
    return "The splats have no identity encodings. Run gaga lift on the scene and export them."


def no_edits(session: Session) -> str:
    """Needs something to record."""
    history = session.history
    if history is not None and history.can_undo:
        return ""
    return no_scene(session) or "Nothing has been edited yet."


def no_photos(session: Session) -> str:
    """Needs cameras."""
    return no_scene(session) or ("" if session.cameras else "This scene has no photos.")


def no_photo_files(session: Session) -> str:
    """Needs photos that are on the disk."""
    folder = session.project.folder if session.project is not None else None
    if folder is not None and folder.image_paths:
        return ""
    return no_photos(session) or "The photos of this scene are not here."


def no_keyframe(session: Session) -> str:
    """Needs a keyframe of the camera's path."""
    if session.project is not None and session.project.film.keyframes:
        return ""
    return no_scene(session) or "The camera's path has no keyframes. Add one first."


def no_path(session: Session) -> str:
    """Needs two keyframes or more."""
    reason = no_keyframe(session)
    if reason or (session.project is not None and len(session.project.film.keyframes) > 1):
        return reason
    return "The camera's path has one keyframe only. Add another one."


def not_filmable(session: Session) -> str:
    """Needs two keyframes or more, or photos to go through, and the job runner."""
    reason = no_path(session) if no_photo_files(session) else ""
    return reason or busy(session)


def no_undo(session: Session) -> str:
    """Needs an edit."""
    history = session.history
    return "" if history is not None and history.can_undo else "There is nothing to undo."


def no_redo(session: Session) -> str:
    """Needs an undone edit."""
    history = session.history
    return "" if history is not None and history.can_redo else "There is nothing to redo."


def nothing_pointed(session: Session) -> str:
    """Needs a point of the surface that was clicked with the right button."""
    if session.view.pointed is not None:
        return no_scene(session)
    return no_scene(session) or "No point is chosen. Right-click one in the picture."


def no_corner(session: Session) -> str:
    """Needs an outline that is being drawn, or a point of the ground."""
    if session.tool is ToolName.GROUND:
        return "" if session.view.ground else "No point of the ground is marked yet."
    if session.tool is ToolName.MEASURE:
        return "" if session.view.measured else "No point is marked yet."
    if session.view.outline is not None:
        return ""
    return no_scene(session) or "No outline is being drawn. Take the polygon tool first."


def nothing_to_confirm(session: Session) -> str:
    """Needs an outline or the preview of a cleaning or filling."""
    waits = cleanup.shown(session) is not None or fill.shown(session) is not None
    if session.view.outline is not None or waits:
        return ""
    if click_object.is_clicking(session):
        return no_clicks(session)
    return no_scene(session) or "There is nothing to confirm."


def no_cancel(session: Session) -> str:
    """Needs something that Escape ends."""
    leaves = session.tool is not ToolName.PICK or session.rig.is_flying
    if session.is_previewing or leaves or not no_selection(session):
        return ""
    return "There is nothing to cancel."


# --- Camera: projection, speed, bookmarks, photo against picture, the path and its film.


_SLOWEST, _FASTEST = 0.1, 5.0  # of the preferences' slider
RECALL = tuple(f"camera.bookmark_{key}" for key in camera.BOOKMARK_KEYS)
SET = tuple(f"camera.set_bookmark_{key}" for key in camera.BOOKMARK_KEYS)


def _toggle_orthographic(session: Session) -> None:
    session.rig.set_orthographic(not session.rig.pose.is_orthographic)


def _speed(factor: float) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        speed = min(max(session.settings.fly_speed * factor, _SLOWEST), _FASTEST)
        session.change_settings(replace(session.settings, fly_speed=speed))
        session.hint = f"Fly speed {speed:.2g}×"

    return run


def _compare(mode: PhotoCompareMode, name: str, title: str) -> Command:
    return Command(
        f"camera.{name}",
        title,
        lambda session: split_view.set_compare_mode(session, mode),
        enabled=no_photos,
        is_on=lambda session: session.view.compare is mode,
    )


def _split(name: str, title: str, left: Side, right: Side) -> Command:
    return Command(
        f"camera.{name}",
        title,
        lambda session: split_view.show(session, left, right),
        enabled=lambda session: _no_split(session, left, right),
        is_on=lambda session: split_view.is_shown(session, left, right),
    )


def _no_split(session: Session, left: Side, right: Side) -> str:
    if split_view.is_shown(session, left, right):
        return ""
    reason = split_view.why_not(session, left) or split_view.why_not(session, right)
    is_job = left is Side.PRESET and split_view.other_labels(session) is None
    return reason or (busy(session) if is_job else "")


def _no_bookmark(key: int) -> Reason:
    def reason(session: Session) -> str:
        if camera.bookmark_index(session, key) is not None:
            return ""
        return no_scene(session) or f"No bookmark has the key {key} yet."

    return reason


def _name_of(key: int) -> Callable[[Session], str]:
    def describe(session: Session) -> str:
        index = camera.bookmark_index(session, key)
        return camera.bookmarks(session)[index].name if index is not None else f"Bookmark {key}"

    return describe


def _recall(key: int) -> Command:
    return Command(
        RECALL[key - 1],
        f"Go to bookmark {key}",
        lambda session: camera.recall_bookmark_key(session, key),
        f"Ctrl+{key}",
        enabled=_no_bookmark(key),
        describe=_name_of(key),
    )


def _set(key: int) -> Command:
    return Command(
        SET[key - 1],
        f"Set bookmark {key}",
        lambda session: camera.set_bookmark_key(session, key),
        f"Ctrl+Shift+{key}",
        enabled=no_scene,
    )


CAMERA_COMMANDS: tuple[Command, ...] = (
    Command(
        "view.ortho",
        "Orthographic",
        _toggle_orthographic,
        "5",
        enabled=no_scene,
        is_on=lambda session: session.rig.pose.is_orthographic,
    ),
    switch("view.cube", "View cube", "show_cube"),
    Command("camera.faster", "Fly faster", _speed(1.25)),
    Command("camera.slower", "Fly slower", _speed(1 / 1.25)),
    Command(
        "camera.add_bookmark", "Bookmark this view", camera.add_bookmark, "Ctrl+B", enabled=no_scene
    ),
    *(_recall(key) for key in camera.BOOKMARK_KEYS),
    *(_set(key) for key in camera.BOOKMARK_KEYS),
    _split("swipe", "Swipe between photo and picture", Side.PHOTO, Side.PICTURE),
    _split("split_groups", "Split: picture and groups", Side.PICTURE, Side.GROUPS),
    _split("split_photo_groups", "Split: photo and groups", Side.PHOTO, Side.GROUPS),
    _split("split_truth", "Split: truth and groups", Side.TRUTH, Side.GROUPS),
    _split("split_errors", "Split: groups and their errors", Side.GROUPS, Side.ERRORS),
    _split("split_before", "Split: before and after the last edit", Side.BEFORE, Side.PICTURE),
    _split("split_preset", "Split: the other preset and these groups", Side.PRESET, Side.GROUPS),
    _compare(PhotoCompareMode.DIFFERENCE, "difference", "Difference of photo and picture"),
    Command(
        "camera.hold_photo", "Photo while held", split_view.hold_photo, "Shift+G", enabled=no_photos
    ),
    Command("camera.add_keyframe", "Add keyframe", camera.add_keyframe, "K", enabled=no_scene),
    Command("camera.turntable", "Turntable", camera.make_turntable, enabled=no_scene),
    Command(
        "camera.play",
        "Play the path",
        camera.toggle_playing,
        "Shift+K",
        enabled=no_path,
        is_on=lambda session: session.view.playback.is_playing,
    ),
    Command("camera.clear_path", "Remove all keyframes", camera.clear_path, enabled=no_keyframe),
    Command("camera.open_path", "Open path…", ask(Request.OPEN_PATH), enabled=no_scene),
    Command("camera.save_path", "Save path…", ask(Request.SAVE_PATH), enabled=no_keyframe),
    Command("camera.film", "Save film…", ask(Request.SAVE_FILM), enabled=not_filmable),
)


# --- Edit: undo, duplicate, delete, and what ends a gesture.


def _mirror(axis: int) -> Command:
    return Command(
        f"edit.mirror_{'xyz'[axis]}",
        f"Mirror across {'XYZ'[axis]}",
        lambda session: transform.mirror(session, axis),
        enabled=no_selection,
    )


EDIT_COMMANDS: tuple[Command, ...] = (
    Command("edit.undo", "Undo", Session.undo, "Ctrl+Z", enabled=no_undo, describe=undo_title),
    Command(
        "edit.redo",
        "Redo",
        Session.redo,
        "Ctrl+Shift+Z",
        ("Ctrl+Y",),
        enabled=no_redo,
        describe=redo_title,
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
    Command("edit.confirm", "Confirm", confirm, "Enter", enabled=nothing_to_confirm),
    Command("edit.cancel", "Cancel", cancel, "Escape", enabled=no_cancel),
    Command("edit.preferences", "Preferences…", ask(Request.PREFERENCES), "Ctrl+,"),
)


# --- File: opening, saving, exporting.


FILE_COMMANDS: tuple[Command, ...] = (
    Command("file.open_folder", "Open scene folder…", ask(Request.OPEN_FOLDER), "Ctrl+O"),
    Command("file.open_file", "Open splat file…", ask(Request.OPEN_FILE), "Ctrl+Shift+O"),
    Command(
        "file.make_splats",
        "Make splats from photos",
        reconstruction.make,
        enabled=reconstruction.why_not,
        describe=reconstruction.title,
    ),
    Command(
        "file.make_splats_as",
        "Make splats as…",
        ask(Request.MAKE_SPLATS),
        enabled=reconstruction.why_not,
    ),
    Command("file.add_splats", "Add splats…", ask(Request.ADD_SPLATS), enabled=not_saveable),
    Command("file.demo", "Open the demo", lambda s: s.open_demo(), enabled=busy),
    Command("file.save", "Save project", lambda s: s.save(), "Ctrl+S", enabled=no_scene),
    Command(
        "file.save_as", "Save project as…", ask(Request.SAVE_AS), "Ctrl+Shift+S", enabled=no_scene
    ),
    Command(
        "file.export_scene",
        "Export scene…",
        ask(Request.EXPORT_SCENE),
        "Ctrl+Shift+E",
        enabled=not_saveable,
    ),
    Command(
        "file.export_page",
        "Export a web page…",
        ask(Request.EXPORT_PAGE),
        enabled=not_saveable,
    ),
    Command(
        "file.export_selected",
        "Export selection…",
        ask(Request.EXPORT_SELECTED),
        enabled=not_exportable_selection,
    ),
    Command(
        "file.export_objects",
        "Export objects…",
        ask(Request.EXPORT_OBJECTS),
        enabled=not_exportable_objects,
    ),
    Command(
        "file.export_meshes",
        "Export meshes…",
        ask(Request.EXPORT_MESHES),
        enabled=not_exportable_objects,
    ),
    Command(
        "file.export_cameras",
        "Export cameras…",
        ask(Request.EXPORT_CAMERAS),
        enabled=no_views,
    ),
    Command(
        "file.export_masks",
        "Export masks…",
        ask(Request.EXPORT_MASKS),
        enabled=not_exportable_masks,
    ),
    Command(
        "file.save_script",
        "Save the edits as a script…",
        ask(Request.SAVE_SCRIPT),
        enabled=no_edits,
    ),
    Command(
        "file.save_picture",
        "Save picture…",
        ask(Request.SAVE_PICTURE),
        "Ctrl+Alt+S",
        enabled=not_saveable,
    ),
    Command("file.close", "Close", lambda s: s.close(), "Ctrl+W", enabled=not_saveable),
    Command("file.quit", "Quit", lambda s: s.quit(), "Ctrl+Q"),
)


# --- Help: finding commands and keys.


HELP_COMMANDS: tuple[Command, ...] = (
    Command("help.palette", "Find a command…", ask(Request.COMMAND_LIST), "F3", ("Ctrl+P",)),
    Command("help.shortcuts", "Keys and mouse", ask(Request.SHORTCUTS), "F1"),
    Command(
        "help.first_steps",
        "First steps",
        toggle_first_steps,
        is_on=lambda s: not s.settings.first_steps_done,
    ),
    Command("help.about", "About gaga-studio", ask(Request.ABOUT)),
)


# --- View: what the color of splats means, how they are drawn, and the background.


_BACKGROUNDS = ("#1c1c1f", "#000000", "#808080", "#ffffff")  # dark, black, gray, white


def next_mode(session: Session) -> None:
    """Switch to the next mode that has something to show, cyclically."""
    current = [command.id for command in _MODES].index(f"view.{session.view.mode}")
    for command in (*_MODES[current + 1 :], *_MODES):
        if not command.enabled(session):
            command.run(session)
            return


def next_background(session: Session) -> None:
    """Switch to the next background: dark, black, gray, white."""
    now = session.settings.background
    at = _BACKGROUNDS.index(now) if now in _BACKGROUNDS else -1
    color = _BACKGROUNDS[(at + 1) % len(_BACKGROUNDS)]
    session.change_settings(replace(session.settings, background=color))


def _centres(colors: CentreColors, title: str, enabled: Reason) -> Command:
    def run(session: Session) -> None:
        view = session.view
        is_on = view.centre_colors is colors
        view.centre_colors = CentreColors.OWN if is_on else colors
        if not is_on:
            view.mode = Mode.CENTRES

    return Command(
        f"view.{colors}_centres",
        title,
        run,
        enabled=enabled,
        is_on=lambda session: session.view.centre_colors is colors,
    )


def _mode(mode: Mode, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.mode = mode

    needs = {
        Mode.GROUPS: no_groups,
        Mode.MASK: no_groups,
        Mode.CONFIDENCE: no_confidence,
        Mode.IDENTITY: no_identity_colors,
    }
    return Command(
        f"view.{mode}",
        title,
        run,
        enabled=needs.get(mode, no_scene),
        is_on=lambda session: session.view.mode is mode,
    )


def _look(look: SplatLook, title: str) -> Command:
    def run(session: Session) -> None:
        session.view.look = look

    return Command(
        f"view.look_{look}",
        title,
        run,
        enabled=no_scene,
        is_on=lambda session: session.view.look is look,
    )


_MODES = (
    _mode(Mode.COLOR, "Color"),
    _mode(Mode.GROUPS, "Groups"),
    _mode(Mode.DEPTH, "Depth"),
    _mode(Mode.CONFIDENCE, "Confidence"),
    _mode(Mode.CENTRES, "Centres"),
    _mode(Mode.RINGS, "Rings"),
    _mode(Mode.MASK, "Mask of the object"),
    _mode(Mode.IDENTITY, "Identity encodings"),
)
MODE_COMMANDS: tuple[Command, ...] = (
    *_MODES,
    Command("view.next_mode", "Next render mode", next_mode, "M", enabled=no_scene),
    _centres(CentreColors.GROUPS, "Centres in the colors of their groups", no_groups),
    _centres(
        CentreColors.IDENTITY, "Centres in the colors of their identities", no_identity_colors
    ),
    switch(
        "view.folder_colors",
        "Groups in the colors of their folders",
        "folder_colors",
        enabled=no_folders,
    ),
    _look(SplatLook.AUTO, "Look that the file asks for"),
    _look(SplatLook.CLASSIC, "Classic look"),
    _look(SplatLook.ANTIALIASED, "Antialiased look (mip)"),
    Command("view.background", "Next background color", next_background),
)


# --- Find and Object: how objects are found in masks, and what is done with those that are there.


def _labels(source: LabelSource) -> Command:
    def is_on(session: Session) -> bool:
        return session.scene is not None and session.scene.identities.source == source

    def run(session: Session) -> None:
        association.use_labels(session, source)

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
        masks.make_with_model,
        enabled=masks.why_no_model_masks,
        describe=masks.model_title,
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
        association.associate,
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
    Command("object.lift", "Lift groups to identities", association.lift, enabled=not_liftable),
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
        "object.quality",
        "Measure the quality of the objects",
        memory_bank.measure_quality,
        enabled=no_bank,
    ),
    Command(
        "object.worst_view", "Go to the worst view", memory_bank.worst_view, enabled=no_quality
    ),
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
        folders.leave_parent,
        enabled=not_under_an_object,
    ),
    Command(
        "object.children_go_along",
        "Children go along",
        toggle_children_go_along,
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
        objects.split_here,
        enabled=not_one_object_with_levels,
    ),
    Command(
        "object.join_here",
        "Join here (one level coarser)",
        objects.join_here,
        enabled=not_one_object_with_levels,
    ),
    Command(
        "object.split_masks",
        "Split into the two things that its masks show",
        memory_bank.split_by_masks,
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
        toggle_clean_first,
        is_on=lambda s: s.settings.clean_first,
    ),
)


# --- Select: everything that changes the selection at once.


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
        folders.select_with_children,
        enabled=nothing_under,
    ),
    Command(
        "select.keep", "Keep the selection", selection.keep_next_selection, enabled=no_selection
    ),
)


# --- Tools: the tool bar's tools, and the running task.


def _take(tool: ToolName) -> Callable[[Session], None]:
    def run(session: Session) -> None:
        session.tool = tool

    return run


def _tool(tool: ToolName, title: str, shortcut: str = "") -> Command:
    return Command(
        f"tool.{tool}",
        title,
        _take(tool),
        shortcut,
        enabled=no_scene,
        is_on=lambda session: session.tool is tool,
    )


TOOLS_COMMANDS: tuple[Command, ...] = (
    _tool(ToolName.PICK, "Pick objects"),
    Command(
        "tool.object",
        "Select an object by clicks",
        click_object.begin,
        "O",
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.OBJECT,
    ),
    _tool(ToolName.RECT, "Select by rectangle", "R"),
    _tool(ToolName.LASSO, "Select by lasso", "L"),
    _tool(ToolName.POLYGON, "Select by polygon", "P"),
    _tool(ToolName.BRUSH, "Select by brush", "B"),
    _tool(ToolName.SPHERE, "Select by sphere"),
    _tool(ToolName.ERASE, "Erase with a brush"),
    _tool(ToolName.COLOR, "Color with a brush"),
    _tool(ToolName.CLONE, "Clone with a brush"),
    _tool(ToolName.MOVE, "Move", "1"),
    _tool(ToolName.ROTATE, "Rotate", "2"),
    _tool(ToolName.SCALE, "Scale", "3"),
    Command(
        "tool.ground",
        "Align to ground by three points",
        measure.begin_ground,
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.GROUND,
    ),
    Command(upright.COMMAND, "Turn upright", upright.turn, enabled=no_scene),
    Command(
        "tool.measure",
        "Measure lengths, angles and heights",
        measure.begin,
        enabled=no_scene,
        is_on=lambda session: session.tool is ToolName.MEASURE,
    ),
    Command(
        "tool.origin_here", "Set the origin here", measure.set_origin_here, enabled=nothing_pointed
    ),
    switch("tool.snap", "Handles snap to steps", "snaps"),
    switch("tool.local_axes", "Handles along the object's own axes", "local_axes", "Shift+C"),
    Command(
        "tool.set_pivot",
        "Set the pivot at the camera's focus",
        set_pivot,
        enabled=no_scene,
    ),
    Command("tool.pivot_here", "Set the pivot here", set_pivot_here, enabled=nothing_pointed),
    Command("tool.reset_pivot", "Pivot in the middle of the selection", reset_pivot),
    switch("tool.splats", "Select single splats, not objects", "takes_splats"),
    switch("tool.visible_only", "Select the visible surface only", "visible_only"),
    Command(
        "tool.click_model",
        "Clicks of the tool Object ask a model",
        click_object.switch_model,
        enabled=click_object.why_no_model,
        is_on=lambda session: click_object.chosen_model(session) is not None,
    ),
    Command("tool.smaller_brush", "Smaller brush", smaller_brush, "["),
    Command("tool.larger_brush", "Larger brush", larger_brush, "]"),
    Command(
        "tool.remove_corner",
        "Take back the last corner",
        remove_corner,
        enabled=no_corner,
        describe=remove_title,
    ),
    Command("job.cancel", "Cancel the running task", lambda s: s.jobs.cancel(), enabled=idle),
)


# --- View: how the scene is shown, and from where.


def _axis(axis: str) -> Command:
    return Command(
        f"view.{axis}",
        f"From the {axis}",
        lambda session: session.rig.look_along(axis),
        enabled=no_scene,
    )


VIEW_COMMANDS: tuple[Command, ...] = (
    *MODE_COMMANDS,
    Command(
        "view.frame_selected",
        "Focus the selection",
        camera.frame_selected,
        "F",
        enabled=no_scene,
    ),
    Command(
        "view.frame_all",
        "Show the whole scene",
        camera.frame_all,
        "Shift+F",
        ("Home",),
        enabled=no_scene,
    ),
    *(_axis(axis) for axis in ("front", "back", "left", "right", "top", "bottom")),
    Command(
        "view.next_photo",
        "Next photo",
        lambda s: camera.next_view(s, 1),
        "Right",
        enabled=no_photos,
    ),
    Command(
        "view.previous_photo",
        "Previous photo",
        lambda s: camera.next_view(s, -1),
        "Left",
        enabled=no_photos,
    ),
    Command(
        "view.fly",
        "Fly",
        toggle_flying,
        "V",
        enabled=no_scene,
        is_on=lambda s: s.rig.is_flying,
    ),
    switch("view.frusta", "Cameras of the photos", "show_frusta", "C", enabled=no_photos),
    switch("view.outline", "Outline of the selection", "show_outline", enabled=no_scene),
    switch("view.box", "Box of the selection", "show_box", enabled=no_scene),
    switch(
        "view.lights_masks",
        "Light up the splats of the chosen mask",
        "lights_masks",
        enabled=no_shown_bank,
    ),
    switch(
        "view.mask_gate", "Depth gate of the chosen mask", "has_mask_gate", enabled=no_shown_bank
    ),
    Command(
        "view.timeline",
        "Replay the memory bank",
        memory_bank.toggle_timeline,
        enabled=not_replayable,
        is_on=lambda s: memory_bank.timeline_of(s).is_open,
    ),
    switch("view.lod", "Level of detail", "uses_lod", enabled=level_of_detail.no_tree),
    Command(
        level_of_detail.COMMAND,
        "Build level of detail",
        level_of_detail.build,
        enabled=level_of_detail.not_buildable,
    ),
    switch("view.panels", "Panels", "show_panels", "Tab"),
    switch("view.info", "Figures", "show_info", "I"),
)


# --- One table of commands behind menu, tool bar, shortcuts, shortcut sheet and palette.
# A file each for the menus; a new command is one entry there.


MENUS: Mapping[str, tuple[Command, ...]] = {
    "File": FILE_COMMANDS,
    "Edit": EDIT_COMMANDS,
    "Select": SELECT_COMMANDS,
    "Find": FIND_COMMANDS,
    "Object": OBJECTS_COMMANDS,
    "View": VIEW_COMMANDS,
    "Camera": CAMERA_COMMANDS,
    "Tools": TOOLS_COMMANDS,
    "Help": HELP_COMMANDS,
}
COMMANDS = tuple(command for menu in MENUS.values() for command in menu)
_MENU_OF = {command.id: title for title, menu in MENUS.items() for command in menu}
_BY_ID = {command.id: command for command in COMMANDS}


def _own_keys(chosen: Command) -> Keys:
    return tuple(keys for keys in (chosen.shortcut, *chosen.aliases) if keys)


PROFILES: Mapping[str, Mapping[str, Keys]] = {
    "supersplat": {c.id: _own_keys(c) for c in COMMANDS},
    "blender": {c.id: BLENDER.get(c.id, _own_keys(c)) for c in COMMANDS},
}
_BY_KEYS = {
    profile: {keys: _BY_ID[id_] for id_, listed in table.items() for keys in listed}
    for profile, table in PROFILES.items()
}


def menu_of(chosen: Command) -> str:
    """Title of the menu that a command stands in."""
    return _MENU_OF[chosen.id]


def command(command_id: str) -> Command:
    """Return the command with this id; ``KeyError`` when there is none."""
    return _BY_ID[command_id]


def for_shortcut(keys: str, session: Session) -> Command | None:
    """Return the command of a shortcut. While flying, the fly keys move the camera."""
    profile = _profile(session)
    letters = keys.removeprefix("Shift+").removeprefix("Alt+")
    if session.rig.is_flying and letters in FLY_KEYS:
        return None
    clicks_points = session.view.outline is not None or session.tool in (
        ToolName.GROUND,
        ToolName.MEASURE,
    )
    if keys == "Backspace" and clicks_points:  # it never deletes then
        return _BY_ID["tool.remove_corner"]
    return _BY_KEYS[profile].get(keys)


def keys_of(chosen: Command, session: Session) -> Keys:
    """Return every shortcut of a command in the profile that the user chose."""
    return PROFILES[_profile(session)][chosen.id]


def shortcut_of(chosen: Command, session: Session) -> str:
    """Return the shortcut that is shown for a command; "" when it has none."""
    keys = keys_of(chosen, session)
    return keys[0] if keys else ""


def _profile(session: Session) -> str:
    wanted = session.settings.keys
    return wanted if wanted in PROFILES else "supersplat"


def run(command_id: str, session: Session) -> bool:
    """Run a command if it can be run; a disabled one leaves its reason as the hint."""
    chosen = _BY_ID[command_id]
    reason = chosen.enabled(session)
    if reason:
        session.hint = reason
        return False
    session.hint = ""
    chosen.run(session)
    return True
