"""Which nodes lie behind what is opaque: the splats of the last cut, counted in coarse cells.

The idea of occlusion maps (Zhang 1997), without a picture: what splats cover adds up in the cell of
their centre, by depth. Where it adds up to several layers, also in all cells around, the view ends.
A node that lies wholly behind is not left out but drawn coarser, so an error leaves no hole.
"""

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.raster.base import NEAR

_CELLS = 72  # along the longer side of the picture
_DEPTHS = 96
_FARTHEST = 1e5  # times the nearest depth: what lies behind hides nothing
_OPAQUE = 2.0  # layers; seen from the front they are twice as many: e^-4 of what is behind shows
_THIN = 0.4  # share of them that each cell has alone, or there may be a gap


def covers_of(log_scales: FloatArray, logit_opacities: FloatArray) -> FloatArray:
    """What splats cover (K,), world units squared: the mean over all directions, by opacity."""
    with np.errstate(over="ignore", invalid="ignore"):
        a, b, c = np.exp(log_scales.T)
        faces = np.float32(np.pi) * (a * b + b * c + c * a)
        covers: FloatArray = faces / (1 + np.exp(-logit_opacities))
    return covers


def hidden_nodes(
    boxes: FloatArray, means: FloatArray, covers: FloatArray, camera: Camera
) -> BoolArray:
    """Nodes (M,) of these boxes (M, 6) of which the picture shows next to nothing.

    ``means`` (K, 3) and ``covers`` (K,) are samples of the splats that are drawn, opaque as they
    are: of n splats each counts for n / K of them. What lies out of the picture is never hidden.
    """
    # Imported when first needed: importing numba takes a large part of the launch time.
    from gaga_core.scene.lod.occlusion_kernels import behind, cover_cells, end_depths

    share = _CELLS / max(camera.width, camera.height)
    width = max(round(camera.width * share), 1)
    height = max(round(camera.height * share), 1)
    K, x, y = camera.K, width / camera.width, height / camera.height
    lens = np.array([K[0, 0] * x, K[1, 1] * y, K[0, 2] * x, K[1, 2] * y])
    pose: DoubleArray = np.ascontiguousarray(camera.cam_from_world[:3], np.float64)
    bins = _DEPTHS / np.log(_FARTHEST)
    grid = np.zeros((height, width, _DEPTHS), np.float32)
    cover_cells(means, covers, pose, lens, NEAR, bins, grid)
    depths = np.empty((height, width), np.float32)
    end_depths(grid, NEAR, bins, _OPAQUE, _THIN, depths)
    hidden = np.empty(len(boxes), np.bool_)
    behind(boxes, pose, lens, NEAR, depths, hidden)
    return hidden
