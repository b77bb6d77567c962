"""The undo history of a document as a file, history.npz: it comes back after a crash."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, check_shape
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.files import atomic_write
from gaga_core.scene.edits.history import History, HistoryRecord
from gaga_core.scene.edits.history_file import history_arrays, history_of
from gaga_core.scene.project import scene_arrays
from gaga_core.scene.scene import Revision, Scene
from gaga_studio.session.document import Document

_LOG = logging.getLogger(__name__)
FILE = "history.npz"


@dataclass(frozen=True, eq=False)
class HistoryCopy:
    """What undo and redo need, of E entries, as values that another thread may write."""

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
        if str(arrays["scene"]) != scene_file:  # of an autosave before or after this one
            return None
        record, n_lost = history_of(arrays)
        n_states = len(record.edits) + 1
        contents = arrays["contents"][n_lost : n_lost + n_states]
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
    if not same or (trial.names, trial.colors) != (scene.names, scene.colors):
        raise ValueError("it does not lead to the scene")


def resume_history(document: Document, copied: HistoryCopy) -> None:
    """Let ``document``, just opened, undo and redo what ``copied`` holds."""
    document.history.resume(copied.record)
    document.save_state.resume(copied.contents)
