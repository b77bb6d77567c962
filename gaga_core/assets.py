"""Where shaders, fonts, the parts of a web page and the demo scene lie."""

from pathlib import Path


def assets() -> Path:
    """The folder of shaders, fonts, web pages and the demo: in the wheel, or in the checkout."""
    here = Path(__file__).resolve().parent
    inside = here / "assets"
    return inside if inside.is_dir() else here.parent / "assets"
