"""Affine colors that recolor an object and keep its shading."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, FloatArray, check_shape
from gaga_core.color import LUMA, rgb_from_dc
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.scene import Scene

_DARK = 0.15  # an object darker than this is not brightened by more than target / 0.15
_BLACK = 0.02  # shading left in an object painted black, so that the next recolor still has some


def tint_affine(
    mean_rgb: AnyArray | Sequence[float],
    target_rgb: AnyArray | Sequence[float],
    strength: float = 1.0,
) -> DoubleArray:
    """Affine color (3, 4) that sends ``mean_rgb`` (3,) to ``target_rgb`` (3,), 0..1.

    A color c becomes ``t + t' (y(c) - y(m)) / max(y(m), 0.15)`` with m the mean, t the target,
    y the luminance and t' the target, at least 0.02 in each channel: the object takes the target's
    hue everywhere, its light and dark stay in proportion, and the mean lands on the target exactly.
    ``strength`` 0..1 blends from no change to all of it.
    """
    mean, target = np.asarray(mean_rgb, np.float64), np.asarray(target_rgb, np.float64)
    check_shape("mean_rgb", mean, (3,))
    check_shape("target_rgb", target, (3,))
    if not 0 <= strength <= 1:
        raise ValueError(f"strength: expected 0..1, got {strength}")
    gain = np.maximum(target, _BLACK) / max(float(LUMA @ mean), _DARK)
    linear = np.outer(gain, LUMA)
    full = np.column_stack([linear, target - linear @ mean])
    return (1 - strength) * np.eye(3, 4) + strength * full


def mean_color(scene: Scene, indices: AnyArray, seen: FloatArray | None = None) -> DoubleArray:
    """Mean color (3,) of splats as they are colored now (degree 0 of SH).

    Weighted by opacity and area, as much as is seen of each: many small dark splats inside an
    object do not darken it. ``seen`` (K, 4), where it is known, is the color without edits of
    each of them, ascending, from outside, and the share of views that nothing hides it in (see
    `gaga_core.query.group_facts`): most splats of a trained object lie inside and are darker.
    Mid grey when there are none.
    """
    splats = sorted_indices(indices, len(scene))
    if len(splats) == 0:
        return np.full(3, 0.5)
    # Clipped before the placement's map, not after it: the mean then follows a recolor exactly,
    # and a stray splat of color 100 does not pull it.
    rgb = np.clip(rgb_from_dc(scene.gaussians.sh[splats, 0]).astype(np.float64), 0, 1)
    share = np.ones(len(splats))
    if seen is not None and seen[:, 3].any():
        outside = seen.astype(np.float64)
        rgb = np.clip(outside[:, :3], 0, 1)
        share = outside[:, 3] ** 2  # what few views see is mostly covered in these, too
    index = scene.placement[splats]
    for row in np.unique(index[index != 0]):
        affine, at = scene.placements.color[row], index == row
        rgb[at] = rgb[at] @ affine[:, :3].T + affine[:, 3]
    logits = scene.gaussians.logit_opacities[splats].astype(np.float64)
    # The two longest axes of an ellipsoid span the largest picture of it.
    logs = np.sort(scene.gaussians.log_scales[splats].astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    weights = np.exp(np.clip(logs - logs.max(), -60, 0)) / (1 + np.exp(-np.clip(logits, -30, 30)))
    return np.clip(np.average(rgb, axis=0, weights=weights * share), 0, 1)


# --- Color grading as one affine map of RGB, so that SH stay right and grades compose.
# The steps and their order are those that photo editors use: white balance, saturation,
# brightness, levels. All of them are linear or affine, so the whole grade is one (3, 4) matrix; a
# highlight or a contrast curve would not be, and view dependence would be lost.


_WARM = np.array([0.25, 0.0, -0.25])  # gain of red and blue at temperature 1
_GREEN = np.array([-0.1, 0.2, -0.1])  # gain at green-magenta 1
_NARROWEST = 0.01  # white stays this far above black


def _within(default: float, low: float, high: float) -> float:
    return field(default=default, metadata={"limits": (low, high)})


@dataclass(frozen=True)
class Grade:
    """Change of colors; the defaults change nothing."""

    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)  # gain of red, green, blue, 0..4
    temperature: float = _within(0.0, -1, 1)  # cold .. warm
    green: float = _within(0.0, -1, 1)  # magenta .. green
    saturation: float = _within(1.0, 0, 4)  # 0: grey
    brightness: float = _within(0.0, -1, 1)  # added
    black: float = _within(0.0, -1, 1)  # the level that becomes 0
    white: float = _within(1.0, 0, 2)  # the level that becomes 1
    opacity: float = _within(1.0, 0, 1)  # factor; independent of the colors

    def __post_init__(self) -> None:
        for name, (low, high) in ((f.name, f.metadata["limits"]) for f in fields(self)[1:]):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: expected {low}..{high}, got {getattr(self, name)}")
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
