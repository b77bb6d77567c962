"""Handlers that change the view or need several actions, and titles that change."""

from dataclasses import replace

from gaga_studio.actions import (
    align_ground,
    cleanup,
    click_object,
    fill,
    history,
    measure,
    selection,
)
from gaga_studio.session.session import Session
from gaga_studio.session.view_state import ToolName
from gaga_studio.tools.region import close_outline

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
        history.cancel_preview(session)
    elif session.rig.is_flying:
        session.rig.is_flying = False
    elif session.view.outline is not None:
        session.view.outline = None
    elif session.tool is ToolName.GROUND:
        align_ground.leave(session)
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
        align_ground.take_back(session)
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
