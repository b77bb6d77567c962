"""The splats as points of one picture: what gestures on the picture select from.

Projected once per camera and scene; a stroke then asks for a mask of pixels as often as the mouse
moves, one pass over (N,) integers each time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.raster.base import NEAR
from gaga_core.raster.cpu.prepare import for_kernel, pose_and_lens
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.selection_kernels import covered, project_centres
from gaga_core.threads import run_chunks

# A splat counts as visible surface up to this far behind the median depth, relative to depth:
# centres of a surface's splats lie a little on both sides of it.
SURFACE_SLACK = 0.02
_CHUNK = 65536


@dataclass(frozen=True, eq=False)
class Screen:
    """Where the centre of each splat is drawn."""

    pixel: IntArray  # (N,) row * width + column; -1 = cannot be selected in this picture
    width: int
    height: int

    def inside(self, mask: BoolArray) -> IntArray:
        """Splats (K,), ascending, that are drawn on a set pixel of ``mask`` (H, W)."""
        check_shape("mask", mask, (self.height, self.width), np.bool_)
        n = len(self.pixel)
        rows, counts = np.empty(n, np.int32), np.zeros(-(-n // _CHUNK), np.int64)
        flat = for_kernel(mask, np.bool_).ravel()

        def work(start: int, stop: int) -> None:
            covered(self.pixel, flat, rows, counts, _CHUNK, start, stop)

        run_chunks(work, n, _CHUNK)
        pieces = [rows[c * _CHUNK : c * _CHUNK + k] for c, k in enumerate(counts)]
        return np.concatenate([np.zeros(0, np.int32), *pieces])


def screen(scene: Scene, camera: Camera, surface_depth: FloatArray | None = None) -> Screen:
    """Project the centres of all splats that can be selected, placements applied.

    With ``surface_depth`` (H, W), a picture's median depth at the camera's size, only the visible
    surface; without it, through everything.
    """
    surface = np.zeros((0, 0), np.float32)
    if surface_depth is not None:
        check_shape("surface_depth", surface_depth, (camera.height, camera.width))
        surface = for_kernel(surface_depth, np.float32)
    pose, lens = pose_and_lens(camera)
    poses = scene.placements.cam_from_file(pose)
    means = for_kernel(scene.gaussians.means, np.float32)
    state, placement = for_kernel(scene.state, np.uint8), for_kernel(scene.placement, np.int32)
    unwanted = int(State.HIDDEN | State.DELETED | State.LOCKED)
    pixel = np.empty(len(scene), np.int32)

    def work(start: int, stop: int) -> None:
        project_centres(
            means,
            state,
            unwanted,
            placement,
            poses,
            lens,
            surface,
            SURFACE_SLACK,
            NEAR,
            camera.width,
            camera.height,
            pixel,
            start,
            stop,
        )

    run_chunks(work, len(scene), _CHUNK)
    return Screen(pixel, camera.width, camera.height)


# --- Shapes drawn on the picture as masks of pixels (H, W) bool.
# A pixel belongs to a shape when its centre (x + 0.5, y + 0.5) lies in it.


ScreenPoint = tuple[float, float]


def rectangle(corners: tuple[float, float, float, float], width: int, height: int) -> BoolArray:
    """The rectangle (u0, v0, u1, v1), pixels, any corner order: every pixel that it touches."""
    u0, v0, u1, v1 = corners
    left, right = sorted((u0, u1))
    top, bottom = sorted((v0, v1))
    mask = np.zeros((height, width), np.bool_)
    rows = slice(max(int(np.floor(top)), 0), max(int(np.ceil(bottom)), 0))
    mask[rows, max(int(np.floor(left)), 0) : max(int(np.ceil(right)), 0)] = True
    return mask


def polygon(points: Sequence[ScreenPoint], width: int, height: int) -> BoolArray:
    """The inside of a closed outline, a lasso's or a polygon's; empty under three points."""
    mask = np.zeros((height, width), np.bool_)
    if len(points) < 3:
        return mask
    # Imported when first needed: it takes a large part of a second.
    from skimage.draw import polygon as pixels_inside

    outline = np.asarray(points, np.float64) - 0.5
    shape = (height, width)
    rows, columns = pixels_inside(outline[:, 1], outline[:, 0], shape)  # type: ignore[no-untyped-call]
    mask[rows, columns] = True
    return mask


def stroke(mask: BoolArray, start: ScreenPoint, stop: ScreenPoint, radius: float) -> None:
    """Paint a round brush of ``radius`` pixels from ``start`` to ``stop`` into ``mask`` (H, W).

    A brush that is moved in many small steps paints the union of its steps.
    """
    height, width = mask.shape
    a, b = np.asarray(start, np.float64), np.asarray(stop, np.float64)
    lo = np.floor(np.minimum(a, b) - radius).astype(int)
    hi = np.ceil(np.maximum(a, b) + radius).astype(int) + 1
    left, top = max(lo[0], 0), max(lo[1], 0)
    right, bottom = min(hi[0], width), min(hi[1], height)
    if left >= right or top >= bottom:
        return
    u = np.arange(left, right) + 0.5 - a[0]
    v = (np.arange(top, bottom) + 0.5 - a[1])[:, None]
    along = b - a
    length2 = float(along @ along)
    share = np.clip((u * along[0] + v * along[1]) / length2, 0, 1) if length2 > 0 else 0.0
    near = (u - share * along[0]) ** 2 + (v - share * along[1]) ** 2 <= radius * radius
    mask[top:bottom, left:right] |= near
