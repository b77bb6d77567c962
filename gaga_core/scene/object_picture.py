"""Pictures of single objects: the object alone, on neutral ground, as large as fits."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.raster.cpu.rasterizer import CpuRasterizer

GROUND = 112  # grey behind the object: dark and bright objects stand out from it
MOST_DRAWN = 60_000  # splats
_FILLS = 0.9  # share of the side that the object takes
_EDGE = 1.0  # percent of the splats that may lie outside on each side
_INNER, _AROUND = 6.0, 0.25  # percent outside the inner part; room around it, of its extent
_STEEP = 0.45  # best elevation of the view, radians over the ground: three-quarter
_FAR = 0.15  # how much the distance of a camera counts against its elevation


@dataclass(frozen=True, eq=False)
class ObjectView:
    """From where an object is drawn."""

    centre: DoubleArray  # (3,) world
    radius: float
    towards: DoubleArray  # (3,) unit, from the object to the eye
    up: DoubleArray  # (3,) unit

    def camera(self, side: int) -> Camera:
        """A picture that holds all of the object."""
        focal = 1.6 * side
        eye = self.centre + 6 * self.radius * self.towards
        K = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1.0]])
        return Camera(K, look_at(eye, self.centre, self.up), side, side, "thumbnail")


@dataclass(frozen=True, eq=False)
class ObjectDrawing:
    """What a picture of an object is drawn from, by the processor or by OpenGL."""

    splats: Gaussians  # far to near
    camera: Camera  # of the picture, which they fill

    def render(self) -> UInt8Array:
        """Draw it on the processor: (H, W, 3)."""
        ground = np.full(3, GROUND / 255, np.float32)
        frame = CpuRasterizer().render(self.splats, self.camera, background=ground)
        return np.rint(np.clip(frame.image, 0, 1) * 255).astype(np.uint8)


def object_view(
    centre: DoubleArray, radius: float, cameras: Sequence[Camera], up: DoubleArray
) -> ObjectView:
    """A little from above, where a photo was taken; from any side without photos."""
    return ObjectView(centre, radius, _towards(cameras, centre, up), up)


def object_drawing(splats: Gaussians, view: ObjectView, side: int) -> ObjectDrawing:
    """Splats of one object as a picture (side, side); raises ``GagaError`` when there are none."""
    if len(splats) == 0:
        raise GagaError("The object has no splats.")
    camera = _tight(view.camera(side), splats)
    depths = splats.means @ camera.cam_from_world[2, :3].astype(np.float32)
    return ObjectDrawing(splats.take(np.argsort(-depths, kind="stable")), camera)


def object_picture(splats: Gaussians, view: ObjectView, side: int) -> UInt8Array:
    """`object_drawing`, drawn on the processor: (side, side, 3)."""
    return object_drawing(splats, view, side).render()


def _towards(cameras: Sequence[Camera], centre: DoubleArray, up: DoubleArray) -> DoubleArray:
    """Direction (3,) to the camera of the photos that sees the object best."""
    if not cameras:
        side = np.cross(up, [0.0, 0.0, 1.0] if abs(up[2]) < 0.9 else [1.0, 0.0, 0.0])
        front = np.cross(side, up)
        direction = side / np.linalg.norm(side) + front / np.linalg.norm(front) + 0.7 * up
        return direction / np.linalg.norm(direction)
    away = np.stack([camera.position for camera in cameras]) - centre
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    away = away / distance[:, None]
    elevation = np.arcsin(np.clip(away @ up, -1, 1))
    cost = np.abs(elevation - _STEEP) + _FAR * distance / np.median(distance)
    return away[int(cost.argmin())]


def _tight(camera: Camera, splats: Gaussians) -> Camera:
    """``camera`` with the focal length and the centre at which the splats fill the picture."""
    pixels, depth = camera.project(splats.means.astype(np.float64))
    shown = pixels[np.isfinite(pixels).all(axis=1) & (depth > 0) & (splats.opacities > 0.1)]
    if len(shown) == 0:
        return camera
    low, inner_low, inner_high, high = np.percentile(
        shown, [_EDGE, _INNER, 100 - _INNER, 100 - _EDGE], axis=0
    )
    reach = _AROUND * (inner_high - inner_low)  # strays are farther away than this
    low, high = np.maximum(low, inner_low - reach), np.minimum(high, inner_high + reach)
    zoom = _FILLS * camera.width / max(float((high - low).max()), 1e-6)
    K = camera.K.copy()
    K[:2] *= zoom
    K[:2, 2] += camera.width / 2 - zoom * (low + high) / 2
    return replace(camera, K=K)
