"""One writer a folder: a lock that ends with its program, and the name of who holds it."""

import getpass
import os
import socket
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
from filelock import FileLock, Timeout

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error, refuse_links
from gaga_core.io.json_file import read_json

LOCK, OWNER = ".gaga.lock", ".gaga.owner.json"
_POLL_S = 0.02
_CLOCK_S = 60.0  # a clock that is put right meanwhile is, most often, put right by less


class Owner(msgspec.Struct, frozen=True):
    """The writer of a folder."""

    program: str
    user: str
    host: str
    pid: int

    def __str__(self) -> str:
        return f"{self.program} of {self.user} on {self.host} (process {self.pid})"


class InUseError(GagaError):
    """Another program writes to the folder."""

    def __init__(self, folder: Path, owner: Owner | None) -> None:
        super().__init__(
            f"{folder} is open in {owner or 'another program'}. Close it there, or save elsewhere."
        )
        self.owner = owner


@dataclass
class _Held:
    lock: FileLock
    users: int


_held: dict[Path, _Held] = {}
_guard = threading.Lock()


class FolderLock:
    """Writing to ``folder`` is this program's until `release`; several in one program share it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._is_held = True

    def release(self) -> None:
        """Let other programs write. The lock file stays: removing it would let two in."""
        with _guard:
            if not self._is_held:
                return
            self._is_held = False
            held = _held[self.folder]
            held.users -= 1
            if held.users == 0:
                del _held[self.folder]
                with suppress(OSError):  # it is only a name, and someone may have made it a folder
                    (self.folder / OWNER).unlink()
                held.lock.release()

    def __enter__(self) -> "FolderLock":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


def lock_folder(folder: Path, *, patience_s: float = 0.0) -> FolderLock:
    """Make this program the only one that writes to ``folder``, which is made if it is not there.

    A program that ended, even by a crash, holds nothing. Raises ``InUseError`` when another one
    still holds the folder after ``patience_s`` seconds, ``GagaError`` when the place cannot be
    written, or a link leads out of it.
    """
    refuse_links(folder)
    refuse_links(folder / LOCK, folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        key = folder.resolve()
        with _guard:
            if key in _held:
                _held[key].users += 1
                return FolderLock(key)
            lock = FileLock(key / LOCK, thread_local=False)
            lock.acquire(timeout=patience_s, poll_interval=_POLL_S)
            _held[key] = _Held(lock, 1)
    except Timeout as error:
        raise InUseError(folder, owner_of(folder)) from error
    except OSError as error:
        raise GagaError(explain_os_error(error, folder)) from error
    mine = FolderLock(key)
    try:
        note_owner(key)
    except GagaError:  # the disk is full: the lock alone keeps others out
        mine.release()
        raise
    return mine


def owner_of(folder: Path) -> Owner | None:
    """The last known writer of the folder; None when it is not known."""
    file = folder / OWNER
    if not file.is_file():
        return None
    try:
        return read_json(file, Owner, "")
    except GagaError:  # just released, or damaged: the lock counts, this is only its name
        return None


def _me() -> Owner:
    try:
        user = getpass.getuser()
    except (OSError, KeyError, ImportError):  # no name for this number of a user
        user = str(os.getuid()) if hasattr(os, "getuid") else "someone"
    return Owner(Path(sys.argv[0]).name or "python", user, socket.gethostname(), os.getpid())


def note_owner(folder: Path) -> None:
    """Say in ``folder`` that this program works there, for `working_in`."""
    with atomic_write(folder / OWNER) as temporary:
        temporary.write_bytes(msgspec.json.encode(_me()))


def working_in(folder: Path) -> Owner | None:
    """The other program of this machine that said it works in ``folder``, while it runs."""
    owner, me = owner_of(folder), _me()
    if owner is None or owner.host != me.host or owner.pid == me.pid:
        return None
    with suppress(OSError):  # it has just ended
        return owner if is_running(owner.pid, (folder / OWNER).stat().st_mtime) else None
    return None


def forget_owner(folder: Path) -> None:
    """Take back what `note_owner` said."""
    if owner_of(folder) == _me():
        with suppress(OSError):  # a disk that cannot be written
            (folder / OWNER).unlink()


def is_running(pid: int, noted_at: float) -> bool:
    """Whether the program runs that wrote its number ``pid`` at ``noted_at`` (seconds since the
    epoch). On Linux one that has ended and waits for its parent, or that began later and was given
    the same number, after a restart of the machine say, does not count."""
    if pid == os.getpid():
        return True
    if sys.platform == "win32":
        import ctypes

        handle = ctypes.windll.kernel32.OpenProcess(0x1000, False, pid)
        if handle:
            ctypes.windll.kernel32.CloseHandle(handle)
        return bool(handle)
    with suppress(OSError, ValueError, StopIteration):  # another system
        words = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
        state, *_, ticks = words.rpartition(")")[2].split()[:20]
        began_at = _booted_at() + int(ticks) / os.sysconf("SC_CLK_TCK")
        if state in "ZX" or began_at > noted_at + _CLOCK_S:
            return False
    with suppress(ProcessLookupError):
        try:
            os.kill(pid, 0)
        except PermissionError:
            return True
        return True
    return False


def _booted_at() -> float:
    """When a Linux machine was started, seconds since the epoch."""
    lines = Path("/proc/stat").read_text(encoding="ascii").splitlines()
    return float(next(line for line in lines if line.startswith("btime")).split()[1])
