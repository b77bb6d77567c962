"""Small and read-only disks: a file system in memory that only the process sees which mounts it.

Only a process of one thread may do so: what starts threads (numpy's BLAS) is imported afterwards.
"""

import ctypes
import errno
import os
import shutil
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from gaga_core.errors import GagaError

if TYPE_CHECKING:
    from tests.faults.programs import Version

_NEWNS, _NEWUSER = 0x00020000, 0x10000000  # linux/sched.h
_READ_ONLY, _REMOUNT = 1, 32  # linux/mount.h


def _mounted(place: Path, options: str, flags: int = 0) -> None:
    """Mount a file system in memory; ``OSError`` where that is not allowed."""
    libc = ctypes.CDLL(None, use_errno=True)
    arguments = (b"tmpfs", str(place).encode(), b"tmpfs", flags, options.encode())
    if libc.mount(*arguments):
        raise OSError(ctypes.get_errno(), "mount")


def _own_mounts() -> None:
    """Let this process mount what no other one sees; ``OSError`` where that is not allowed."""
    if sys.platform != "linux":
        raise OSError(errno.ENOTSUP, "mounts of a process")
    libc, user, group = ctypes.CDLL(None, use_errno=True), os.getuid(), os.getgid()
    if libc.unshare(_NEWNS | _NEWUSER):
        raise OSError(ctypes.get_errno(), "unshare")
    Path("/proc/self/setgroups").write_text("deny")
    Path("/proc/self/uid_map").write_text(f"0 {user} 1")
    Path("/proc/self/gid_map").write_text(f"0 {group} 1")


def _copied(made: Path, place: Path, said: Connection) -> Path | None:
    """A copy of ``made`` on a disk of 256 MiB; None, and "cannot" said, where none is mounted."""
    try:
        _own_mounts()
        _mounted(place, "size=256m")
    except OSError as error:
        if error.errno == errno.EINVAL:  # it has threads
            raise
        said.send(("cannot", str(error)))
        return None
    root = place / "it"
    os.environ["GAGA_HOME"] = str(root / "home")
    return Path(shutil.copytree(made, root))


def run_on_a_disk(
    name: str, made: Path, place: Path, kind: str, version: "Version", said: Connection
) -> None:
    """Run a program in a copy of ``made`` on a disk that is "full" or "read-only".

    Says "cannot" where no disk can be mounted, else: the sentence, the result before and after it,
    and the files that are there then but were not there before.
    """
    root = _copied(made, place, said)
    if root is None:
        return
    from tests.faults.programs import PROGRAMS, finish

    program = PROGRAMS[name]
    before, files = program.result(root), set(root.rglob("*"))
    if kind == "full":
        _fill(place)
    else:
        _mounted(place, "size=256m", _REMOUNT | _READ_ONLY)
    sentence = ""
    try:
        program.run(root, version)
    except GagaError as error:
        sentence = str(error)
    finish(root)
    stray = sorted(str(path.relative_to(root)) for path in set(root.rglob("*")) - files)
    said.send(("done", sentence, before, program.result(root), stray))


def download_on_a_disk(made: Path, place: Path, said: Connection) -> None:
    """Download a model to a disk that gets full midway, and once more when there is room again.

    Says "cannot" where no disk can be mounted, else: the sentence, the bytes that were kept, and
    the bytes that the second try fetched.
    """
    root = _copied(made, place, said)
    if root is None:
        return
    from gaga_core.progress import run_stage
    from tests.faults.programs import PROGRAMS, download_stage

    kept, sentence = PROGRAMS["model"].opens, ""
    stage = download_stage(root)
    while not kept(root):
        next(stage)
    _fill(place)
    try:
        run_stage(stage)
    except GagaError as error:
        sentence = str(error)
    n_kept = kept(root)
    (place / "full").unlink()
    said.send(("done", sentence, n_kept, run_stage(download_stage(root)).n_bytes))


def _fill(place: Path) -> None:
    """Leave room for 4 kB."""
    block = bytes(4096)
    with (place / "full").open("wb", buffering=0) as file:
        try:
            while True:
                file.write(block)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
        file.truncate(file.tell() - len(block))
