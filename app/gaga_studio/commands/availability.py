"""Why a command cannot be run now: "" when it can."""

import numpy as np

from gaga_core.scene.scene import State
from gaga_studio.actions import (
    add_views,
    bank_timeline,
    children,
    cleanup,
    click_object,
    fill,
    folders,
    identities,
    object_lines,
    quality,
    search,
)
from gaga_studio.session.notices import NothingSelectedError
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import ToolName


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
    if children.can_take_out(session):
        return ""
    return no_selection(session) or "What is selected lies under no object. Drag it onto one."


def nothing_under(session: Session) -> str:
    """Needs a selected object under which others lie."""
    if children.has_children(session):
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
    return no_scene(session) or identities.NO_IDENTITIES


def no_identities(session: Session) -> str:
    """Needs labels by votes and by identities, to choose from."""
    scene = session.scene
    if scene is not None and scene.identities.other is not None:
        return ""
    return no_scene(session) or identities.NO_IDENTITIES


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
    return no_masks(session) or add_views.why_not(session)


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
    if reason or object_lines.levels_of(session) is not None:
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
    return "" if bank_timeline.timeline_of(session).is_open else no_bank(session)


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
    if reason or quality.of_group(session, session.focus) is not None:
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
