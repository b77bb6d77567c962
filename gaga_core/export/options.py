"""Changes of an export: less color, a crop, another origin, other units.

This module is light: the command reads it to explain its options.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.scene.camera_path import Bookmark, CameraPath, Shot

if TYPE_CHECKING:
    from gaga_core.scene.scene import Scene

Point = tuple[float, float, float]
_LOWEST = 0.5  # percent of the centres may lie under the ground: a few stray ones do not lift it


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

    sh_degree: int | None = None
    """Highest degree of view-dependent color to keep, 0 to 4; default: all (scene, objects)."""
    crop: tuple[Point, Point] | None = None
    """Leave out what is outside a box: lowest x, y, z and highest, scene units (scene, objects)."""
    centre: bool = False
    """Move the middle of what is written to the origin (scene, objects)."""
    ground: bool = False
    """Move its lowest point to height 0 (scene, objects)."""
    scale: float = 1.0
    """Units of the files per scene unit (scene, objects)."""
    decimate: float = 1.0
    """Share of the splats to keep, 0.25 for a quarter: neighbours that are alike are merged. What
    that loses is told in dB: pictures of before against pictures of after (scene, objects)."""
    as_trained: bool = False
    """Leave a .glb or .usd in the axes of the scene, as other forms are; else it is turned so that
    up is y, as glTF has it (scene, objects)."""
    up: Point = (0.0, 0.0, 1.0)  # unit, world: ``ground`` moves along it, a .glb is turned by it
    page: PageContent = field(default_factory=PageContent)  # of an .html

    def __post_init__(self) -> None:
        """Refuse what cannot be written."""
        if self.sh_degree is not None and not 0 <= self.sh_degree <= 4:
            raise ValueError(f"sh_degree: expected 0 to 4, got {self.sh_degree}")
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise ValueError(f"scale: expected a number above 0, got {self.scale}")
        if not 0 < self.decimate <= 1:
            raise ValueError(f"keep: expected above 0 and up to 1, got {self.decimate}")
        if self.crop is not None and not np.all(np.less_equal(*self.crop)):
            raise ValueError(f"crop: expected lo <= hi, got {self.crop}")
        if abs(float(np.linalg.norm(self.up)) - 1) > 1e-6:
            raise ValueError(f"up: expected a unit vector, got {self.up}")

    def inside(self, scene: "Scene", splats: IntArray) -> IntArray:
        """Those of ``splats`` (K,) whose centres lie in the crop."""
        if self.crop is None:
            return splats
        from gaga_core.scene.selection.algebra import world_means
        from gaga_core.scene.selection.bounds import within

        return splats[within(world_means(scene, splats), *map(np.array, self.crop))]

    def count(self, n: int) -> int:
        """About how many of ``n`` splats are left."""
        return max(min(n, 1), round(self.decimate * n))

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

    def turn(self) -> DoubleArray:
        """The rotation (3, 3) of what a .glb holds: up becomes -y, which its writer makes y.

        Splats, meshes and colliders of one export have the same one.
        """
        up, to = np.array(self.up, np.float64), np.array([0.0, -1.0, 0.0])
        axis, cosine = np.cross(up, to), float(up @ to)
        if self.as_trained or cosine > 1 - 1e-9:
            return np.eye(3)
        if cosine < -1 + 1e-9:  # it stands on its head: half around x
            return np.diag([1.0, -1.0, -1.0])
        x, y, z = axis
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.asarray(np.eye(3) + cross + cross @ cross / (1 + cosine), np.float64)

    def standing(self, gaussians: Gaussians) -> Gaussians:
        """``gaussians`` as a .glb holds them, see `turn`."""
        from gaga_core.io.splats.glb import placed

        place = np.eye(4)
        place[:3, :3] = self.turn()
        return placed(gaussians, place)

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
            changes["comments"] = gaussians.with_metres(False).comments
        return replace(gaussians, **changes) if changes else gaussians
