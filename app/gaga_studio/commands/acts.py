"""What commands do in more than one call, and titles of the moment."""

from dataclasses import replace

from gaga_studio import tour
from gaga_studio.session import Session
from gaga_studio.view import Mode, ToolName

# --- titles of the moment


def undo_title(session: Session) -> str:
    """ "Undo Move mug"."""
    history = session.history
    return f"Undo {history.undo_title}" if history is not None and history.can_undo else "Undo"


def redo_title(session: Session) -> str:
    """ "Redo Move mug"."""
    history = session.history
    return f"Redo {history.redo_title}" if history is not None and history.can_redo else "Redo"


# --- acts


def cancel(session: Session) -> None:
    """End the innermost thing: a drag, flying, the tool, the selection."""
    if session.is_previewing:
        session.cancel_preview()
    elif session.rig.is_flying:
        session.rig.is_flying = False
    elif session.tool is not ToolName.PICK:
        session.tool = ToolName.PICK
    else:
        select_none(session)


def select_all(session: Session) -> None:
    """Select everything visible."""
    session.attempt(lambda: session.need().select_all())


def select_none(session: Session) -> None:
    """Select nothing."""
    session.attempt(lambda: session.need().select_none())


def select_inverse(session: Session) -> None:
    """Select what is not selected."""
    session.attempt(lambda: session.need().select_inverse())


def merge(session: Session) -> None:
    """Make the selected objects one."""
    session.attempt(lambda: session.need().merge_selected())


def next_mode(session: Session) -> None:
    """Color, groups, depth, and round again."""
    modes = list(Mode)
    session.view.mode = modes[(modes.index(session.view.mode) + 1) % len(modes)]


def frame_selected(session: Session) -> None:
    """Show the selection."""
    tour.frame_selected(session)


def frame_all(session: Session) -> None:
    """Show everything."""
    tour.frame_all(session)


def next_view(session: Session) -> None:
    """Fly to the next photo."""
    tour.next_view(session, 1)


def previous_view(session: Session) -> None:
    """Fly to the photo before."""
    tour.next_view(session, -1)


def toggle_clean_first(session: Session) -> None:
    """Clean objects before they are isolated, deleted or exported, or do not."""
    settings = session.settings
    session.change_settings(replace(settings, clean_first=not settings.clean_first))


def toggle_flying(session: Session) -> None:
    """Orbit or fly."""
    session.rig.is_flying = not session.rig.is_flying


def toggle_frusta(session: Session) -> None:
    """Show or hide the photos' cameras."""
    session.view.show_frusta = not session.view.show_frusta


def toggle_outline(session: Session) -> None:
    """Show or hide the outline of the selection."""
    session.view.show_outline = not session.view.show_outline


def toggle_panels(session: Session) -> None:
    """Show or hide everything but the picture."""
    session.view.show_panels = not session.view.show_panels


def toggle_info(session: Session) -> None:
    """Show or hide the figures in the status bar."""
    session.view.show_info = not session.view.show_info


def toggle_rect_splats(session: Session) -> None:
    """Rectangle: whole objects or single splats."""
    session.view.rect_takes_splats = not session.view.rect_takes_splats
