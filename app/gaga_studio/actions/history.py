"""Undo and redo, and the end of a drag whose edit is only shown."""

from gaga_studio.session.session import Session


def undo(session: Session) -> str | None:
    """Undo the newest edit; return its title, None if there is none."""
    return session.document.undo() if session.document is not None else None


def redo(session: Session) -> str | None:
    """Redo the next undone edit; return its title, None if there is none."""
    return session.document.redo() if session.document is not None else None


def commit_preview(session: Session) -> bool:
    """Make what a drag shows one entry of the history; False if nothing changed."""
    return session.document is not None and session.document.commit_preview()


def cancel_preview(session: Session) -> None:
    """Cancel a drag: everything is as it was before."""
    if session.document is not None:
        session.document.cancel_preview()
