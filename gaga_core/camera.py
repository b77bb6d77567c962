"""A posed pinhole camera."""

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, check_shape
from gaga_core.geometry import turned

NEAR = 0.01  # scene units: what is nearer to a camera is not drawn, here and in all shaders
MOST_PIXELS = 65_536  # of a side of a picture
_NUMBER = re.compile("([0-9]+)")
_LONGEST_FOCAL = 1e9  # pixels: of a telescope with a picture of `MOST_PIXELS`
_FARTHEST = 1e15  # scene units: float32 tells nothing apart there
_RIGID = 0.01  # of a rotation times its transpose, off the identity: files round


def is_usable(K: DoubleArray, cam_from_world: DoubleArray) -> bool:
    """Whether pixels can be computed with numbers of a file: K (3, 3), pose (4, 4) or (3, 4)."""
    focal, rotation = (K[0, 0], K[1, 1]), cam_from_world[:3, :3]
    # Comparisons with NaN are false.
    if not (np.abs(K).max() <= _LONGEST_FOCAL and np.abs(cam_from_world).max() <= _FARTHEST):
        return False
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    return bool(min(focal) > 0 and off <= _RIGID and np.linalg.det(rotation) > 0)


def natural_order(name: str) -> tuple[tuple[tuple[int, str], ...], str]:
    """Key that sorts names of views by their numbers: rgb_2 before rgb_10, as rgb_02 is.

    Names that differ in leading zeros only come one after the other.
    """
    parts = _NUMBER.split(name)  # text and numbers in turns
    parts[1::2] = (number.lstrip("0") for number in parts[1::2])
    return tuple((len(part) * (k % 2), part) for k, part in enumerate(parts)), name


@dataclass(frozen=True, eq=False)
class Camera:
    """Pinhole camera, OpenCV axes, pixel centres at +0.5, no distortion.

    Raises ``ValueError`` when a shape is wrong.
    """

    K: DoubleArray  # (3, 3) pixels
    cam_from_world: DoubleArray  # (4, 4) rigid
    width: int
    height: int
    name: str = ""  # file name of the photo, with suffix

    def __post_init__(self) -> None:
        check_shape("K", self.K, (3, 3))
        check_shape("cam_from_world", self.cam_from_world, (4, 4))
        if not (1 <= self.width <= MOST_PIXELS and 1 <= self.height <= MOST_PIXELS):
            size = f"{self.width} x {self.height}"
            raise ValueError(f"camera {self.name}: size {size}, expected 1 to {MOST_PIXELS:,}")

    @cached_property
    def position(self) -> DoubleArray:
        """Centre of projection (3,), world."""
        rotation = self.cam_from_world[:3, :3]
        return -turned(self.cam_from_world[None, :3, 3], rotation.T)[0]

    @cached_property
    def forward(self) -> DoubleArray:
        """Unit viewing direction (3,), world."""
        return self.cam_from_world[2, :3].copy()

    @cached_property
    def world_from_cam(self) -> DoubleArray:
        """Inverse pose (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.cam_from_world[:3, :3].T
        matrix[:3, 3] = self.position
        return matrix

    def resized(self, width: int, height: int) -> "Camera":
        """The same view at another picture size: K is scaled in x and y."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return replace(self, K=scale @ self.K, width=width, height=height)

    def at_most(self, longest_side: int) -> "Camera":
        """The same view with no side longer than ``longest_side`` pixels."""
        scale = min(1.0, longest_side / max(self.width, self.height))
        if scale == 1.0:
            return self
        return self.resized(max(1, round(self.width * scale)), max(1, round(self.height * scale)))

    def project(self, points_world: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Pixels (N, 2) and depths (N,) along the viewing direction of world points (N, 3)."""
        p_cam = turned(points_world, self.cam_from_world[:3, :3]) + self.cam_from_world[:3, 3]
        depth = p_cam[:, 2]
        safe = np.where(np.abs(depth) < 1e-12, 1e-12, depth)
        pixels = p_cam[:, :2] / safe[:, None] * np.array([self.K[0, 0], self.K[1, 1]])
        return pixels + self.K[:2, 2], depth

    def shows(self, pixels: DoubleArray, depths: DoubleArray) -> BoolArray:
        """Which of the points that `project` gave (N,) are before the camera, in the picture."""
        inside = (pixels > 0).all(axis=1) & (pixels < [self.width, self.height]).all(axis=1)
        return (depths > 0) & inside

    def rays(self, pixels: DoubleArray) -> DoubleArray:
        """World directions (N, 3) of pixels (N, 2), as long as to have depth 1."""
        across = (pixels - self.K[:2, 2]) / [self.K[0, 0], self.K[1, 1]]
        rays: DoubleArray = np.c_[across, np.ones(len(pixels))]
        return rays @ self.world_from_cam[:3, :3].T

    def unproject(self, u: float, v: float, depth: float) -> DoubleArray:
        """World point (3,) at pixel (u, v) and ``depth`` along the viewing direction."""
        x = (u - self.K[0, 2]) / self.K[0, 0] * depth
        y = (v - self.K[1, 2]) / self.K[1, 1] * depth
        return (self.world_from_cam @ np.array([x, y, depth, 1.0]))[:3]
