"""What the photos' cameras saw while the object stood there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.fill.config import FillConfig

_AROUND = 32  # cameras where there are no photos
_FROM = 3.0  # radii of the object: how far away they stand
_UP = np.array([0.0, 0.0, 1.0])  # any: only what is in the picture counts
_CLEAR = 0.02  # weight of the object under which a pixel does not show it
_MOST_POINTS = 2000  # of the object, projected to find the views that show it


@dataclass(frozen=True, eq=False)
class SeenView:
    """The surface that a view showed."""

    camera: Camera
    depth: FloatArray  # (H, W) camera depth of the surface; 0 where there is none
    is_object: BoolArray  # (H, W) the surface is the object
    is_clear: BoolArray  # (H, W) nothing of the object shows
    after: FloatArray  # (H, W) depth of the surface that is left without it; 0 where there is none
    after_alpha: FloatArray  # (H, W) of what is left without it


@dataclass(frozen=True, eq=False)
class Seen:
    """All looked-at views, and which splats can be told from them."""

    views: tuple[SeenView, ...]
    known: BoolArray  # (N,) shown by the photos; what only shimmers through the object is not


def seen_stage(
    gaussians: Gaussians,
    is_object: BoolArray,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    config: FillConfig,
    made: BoolArray | None = None,
) -> Stage[Seen]:
    """Draw the views in which the object (``is_object`` (N,)) is, with it in its place.

    ``made``: (N,) splats that no photo can have shown, and that are there because an edit made
    them.
    Depths are those at which half of the light is taken (median), so that they lie on a surface.
    """
    chosen = _views_of(gaussians.means[is_object].astype(np.float64), cameras, config)
    n = len(chosen)
    total = np.zeros((len(gaussians), 1), np.float32)
    mark = np.repeat(is_object.astype(np.float32)[:, None], 3, axis=1)
    frames = []
    for i, camera in enumerate(chosen):
        yield Progress("Look behind the object", i, 3 * n, camera.name)
        frame = rasterizer.render(gaussians, camera, channels=mark)
        shape = (camera.height, camera.width)
        rasterizer.vote(gaussians, camera, np.zeros(shape, np.int32), total)
        frames.append(frame)
    others = np.flatnonzero(~is_object)
    bare, alone = gaussians.take(others), np.zeros((len(others), 1), np.float32)
    for i, camera in enumerate(chosen):
        yield Progress("Look behind the object", n + i, 3 * n, camera.name)
        rasterizer.vote(bare, camera, np.zeros((camera.height, camera.width), np.int32), alone)
    known = total[:, 0] > config.seen
    known[others] &= total[others, 0] > config.seen_share * alone[:, 0]
    if made is not None:
        known |= made
    rest = gaussians.take(~is_object & known)
    views = []
    for i, (camera, frame) in enumerate(zip(chosen, frames, strict=True)):
        yield Progress("Look behind the object", 2 * n + i, 3 * n, camera.name)
        after = rasterizer.render(rest, camera)
        share = frame.image[:, :, 0]
        views.append(
            SeenView(
                camera=camera,
                depth=frame.median_depth,
                is_object=share > 0.5,
                is_clear=share < _CLEAR,
                after=after.median_depth,
                after_alpha=after.alpha,
            )
        )
    return Seen(tuple(views), known)


def _views_of(
    points: DoubleArray, cameras: Sequence[Camera], config: FillConfig
) -> tuple[Camera, ...]:
    """Views that show some of ``points`` (K, 3), world, at the size at which they are drawn.

    Without any (a file of splats alone): cameras on a sphere around the points.
    """
    sample = points[:: max(1, len(points) // _MOST_POINTS)]
    found = []
    for camera in cameras:
        pixels, depth = camera.project(sample)
        inside = (depth > 0) & (pixels >= 0).all(axis=1)
        inside &= (pixels < [camera.width, camera.height]).all(axis=1)
        if inside.any():
            found.append(camera)
    if not found:
        return _around(sample, config)
    if len(found) > config.most_views:
        places = np.linspace(0, len(found) - 1, config.most_views).round().astype(int)
        found = [found[i] for i in places]
    return tuple(_small(camera, config.view_pixels) for camera in found)


def _around(points: DoubleArray, config: FillConfig) -> tuple[Camera, ...]:
    """Cameras evenly on a sphere around ``points``, which look at their middle."""
    middle = np.median(points, axis=0)
    radius = max(float(np.percentile(np.linalg.norm(points - middle, axis=1), 95)), 1e-6)
    side = config.view_pixels
    K = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    k = np.arange(_AROUND) + 0.5  # Fibonacci sphere
    height, turn = 1 - 2 * k / _AROUND, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - height**2)
    towards = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    return tuple(
        Camera(K, look_at(middle + _FROM * radius * d, middle, _UP), side, side) for d in towards
    )


def _small(camera: Camera, most: int) -> Camera:
    factor = min(1.0, most / max(camera.width, camera.height))
    width, height = (max(1, round(side * factor)) for side in (camera.width, camera.height))
    return camera.resized(width, height)
