"""Writing files so that a failure loses nothing."""

import errno
import hashlib
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import numpy as np

from gaga_core.errors import GagaError

_LOG = logging.getLogger(__name__)
_BLOCKS, _BLOCK = 64, 1 << 16  # a fingerprint samples this many blocks of this many bytes


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary path next to ``path`` to write to; it replaces ``path`` when the block ends well.

    On any error (also a cancel) the temporary file is removed and ``path`` is as it was. A full
    disk or missing permission is raised as ``GagaError``.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{uuid4().hex[:8]}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    try:
        yield temporary
        os.replace(temporary, path)  # noqa: PTH105  atomic on every system
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def set_aside(path: Path) -> Path | None:
    """Rename a damaged file to ``NAME.damaged`` next to itself, so that a new one can be written.

    A former one of that name is replaced. Returns the new path; None when the place refuses it.
    """
    aside = path.with_name(f"{path.name}.damaged")
    try:
        os.replace(path, aside)  # noqa: PTH105  replaces on every system
    except OSError as error:
        _LOG.warning("%s cannot be set aside: %s", path, error)
        return None
    return aside


def fingerprint(path: Path) -> str:
    """Digest of a file's size and of blocks all over it: quick also for gigabytes.

    Raises ``GagaError`` when the file cannot be read.
    """
    try:
        size = path.stat().st_size
        digest = hashlib.sha256(str(size).encode())
        with path.open("rb") as file:
            for start in np.linspace(0, max(size - _BLOCK, 0), _BLOCKS).astype(np.int64):
                file.seek(int(start))
                digest.update(file.read(_BLOCK))
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return digest.hexdigest()


def explain_os_error(error: OSError, path: Path) -> str:
    """One sentence about why ``path`` could not be written or read."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return f"The disk is full: {path} was not written. Free some space, or choose another disk."
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"There is no permission to use {path}. Choose another place."
    if error.errno == errno.EISDIR:
        return f"{path} is a folder. Choose a file name."
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        return f"{path} does not exist. Check the path."
    return f"{path} cannot be used: {error.strerror or error}."
