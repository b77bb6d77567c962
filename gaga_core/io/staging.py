"""Results of several files that appear together or not at all."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.io.files import explain_os_error, remove_leftovers


@contextmanager
def staging_folder(target: Path) -> Iterator[Path]:
    """A hidden folder inside ``target`` to build results in; `publish` moves them to their place.

    It is removed at the end, also on an error or when a stage is cancelled, together with
    ``target`` if that was made here and stayed empty. A disk that is full or read-only becomes a
    ``GagaError``.
    """
    made: list[Path] = []
    try:
        made += [folder for folder in (target, *target.parents) if not folder.exists()]
        target.mkdir(parents=True, exist_ok=True)
        remove_leftovers(target)
        staging = Path(tempfile.mkdtemp(prefix=".gaga-", dir=target))
    except OSError as error:
        _remove_empty(made)
        raise GagaError(explain_os_error(error, target)) from error
    try:
        yield staging
    except OSError as error:
        raise GagaError(explain_os_error(error, target)) from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_empty(made)


def publish(staging: Path, name: str, target: Path) -> None:
    """Move the file or folder ``name`` from ``staging`` to ``target``, replacing what is there.

    ``name`` may be a path; folders on the way are made. A folder is replaced as a whole; the old
    one is set aside first and put back on failure.
    """
    new, old = staging / name, target / name
    if not new.is_dir():
        old.parent.mkdir(parents=True, exist_ok=True)
        new.replace(old)
        return
    aside = staging / f"{name}.old"
    if old.exists():
        old.replace(aside)
    try:
        new.replace(old)
    except OSError:
        if aside.exists():
            aside.replace(old)
        raise


def _remove_empty(folders: list[Path]) -> None:
    """Remove the folders made here that are empty, innermost first."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:  # never made, or in use by now: leave it
            return
