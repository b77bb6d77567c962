"""Check that the result of a job still fits what is open."""

from collections.abc import Callable

from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session


def watch(
    session: Session, document: Document, is_same: Callable[[], bool], text: str
) -> Callable[[], bool]:
    """Return a check for the end of a job: is ``document`` still open, and ``is_same`` true?

    When ``is_same`` is false, the user gets the notice ``text``.
    """

    def check() -> bool:
        if session.document is not document:
            return False
        if is_same():
            return True
        session.notify(Level.WARNING, text)
        return False

    return check
