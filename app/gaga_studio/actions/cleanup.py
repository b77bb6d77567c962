"""Clean objects: with a preview to apply or cancel, or before isolate, delete and export."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from gaga_core.arrays import IntArray
from gaga_core.export.options import ExportOptions
from gaga_core.scene import cleanup
from gaga_core.scene.edits import Edit
from gaga_core.scene.scene import Scene
from gaga_studio.actions import children, objects, unchanged
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, notifies
from gaga_studio.session.session import Session

if TYPE_CHECKING:
    from gaga_core.scene.cleanup import CleanPreview

_CHANGED = "The scene changed while the object was cleaned, so nothing is done. Try it again."
_AS_IS = ExportOptions()
Build = Callable[[Scene, Sequence[int], IntArray, str], Edit | None]


# --- the preview


def shown(session: Session) -> "CleanPreview | None":
    """Return the preview that is shown now."""
    return session.document.cleaning if session.document is not None else None


def start(session: Session) -> None:
    """Compute what cleaning the selected object would change, and show it."""
    groups = session.selected_groups()
    if session.document is None or len(groups) != 1:
        return
    document, group = session.document, groups[0]
    stage = cleanup.clean_object_stage(document.settled().scene, group)
    is_same = _watch(session, document)

    def done(found: "CleanPreview") -> None:
        if not found:
            session.notify(Level.HINT, found.sentence())
        elif is_same():
            document.show_cleaning(found)

    session.jobs.start(f"Clean {document.name_of(group)}", stage, on_done=done)


@notifies
def apply(session: Session) -> bool:
    """Clean as the preview shows: one entry of the history."""
    document = session.need()
    found = document.cleaning
    if found is None:
        return False
    title = f"Clean {document.name_of(found.group)}"
    return document.do(cleanup.cleaned_edit(document.settled().scene, found, title))


def cancel(session: Session) -> bool:
    """Cancel the preview; False when there is none."""
    if shown(session) is None:
        return False
    session.cancel_preview()
    return True


# --- cleaning first


def isolate_selected(session: Session) -> None:
    """Hide everything but the selection; whole objects are cleaned first if that is wanted."""
    also = children.locked_along(session)

    def build(scene: Scene, groups: Sequence[int], labels: IntArray, title: str) -> Edit | None:
        return cleanup.isolate_cleaned(scene, groups, labels, title, also)

    _clean_then(session, "Isolate", build, objects.isolate, with_locked=True)


def delete_selected(session: Session) -> None:
    """Delete the selection; whole objects are cleaned first if that is wanted."""
    _clean_then(session, "Delete", cleanup.delete_cleaned, objects.delete)


def _clean_then(
    session: Session,
    verb: str,
    build: Build,
    plain: Callable[[Session], bool],
    *,
    with_locked: bool = False,
) -> None:
    """Clean, then ``build``; ``plain`` instead where nothing is to be cleaned.

    ``with_locked`` objects that go along are named, too: `children.along`.
    """
    groups = to_clean(session)
    if not groups:
        plain(session)
        return
    document = session.need()
    under = children.along(session, with_locked=with_locked).groups
    title = children.title_along(document, verb, under)
    stage = cleanup.clean_objects_stage(document.settled().scene, groups)
    is_same = _watch(session, document)

    def done(labels: IntArray) -> None:
        if is_same():
            document.do(build(document.scene, groups, labels, title))

    session.jobs.start(f"{title}, cleaned", stage, on_done=done)


def to_clean(session: Session) -> tuple[int, ...]:
    """Objects to clean before something is done to the selection; parts of objects never are."""
    if session.scene is None or not session.settings.clean_first:
        return ()
    return cleanup.whole_objects(children.scene_along(session, with_locked=False))


def _watch(session: Session, document: Document) -> Callable[[], bool]:
    before = document.history.state_id

    def is_same() -> bool:
        return document.history.state_id == before and not document.history.is_previewing

    return unchanged.watch(session, document, is_same, _CHANGED)
