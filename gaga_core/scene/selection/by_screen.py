"""The splats as points of one picture: what gestures on the picture select from.

Projected once per camera and scene; a stroke then asks for a mask of pixels as often as the mouse
moves, one pass over (N,) integers each time.
"""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.kernels import run_chunks
from gaga_core.raster.base import NEAR
from gaga_core.raster.cpu.prepare import for_kernel, pose_and_lens
from gaga_core.scene.scene import Scene, State
from gaga_core.scene.selection.by_screen_kernels import covered, project_centres

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
