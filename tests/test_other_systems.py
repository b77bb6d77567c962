"""What Windows lacks is not asked for when a module is imported, of the program or of the tests."""

import subprocess
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[1]

_CHILD = """
import importlib, multiprocessing, os, signal, sys
from multiprocessing import context, reduction
from pathlib import Path
import asyncio, dask.distributed, numba, PIL.Image, psutil, pytest, scipy.spatial, torch
for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios"):
    sys.modules[name] = None
for name in ("fork", "getuid", "killpg", "mkfifo", "sched_getaffinity", "setsid", "sysconf"):
    delattr(os, name)
for name in ("SIGALRM", "SIGKILL", "SIGSTOP", "SIGUSR1", "SIGXFSZ"):
    delattr(signal, name)
for name in ("ForkContext", "ForkProcess", "ForkServerContext", "ForkServerProcess"):
    delattr(context, name)
reduction.HAVE_SEND_HANDLE = False  # what a fork server needs
for name in ("fork", "forkserver"):
    del context._concrete_contexts[name]
failed = []
for folder, package in (("gaga_core",) * 2, ("app/gaga_studio", "gaga_studio"), ("tests",) * 2):
    for file in sorted(Path(folder).rglob("*.py")):
        parts = file.relative_to(folder).with_suffix("").parts
        if parts[-1] == "__main__":
            continue
        name = ".".join((package, *parts)).removesuffix(".__init__")
        try:
            importlib.import_module(name)
        except (Exception, pytest.skip.Exception) as error:
            if not isinstance(error, pytest.skip.Exception):
                failed.append(f"{name}: {type(error).__name__}: {error}")
sys.exit("\\n".join(failed) or 0)
"""


def test_every_module_is_imported_without_what_windows_lacks() -> None:
    """Those of the program and those of the tests, which must be collected there."""
    child = [sys.executable, "-c", _CHILD]
    done = subprocess.run(child, cwd=_ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
