"""Where things lie on disk: the user's settings, the demo scene."""

import os
import re
from pathlib import Path


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
