"""Files: written so that a failure loses nothing, compared, and the paths of our assets."""

import errno
import hashlib
import logging
import os
import re
import shutil
import stat
import sys
import time
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

import numpy as np

from gaga_core.errors import GagaError

_LOG = logging.getLogger(__name__)
_MOST_NAME = 255  # bytes: what file systems take
_LONGEST = 200  # bytes of a name in that of its temporary file: file systems take 255
# Names of `atomic_write` and `staging_folder`.
_LEFT = re.compile(r"\..+\.[0-9a-f]{8}\.part|\.gaga-[a-z0-9_]{8}")
_OURS = re.compile(r"\.gaga-.+|.+\.gaga")  # folders that only this program makes
_IN_SCENE = ("gaga", "masks")  # those that it makes in a scene, next to one of ...
_SCENE = ("images", "input", "sparse", "colmap", "point_cloud", "point_cloud.ply")  # ... these
_JUNCTION = 0xA0000003  # IO_REPARSE_TAG_MOUNT_POINT of the Windows SDK (winnt.h)
PLAN = "publish.json"  # in a folder of results that are whole, see `staging.publish_all`
_OLD_S = 3600.0
_LONGEST_LIST = 1 << 20  # bytes of a text file of words
_looked_at: set[Path] = set()  # folders that this program has written to
_BLOCKS, _BLOCK = 64, 1 << 16  # a fingerprint samples this many blocks of this many bytes
# What reading a file may take without a look at its size: a picture of 100 megapixels does.
_ALWAYS_GRANTED = 1 << 30  # bytes
_MOST_TIMES_FILE = 50  # SOG, the densest form of real splats, takes 20 times its size in memory
_MEMORY_SHARE = 0.5  # of this machine's
_UNKNOWN_MEMORY = 4 << 30  # bytes, where the system does not say
_WAITS_S = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4)  # between attempts to rename what is in use
_IN_USE = (5, 32)  # ERROR_ACCESS_DENIED and ERROR_SHARING_VIOLATION of the Windows API
_LONG_NAME = 206  # ERROR_FILENAME_EXCED_RANGE: over 260 characters, where Windows is not set up
# What Windows refuses in names; control characters; halves of letters, which macOS refuses.
_REFUSED = re.compile(r'[<>:"/\\|?*\x00-\x1f\x7f\ud800-\udfff]')
_DEVICES = re.compile(r"(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[0-9¹²³])", re.IGNORECASE)


def assets() -> Path:
    """The folder of shaders, fonts, web pages and the demo: in the wheel, or in the checkout."""
    here = Path(__file__).resolve().parents[1]
    inside = here / "assets"
    return inside if inside.is_dir() else here.parent / "assets"


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file; ``GagaError`` where the system cannot say, as of a name of
    thousands of letters that a file gave."""
    try:
        return path.is_file()
    except (OSError, ValueError) as error:
        known = error if isinstance(error, OSError) else OSError(errno.EINVAL, str(error))
        raise GagaError(explain_os_error(known, path)) from error


def open_file(path: Path, buffering: int = -1) -> BinaryIO:
    """Open a file to read its bytes. Raises ``OSError``, for a pipe or a device, too.

    Opening a pipe would wait until somebody writes to it.
    """
    mode = path.stat().st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OSError(errno.EINVAL, "it is no regular file")
    return path.open("rb", buffering=buffering)


def check_memory(path: Path, n_bytes: float, what: str, n_stored: int = 0) -> None:
    """Raise ``GagaError`` when reading ``path`` would take too much memory; call it before.

    ``n_bytes``: the most that reading takes at a time, computed from the file's header; ``what``
    the file claims to hold ("20,000,000 splats"). Refused: more than half of the machine's memory;
    more than 1 GiB and 50 times the file's size, which no real file needs. ``n_stored``: bytes of
    all files that are read, when ``path`` names others.
    """
    if n_bytes <= _ALWAYS_GRANTED:
        return
    size, memory = n_stored or path.stat().st_size, machine_memory()
    if n_bytes <= min(_MOST_TIMES_FILE * size, _MEMORY_SHARE * memory):
        return
    raise GagaError(
        f"{path} has {_megabytes(size)} and says that it holds {what}: reading it would take "
        f"{_megabytes(n_bytes)} of the {_megabytes(memory)} of memory here. Check where it is from."
    )


def _megabytes(n_bytes: float) -> str:
    return f"{n_bytes / 1e6:,.0f} MB" if n_bytes >= 1e6 else f"{n_bytes:,.0f} bytes"


@cache
def machine_memory() -> int:
    """Bytes of this machine's memory; 4 GiB where the system does not say."""
    if sys.platform == "win32":
        return _windows_memory()
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return _UNKNOWN_MEMORY


def _windows_memory() -> int:
    """``GetPhysicallyInstalledSystemMemory`` of the Windows API."""
    import ctypes

    kilobytes = ctypes.c_ulonglong()
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    is_known = kernel.GetPhysicallyInstalledSystemMemory(ctypes.byref(kilobytes))
    return kilobytes.value * 1024 if is_known else _UNKNOWN_MEMORY


def is_link(path: Path) -> bool:
    """Whether ``path`` is a symbolic link, or a junction of Windows; False where nothing is."""
    try:
        status = path.lstat()
    except (OSError, ValueError):
        return False
    return stat.S_ISLNK(status.st_mode) or getattr(status, "st_reparse_tag", 0) == _JUNCTION


def refuse_links(path: Path, root: Path | None = None) -> None:
    """Raise ``GagaError`` when ``path`` or a step from ``root`` to it is a link.

    To be called before anything behind ``path`` is written, moved or removed: a scene may come from
    anyone, and its links may lead anywhere. Without ``root`` the steps begin at the first folder
    that this program makes, as SCENE/gaga; links on the way there are the user's own.
    """
    path = Path(path).absolute()
    steps = (*reversed(path.parents), path)
    start = path if root is None else root.absolute()
    if root is None:
        start = next((step.parent for step in steps if _is_ours(step)), path)
    for step in steps:
        if step != start and step.is_relative_to(start) and is_link(step):
            raise GagaError(
                f"{step} is a link, which may lead anywhere, so nothing is written behind it. "
                "Put the file or folder itself there."
            )


def _is_ours(folder: Path) -> bool:
    """Whether a folder is one that this program makes: by its name and its neighbours."""
    if folder.name in _IN_SCENE:
        return any((folder.parent / name).exists() for name in _SCENE)
    return _OURS.fullmatch(folder.name) is not None


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary path next to ``path`` to write to; it replaces ``path`` when the block ends well.

    On any error (also a cancel) the temporary file is removed and ``path`` is as it was. A full
    disk or missing permission is raised as ``GagaError``, and so is a link on the way in a folder
    of ours (`refuse_links`). A link at ``path`` itself is replaced, not followed.
    """
    path = Path(path)
    refuse_links(path.parent)
    stem = path.name.encode()[:_LONGEST].decode(errors="ignore")
    temporary = path.with_name(f".{stem}.{uuid4().hex[:8]}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.parent not in _looked_at:  # at this program's first write to the folder
            _looked_at.add(path.parent)
            remove_leftovers(path.parent)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    try:
        yield temporary
        replace_file(temporary, path)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    finally:
        try:
            temporary.unlink(missing_ok=True)
        except OSError as error:  # a read-only disk: what is raised already says more
            _LOG.info("%s was not removed: %s", temporary, error)


def replace_file(source: Path, target: Path) -> None:
    """Rename a file or a folder to ``target``, in place of a file there.

    On Windows a virus scanner or an indexer may have either one open for a moment: it is tried
    again for a second. Raises ``OSError``.
    """
    for wait in _WAITS_S:
        try:
            os.replace(source, target)  # noqa: PTH105  replaces on every system
        except OSError as error:
            if getattr(error, "winerror", 0) not in _IN_USE:
                raise
            time.sleep(wait)
        else:
            return
    os.replace(source, target)  # noqa: PTH105


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all; see `atomic_write`."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove_leftovers(folder: Path) -> int:
    """Remove files and folders that killed programs left in ``folder``; return how many.

    They are ours by their names, and old: nothing wrote to them for an hour. A subfolder is not
    looked into.
    """
    n, limit = 0, time.time() - _OLD_S
    try:
        refuse_links(folder)
        names = [entry.name for entry in os.scandir(folder) if _LEFT.fullmatch(entry.name)]
        for name in names:
            left = folder / name
            if _newest(left) < limit and not (left / PLAN).is_file():
                is_folder = left.is_dir() and not is_link(left)
                shutil.rmtree(left) if is_folder else left.unlink()
                n += 1
    except (OSError, GagaError) as error:  # no permission, or another program was quicker: no harm
        _LOG.info("leftovers in %s: %s", folder, error)
    return n


def _newest(path: Path) -> float:
    """Time of the last change of a file, or of anything in a folder."""
    inside = path.rglob("*") if path.is_dir() and not is_link(path) else ()
    times: list[float] = [item.lstat().st_mtime for item in (path, *inside)]
    return max(times)


def set_aside(path: Path) -> Path | None:
    """Rename a damaged file to ``NAME.damaged`` next to itself, so that a new one can be written.

    A former one of that name is replaced. Returns the new path; None when the place refuses it.
    """
    aside = path.with_name(f"{path.name}.damaged")
    try:
        refuse_links(path.parent)
        replace_file(path, aside)
    except (OSError, GagaError) as error:
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
        with open_file(path) as file:
            for start in np.linspace(0, max(size - _BLOCK, 0), _BLOCKS).astype(np.int64):
                file.seek(int(start))
                digest.update(file.read(_BLOCK))
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    return digest.hexdigest()


def too_long(path: Path) -> str:
    """A sentence where no file can be called ``path``; "" where one can."""
    n = max((len(os.fsencode(part)) for part in path.parts), default=0)
    return f"The name is too long: {n} bytes of {_MOST_NAME} at most." if n > _MOST_NAME else ""


def safe_name(name: str) -> str:
    """``name`` as that of one file on Linux, macOS and Windows; unchanged where it is one.

    Otherwise what a system refuses is left out or a hyphen, and a digest of ``name`` is appended:
    different names stay different. A suffix may follow.
    """
    plain = _REFUSED.sub("-", name).encode()[:_LONGEST].decode(errors="ignore").strip(" .")
    is_device = _DEVICES.fullmatch(plain.partition(".")[0].rstrip()) is not None
    if plain == name != "" and not is_device:
        return name
    digest = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:8]
    short = plain.encode()[: _LONGEST - 10].decode(errors="ignore").strip(" .")
    return f"_{short}-{digest}" if is_device else f"{short}-{digest}"


def same_name(name: str) -> str:
    """Equal for two names that are those of one file where letter case or accents do not count."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def read_names(path: Path) -> list[str]:
    """Words of a text file, one a line."""
    try:
        with open_file(path) as file:
            raw = file.read(_LONGEST_LIST + 1)
        if len(raw) > _LONGEST_LIST:
            raise GagaError(f"{path} has more than {_LONGEST_LIST >> 20} MiB, too much for a list.")
        lines = raw.decode().splitlines()
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except UnicodeDecodeError as error:
        raise GagaError(f"{path} is not a text file. Copy it again.") from error
    return [line.strip() for line in lines if line.strip()]


def explain_os_error(error: OSError, path: Path) -> str:
    """One sentence about why ``path`` could not be written or read."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return f"The disk is full: {path} was not written. Free some space, or choose another disk."
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"There is no permission to use {path}. Choose another place."
    if error.errno == errno.ENAMETOOLONG or getattr(error, "winerror", 0) == _LONG_NAME:
        longest = max(Path(os.fsdecode(error.filename or path)).parts, key=len)
        return f"The name {longest[:40]}… is too long. Choose a shorter one."
    if error.errno == errno.EISDIR:
        return f"{path} is a folder. Choose a file name."
    if error.errno in (errno.ENOENT, errno.ENOTDIR):
        if error.filename is not None and path.exists():
            return f"{os.fsdecode(error.filename)} does not exist. It belongs to {path.name}."
        return f"{path} does not exist. Check the path."
    return f"{path} cannot be used: {error.strerror or error}."
