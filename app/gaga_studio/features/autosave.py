"""Autosave in a folder of its own, and what is left after a crash.

Every minute with unsaved edits the project is written to a folder under `paths.home`, with the undo
history; saving, discarding or closing removes it. A folder whose program does not run any more was
left by a crash. What was recovered from it stays there until the edits are autosaved again, saved
or discarded.
"""

import logging
import os
import shutil
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated
from uuid import uuid4

import msgspec
import numpy as np

from gaga_core.arrays import AnyArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import TEXT, Column, checked, read_arrays
from gaga_core.io.files import atomic_write, set_aside
from gaga_core.io.folder.lock import is_running
from gaga_core.io.json_file import PathText, read_json
from gaga_core.progress import Progress, Stage
from gaga_core.scene.edits.history import History, HistoryRecord, history_arrays, history_of
from gaga_core.scene.project import (
    PROJECT_FILE,
    Project,
    open_path_stage,
    save_project,
    saved_scene,
    scene_arrays,
)
from gaga_core.scene.scene import Revision, Scene
from gaga_studio.features import level_of_detail
from gaga_studio.session.document import Document
from gaga_studio.session.notices import Level, UserQuestion
from gaga_studio.session.session import Session
from gaga_studio.system import paths

# --- the undo history as a file

_LOG = logging.getLogger(__name__)
FILE = "history.npz"
_OWN = {"scene": TEXT, "contents": Column(np.int64, ("states",))}  # the rest is the history's


@dataclass(frozen=True, eq=False)
class HistoryCopy:
    """The E entries of undo and redo, as values that another thread may write."""

    record: HistoryRecord
    contents: tuple[int, ...]  # (E + 1) of each state: states of one number are saved alike


def copy_history(document: Document) -> HistoryCopy:
    """The history of ``document`` as it is now, without a preview."""
    history, states = document.history, document.history.state_ids
    contents = tuple(document.save_state.content(state)[0] for state in states)
    return HistoryCopy(history.record(), contents)


def write_history(folder: Path, copied: HistoryCopy, scene_file: str) -> None:
    """Write it next to the project saved in ``folder``, of which ``scene_file`` is the scene."""
    arrays: dict[str, AnyArray] = {
        "scene": np.array(scene_file),
        "contents": np.array(copied.contents, np.int64),
        **history_arrays(copied.record),
    }
    with atomic_write(folder / FILE) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def read_history(folder: Path, scene_file: str, scene: Scene) -> HistoryCopy | None:
    """Read what `write_history` wrote next to the project with ``scene``.

    None when there is none of this scene file, or when it is damaged: undoing and redoing all of it
    must end at ``scene``, bit for bit.
    """
    file = folder / FILE
    if not file.is_file():
        return None
    try:
        arrays = read_arrays(file, "")
        own = checked(arrays, _OWN)
        if str(own["scene"]) != scene_file:  # of an autosave before or after this one
            return None
        record, n_lost = history_of(arrays)
        n_states = len(record.edits) + 1
        contents = own["contents"][n_lost : n_lost + n_states]
        check_shape("contents", contents, (n_states,), np.int64)
        _check_walk(scene, record)
    except (GagaError, ValueError, KeyError, IndexError, TypeError) as error:
        _LOG.warning("the undo history in %s is left out: %s", folder, error)
        return None
    return HistoryCopy(record, tuple(contents.tolist()))


def _check_walk(scene: Scene, record: HistoryRecord) -> None:
    """Raise ``ValueError`` unless undoing and redoing everything comes back to ``scene``."""
    trial = replace(scene, revision=Revision())
    history = History(trial)
    history.resume(record)
    for cursor in (0, len(record.edits), record.cursor):
        history.go_to(cursor)
    ours, theirs = scene_arrays(trial), scene_arrays(scene)
    same = ours.keys() == theirs.keys() and all(
        np.array_equal(ours[name], theirs[name]) for name in ours
    )
    tables = [(one.names, one.colors, one.weights) for one in (trial, scene)]
    if not same or tables[0] != tables[1]:
        raise ValueError("it does not lead to the scene")


def resume_history(document: Document, copied: HistoryCopy) -> None:
    """Let ``document``, just opened, undo and redo what ``copied`` holds."""
    document.history.resume(copied.record)
    document.save_state.resume(copied.contents)


# --- the autosaved project

EVERY_S = 60.0  # at most this much work is lost in a crash
_NOTE = "recovery.json"


class RecoveryNote(msgspec.Struct, frozen=True):
    """Content of recovery.json."""

    pid: Annotated[int, msgspec.Meta(ge=1, lt=1 << 31)]  # program that wrote it, or recovered it
    name: str  # of what was open
    project: PathText | None  # where its project was saved; None: never
    saved_at: Annotated[float, msgspec.Meta(ge=0, lt=1e11)]  # seconds since the epoch


@dataclass(frozen=True)
class Recovery:
    """Unsaved edits of a program that does not run any more."""

    folder: Path  # a saved project
    name: str  # of what was open
    project: Path | None  # where its project was saved; None: never
    saved_at: float  # seconds since the epoch

    @property
    def age(self) -> str:
        """The age in words: "5 minutes ago"."""
        minutes = max(int(time.time() - self.saved_at) // 60, 0)
        for size, unit in ((1440, "day"), (60, "hour"), (1, "minute")):
            if minutes >= size:
                n = minutes // size
                return f"{n} {unit}{'' if n == 1 else 's'} ago"
        return "less than a minute ago"


@dataclass
class Recovered:
    """Autosaves that hold what is open."""

    folders: tuple[Path, ...] = ()


class Autosave:
    """Writes the open project while it has unsaved edits; one writer thread."""

    def __init__(self, every_s: float | None = None) -> None:
        self._wanted = every_s  # None: as in the settings
        self._folder = root() / f"{os.getpid()}-{uuid4().hex[:8]}"
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="autosave")
        self._pending: Future[None] | None = None
        self._written: tuple[object, object] | None = None  # document and content in the folder
        self._copies: tuple[Path, ...] = ()  # recovered from, and still needed
        self._next = time.monotonic() + (EVERY_S if every_s is None else every_s)

    def tick(self, session: Session) -> None:
        """Once a frame: write when it is time, remove what is not needed any more."""
        self._note_failure(session)
        every = self._wanted if self._wanted is not None else session.settings.autosave_minutes * 60
        self._next = min(self._next, time.monotonic() + every)
        if self._pending is not None:
            return
        document = session.document
        if document is not None:
            recovered = document.feature(Recovered)
            self._copies, recovered.folders = (*self._copies, *recovered.folders), ()
        if document is None or not session.unsaved:
            if self._written is not None or self._copies:
                self._written = None
                self._pending = self._writer.submit(self._clear)
            self._next = time.monotonic() + every
            return
        now = (document, document.save_state.content(document.history.state_id))
        # A drag is not an edit yet; only a state of the history is written.
        if time.monotonic() < self._next or session.is_dragging or now == self._written:
            return
        self._next = time.monotonic() + every
        self._written = now
        project = replace(document.project, scene=replace(document.history.base))
        place = str(project.path) if project.path is not None else None
        history = copy_history(document)
        note = RecoveryNote(os.getpid(), document.title_name, place, time.time())

        def write() -> None:
            save_project(project, self._folder, copies_model=True, overwrites=True)
            write_history(self._folder, history, saved_scene(self._folder))
            _write_note(self._folder, note)
            self._remove_copies()

        self._pending = self._writer.submit(write)

    def finish(self) -> None:
        """Remove the autosave: the program ends normally."""
        self._writer.submit(self._clear)
        self._writer.shutdown(wait=True)

    def wait(self) -> None:
        """Wait for the writer (for tests)."""
        if self._pending is not None:
            self._pending.exception()

    def _clear(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        self._remove_copies()

    def _remove_copies(self) -> None:
        copies, self._copies = self._copies, ()
        for folder in copies:
            shutil.rmtree(folder, ignore_errors=True)

    def _note_failure(self, session: Session) -> None:
        if self._pending is None or not self._pending.done():
            return
        error, self._pending = self._pending.exception(), None
        if error is not None:
            _LOG.warning("autosave: %s", error)
            text = str(error) if isinstance(error, GagaError) else "Autosave failed; see the log."
            session.notify(Level.WARNING, f"The edits could not be kept safe: {text}")


def root() -> Path:
    """Return the folder of the autosaved projects."""
    return paths.home() / "recovery"


def left_over() -> tuple[tuple[Recovery, ...], tuple[str, ...]]:
    """Return what programs that ended without saving left, newest first, and problems.

    A problem is a sentence about a damaged note, which is set aside.
    """
    found, problems = [], []
    for file in root().glob(f"*/{_NOTE}"):
        try:
            note = read_json(file, RecoveryNote, "")
        except GagaError as error:
            _LOG.warning("recovery: %s", error)
            aside = set_aside(file)
            problems.append(
                f"The note of autosaved edits is damaged and was set aside as {aside or file}. The "
                f"edits may be whole: open {file.parent} with Open scene folder."
            )
            continue
        if not is_running(note.pid, file.stat().st_mtime):
            project = Path(note.project) if note.project else None
            found.append(Recovery(file.parent, note.name, project, note.saved_at))
    return tuple(sorted(found, key=lambda r: -r.saved_at)), tuple(problems)


def offer(session: Session) -> bool:
    """Ask about the newest project that a crash left; return whether there was one."""
    waiting, problems = left_over()
    for problem in problems:
        session.notify(Level.WARNING, problem)
    if not waiting:
        return False
    newest = waiting[0]

    def chosen(choice: str) -> None:
        if choice == "Recover":
            _recover(session, newest)
        elif choice == "Discard":
            _remover(newest.folder)()
            offer(session)

    is_past = newest.project is not None and _saved_at(newest.project) > newest.saved_at
    since = " The project was saved since then, without them." if is_past else ""
    session.pending_question = UserQuestion(
        f"gaga-studio ended without saving the edits of {newest.name} ({newest.age}).{since} "
        "Recover them?",
        ("Recover", "Discard", "Later"),
        chosen,
    )
    return True


def _recover(session: Session, found: Recovery) -> None:
    """Open what was autosaved as unsaved edits of the project that it belongs to.

    The autosave stays until `Autosave` has written or removed the edits; it is this program's now.
    """

    def opened(found_there: tuple[Project, HistoryCopy | None]) -> None:
        project, history = found_there
        project.path, project.copies.leaving = found.project, found.folder
        if found.project is not None and 0 < _saved_at(found.project) <= found.saved_at:
            project.known_saves.add(saved_scene(found.project))
        session.take(project)
        level_of_detail.opened(session)
        document = session.need()
        if history is not None:
            resume_history(document, history)
        document.save_state.saved(None)  # nothing of it is on disk
        document.feature(Recovered).folders = (found.folder,)
        added = [item for item in project.scene.added if not item.is_made]
        names = [project.model_path, *(Path(item.path) for item in added)]
        document.copies_model = any(name.is_relative_to(found.folder) for name in names)
        place = str(found.project) if found.project is not None else None
        _write_note(found.folder, RecoveryNote(os.getpid(), found.name, place, found.saved_at))

    session.jobs.start("Recover", _open_stage(found.folder), on_done=opened)


def _open_stage(folder: Path) -> Stage[tuple[Project, HistoryCopy | None]]:
    """Open the project of an autosave and its undo history."""
    project = yield from open_path_stage(folder)
    yield Progress("Read the undo history", 0, 0)
    return project, read_history(folder, saved_scene(folder), project.scene)


def _saved_at(place: Path) -> float:
    """When the project in ``place`` was saved last, seconds since the epoch; 0: there is none."""
    file = place / PROJECT_FILE
    return file.stat().st_mtime if file.is_file() else 0.0


def _write_note(folder: Path, note: RecoveryNote) -> None:
    with atomic_write(folder / _NOTE) as temporary:
        temporary.write_bytes(msgspec.json.encode(note))


def _remover(folder: Path) -> Callable[[], None]:
    return lambda: shutil.rmtree(folder, ignore_errors=True)
