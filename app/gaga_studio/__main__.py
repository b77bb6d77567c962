"""``gaga-studio [PATH] [--demo]``: read the arguments, then open the window.

Nothing heavy is imported before the arguments are understood and a display is known to exist.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from gaga_core.errors import GagaError
from gaga_core.version import __version__

_LIBRARIES = "libgl1 libegl1 libgl1-mesa-dri libx11-6 libxrandr2 libxinerama1 libxcursor1 libxi6"


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line of the window: ``path`` (Path or None) and ``demo`` (bool)."""
    parser = argparse.ArgumentParser(
        prog="gaga-studio",
        description="View and edit a 3D Gaussian Splatting scene, object by object.",
        epilog="The headless command is called gaga.",
    )
    parser.add_argument(
        "path", nargs="?", type=Path, help="a scene folder, a file of splats or a saved project"
    )
    parser.add_argument("--demo", action="store_true", help="open the demo scene")
    parser.add_argument("--version", action="version", version=f"gaga-studio {__version__}")
    return parser.parse_args(arguments)


def display_problem(platform: str, environment: dict[str, str]) -> str:
    """Why no window can be opened here, as a sentence; empty when it can be opened."""
    if not platform.startswith("linux"):
        return ""
    if environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY"):
        return ""
    return (
        "gaga-studio needs a display and found none (DISPLAY and WAYLAND_DISPLAY are unset). "
        "Start it from a desktop session, or use the command gaga, which needs no window."
    )


def library_problem(error: ImportError) -> str:
    """A missing system library as a sentence that names what to install."""
    return (
        f"gaga-studio cannot load a library that it needs ({error}). "
        f"On Debian or Ubuntu run: sudo apt-get install {_LIBRARIES}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Open the window; the exit status is 0 only if it opened."""
    chosen = parse(arguments)
    problem = display_problem(sys.platform, dict(os.environ))
    if problem:
        sys.stderr.write(problem + "\n")
        return 1
    try:
        from gaga_studio.studio import Studio
    except ImportError as error:
        if "lib" not in str(error):
            raise
        sys.stderr.write(library_problem(error) + "\n")
        return 1
    try:
        Studio(path=chosen.path, demo=chosen.demo).run()
    except GagaError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
