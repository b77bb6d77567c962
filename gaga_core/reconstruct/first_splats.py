"""What a training starts from: points, what covers the holes between them, and a background."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, UInt8Array, check_shape
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.reconstruct.cover import CameraBall, cover_holes_stage
from gaga_core.reconstruct.far_shell import far_shell
from gaga_core.reconstruct.initial import initial_gaussians
from gaga_core.reconstruct.optimizer import concatenate
from gaga_core.reconstruct.settings import TrainConfig, fewness
from gaga_core.reconstruct.stereo import stereo_points_stage
from gaga_core.reconstruct.views import TrainView

_LARGEST = 0.05  # standard deviation, x the distance to the nearest camera
_RESERVED = 4  # points leave one part in so many of the cap to what covers holes
_SHELL = 20  # the shell takes at most one part in so many of the cap


def first_splats_stage(
    points: DoubleArray,  # (P, 3) world
    colors: UInt8Array,  # (P, 3)
    views: Sequence[TrainView],
    config: TrainConfig,
    rasterizer: Rasterizer,
) -> Stage[Gaussians]:
    """What a training of ``config`` starts from: splats for points, then for holes, then a shell.

    Fewer points than `TrainConfig.stereo` are joined by those of `stereo.stereo_points_stage`. More
    than the cap on splats admits next to the cover and the shell are thinned at random, from the
    seed.
    """
    check_shape("points", points, ("P", 3))
    most = config.density.max_splats
    n_shell = min(config.shell_of(len(views)), most // _SHELL)
    most_points = most - min(config.cover + n_shell, most // _RESERVED)
    n_more = min(config.stereo, most_points) - len(points)
    if n_more > 0:
        more, more_colors = yield from stereo_points_stage(points, views, n_more, config.seed)
        points = np.concatenate([points, more])
        colors = np.concatenate([colors, more_colors])
    if len(points) > most_points:
        chosen = np.random.default_rng(config.seed).permutation(len(points))[:most_points]
        points, colors = points[chosen], colors[chosen]
    first = initial_gaussians(
        points, colors, opacity=config.initial_opacity, scale=config.initial_scale
    )
    if config.cover > 0 and fewness(len(views)) > 0:
        first = _limited(first, views)
    covered = yield from cover_holes_stage(
        first, points, views, config.with_cap(most - n_shell), rasterizer
    )
    return concatenate(covered, far_shell(covered, CameraBall.around(points, views), n_shell))


def _limited(splats: Gaussians, views: Sequence[TrainView]) -> Gaussians:
    """``splats`` no larger than `_LARGEST`: lone points do not stretch over what covers fill."""
    positions = np.array([view.camera.position for view in views])
    largest = np.log(_LARGEST * cKDTree(positions).query(splats.means)[0] + 1e-9)
    limits = largest.astype(np.float32)[:, None]
    return replace(splats, log_scales=np.minimum(splats.log_scales, limits))
