"""Why a command cannot be run now: "" when it can."""

import numpy as np

from gaga_core.scene.scene import State
from gaga_studio import cleaning
from gaga_studio.session import Session
from gaga_studio.view import ToolName


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
    reason = no_scene(session)
    if reason:
        return reason
    return "" if len(session.selected_indices()) else "Nothing is selected. Click an object first."


def no_selection_to_clean(session: Session) -> str:
    """Needs a selection, and the job runner when it is to be cleaned first."""
    return no_selection(session) or (busy(session) if session.settings.clean_first else "")


def not_cleanable(session: Session) -> str:
    """Needs one selected object and the job runner."""
    return not_one_object(session) or busy(session)


def no_cleaning(session: Session) -> str:
    """Needs the preview of a cleaning."""
    if cleaning.shown(session) is not None:
        return ""
    return no_scene(session) or "There is no preview of a cleaning. Use Clean up first."


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


def no_confidence(session: Session) -> str:
    """Needs to know how sure each splat is of its group."""
    scene = session.scene
    if scene is not None and scene.confidence is not None:
        return ""
    return no_scene(session) or "How sure the groups are is not known. Use Find objects."


def not_exportable_objects(session: Session) -> str:
    """Needs objects and the job runner."""
    return no_groups(session) or busy(session)


def no_masks(session: Session) -> str:
    """Needs masks and the job runner."""
    reason = not_saveable(session)
    if reason or len(session.masks):
        return reason
    return "This scene has no masks. Put label maps into its masks folder and open it again."


def not_one_object(session: Session) -> str:
    """Needs exactly one selected object."""
    reason = no_selection(session)
    if reason:
        return reason
    n = len(session.selected_groups())
    return "" if n == 1 else f"{n} objects are selected. Select one." if n else "Select an object."


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


def no_undo(session: Session) -> str:
    """Needs an edit."""
    history = session.history
    return "" if history is not None and history.can_undo else "There is nothing to undo."


def no_redo(session: Session) -> str:
    """Needs an undone edit."""
    history = session.history
    return "" if history is not None and history.can_redo else "There is nothing to redo."


def no_outline(session: Session) -> str:
    """Needs an outline that is being drawn."""
    if session.view.outline is not None:
        return ""
    return no_scene(session) or "No outline is being drawn. Take the polygon tool first."


def nothing_to_confirm(session: Session) -> str:
    """Needs an outline or the preview of a cleaning."""
    if session.view.outline is not None or cleaning.shown(session) is not None:
        return ""
    return no_scene(session) or "There is nothing to confirm."


def no_cancel(session: Session) -> str:
    """Needs something that Escape ends."""
    leaves = session.tool is not ToolName.PICK or session.rig.is_flying
    if session.is_previewing or leaves or not no_selection(session):
        return ""
    return "There is nothing to cancel."
