"""Color grading as one affine map of RGB, so that SH stay right and grades compose.

The steps and their order are those that photo editors use: white balance, saturation, brightness,
levels. All of them are linear or affine, so the whole grade is one (3, 4) matrix; a highlight or a
contrast curve would not be, and view dependence would be lost.
"""

from dataclasses import dataclass, fields

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.color import LUMA

_WARM = np.array([0.25, 0.0, -0.25])  # gain of red and blue at temperature 1
_GREEN = np.array([-0.1, 0.2, -0.1])  # gain at green-magenta 1
_NARROWEST = 0.01  # white stays this far above black


@dataclass(frozen=True)
class Grade:
    """How colors change; the defaults change nothing."""

    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # gain of red, green, blue, 0..4
    temperature: float = 0.0  # -1 (cold) .. 1 (warm)
    green: float = 0.0  # -1 (magenta) .. 1 (green)
    saturation: float = 1.0  # 0 (grey) .. 4
    brightness: float = 0.0  # added, -1..1
    black: float = 0.0  # the level that becomes 0, -1..1
    white: float = 1.0  # the level that becomes 1, 0..2
    opacity: float = 1.0  # factor, 0..1; independent of the colors

    def __post_init__(self) -> None:
        limits = {
            "temperature": (-1, 1),
            "green": (-1, 1),
            "saturation": (0, 4),
            "brightness": (-1, 1),
            "black": (-1, 1),
            "white": (0, 2),
            "opacity": (0, 1),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name}: expected {low}..{high}, got {value}")
        if len(self.tint) != 3 or not all(0 <= gain <= 4 for gain in self.tint):
            raise ValueError(f"tint: expected three gains 0..4, got {self.tint}")
        if self.white - self.black < _NARROWEST:
            raise ValueError(f"white: expected more than black {self.black}, got {self.white}")

    @property
    def changes_nothing(self) -> bool:
        """Whether all values are the defaults."""
        return all(getattr(self, f.name) == f.default for f in fields(self))


def grade_affine(grade: Grade) -> DoubleArray:
    """Affine color (3, 4) of a grade, without its opacity: ``levels(saturate(balance(c)) + b)``."""
    balance = (1 + grade.temperature * _WARM + grade.green * _GREEN) * np.array(grade.tint)
    saturate = grade.saturation * np.eye(3) + (1 - grade.saturation) * np.outer(np.ones(3), LUMA)
    contrast = 1 / (grade.white - grade.black)
    linear = contrast * saturate @ np.diag(balance)
    offset = np.full(3, contrast * (grade.brightness - grade.black))
    return np.column_stack([linear, offset])
