"""Shows a file in the file manager of the system."""

import shutil
import subprocess
import sys
from pathlib import Path

from gaga_core.errors import GagaError


def show(path: Path) -> None:
    """Open the folder of ``path`` with the file in sight; ``GagaError`` where nothing can."""
    path = path.absolute()
    folder = path if path.is_dir() else path.parent
    if not folder.is_dir():
        raise GagaError(f"{folder} is not there any more.")
    command = _command(path, folder)
    if shutil.which(command[0]) is None:
        raise GagaError(f"No file manager was found. The folder is {folder}.")
    subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _command(path: Path, folder: Path) -> list[str]:
    if sys.platform == "win32":
        return ["explorer", f"/select,{path}"]
    if sys.platform == "darwin":
        return ["open", "-R", str(path)]
    return ["xdg-open", str(folder)]
