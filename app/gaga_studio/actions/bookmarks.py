"""Views that a person keeps by name; they are saved with the project."""

from dataclasses import replace

from gaga_core.scene.camera_path import Bookmark, carried_bookmarks
from gaga_studio.session.session import Session

KEYS = tuple(range(1, 10))


def listed(session: Session) -> tuple[Bookmark, ...]:
    """Return the bookmarks of the open scene, in their order."""
    document = session.document
    if document is None:
        return ()
    marks, world = document.project.bookmarks, document.world
    key = (marks, world.tobytes())
    return document.read.once("bookmarks", key, lambda: carried_bookmarks(marks, world))


def add(session: Session, name: str = "", key: int = 0) -> None:
    """Keep the present view at the end of the list."""
    marks = listed(session)
    mark = Bookmark(name or _fresh_name(marks), session.rig.shot(), key)
    _keep(session, (*marks, mark))


def recall(session: Session, index: int) -> None:
    """Fly to a bookmark by its place in the list."""
    session.view.playback.is_playing = False
    session.active_view = None
    session.rig.go_to_shot(listed(session)[index].shot)


def index_of(session: Session, key: int) -> int | None:
    """Return the index of the bookmark that has a key 1..9; None if none has it."""
    found = [i for i, mark in enumerate(listed(session)) if mark.key == key]
    return found[0] if found else None


def set_key(session: Session, key: int) -> None:
    """Keep the present view under a key 1..9: its bookmark moves here, or a new one is made."""
    index = index_of(session, key)
    if index is None:
        add(session, f"View {key}" if not _has(session, f"View {key}") else "", key)
    else:
        update(session, index)


def recall_key(session: Session, key: int) -> bool:
    """Fly to the bookmark with this key; False if there is none."""
    index = index_of(session, key)
    if index is not None:
        recall(session, index)
    return index is not None


def update(session: Session, index: int) -> None:
    """Replace the view of a bookmark by the present one."""
    _change(session, index, replace(listed(session)[index], shot=session.rig.shot()))


def rename(session: Session, index: int, name: str) -> None:
    """Give a bookmark another name; an empty one changes nothing."""
    mark = listed(session)[index]
    if name.strip() and name.strip() != mark.name:
        _change(session, index, replace(mark, name=name.strip()))


def remove(session: Session, index: int) -> None:
    """Forget a bookmark."""
    marks = listed(session)
    _keep(session, (*marks[:index], *marks[index + 1 :]))


def move(session: Session, index: int, by: int) -> None:
    """Move a bookmark up (-1) or down (1) in the list."""
    marks = list(listed(session))
    to = index + by
    if 0 <= to < len(marks):
        marks.insert(to, marks.pop(index))
        _keep(session, tuple(marks))


def _change(session: Session, index: int, mark: Bookmark) -> None:
    marks = listed(session)
    _keep(session, (*marks[:index], mark, *marks[index + 1 :]))


def _keep(session: Session, marks: tuple[Bookmark, ...]) -> None:
    document = session.need()
    kept = document.project.bookmarks
    known = {now.shot: was.shot for now, was in zip(listed(session), kept, strict=True)}
    document.project.bookmarks = tuple(
        replace(mark, shot=document.as_opened(mark.shot, known)) for mark in marks
    )
    document.save_state.note_outside_history()


def _has(session: Session, name: str) -> bool:
    return any(mark.name == name for mark in listed(session))


def _fresh_name(marks: tuple[Bookmark, ...]) -> str:
    names, n = {mark.name for mark in marks}, len(marks) + 1
    while f"View {n}" in names:
        n += 1
    return f"View {n}"
