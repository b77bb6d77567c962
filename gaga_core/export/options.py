"""Changes of an export: less color, a crop, another origin, other units."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.packing import PALETTE
from gaga_core.io.splats.splat_files import SplatFormat
from gaga_core.io.splats.web_page import viewer_bytes
from gaga_core.scene.camera_path import Bookmark, CameraPath, Shot
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means

Point = tuple[float, float, float]
_LOWEST = 0.5  # percent of the centres may lie under the ground: a few stray ones do not lift it
_HEADER = 1500  # bytes before the splats of a file, about
_SPZ = 0.75  # of its bytes are left when it is packed, about
# Measured on scans and on random splats, which hardly shrink: bytes of the code books in meta.json,
# of a splat, and of an SH coefficient in the palette.
_SOG_HEAD, _SOG, _SOG_SH = 11_000, 13.5, 0.7
# The same of a web page, in base64, and of an object with its picture.
_PAGE_HEAD, _PAGE, _PAGE_SH, _PAGE_OBJECT = 11_000, 19.0, 0.9, 2_600
_SPLAT = 32  # bytes of a splat in a .splat


@dataclass(frozen=True)
class PageContent:
    """Content of a web page in addition to the splats; world of the scene."""

    title: str = ""  # empty: the name of the file
    start: Shot | None = None  # first view; None: the first bookmark, else photo, else all
    bookmarks: tuple[Bookmark, ...] = ()
    path: CameraPath = field(default_factory=CameraPath)
    cameras: tuple[Camera, ...] = ()  # of the photos: objects are pictured from their side
    background: frozenset[int] = frozenset()  # groups that the list folds at its end


@dataclass(frozen=True)
class ExportOptions:
    """Changes to what is written; by default there are none, and bits survive."""

    sh_degree: int | None = None  # highest degree of the color's SH that is kept; None: all
    crop: tuple[Point, Point] | None = None  # lo, hi: centres outside are left out; world
    centre: bool = False  # the middle of all that is written becomes the origin
    ground: bool = False  # its lowest point comes to height 0 along ``up``
    up: Point = (0.0, 0.0, 1.0)  # unit, world
    scale: float = 1.0  # units of the file per scene unit
    keep: float = 1.0  # share of the splats: neighbours are merged until so many are left
    page: PageContent = field(default_factory=PageContent)  # of an .html

    def __post_init__(self) -> None:
        """Refuse what cannot be written."""
        if self.sh_degree is not None and not 0 <= self.sh_degree <= 4:
            raise ValueError(f"sh_degree: expected 0 to 4, got {self.sh_degree}")
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise ValueError(f"scale: expected a number above 0, got {self.scale}")
        if not 0 < self.keep <= 1:
            raise ValueError(f"keep: expected above 0 and up to 1, got {self.keep}")
        if self.crop is not None and not np.all(np.less_equal(*self.crop)):
            raise ValueError(f"crop: expected lo <= hi, got {self.crop}")
        if abs(float(np.linalg.norm(self.up)) - 1) > 1e-6:
            raise ValueError(f"up: expected a unit vector, got {self.up}")

    def inside(self, scene: Scene, splats: IntArray) -> IntArray:
        """Those of ``splats`` (K,) whose centres lie in the crop."""
        if self.crop is None:
            return splats
        means = world_means(scene, splats)
        lo, hi = (np.array(corner) for corner in self.crop)
        return splats[((means >= lo) & (means <= hi)).all(axis=1)]

    def count(self, n: int) -> int:
        """About how many of ``n`` splats are left."""
        return max(min(n, 1), round(self.keep * n))

    def origin(self, means: FloatArray) -> DoubleArray:
        """The point (3,), world, that becomes the origin when all of ``means`` (K, 3) is written.

        The files of all objects share it, so that they still fit together.
        """
        finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
        if len(finite) == 0 or not (self.centre or self.ground):
            return np.zeros(3)
        up = np.array(self.up)
        middle = (finite.min(axis=0) + finite.max(axis=0)) / 2 if self.centre else np.zeros(3)
        if not self.ground:
            return np.asarray(middle, np.float64)
        lowest = float(np.percentile(finite @ up, _LOWEST))
        return np.asarray(middle + (lowest - middle @ up) * up, np.float64)

    def applied(self, gaussians: Gaussians, origin: DoubleArray) -> Gaussians:
        """``gaussians`` as they are written: with less color, from ``origin`` (3,), scaled."""
        changes: dict[str, Any] = {}  # fields of Gaussians
        if self.sh_degree is not None and self.sh_degree < gaussians.sh_degree:
            changes["sh"] = gaussians.sh[:, : (self.sh_degree + 1) ** 2].copy()
        if origin.any() or self.scale != 1.0:
            moved = (gaussians.means.astype(np.float64) - origin) * self.scale
            changes["means"] = moved.astype(np.float32)
        if self.scale != 1.0:
            changes["log_scales"] = gaussians.log_scales + np.float32(np.log(self.scale))
        return replace(gaussians, **changes) if changes else gaussians


def estimated_bytes(
    gaussians: Gaussians, n: int, form: SplatFormat, sh_degree: int, n_objects: int = 0
) -> int:
    """About how large a file with ``n`` splats like ``gaussians`` is, at ``sh_degree``.

    ``n_objects``: how many a web page lists, with a picture each.
    """
    n_rest = 3 * ((sh_degree + 1) ** 2 - 1)
    if form is SplatFormat.SPLAT:
        return n * _SPLAT
    if form is SplatFormat.COMPRESSED_PLY:
        return _HEADER + n * (16 + n_rest) + -(-n // 256) * 72
    if form is SplatFormat.PLY:
        extra = sum(c.nbytes // max(len(c), 1) for c in gaussians.extra.values())
        return _HEADER + n * (4 * (14 + n_rest) + extra)
    if form is SplatFormat.GLB:
        return _HEADER + 4 * n * (11 + 3 + n_rest)
    if form is SplatFormat.HTML:
        sh = (_PAGE_SH * n_rest * min(n, PALETTE) + 2.7 * n) if n_rest else 0
        return round(viewer_bytes() + _PAGE_HEAD + _PAGE * n + sh + _PAGE_OBJECT * n_objects)
    if form is SplatFormat.SOG:
        sh = 5_500 + 1.5 * n + _SOG_SH * n_rest * min(n, PALETTE) if n_rest else 0
        return round(_SOG_HEAD + _SOG * n + sh)
    return round(_SPZ * n * (9 + 1 + 3 + 3 + 4 + n_rest))


def box_of(corners: Sequence[float]) -> tuple[Point, Point]:
    """A crop of six numbers: the lowest x, y, z and the highest. ``ValueError`` otherwise."""
    if len(corners) != 6:
        raise ValueError(f"crop: expected 6 numbers, got {len(corners)}")
    x0, y0, z0, x1, y1, z1 = (float(value) for value in corners)
    return (x0, y0, z0), (x1, y1, z1)
