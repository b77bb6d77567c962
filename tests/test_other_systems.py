"""What Windows lacks is not asked for when a module is imported."""

import subprocess
import sys

_CHILD = """
import importlib, os, pkgutil, sys
import numba, PIL.Image, scipy.spatial, torch
for name in ("fcntl", "resource", "termios", "pwd"):
    sys.modules[name] = None
for name in ("sysconf", "killpg", "sched_getaffinity", "fork"):
    delattr(os, name)
import gaga_core
for found in pkgutil.walk_packages(gaga_core.__path__, "gaga_core."):
    if not found.name.endswith("__main__"):
        importlib.import_module(found.name)
"""


def test_every_module_is_imported_without_what_windows_lacks() -> None:
    child = [sys.executable, "-c", _CHILD]
    done = subprocess.run(child, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
