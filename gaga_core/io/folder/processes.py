"""Child processes: each ends with its parent, and its output is followed line by line."""

import ctypes
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import AnyStr

# --- A child process ends when its parent ends, even by a crash.


_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_SYNCHRONIZE, _INFINITE = 0x00100000, 0xFFFFFFFF  # of the Windows API: winnt.h, winbase.h


def end_with_parent() -> None:
    """Make this process end when the one that started it does; called by workers at their start.

    On Linux the kernel sends SIGKILL, whatever the process is busy with; elsewhere a thread waits
    for the parent's end, as far as the interpreter lets it run.
    """
    parent = os.getppid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it ended before the kernel knew
            os._exit(1)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    if sys.platform == "win32":  # the number of the parent stays when it has ended
        kernel = ctypes.windll.kernel32
        kernel.OpenProcess.restype = ctypes.c_void_p
        handle = ctypes.c_void_p(kernel.OpenProcess(_SYNCHRONIZE, False, parent))
        kernel.WaitForSingleObject(handle, _INFINITE)  # returns at once where there is none
    else:
        while os.getppid() == parent:
            time.sleep(1)
    os._exit(1)


# --- Follow the output of a program line by line; it is ended when the caller stops reading.


_SECONDS = 0.2  # between two looks when the program says nothing
_GRACE = 3.0  # seconds that a program gets to end by itself
_MOST_AHEAD = 64  # lines or blocks that wait for the caller
_MOMENT = 0.01  # seconds


def follow(
    command: Sequence[str], environment: Mapping[str, str] | None = None
) -> Generator[str, None, int]:
    """Run ``command`` and yield the lines that it prints, "" when it says nothing for a moment.

    Returns its exit status. Lines of standard output and standard error come as they are written.
    Closing the generator ends the program. Raises ``OSError`` when it cannot be started.
    """
    process = subprocess.Popen(
        list(command),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        env=environment,
    )
    assert process.stdout is not None
    return (yield from _followed(process, (line.strip() for line in process.stdout), ""))


def follow_blocks(command: Sequence[str], n_bytes: int) -> Generator[bytes, None, int]:
    """As `follow`, for standard output in blocks of ``n_bytes``; b"" when it says nothing.

    An incomplete last block is left out.
    """
    process = subprocess.Popen(
        list(command),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert process.stdout is not None
    blocks = iter(partial(process.stdout.read, n_bytes), b"")
    whole = (block for block in blocks if len(block) == n_bytes)
    return (yield from _followed(process, whole, b""))


def _followed(
    process: subprocess.Popen[AnyStr], pieces: Iterator[AnyStr], nothing: AnyStr
) -> Generator[AnyStr, None, int]:
    told: queue.Queue[AnyStr | None] = queue.Queue(_MOST_AHEAD)

    def read() -> None:
        for piece in pieces:
            told.put(piece)
        told.put(None)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        while True:
            try:
                piece = told.get(timeout=_SECONDS)
            except queue.Empty:
                yield nothing
                continue
            if piece is None:
                return process.wait()
            yield piece
    finally:
        _end(process)
        while reader.is_alive():  # it may wait for a place
            with suppress(queue.Empty):
                told.get(timeout=_MOMENT)
        if process.stdout is not None:
            process.stdout.close()


def _end(process: subprocess.Popen[AnyStr]) -> None:
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
