"""The similarity that brings one capture to another, with what it leaves, and how sure it is."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, decimal_text
from gaga_core.io.cameras.given import Lens
from gaga_core.scene.frame import inverse, length_text, scale_of
from gaga_core.scene.scene import Scene

By = Literal["photos", "surfaces"]


class NotAlignedError(GagaError):
    """What the captures share does not say how they lie to each other."""


@dataclass(frozen=True, eq=False)
class Capture:
    """One of two captures."""

    name: str
    cameras: tuple[Camera, ...] = ()  # of its photos, in the world of ``scene`` as it is now
    photos: Mapping[str, Path] = field(default_factory=dict)  # by name of the camera
    scene: Scene | None = None  # None: its photos are placed, and there are no splats yet
    behind: frozenset[int] = frozenset()  # groups that are background: no things that move
    lenses: Mapping[str, Lens] = field(default_factory=dict)  # of photos that are not pinhole's


@dataclass(frozen=True)
class TrustConfig:
    """What an alignment must show. The bounds of its errors are those that a person sees where two
    scans of a room overlap: 1 cm in a metre."""

    fewest: int = 30  # points that fit
    share: float = 0.25  # of the points that are shared: fewer could be a thing that was moved
    degrees: float = 0.5  # one standard error of the rotation
    scale: float = 0.005  # one standard error of the scale, relative


_TRUST = TrustConfig()
_FINEST = 0.001  # units, degrees and percent: nobody needs less, and its zeros are hard to read
CURES: Mapping[By, str] = {
    "photos": "Add photos that show both, or place it by hand.",
    "surfaces": "Place it by hand.",
}


@dataclass(frozen=True, eq=False)
class Alignment:
    """How the second capture lies in the world of the first."""

    world: DoubleArray  # (4, 4) first_from_second: rotation times scale, and an offset
    by: By
    n_points: int  # that fit
    share: float  # of all that the two share
    residual: float  # median distance of points that fit, units of the first capture
    pixels: float | None  # median error of these in the photos; None: not by photos
    turn_error: float  # radians, one standard error
    scale_error: float  # relative, one standard error

    @property
    def scale(self) -> float:
        """Factor of lengths of the second capture."""
        return scale_of(self.world)

    @property
    def angle(self) -> float:
        """Angle of the rotation, radians."""
        cosine = (np.trace(self.world[:3, :3]) / self.scale - 1) / 2
        return float(np.arccos(np.clip(cosine, -1, 1)))

    def sentence(self, *, is_metric: bool) -> str:
        """What was found, for a person."""
        what = "points of the photos" if self.by == "photos" else "points of the surfaces"
        apart = length_text(max(self.residual, _FINEST), is_metric=is_metric)
        apart = apart if self.residual >= _FINEST else f"under {apart}"
        text = f"{self.n_points:,} {what} fit, {apart} apart in the median"
        if self.pixels is not None:
            text += f", and {self.pixels:.1f} pixels off where the photos show them"
        angle, scale = f"{np.degrees(self.angle):.1f}", decimal_text(self.scale, 4)
        turned = "not turned" if angle == "0.0" else f"turned by {angle}°"
        size = "of the same size" if scale == "1" else f"{scale} times as large"
        errors = float(np.degrees(self.turn_error)), 100 * self.scale_error
        turn, share = (
            decimal_text(e, 2) if e >= _FINEST else f"under {decimal_text(_FINEST)}" for e in errors
        )
        return f"{text}; {turned}, {size}, known to {turn}° and {share} %."

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "first_from_second": self.world.tolist(),
            "scale": self.scale,
            "by": self.by,
            "points": self.n_points,
            "share": round(self.share, 4),
            "residual": self.residual,
            "pixels": self.pixels,
            "degrees_error": float(np.degrees(self.turn_error)),
            "scale_error": self.scale_error,
        }


def trusted(found: Alignment) -> Alignment:
    """``found``. Raises ``NotAlignedError`` with the reason where it cannot be trusted."""
    what = f"The captures share too little: {found.n_points:,} {found.by} points fit"
    if found.n_points < _TRUST.fewest:
        text = f"it takes {_TRUST.fewest}."
    elif found.share < _TRUST.share:
        text = f"{found.share:.0%} of those that look alike; the others contradict."
    elif not (np.degrees(found.turn_error) <= _TRUST.degrees and found.scale_error <= _TRUST.scale):
        text = "from too few places to say how they lie to each other."
    else:
        return found
    raise NotAlignedError(f"{what}, {text} {CURES[found.by]}")


def difference(a: DoubleArray, b: DoubleArray) -> tuple[float, float]:
    """Angle in radians and relative scale between two similarities (4, 4)."""
    between = inverse(a) @ b
    scale = scale_of(between)
    cosine = (np.trace(between[:3, :3]) / scale - 1) / 2
    return float(np.arccos(np.clip(cosine, -1, 1))), abs(scale - 1)
