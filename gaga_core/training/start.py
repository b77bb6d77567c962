"""The start of a training: points, splats that cover the holes between them, a background."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray, UInt8Array, check_shape
from gaga_core.camera import Camera
from gaga_core.color import dc_from_rgb, rgb_from_dc
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.training.optimizer import concatenate
from gaga_core.training.settings import TrainConfig, fewness
from gaga_core.training.stereo import stereo_points_stage
from gaga_core.training.views import TrainView, TrainViews

# --- The first Gaussians of a training: one for each point that structure from motion found.


_INITIAL_NEIGHBOURS = 3
_FEWEST_POINTS = 4  # points, for each to have its neighbours


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
    if len(points) < _FEWEST_POINTS:
        raise GagaError(
            f"The model has {len(points)} points, too few to start from. Take more photos that "
            "overlap, and reconstruct again."
        )
    size = scale * np.maximum(neighbour_distance(points), 1e-7)
    return round_gaussians(points, size, colors * np.float32(1 / 255), opacity)


def neighbour_distance(points: DoubleArray) -> DoubleArray:
    """Root mean square distance (P,) of each point to its three nearest."""
    distances: DoubleArray = np.asarray(cKDTree(points).query(points, _INITIAL_NEIGHBOURS + 1)[0])
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


def random_points(cameras: Sequence[Camera], n: int, seed: int) -> DoubleArray:
    """Points (n, 3) world for cameras that come without any: uniform in a box three times the
    extent of the cameras (Kerbl et al. 2023, section 7.4)."""
    positions = np.array([camera.position for camera in cameras])
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    half = 1.5 * max(float(np.ptp(positions, axis=0).max()), 1e-6)
    points: DoubleArray = middle + np.random.default_rng(seed).uniform(-half, half, (n, 3))
    return points


# --- Splats where photos show something but no point was found: sky, plain walls.


STAGE = "Place first splats"
_COARSE_SIDE = 64  # pixels of the longest side of the pictures in which holes are looked for
_HOLE_COVERAGE = 0.3  # coverage under which a pixel is a hole
_UNLIKE_BACKGROUND = 0.03  # in 0..1: pixels nearer to the background color need no splat
_AROUND = 16  # points next to a hole that tell its depth
_COVER_OVERLAP = 0.7  # standard deviation of a splat for a hole, in its pixels
_OTHERS = 0.6  # a cover nearer to another camera than this x to its own is put far away
_BEYOND = 2.0  # radius of the ball around all cameras, x the distance of the farthest
_FAR_QUANTILE = 0.9  # quantile of their depths: what is plain is mostly behind


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
        coarse = view.smaller(_COARSE_SIDE / max(view.camera.width, view.camera.height))
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
        return np.where(is_near, np.maximum(depth, far), depth)


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
    near = camera.shows(pixels, depths)
    target = view.target(np.array(config.background, np.float32))
    shows_something = (np.abs(target - config.background) > _UNLIKE_BACKGROUND).any(axis=2)
    v, u = np.nonzero((alpha < _HOLE_COVERAGE) & shows_something)
    if near.sum() < _AROUND or len(u) == 0:
        return known.take(np.zeros(0, np.int64))
    at = np.stack([u, v], axis=1).astype(np.float64) + 0.5
    around = cKDTree(pixels[near]).query(at, _AROUND)[1]
    depth = np.quantile(depths[near][around], _FAR_QUANTILE, axis=1)
    rays = camera.rays(at)
    depth = ball.behind_others(camera.position, rays, depth)
    p_world = camera.position + rays * depth[:, None]
    size = _COVER_OVERLAP * depth / camera.K[0, 0]
    return round_gaussians(p_world, size, target[v, u], config.initial_opacity)


# --- A closed background: a sphere of splats behind everything that photos show.
# Between few photos a new view looks past the splats of all of them, into directions that no photo
# shows, and there is nothing but black. A far shell closes these gaps with the colors of what is
# seen next to them. Where photos do show something it is behind that, or is trained like any other
# splat.


_OUTSIDE = 1.5  # x distance of the farthest camera: splats beyond are background
_OUTERMOST = 0.995  # quantile of the distances of all splats that the shell encloses
_MARGIN = 1.2  # radius of the shell, x that distance or the radius of the ball of the cameras
_SHELL_NEIGHBOURS = 16  # background splats whose colors a splat of the shell mixes
_GAP_DEGREES = 30.0  # degrees from the nearest of them: no shell beyond
_SHELL_OVERLAP = 0.6  # standard deviation, x the distance from one splat of the shell to the next
_SOFT = 1e-3  # squared distance on the unit sphere that nearer neighbours do not count more for
_SHELL_OPACITY = 0.95  # nothing may be seen through it: where no photo looks it stays as it is


def far_shell(splats: Gaussians, ball: CameraBall, most: int) -> Gaussians:
    """At most ``most`` splats on a sphere around ``splats`` and all cameras.

    They lie in the directions, seen from the middle of ``ball``, within `_GAP_DEGREES` of a
    background splat, and have the colors of these, nearer ones counting more. None at all where
    there is no background.
    """
    away = splats.means - ball.middle
    distances = np.linalg.norm(away, axis=1)
    is_background = distances > _OUTSIDE * ball.farthest
    if is_background.sum() < _SHELL_NEIGHBOURS or most == 0:
        return splats.take(np.zeros(0, np.int64))
    radius = _MARGIN * max(float(np.quantile(distances, _OUTERMOST)), ball.radius)
    known = cKDTree(away[is_background] / distances[is_background, None])
    directions = even_directions(most)
    found = known.query(directions, _SHELL_NEIGHBOURS)
    apart, neighbours = np.asarray(found[0]), np.asarray(found[1])
    is_near = apart[:, 0] < 2 * np.sin(np.radians(_GAP_DEGREES) / 2)
    weights = 1 / (apart[is_near] ** 2 + _SOFT)
    weights /= weights.sum(axis=1, keepdims=True)
    rgb = np.clip(rgb_from_dc(splats.sh[is_background, 0]), 0, 1)
    colors = (weights[..., None] * rgb[neighbours[is_near]]).sum(axis=1)
    size = _SHELL_OVERLAP * np.sqrt(4 * np.pi / most) * radius
    return round_gaussians(
        ball.middle + radius * directions[is_near],
        np.full(int(is_near.sum()), size),
        colors.astype(np.float32),
        _SHELL_OPACITY,
    )


def even_directions(n: int) -> DoubleArray:
    """Unit vectors (n, 3) spread evenly over the sphere: a spiral of golden angles."""
    k = np.arange(n) + 0.5
    height = 1 - 2 * k / n
    turn = np.pi * (1 + np.sqrt(5)) * k
    width = np.sqrt(1 - height**2)
    return np.stack([width * np.cos(turn), width * np.sin(turn), height], axis=1)


# --- Points of depth that a phone measured.


_DEPTH_APART = 0.1  # relative, from a point of structure from motion ...
_AGREEING = 0.3  # ... and the share of those in a view that must be as near: others are hidden
_FEWEST_COMPARED = 10  # points of a view that its depth is compared with
_STEEPEST_STEP = 0.05  # relative, to the next pixel: what lies between two surfaces is nowhere


def with_sure_depth(views: TrainViews, points: DoubleArray) -> TrainViews:
    """``views`` without depth that contradicts ``points`` (P, 3) world."""

    def sure(view: TrainView) -> TrainView:
        is_sure = view.depth is not None and _agrees(view.depth, view.camera, points)
        return view if is_sure else replace(view, depth=None)

    return replace(views, train=tuple(map(sure, views.train)))


def depth_points(views: Sequence[TrainView], n: int, seed: int) -> tuple[DoubleArray, UInt8Array]:
    """At most ``n`` points (M, 3) of the measured depth of ``views`` with their colors (M, 3); none
    where no view has any."""
    places, colors = [np.zeros((0, 3))], [np.zeros((0, 3), np.uint8)]
    for view in views:
        if view.depth is None:
            continue
        depth = view.depth
        step = maximum_filter(depth, 3) - minimum_filter(depth, 3)  # holes are steps, too
        v, u = np.nonzero((depth > 0) & (step < _STEEPEST_STEP * depth))
        at = (np.stack([u, v], axis=1) + 0.5) / depth.shape[::-1]
        size = np.array([view.camera.width, view.camera.height])
        x, y = (at * size).astype(np.int64).T
        camera = view.camera
        places.append(camera.position + camera.rays(at * size) * depth[v, u, None])
        colors.append(view.picture[y, x])
    found, rgb = np.concatenate(places), np.concatenate(colors)
    chosen = np.random.default_rng(seed).permutation(len(found))[:n]
    return found[chosen], rgb[chosen]


def _agrees(depth: FloatArray, camera: Camera, points: DoubleArray) -> bool:
    """Whether points that a view shows are about as far as its depth says, so that it is of this
    photo and in the unit of the scene."""
    height, width = depth.shape
    small = camera.resized(width, height)
    pixels, far = small.project(points)
    shown = small.shows(pixels, far)
    u, v = pixels[shown].astype(np.int64).T
    measured, far = depth[v, u], far[shown]
    known = measured > 0
    if known.sum() < _FEWEST_COMPARED:
        return False
    return bool((np.abs(measured / far - 1)[known] < _DEPTH_APART).mean() > _AGREEING)


_LARGEST_SHARE = 0.05  # standard deviation, x the distance to the nearest camera
_INSIDE = 0.7  # share of the views in which a point is on the object: masks have faults
_COVER_PART = 4  # points leave one part in so many of the cap to what covers holes
_SHELL_PART = 20  # the shell takes at most one part in so many of the cap


def first_splats_stage(
    points: DoubleArray,  # (P, 3) world
    colors: UInt8Array,  # (P, 3)
    views: Sequence[TrainView],
    config: TrainConfig,
    rasterizer: Rasterizer,
) -> Stage[Gaussians]:
    """What a training of ``config`` starts from: splats for points, then for holes, then a shell.

    Fewer points than `TrainConfig.stereo` are joined by `depth_points`, or without measured depth
    by those of `stereo.stereo_points_stage`. More than the cap on splats admits next to the cover
    and the shell are thinned at random, from the seed.
    """
    check_shape("points", points, ("P", 3))
    most = config.density.max_splats
    n_shell = min(config.shell_of(len(views)), most // _SHELL_PART)
    most_points = most - min(config.cover + n_shell, most // _COVER_PART)
    n_more = min(config.stereo, most_points) - len(points)
    if n_more > 0:
        more, more_colors = depth_points(views, n_more, config.seed)
        if len(more) == 0:
            more, more_colors = yield from stereo_points_stage(points, views, n_more, config.seed)
        points = np.concatenate([points, more])
        colors = np.concatenate([colors, more_colors])
    inside = in_foreground(points, views)
    points, colors = points[inside], colors[inside]
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


def in_foreground(points: DoubleArray, views: Sequence[TrainView]) -> BoolArray:
    """Which points (P,) lie on the object in most views that show them; all without masks."""
    shown, inside = np.zeros(len(points)), np.zeros(len(points))
    for view in views:
        if view.alpha is None:
            continue
        pixels, depths = view.camera.project(points)
        rows = np.flatnonzero(view.camera.shows(pixels, depths))
        u, v = pixels[rows].astype(np.int64).T
        shown[rows] += 1
        inside[rows] += view.alpha[v, u] > 0
    result: BoolArray = inside >= _INSIDE * shown
    return result


def _limited(splats: Gaussians, views: Sequence[TrainView]) -> Gaussians:
    """``splats`` no larger than `_LARGEST_SHARE`: lone points stretch over no cover."""
    positions = np.array([view.camera.position for view in views])
    largest = np.log(_LARGEST_SHARE * cKDTree(positions).query(splats.means)[0] + 1e-9)
    limits = largest.astype(np.float32)[:, None]
    return replace(splats, log_scales=np.minimum(splats.log_scales, limits))
