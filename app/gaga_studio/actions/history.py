"""Undo and redo, and the end of a drag whose edit is only shown."""

from gaga_studio.session.session import Session


def undo(session: Session) -> str | None:
    """Take the newest edit back; its title, None if there is none."""
    return session.document.undo() if session.document is not None else None


def redo(session: Session) -> str | None:
    """Do the next undone edit again; its title, None if there is none."""
    return session.document.redo() if session.document is not None else None


def commit_preview(session: Session) -> bool:
    """End a drag: what it shows becomes one entry; False if nothing changed."""
    return session.document is not None and session.document.commit_preview()


def cancel_preview(session: Session) -> None:
    """Drop a drag: everything is as it was before."""
    if session.document is not None:
        session.document.cancel_preview()
