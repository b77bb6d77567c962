"""Settings kept between runs: recent files and preferences."""

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, cast, get_type_hints

import msgspec

from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, set_aside
from gaga_core.io.json_file import read_json
from gaga_core.scene.edits.history import DEFAULT_BUDGET
from gaga_studio.system import paths

_LOG = logging.getLogger(__name__)
_MOST_RECENT = 10
_MOST_PATHS = {"recent": _MOST_RECENT, "upright": 100, "as_filed": 100}  # in a setting
PRESETS = ("robust", "paper", "released")
DEFAULT_BACKGROUND = "#1c1c1f"  # of the dark theme; also: that none was chosen
_LIGHT_BACKGROUND = "#e6e8ec"  # around the picture in the light theme (`theme.BACK`)
# What else than a number or a text of the right kind a setting must be.
RANGES: Mapping[str, tuple[float, float]] = {
    "fly_speed": (0.1, 5.0),
    "ui_scale": (0.7, 2.0),
    "font_size": (8.0, 40.0),
    "autosave_minutes": (0.25, 30.0),
    "undo_megabytes": (64.0, 65536.0),
    "lod_millions": (0.25, 16.0),
}
_Theme = Annotated[str, msgspec.Meta(pattern="^(dark|light)$")]
_Keys = Annotated[str, msgspec.Meta(pattern="^(supersplat|blender)$")]
_Preset = Annotated[str, msgspec.Meta(pattern="^(robust|paper|released)$")]
_Identities = Annotated[str, msgspec.Meta(pattern="^(preset|none|vote|refine|paper)$")]
_HexColor = Annotated[str, msgspec.Meta(pattern="^#[0-9a-fA-F]{6}$")]
_Address = Annotated[str, msgspec.Meta(pattern=r"^(|https?://\S{1,300})$")]


@dataclass(frozen=True)
class Settings:
    """Preferences, one line each; saved as JSON under the same names."""

    recent: tuple[str, ...] = ()  # paths, newest first
    upright: tuple[str, ...] = ()  # paths of files that are turned when they are opened
    as_filed: tuple[str, ...] = ()  # paths of such files that stand as they should
    preset: _Preset = "robust"  # of the association
    identities: _Identities = "preset"  # made after it: preset = as the preset has it
    fly_speed: float = 1.0  # 1 crosses the scene in about four seconds
    ui_scale: float = 1.0  # times what the screen asks for
    font_size: float = field(default=15.0)  # pixels at 96 dpi
    invert_zoom: bool = False
    theme: _Theme = "dark"  # or "light"
    keys: _Keys = "supersplat"  # or "blender": the profile of shortcuts
    background: _HexColor = DEFAULT_BACKGROUND  # behind the picture, as in HTML
    clean_first: bool = False  # clean objects before they are isolated, deleted, exported
    children_go_along: bool = True  # what lies under an object, when that is moved, deleted, ...
    autosave_minutes: float = 1.0  # at most this much work is lost in a crash
    undo_megabytes: float = DEFAULT_BUDGET / 1e6  # what undo may hold
    lod_millions: float = 2.0  # splats in the picture of a scene with level of detail
    first_steps_done: bool = False  # the card of five steps is hidden
    steps_done: tuple[str, ...] = ()  # of these five, in any run of the program
    hub_mirror: _Address = (
        ""  # address of a mirror of the hub of models; "" = HF_ENDPOINT or the hub
    )
    works_offline: bool = False  # no hub is ever asked
    folds_background: bool = True  # in the object list
    turns_in_training: bool = True  # the picture, slowly, until it is moved by hand in one
    inpainting_model: str = ""  # file of the model that colors filled holes; "" = none does
    click_model: str = ""  # that clicks of the tool Object ask; "" = the first here, "none" = none

    @property
    def background_color(self) -> tuple[float, float, float]:
        """``background``, or that of the light theme where none was chosen, as red, green, blue in
        0..1; black when it is none."""
        is_light = self.background == DEFAULT_BACKGROUND and self.theme == "light"
        color = _LIGHT_BACKGROUND if is_light else self.background
        try:
            r, g, b = bytes.fromhex(color.removeprefix("#"))
        except ValueError:
            return 0.0, 0.0, 0.0
        return r / 255, g / 255, b / 255

    @property
    def undo_bytes(self) -> int:
        """``undo_megabytes`` in bytes."""
        return int(self.undo_megabytes * 1e6)

    @property
    def lod_budget(self) -> int:
        """``lod_millions`` as a number of splats."""
        return int(self.lod_millions * 1e6)

    def opened(self, path: Path, former: Path | None = None) -> "Settings":
        """These settings with ``path`` as the newest recent file, in place of ``former``."""
        name = str(path.resolve())
        gone = {name} if former is None else {name, str(former.resolve())}
        others = [p for p in self.recent if p not in gone]
        return replace(self, recent=(name, *others)[:_MOST_RECENT])


_TYPES = get_type_hints(Settings, include_extras=True)


def hex_color(rgb: Sequence[float]) -> str:
    """Red, green, blue in 0..1 as HTML writes them: "#1c1c1f"."""
    return "#" + bytes(round(255 * min(max(float(c), 0.0), 1.0)) for c in rgb[:3]).hex()


def settings_file() -> Path:
    """Return the path of the settings file."""
    return paths.home() / "settings.json"


def load_settings() -> tuple[Settings, str]:
    """The saved settings, and a sentence for the user when they could not be read (else empty).

    Names that are unknown and values of another kind fall back to the defaults; a file that is no
    JSON is set aside next to itself.
    """
    path = settings_file()
    if not path.exists():
        return Settings(), ""
    try:
        content = read_json(path, dict[str, object], "")
    except GagaError as error:
        _LOG.warning("settings: %s", error)
        aside = set_aside(path)
        where = f" and were set aside as {aside.name}" if aside is not None else ""
        return Settings(), f"The settings in {path} are damaged{where}; the defaults are used."
    return _checked(content), ""


def save_settings(settings: Settings, before: Settings | None = None) -> None:
    """Write the settings, whole or not at all. Raises ``GagaError`` when they cannot be written.

    With ``before`` only what changed from it: another window may have saved the rest meanwhile.
    """
    if before is not None and settings_file().exists():
        settings = _merged(before, settings, load_settings()[0])
    with atomic_write(settings_file()) as temporary:
        temporary.write_text(json.dumps(asdict(settings), indent=1) + "\n", encoding="utf-8")


def _merged(before: Settings, after: Settings, saved: Settings) -> Settings:
    """``saved`` with what changed from ``before`` to ``after``; lists with the paths of both."""
    changes: dict[str, object] = {}
    for name in (item.name for item in fields(Settings)):
        was, now, there = (getattr(one, name) for one in (before, after, saved))
        if was == now:
            continue
        if name in _MOST_PATHS:
            removed = set(was) - set(now)
            now = (*now, *(path for path in there if path not in {*now, *removed}))
            now = now[: _MOST_PATHS[name]]
        changes[name] = now
    return replace(saved, **changes)  # type: ignore[arg-type]


def _checked(content: dict[str, object]) -> Settings:
    defaults = Settings()
    values: dict[str, object] = {}
    for item in fields(Settings):
        value = content.get(item.name)
        if item.name in _MOST_PATHS and isinstance(value, list):
            paths_of = [path for path in value if isinstance(path, str)]
            value = paths_of[: _MOST_PATHS[item.name]]
        if item.name in content and is_known(item.name, value):
            values[item.name] = msgspec.convert(value, _TYPES[item.name])
        if item.name in RANGES and item.name in values:
            default = getattr(defaults, item.name)
            values[item.name] = _in_range(item.name, cast(float, values[item.name]), default)
    return replace(defaults, **values)  # type: ignore[arg-type]  # kinds are checked above


def _in_range(name: str, value: float, default: float) -> float:
    """A number that is too small or large becomes the nearest; none at all, the default."""
    low, high = RANGES[name]
    return min(max(value, low), high) if value > 0 and math.isfinite(value) else default


def is_known(name: str, value: object) -> bool:
    """Whether ``value`` is one that the setting ``name`` can have; numbers of any size can."""
    try:
        msgspec.convert(value, _TYPES[name])
    except ValueError:
        return False
    return True
