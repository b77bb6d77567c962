"""Where shaders, fonts and the parts of a web page lie."""

from pathlib import Path


def assets() -> Path:
    """The folder of shaders, fonts and web pages: in the wheel, or in the checkout."""
    here = Path(__file__).resolve().parent
    inside = here / "assets"
    return inside if inside.is_dir() else here.parent / "assets"
