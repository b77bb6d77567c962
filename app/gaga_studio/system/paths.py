"""Where things lie on disk: our assets, the user's settings, the demo scene."""

import os
from pathlib import Path


def assets() -> Path:
    """The folder of shaders, fonts and icons: in the wheel, or in the checkout."""
    here = Path(__file__).resolve().parents[1]
    inside = here / "assets"
    return inside if inside.is_dir() else here.parents[1] / "assets"


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
    """Where the demo scene is made on first use."""
    return home() / "demo"
