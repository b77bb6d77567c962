"""What the program remembers between runs: recent files and preferences."""

import json
import logging
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

from gaga_core.io.files import atomic_write
from gaga_studio import paths

_LOG = logging.getLogger(__name__)
_MOST_RECENT = 10


@dataclass(frozen=True)
class Settings:
    """Preferences, one line each; saved as JSON under the same names."""

    recent: tuple[str, ...] = ()  # paths, newest first
    preset: str = "robust"  # of the association
    fly_speed: float = 1.0  # 1 crosses the scene in about four seconds
    ui_scale: float = 1.0  # times what the screen asks for
    font_size: float = field(default=15.0)  # pixels at 96 dpi
    invert_zoom: bool = False
    theme: str = "dark"  # or "light"
    keys: str = "supersplat"  # or "blender": the profile of shortcuts
    clean_first: bool = False  # clean objects before they are isolated, deleted, exported

    def opened(self, path: Path) -> "Settings":
        """These settings with ``path`` as the newest recent file."""
        name = str(path.resolve())
        others = [p for p in self.recent if p != name]
        return replace(self, recent=(name, *others)[:_MOST_RECENT])

    def forgotten(self, path: Path) -> "Settings":
        """These settings without a recent file that is gone."""
        names = {str(path), str(path.resolve())}
        return replace(self, recent=tuple(p for p in self.recent if p not in names))


def settings_file() -> Path:
    """Where the settings are kept."""
    return paths.home() / "settings.json"


def load_settings() -> tuple[Settings, str]:
    """The saved settings, and a sentence for the user when they could not be read (else empty).

    Names that are unknown and values of another kind fall back to the defaults.
    """
    path = settings_file()
    if not path.exists():
        return Settings(), ""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        _LOG.warning("settings %s: %s", path, error)
        return Settings(), f"The settings in {path} cannot be read; the defaults are used."
    if not isinstance(content, dict):
        return Settings(), f"The settings in {path} are not a list of settings; defaults are used."
    return _checked(content), ""


def save_settings(settings: Settings) -> None:
    """Write the settings, whole or not at all. Raises ``GagaError`` when the disk says no."""
    with atomic_write(settings_file()) as temporary:
        temporary.write_text(json.dumps(asdict(settings), indent=1) + "\n", encoding="utf-8")


def _checked(content: dict[str, object]) -> Settings:
    defaults = Settings()
    values: dict[str, object] = {}
    for item in fields(Settings):
        value = content.get(item.name)
        default = getattr(defaults, item.name)
        if isinstance(default, tuple) and isinstance(value, list):
            values[item.name] = tuple(v for v in value if isinstance(v, str))[:_MOST_RECENT]
        elif isinstance(default, float) and isinstance(value, int | float):
            # A bool is an int: harmless here, but no number of these may be 0 or less.
            values[item.name] = float(value) if value > 0 else default
        elif type(value) is type(default):
            values[item.name] = value
    return replace(defaults, **values)  # type: ignore[arg-type]  # kinds are checked above
