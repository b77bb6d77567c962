"""Selections with a name, to be selected again later."""

from gaga_core.scene import edits
from gaga_core.scene.edits import How
from gaga_studio.session.notices import notifies
from gaga_studio.session.session import Session


@notifies
def keep(session: Session, name: str) -> bool:
    """Keep the selection under a name."""
    document = session.need()
    splats = document.selected()
    return document.do(edits.keep_selection(document.settled().scene, name, splats))


def keep_next(session: Session) -> bool:
    """Keep the selection under the next free name: "set 3"."""
    kept = session.scene.named_selections if session.scene is not None else {}
    n = next(i for i in range(1, len(kept) + 2) if f"set {i}" not in kept)
    return keep(session, f"set {n}")


@notifies
def select(session: Session, name: str, how: How = "set") -> bool:
    """Select what is kept under a name."""
    document = session.need()
    rows = edits.named_selection(document.settled().scene, name)
    return document.select(rows, how, f"Select {name}")


@notifies
def forget(session: Session, name: str) -> bool:
    """Forget a named selection."""
    document = session.need()
    return document.do(edits.forget_selection(document.settled().scene, name))
