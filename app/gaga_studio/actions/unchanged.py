"""Whether a job's result still belongs to what is open."""

from collections.abc import Callable

from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session


def watch(
    session: Session, document: Document, is_same: Callable[[], bool], text: str
) -> Callable[[], bool]:
    """A question for the end of a job: whether ``document`` is open still, and ``is_same``.

    When ``is_same`` says no, the notice ``text`` tells the user.
    """

    def ask() -> bool:
        if session.document is not document:
            return False
        if is_same():
            return True
        session.notify(Level.WARNING, text)
        return False

    return ask
