"""Child processes: each ends with its parent, and its output is followed line by line."""

import ctypes
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Mapping, Sequence

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
    lines: queue.Queue[str | None] = queue.Queue()
    reader = threading.Thread(target=_read, args=(process, lines), daemon=True)
    reader.start()
    try:
        while True:
            try:
                line = lines.get(timeout=_SECONDS)
            except queue.Empty:
                yield ""
                continue
            if line is None:
                return process.wait()
            yield line
    finally:
        _end(process)
        reader.join()
        if process.stdout is not None:
            process.stdout.close()


def _read(process: subprocess.Popen[str], lines: queue.Queue[str | None]) -> None:
    if process.stdout is not None:
        for line in process.stdout:
            lines.put(line.strip())
    lines.put(None)


def _end(process: subprocess.Popen[str]) -> None:
    if process.poll() is not None:
        return
    process.terminate()
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
