"""Results of several files that appear together or not at all.

They are built in a hidden folder, then moved by a plan that lies in it. A program that is killed
while it moves leaves its plan: the next one that opens or writes the folder moves the rest.
"""

import errno
import hashlib
import logging
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath

import msgspec
from filelock import FileLock

from gaga_core.errors import GagaError
from gaga_core.io.files import PLAN, explain_os_error, refuse_links, remove_leftovers
from gaga_core.io.json_file import PathText, read_json

if sys.platform != "win32":
    import fcntl

_LOG = logging.getLogger(__name__)
_PATIENCE_S, _POLL_S = 30.0, 0.02
_MOST_BYTES = 4 << 20  # of a plan; one of 20,000 pictures has 1 MB


@contextmanager
def staging_folder(target: Path) -> Iterator[Path]:
    """A hidden folder inside ``target`` to build results in, for `publish_all`.

    It is removed at the end, also on an error or when a stage is cancelled, together with
    ``target`` if that was made here and stayed empty. A disk that is full or read-only becomes a
    ``GagaError``.
    """
    made: list[Path] = []
    refuse_links(target)
    try:
        made += [folder for folder in (target, *target.parents) if not folder.exists()]
        target.mkdir(parents=True, exist_ok=True)
        finish_publishing(target)
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


def publish_all(staging: Path, names: Iterable[str], target: Path) -> None:
    """Move files or folders from ``staging`` to ``target``, replacing what is there.

    A name may be a path; folders on the way are made. A folder is replaced as a whole. A program
    that is killed meanwhile leaves the rest to `finish_publishing`. One program moves at a time:
    ``GagaError`` when another one takes too long, or when a link would be followed.
    """
    plan = list(names)
    draft = staging / f"{PLAN}.part"
    draft.write_bytes(msgspec.json.encode(plan))
    with _alone_in(target):
        draft.replace(staging / PLAN)
        _move(staging, plan, target)
        (staging / PLAN).unlink()


def finish_publishing(target: Path) -> int:
    """Move what a program that was killed in `publish_all` has left; return how many plans.

    Does nothing when there is nothing, or when ``target`` cannot be written.
    """
    plans = list(target.glob(f".gaga-*/{PLAN}"))
    if not plans:
        return 0
    n = 0
    try:
        refuse_links(target)
        with _alone_in(target):
            for plan in plans:
                if plan.is_file():  # its program runs no more: it would hold the lock
                    _move(plan.parent, _read_plan(plan), target)
                    shutil.rmtree(plan.parent)
                    n += 1
    except (OSError, GagaError) as error:
        _LOG.warning("results in %s that were not moved to their places: %s", target, error)
    return n


@contextmanager
def _alone_in(target: Path) -> Iterator[None]:
    """Keep other programs from moving files to ``target``; the lock ends with its program.

    It is one on the folder itself, so that it leaves no file there.
    """
    if sys.platform == "win32":
        name = hashlib.sha256(str(target.resolve()).encode()).hexdigest()[:16]
        with FileLock(Path(tempfile.gettempdir()) / f"gaga-{name}.lock", timeout=_PATIENCE_S):
            yield
        return
    folder, end = os.open(target, os.O_RDONLY), time.monotonic() + _PATIENCE_S
    try:
        while not _try_lock(folder):
            if time.monotonic() > end:
                raise GagaError(f"Another program keeps writing to {target}. Stop it.")
            time.sleep(_POLL_S)
        yield
    finally:
        os.close(folder)


def _try_lock(folder: int) -> bool:
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP):
            raise
        _LOG.info("this disk knows no locks: %s", error)
    return True


def _read_plan(plan: Path) -> list[str]:
    """The names of a plan; ``GagaError`` when one leads out of the folder, or a link next to it."""
    for path in (plan.parent, *plan.parent.rglob("*")):
        refuse_links(path, plan.parent.parent)
    names = read_json(plan, list[PathText], "", most_bytes=_MOST_BYTES)
    for name in names:
        parts = PurePath(name).parts
        if not parts or PurePath(name).anchor or ".." in parts:
            raise GagaError(f"{plan} names {name!r}, which is not in its folder.")
    return names


def _move(staging: Path, names: Iterable[str], target: Path) -> None:
    for name in names:
        if (staging / name).exists():  # else it was moved before the program was killed
            _publish(staging, name, target)


def _publish(staging: Path, name: str, target: Path) -> None:
    """Move one file or folder; an old folder is set aside first and put back on failure."""
    new, old = staging / name, target / name
    refuse_links(old.parent, target)
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
