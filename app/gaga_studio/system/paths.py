"""Paths on disk: settings, demo scene, log; and showing a file in the file manager."""

import hashlib
import logging
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from contextlib import suppress
from logging.handlers import RotatingFileHandler
from pathlib import Path

from gaga_core.errors import GagaError, PlainFormatter


def home() -> Path:
    """The user's folder for settings, recovery files and the demo scene (``GAGA_HOME`` wins)."""
    chosen = os.environ.get("GAGA_HOME")
    if chosen:
        return Path(chosen)
    if os.name == "nt":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
        return Path(base) / "gaga-studio"
    base = os.environ.get("XDG_DATA_HOME") or str(Path.home() / ".local" / "share")
    return Path(base) / "gaga-studio"


def demo_scene() -> Path:
    """Where the demo scene is copied to on first use."""
    return home() / "demo"


def picture_of(opened: str) -> Path:
    """Where the small picture of what was open lately is kept; ``opened``: its path."""
    name = hashlib.sha256(opened.encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return home() / "recent" / f"{name}.jpg"


def forget_pictures(kept: Iterable[str]) -> None:
    """Remove the small pictures of all that is not in ``kept``, the paths that the list has."""
    names = {picture_of(opened).name for opened in kept}
    for file in (home() / "recent").glob("*.jpg"):
        if file.name not in names:
            with suppress(OSError):  # it is tried again with the next one
                file.unlink()


def exports() -> Path:
    """A folder that a person finds again, for what is exported from a scene of our own."""
    chosen = os.environ.get("GAGA_HOME")
    if chosen:
        return Path(chosen) / "exports"
    documents = _documents()
    return (documents if documents.is_dir() else Path.home()) / "gaga-studio"


def _documents() -> Path:
    """The user's folder of documents, as the desktop calls it (XDG user directories)."""
    named = Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "user-dirs.dirs"
    try:
        text = named.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        text = ""  # there is no such file on most systems
    found = re.search(r'^XDG_DOCUMENTS_DIR="(.+)"', text, re.MULTILINE)
    if found is None:
        return Path.home() / "Documents"
    return Path(found[1].replace("$HOME", str(Path.home())))


def shown(path: Path) -> str:
    """``path`` as people write it: ``~`` for their own folder."""
    home = Path.home()
    inside = path.is_relative_to(home) and path != home
    return str(Path("~") / path.relative_to(home)) if inside else str(path)


# --- The log file: errors in full, for developers.

_MOST_BYTES = 1 << 20


def log_file() -> Path:
    """Where the log is."""
    return home() / "log.txt"


def failure(place: str) -> str:
    """The sentence on an error of the program in ``place``, which the log tells in full."""
    return f"Something went wrong in {place}; the details are in the log file {shown(log_file())}."


def start_log() -> Path | None:
    """Write warnings and errors to the log file from now on; None when it cannot be written."""
    path = log_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = RotatingFileHandler(path, maxBytes=_MOST_BYTES, backupCount=1, encoding="utf-8")
    except OSError:
        return None
    handler.setFormatter(PlainFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.setLevel(logging.WARNING)
    logging.getLogger().addHandler(handler)
    return path


# --- Show a file in the file manager of the system.


def show(path: Path) -> None:
    """Open the folder of ``path`` with the file in sight; ``GagaError`` where nothing can."""
    path = path.absolute()
    folder = path if path.is_dir() else path.parent
    if not folder.is_dir():
        raise GagaError(f"{folder} no longer exists.")
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
