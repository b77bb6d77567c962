"""One description of a setting, which the command, the stage and the window share.

A stage's settings are a frozen dataclass. A field has its help as a docstring below it, from which
the command makes an option (`gaga_core.cli.output.options`), and, where there are any, its title,
unit and limits in `setting`, which the window's sheet shows and `check_limits` keeps.
"""

from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from gaga_core.errors import GagaError

T = TypeVar("T")


@dataclass(frozen=True)
class Setting:
    """Title, unit and limits of a field."""

    title: str
    unit: str = ""
    least: float | None = None  # lowest value, or where nothing checks it the window's lowest
    above: float | None = None  # every value is greater than this
    most: float | None = None  # highest value that the window offers

    @property
    def label(self) -> str:
        """Title and unit: "Focal length, pixels"."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest value of a slider; ``ValueError`` for a field that has none."""
        if self.least is None or self.most is None:
            raise ValueError(f"{self.title}: no limits")
        return self.least, self.most

    def clamped(self, value: float) -> float:
        """``value`` within the limits; of values above one the lowest is that itself."""
        low = self.above if self.least is None else self.least
        value = value if low is None else max(value, low)
        return value if self.most is None else min(value, self.most)


def setting(
    default: T,
    title: str = "",
    unit: str = "",
    *,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
) -> T:
    """A field of a settings dataclass that carries its `Setting`."""
    about = Setting(title, unit, least, above, most)
    return field(default=default, metadata={"setting": about})


def setting_of(config: Any, name: str) -> Setting:  # a settings dataclass, or a value of one
    """The description of a field; ``KeyError`` when there is no such field or it has none."""
    return {f.name: f for f in fields(config)}[name].metadata["setting"]


def check_limits(config: Any) -> None:  # a value of a settings dataclass
    """Raise ``GagaError`` for a field that is out of its limits; None is within all."""
    for one in fields(config):
        about, value = one.metadata.get("setting"), getattr(config, one.name)
        if not isinstance(about, Setting) or not isinstance(value, int | float):
            continue
        switch = f"--{one.name.replace('_', '-')}"
        unit = f" {about.unit}" if about.unit else ""
        if about.above is not None and not value > about.above:
            raise GagaError(f"{switch} must be greater than {about.above:,}{unit}.")
        if about.least is not None and not value >= about.least:
            raise GagaError(f"{switch} must be at least {about.least:,}{unit}.")
