"""The first Gaussians of a training: one for each point that structure from motion found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array, check_shape
from gaga_core.color import dc_from_rgb
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.reconstruct.optimizer import concatenate
from gaga_core.reconstruct.settings import TrainConfig
from gaga_core.reconstruct.stereo import stereo_points_stage
from gaga_core.reconstruct.views import TrainView

STAGE = "Place first splats"
_NEIGHBOURS = 3
_FEWEST = 4  # points, for each to have its neighbours
_COARSE = 64  # pixels of the longest side of the pictures in which holes are looked for
_HOLE = 0.3  # coverage under which a pixel is a hole
_AROUND = 16  # points next to a hole that tell its depth
_OVERLAP = 0.7  # standard deviation of a splat for a hole, in its pixels
_OTHERS = 0.6  # a cover nearer to another camera than this x to its own is put far away
_BEYOND = 2.0  # radius of the ball that it is put on, x the distance of the farthest camera
_FAR = 0.9  # quantile of their depths: what is plain is mostly behind


def initial_gaussians(
    points: DoubleArray,  # (P, 3) world
    colors: UInt8Array,  # (P, 3)
    *,
    opacity: float = 0.1,
    scale: float = 1.0,
) -> Gaussians:
    """A round splat at each point: as large as its three nearest points are far (Kerbl 2023).

    Points that are not finite are left out. Raises ``GagaError`` when fewer than 4 are left.
    """
    check_shape("points", points, ("P", 3))
    check_shape("colors", colors, (len(points), 3), np.uint8)
    finite = np.isfinite(points).all(axis=1)
    points, colors = points[finite], colors[finite]
    if len(points) < _FEWEST:
        raise GagaError(
            f"The model has {len(points)} points, too few to start from. Take more photos that "
            "overlap, and reconstruct again."
        )
    size = scale * np.maximum(neighbour_distance(points), 1e-7)
    return round_gaussians(points, size, colors * np.float32(1 / 255), opacity)


def neighbour_distance(points: DoubleArray) -> DoubleArray:
    """Root mean square distance (P,) of each point to its three nearest."""
    distances: DoubleArray = np.asarray(cKDTree(points).query(points, _NEIGHBOURS + 1)[0])
    result: DoubleArray = np.sqrt((distances[:, 1:] ** 2).mean(axis=1))
    return result


def round_gaussians(
    means: DoubleArray, size: DoubleArray, rgb: FloatArray, opacity: float
) -> Gaussians:
    """Splats of equal axes ``size`` (N,), colors ``rgb`` (N, 3) in 0..1, and one opacity."""
    n = len(means)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    return Gaussians(
        means=np.ascontiguousarray(means, np.float32),
        quats=quats,
        log_scales=np.repeat(np.log(size)[:, None], 3, axis=1).astype(np.float32),
        logit_opacities=np.full(n, np.log(opacity / (1 - opacity)), np.float32),
        sh=dc_from_rgb(rgb)[:, None],
    )


def first_splats_stage(
    points: DoubleArray,  # (P, 3) world
    colors: UInt8Array,  # (P, 3)
    views: Sequence[TrainView],
    config: TrainConfig,
    rasterizer: Rasterizer,
) -> Stage[Gaussians]:
    """What a training of ``config`` starts from: `initial_gaussians`, then `cover_holes_stage`.

    Fewer points than `TrainConfig.stereo` are joined by those of `stereo.stereo_points_stage`. More
    than the cap on splats are thinned at random, from the seed.
    """
    check_shape("points", points, ("P", 3))
    most = config.density.max_splats
    n_more = min(config.stereo, most) - len(points)
    if n_more > 0:
        more, more_colors = yield from stereo_points_stage(points, views, n_more, config.seed)
        points = np.concatenate([points, more])
        colors = np.concatenate([colors, more_colors])
    if len(points) > most:
        chosen = np.random.default_rng(config.seed).permutation(len(points))[:most]
        points, colors = points[chosen], colors[chosen]
    first = initial_gaussians(
        points, colors, opacity=config.initial_opacity, scale=config.initial_scale
    )
    return (yield from cover_holes_stage(first, points, views, config, rasterizer))


def cover_holes_stage(
    initial: Gaussians,
    points: DoubleArray,  # (P, 3) world
    views: Sequence[TrainView],
    config: TrainConfig,
    rasterizer: Rasterizer,
) -> Stage[Gaussians]:
    """``initial`` and at most `TrainConfig.cover` splats where views show none of it: sky, walls.

    Structure from motion finds no points there, and density control takes long to grow into a void.
    View by view, each hole of a coarse picture gets a splat of the photo's color, at the far end of
    the depths of the points that lie next to it in the picture; later views see it too. Where that
    is in front of another camera, it goes onto a ball around all cameras, and hides nothing.
    """
    result, shell = initial, _Shell.around(points, views)
    n_left = min(config.cover, config.density.max_splats - len(initial))
    for i, view in enumerate(views):
        yield Progress(STAGE, i, len(views), view.camera.name)
        if n_left <= 0:
            break
        coarse = view.smaller(_COARSE / max(view.camera.width, view.camera.height))
        more = _fill(_opaque(result), points, shell, coarse, rasterizer, config.initial_opacity)
        # The first views meet all holes: they may take what later ones will not need.
        most = min(n_left, max(-(-n_left // (len(views) - i)), n_left // 4))
        if len(more) > most:
            more = more.take(np.linspace(0, len(more) - 1, most).astype(np.int64))
        result = concatenate(result, more)
        n_left -= len(more)
    return result


@dataclass(frozen=True, eq=False)
class _Shell:
    """All cameras, and a ball around them: what is put on it is in front of none."""

    positions: DoubleArray  # (V, 3) world
    middle: DoubleArray  # (3,) world
    radius: float  # scene units

    @staticmethod
    def around(points: DoubleArray, views: Sequence[TrainView]) -> "_Shell":
        """Around the middle of ``points``."""
        middle = np.median(points, axis=0)
        positions = np.array([view.camera.position for view in views])
        farthest = np.linalg.norm(positions - middle, axis=1).max()
        return _Shell(positions, middle, float(_BEYOND * farthest))

    def behind_others(self, eye: DoubleArray, rays: DoubleArray, depth: DoubleArray) -> DoubleArray:
        """``depth`` (P,) along ``rays`` (P, 3) from the camera at ``eye``; but on the ball, where
        that is nearer to another camera than `_OTHERS` x to this one."""
        places = eye + rays * depth[:, None]
        own = np.linalg.norm(places - eye, axis=1)
        is_near = cKDTree(self.positions).query(places)[0] < _OTHERS * own
        a, b = (rays**2).sum(axis=1), rays @ (eye - self.middle)
        c = ((eye - self.middle) ** 2).sum() - self.radius**2
        far = (np.sqrt(b**2 - a * c) - b) / a
        result: DoubleArray = np.where(is_near, np.maximum(depth, far), depth)
        return result


def _opaque(gaussians: Gaussians) -> Gaussians:
    """What they will cover when they are trained."""
    return replace(gaussians, logit_opacities=np.full(len(gaussians), 3, np.float32))


def _fill(
    known: Gaussians,
    points: DoubleArray,
    shell: _Shell,
    view: TrainView,
    rasterizer: Rasterizer,
    opacity: float,
) -> Gaussians:
    """Splats for the holes that ``known`` leaves in a coarse view."""
    camera = view.camera
    alpha = rasterizer.render(known, camera).alpha
    pixels, depths = camera.project(points)
    near = (
        (depths > 0)
        & (pixels > 0).all(axis=1)
        & (pixels < [camera.width, camera.height]).all(axis=1)
    )
    v, u = np.nonzero(alpha < _HOLE)
    if near.sum() < _AROUND or len(u) == 0:
        return known.take(np.zeros(0, np.int64))
    at = np.stack([u, v], axis=1) + 0.5
    around = cKDTree(pixels[near]).query(at, _AROUND)[1]
    depth = np.quantile(depths[near][around], _FAR, axis=1)
    rays = np.c_[(at - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]], np.ones(len(at))]
    rays = rays @ camera.world_from_cam[:3, :3].T
    depth = shell.behind_others(camera.position, rays, depth)
    p_world = camera.position + rays * depth[:, None]
    size = _OVERLAP * depth / camera.K[0, 0]
    return round_gaussians(p_world, size, view.target()[v, u], opacity)
