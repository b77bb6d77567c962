"""Splats where photos show something but no point was found: sky, plain walls."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import DoubleArray
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.reconstruct.initial import round_gaussians
from gaga_core.reconstruct.optimizer import concatenate
from gaga_core.reconstruct.settings import TrainConfig
from gaga_core.reconstruct.views import TrainView

STAGE = "Place first splats"
_COARSE = 64  # pixels of the longest side of the pictures in which holes are looked for
_HOLE = 0.3  # coverage under which a pixel is a hole
_UNLIKE = 0.03  # in 0..1: pixels nearer to the background color need no splat
_AROUND = 16  # points next to a hole that tell its depth
_OVERLAP = 0.7  # standard deviation of a splat for a hole, in its pixels
_OTHERS = 0.6  # a cover nearer to another camera than this x to its own is put far away
_BEYOND = 2.0  # radius of the ball around all cameras, x the distance of the farthest
_FAR = 0.9  # quantile of their depths: what is plain is mostly behind


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
    is in front of another camera, it goes onto a ball around all cameras, and hides nothing. Pixels
    in the color of `TrainConfig.background`, as masks leave them, get none.
    """
    result, ball = initial, CameraBall.around(points, views)
    n_left = min(config.cover, config.density.max_splats - len(initial))
    for i, view in enumerate(views):
        yield Progress(STAGE, i, len(views), view.camera.name)
        if n_left <= 0:
            break
        coarse = view.smaller(_COARSE / max(view.camera.width, view.camera.height))
        more = _fill(_opaque(result), points, ball, coarse, rasterizer, config)
        # The first views meet all holes: they may take what later ones will not need.
        most = min(n_left, max(-(-n_left // (len(views) - i)), n_left // 4))
        if len(more) > most:
            more = more.take(np.linspace(0, len(more) - 1, most).astype(np.int64))
        result = concatenate(result, more)
        n_left -= len(more)
    return result


@dataclass(frozen=True, eq=False)
class CameraBall:
    """All cameras, and a ball around them: what is put on it is in front of none."""

    positions: DoubleArray  # (V, 3) world
    middle: DoubleArray  # (3,) world
    farthest: float  # distance of the farthest camera from the middle, scene units

    @staticmethod
    def around(points: DoubleArray, views: Sequence[TrainView]) -> "CameraBall":
        """Around the middle of ``points`` (P, 3)."""
        middle = np.median(points, axis=0)
        positions = np.array([view.camera.position for view in views])
        farthest = np.linalg.norm(positions - middle, axis=1).max()
        return CameraBall(positions, middle, float(farthest))

    @property
    def radius(self) -> float:
        """Radius of the ball, scene units."""
        return _BEYOND * self.farthest

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
    ball: CameraBall,
    view: TrainView,
    rasterizer: Rasterizer,
    config: TrainConfig,
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
    shows_something = (np.abs(view.target() - config.background) > _UNLIKE).any(axis=2)
    v, u = np.nonzero((alpha < _HOLE) & shows_something)
    if near.sum() < _AROUND or len(u) == 0:
        return known.take(np.zeros(0, np.int64))
    at = np.stack([u, v], axis=1) + 0.5
    around = cKDTree(pixels[near]).query(at, _AROUND)[1]
    depth = np.quantile(depths[near][around], _FAR, axis=1)
    rays = np.c_[(at - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]], np.ones(len(at))]
    rays = rays @ camera.world_from_cam[:3, :3].T
    depth = ball.behind_others(camera.position, rays, depth)
    p_world = camera.position + rays * depth[:, None]
    size = _OVERLAP * depth / camera.K[0, 0]
    return round_gaussians(p_world, size, view.target()[v, u], config.initial_opacity)
