"""The user's folder for what can be made again."""

import os
from pathlib import Path


def user_cache() -> Path:
    """Folder for what can be made again: compiled kernels, what is known of the machine."""
    if os.name == "nt":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "gaga-studio"
