"""Programs of others that tests compare with: ``make peers`` installs them with npm."""

import shutil
from pathlib import Path

_FOLDER = Path(__file__).resolve().parents[1] / ".peers" / "node_modules"


def node_tool(path: str) -> list[str] | None:
    """The command for a script of an npm package; None where Node or the package is missing."""
    node, script = shutil.which("node"), _FOLDER / path
    return [node, str(script)] if node is not None and script.is_file() else None
