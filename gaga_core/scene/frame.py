"""The motion of the whole scene since it was opened, and the length of its unit.

Splats move by their placements. What is kept apart from them, cameras of photos, bookmarks and the
camera path, stays in the frame in which the scene was opened and is carried when it is read.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaga_core.arrays import DoubleArray, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import decimal_text

FARTHEST = 1e18  # the product of two such numbers is finite in float32, in which all is drawn
_SIMILAR = 1e-6  # how far a map may be from rotation times scale, relative


@dataclass(frozen=True, eq=False)
class Frame:
    """A motion of the whole scene. Raises ``ValueError`` when it is none."""

    # (4, 4) world_from_opened: rotation times uniform scale, and an offset
    world: DoubleArray = field(default_factory=lambda: np.eye(4))
    is_metric: bool = False  # a unit of the world is a metre

    def __post_init__(self) -> None:
        check_shape("world", self.world, (4, 4))
        scale_of(self.world)

    @property
    def is_identity(self) -> bool:
        """Whether nothing was moved as a whole and no length is known."""
        return not self.is_metric and np.array_equal(self.world, np.eye(4))

    @property
    def rows(self) -> tuple[tuple[float, float, float, float], ...]:
        """Rows of ``world`` as plain values; none when the scene was not moved."""
        if np.array_equal(self.world, np.eye(4)):
            return ()
        return tuple((a, b, c, d) for a, b, c, d in self.world.tolist())

    def equals(self, other: "Frame") -> bool:
        """Whether both are the same."""
        return self.is_metric == other.is_metric and np.array_equal(self.world, other.world)


def scale_of(world: DoubleArray) -> float:
    """The factor of lengths of a similarity (3, 4) or (4, 4).

    Raises ``ValueError`` when the map mirrors, stretches or flattens space, or is not finite.
    """
    linear = np.asarray(world, np.float64)[:3, :3]
    if not (np.abs(world) <= FARTHEST).all() or not np.linalg.det(linear) > 0:
        raise ValueError("world: expected a rotation times a scale, and an offset")
    scale = float(np.cbrt(np.linalg.det(linear)))
    if np.abs(linear @ linear.T / scale**2 - np.eye(3)).max() > _SIMILAR:
        raise ValueError("world: the map stretches space, so cameras cannot follow it")
    return scale


def inverse(world: DoubleArray) -> DoubleArray:
    """The map back (4, 4) of a similarity (4, 4)."""
    return np.linalg.inv(world).astype(np.float64)


def carried_camera(camera: Camera, world: DoubleArray) -> Camera:
    """``camera`` moved by a similarity (4, 4): it sees the moved scene as it saw the scene.

    Its pose stays rigid: a scale moves its place only. Depths grow by the scale.
    """
    if np.array_equal(world, np.eye(4)):
        return camera
    pose = np.eye(4)
    pose[:3, :3] = camera.cam_from_world[:3, :3] @ (world[:3, :3] / scale_of(world)).T
    pose[:3, 3] = -pose[:3, :3] @ (world[:3, :3] @ camera.position + world[:3, 3])
    return replace(camera, cam_from_world=pose)


def carried_cameras(cameras: Iterable[Camera], world: DoubleArray) -> tuple[Camera, ...]:
    """`carried_camera` of each."""
    return tuple(carried_camera(camera, world) for camera in cameras)


def lengths_text(lengths: Sequence[float], *, is_metric: bool) -> str:
    """Lengths next to each other: "0.527 × 0.220 × 0.176 units", in the digits of the longest."""
    unit, factor, decimals = "units", 1.0, 1
    longest = max(map(abs, lengths), default=0.0)
    if is_metric:
        named = (("km", 1e-3, 2, 1e3), ("m", 1.0, 2, 1.0), ("cm", 1e2, 1, 1e-2), ("mm", 1e3, 1, 0))
        unit, factor, decimals = next(n[:3] for n in named if longest >= n[3])
    elif 0 < longest < 100:
        decimals = 2 - math.floor(math.log10(longest))
    return " × ".join(f"{factor * value:,.{decimals}f}" for value in lengths) + f" {unit}"


def length_text(length: float, *, is_metric: bool) -> str:
    """A length in words: "12.3 cm", "2.40 m", or "0.817 units" while no length is known."""
    if is_metric:
        return lengths_text([length], is_metric=True)
    return f"{decimal_text(length)} units" if 0 < abs(length) < 100 else f"{length:,.1f} units"


LENGTHS: Mapping[str, float] = {  # metres of each unit
    **{"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3, "in": 0.0254, "ft": 0.3048},
    **{"metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0},
    **{"inch": 0.0254, "inches": 0.0254, "foot": 0.3048, "feet": 0.3048},
}
_NUMBER = re.compile(r"([+-]?(?:[0-9]*[.,]?[0-9]+|[0-9]+[.,])(?:e[+-]?[0-9]+)?)\s*(\S*)")
_NEXT = re.compile(r"(?<=[^\W\d])\s+(?=[0-9.,])")  # another number, behind a unit
_THOUSANDS = re.compile(r"[+-]?[1-9][0-9]{0,2}(,[0-9]{3})+")  # or a comma for a point: not clear


def metres_of(text: str) -> float | None:
    """A typed length in metres: "1.5", "1,5 m", "80 cm", "2 ft 10 in"; None where it is none, as 0
    and "1,000", which is one or a thousand."""
    metres = number_of(text, LENGTHS)
    return metres if metres is not None and metres > 0 else None


def number_of(text: str, units: Mapping[str, float]) -> float | None:
    """A typed number times the factor of its unit, which may be left out: "-1.5", "1,5 m"; or the
    sum of several, each with a smaller unit: "2 ft 10 in". None where it is none, a unit is not one
    of ``units``, or it is "1,000", which is one or a thousand."""
    total, sign, last = 0.0, 1.0, math.inf
    texts = _NEXT.split(text.strip().lower().replace("\N{MINUS SIGN}", "-"))
    for part in texts:
        found = _NUMBER.fullmatch(part)
        if found is None or found[2] not in {"", *units} or _THOUSANDS.fullmatch(found[1]):
            return None
        factor = units.get(found[2], 1.0)
        if len(texts) > 1 and not (found[2] and factor < last):
            return None
        number, last = float(found[1].replace(",", ".")), factor
        sign = -1.0 if part.startswith("-") else sign  # "-2 ft 10 in" is less than -2 ft
        total += sign * abs(number) * factor
    return total if math.isfinite(total) else None
