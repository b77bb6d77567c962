"""Saving the open project, and what is asked when files are no longer as they were."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gaga_core.errors import GagaError
from gaga_core.io.folder.lock import FolderLock, InUseError, lock_folder
from gaga_core.io.splats.splat_files import files_of_model
from gaga_core.scene.project import (
    ModelChangedError,
    Project,
    SavedElsewhereError,
    has_changed,
    reopen_stage,
)
from gaga_studio.session import stages
from gaga_studio.session.notices import Level, Request, UserQuestion

if TYPE_CHECKING:
    from gaga_studio.session.session import Session

Stamps = tuple[tuple[int, int, int] | None, ...]  # inode, time and size of each file; None: gone
COPY, ELSEWHERE, RELOAD = "Save with a copy", "Save elsewhere…", "Reload"


@dataclass(frozen=True)
class How:
    """Permissions of a save."""

    copies_model: bool = False
    overwrites: bool = False


def save(
    session: "Session",
    path: Path | None = None,
    then: Callable[[], None] | None = None,
    how: How | None = None,
) -> None:
    """Save the project as it is now where it was, or to ``path``, next to a job that runs.

    ``then`` is called after success. What the user must decide becomes a question.
    """
    document = session.document
    if document is None:
        return
    how = how or How(copies_model=document.copies_model)
    content = document.save_state.content(document.history.state_id)

    def done(where: Path) -> None:
        document.project.path = where
        document.copies_model |= how.copies_model
        if how.copies_model:
            document.stamps = stamps(document.project)
        document.save_state.saved(content)
        session.notify(Level.INFO, f"Saved to {where}.")
        if session.document is document:
            claim(session)
        if then is not None:
            then()

    def failed(error: GagaError) -> bool:
        if session.document is not document:
            return False
        question = _question(session, error, path, then, how)
        session.pending_question = question or session.pending_question
        return question is not None

    stage = stages.save_stage(document.settled(), path, how.copies_model, how.overwrites)
    session.jobs.start_save("Save", stage, done, failed)


def claim(session: "Session") -> None:
    """Make the saved project this program's, or say who has it: then it is read-only here."""
    document = session.need()
    place = document.project.path
    former, document.lock, document.in_use_by = document.lock, None, ""
    try:
        if place is not None:  # else the first save takes it
            document.lock = lock_folder(place)
    except InUseError as error:
        document.in_use_by = str(error.owner or "another program")
        session.notify(
            Level.WARNING,
            f"{document.name} is open in {document.in_use_by}, so it is read-only here. Use Save "
            "project as to keep edits.",
        )
    except GagaError as error:  # a place that cannot be written: saving says the same
        session.notify(Level.WARNING, f"{error} The project is read-only here.")
    release(former)


def release(lock: FolderLock | None) -> None:
    """Let other programs write to the project."""
    if lock is not None:
        lock.release()


def look_at_files(session: "Session") -> bool:
    """Ask what to do when another program changed the splats that are open; whether it did.

    Called when the window gets the focus; asks once about each change.
    """
    document = session.document
    if document is None or session.pending_question is not None:
        return False
    project = document.project
    now = stamps(project)
    if now == document.stamps:
        return False
    document.stamps = now
    files = _files(project)
    changed = [file for file in files if has_changed(file)]
    if not changed:
        return False
    error = ModelChangedError(changed[0][0])
    session.pending_question = _question(session, error, None, None, How())
    return True


def stamps(project: Project) -> Stamps:
    """A quick sign that a file may have changed."""
    return tuple(_stamp(file) for path, _ in _files(project) for file in files_of_model(path))


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size


def _files(project: Project) -> list[tuple[Path, str]]:
    """Files of splats, or the copies that a save has made of them, and their fingerprints."""
    files = [item for item in project.scene.added if not item.is_made]
    added = [(Path(item.path), item.fingerprint) for item in files]
    opened = [(project.model_path, project.model_fingerprint), *added]
    if project.path is None:
        return opened
    return [project.copies.files.get((project.path, file[1]), file) for file in opened]


def _question(
    session: "Session",
    error: GagaError,
    path: Path | None,
    then: Callable[[], None] | None,
    how: How,
) -> UserQuestion | None:
    """The question after a save failed with ``error``; None when there is no choice."""
    document = session.need()
    if isinstance(error, ModelChangedError):
        choices: tuple[str, ...] = (COPY, ELSEWHERE, RELOAD, "Cancel")
    elif isinstance(error, SavedElsewhereError):
        choices = (ELSEWHERE, "Overwrite", "Cancel")
    elif isinstance(error, InUseError):
        choices = (ELSEWHERE, "Try again", "Cancel")
    else:
        return None

    def elsewhere() -> None:
        document.copies_model |= isinstance(error, ModelChangedError)
        session.request = Request.SAVE_AS

    def reload() -> None:
        session.jobs.start("Reload", reopen_stage(document.project), on_done=session.take)

    actions: dict[str, Callable[[], None]] = {
        COPY: lambda: save(session, path, then, replace(how, copies_model=True)),
        "Overwrite": lambda: save(session, path, then, replace(how, overwrites=True)),
        "Try again": lambda: save(session, path, then, how),
        ELSEWHERE: elsewhere,
        RELOAD: reload,
        "Cancel": lambda: None,
    }
    text = str(error)
    if isinstance(error, ModelChangedError) and document.unsaved:
        text += " Reloading loses the unsaved edits."
    return UserQuestion(text, choices, lambda choice: actions[choice]())
