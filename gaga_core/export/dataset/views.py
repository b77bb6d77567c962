"""New views of a scene: near where photos were taken, and only where they show what photos saw."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, FloatArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.raster.cpu.rasterizer import Labelled

TRIES = 8  # proposals of a view, each nearer to a photo than the one before
_SIDE = 160  # pixels of the longest side of a photo's depth
_STEP = 8  # pixels between the points of a picture that are judged
_PHOTOS = 2  # that must have shown a point: one alone may be wrong about its depth
_SAME_DEPTH = 0.05  # of the depth: so far off the photo's surface a point is still on it
_ANGLE = np.cos(np.radians(35))  # between the photo's ray and the view's: a surface looks alike
_NEARER = 2.5  # times smaller a point may be in the photo than in the view
_NEIGHBOURS = 6  # photos next to one: a view stands between it and one of them
_JITTER = 0.15  # of the distance to the target: how far a view stands off the line of two photos
# Of the photos' distance: views of an object, and views of what photos looked at.
CLOSER, ALIKE = (0.6, 1.15), (0.9, 1.1)
_AIM = 0.12  # of the distance: how far from the middle the target is
_ROLL = np.radians(6)
_EMPTY = 0.05  # share of a picture that may be emptier than the photos' pictures are
_SOLID = 0.5  # alpha of a pixel that shows a surface


def rng_of(*key: object) -> np.random.Generator:
    """A generator that depends on ``key`` alone: equal on all machines, whatever came before."""
    return np.random.default_rng(number_of(*key))


def number_of(*key: object) -> int:
    """A number of 64 bits that depends on ``key`` alone.

    The object of the smallest number is chosen of many (rendezvous hashing, Thaler and
    Ravishankar 1998): another object that comes or goes leaves most choices as they were.
    """
    return int.from_bytes(hashlib.blake2b(repr(key).encode(), digest_size=8).digest(), "little")


@dataclass(frozen=True, eq=False)
class Photos:
    """The photos' cameras at a small size, with the depth that each saw."""

    cameras: tuple[Camera, ...]
    depths: tuple[FloatArray, ...]  # (H, W) scene units; 0 = nothing
    alphas: tuple[FloatArray, ...]  # (H, W)
    focals: tuple[float, ...]  # pixels, of the photos at their own size
    empty: float  # share of a picture without a surface, of the emptiest photos
    up: DoubleArray  # (3,) unit, world

    @cached_property
    def looked_at(self) -> DoubleArray:
        """The point (V, 3), world, in the middle of each photo."""
        found = []
        for camera, depth in zip(self.cameras, self.depths, strict=True):
            height, width = depth.shape
            # The rest is often far behind: views of a point there would turn away from the middle.
            middle = depth[height // 3 : -(height // 3), width // 3 : -(width // 3)]
            seen = middle[middle > 0] if (middle > 0).any() else depth[depth > 0]
            far = float(np.median(seen)) if len(seen) else 1.0
            found.append(camera.position + far * camera.forward)
        return np.array(found)

    @cached_property
    def digest(self) -> str:
        """Of the cameras and their up."""
        poses = [(np.round(c.cam_from_world, 9).tolist(), f) for c, f in self._own()]
        told = repr((poses, np.round(self.up, 9).tolist()))
        return hashlib.blake2b(told.encode(), digest_size=8).hexdigest()

    def _own(self) -> Iterator[tuple[Camera, float]]:
        return zip(self.cameras, self.focals, strict=True)

    @cached_property
    def usual(self) -> float:
        """Share of a photo that as many others show as a view must be shown by, 0..1: the median.

        Of a few dozen it is nearly 1, of eight around a table 0.4 to 0.6.
        """
        found = []
        for camera, depth, focal in zip(self.cameras, self.depths, self.focals, strict=True):
            rows, columns = np.nonzero(depth[_STEP // 2 :: _STEP, _STEP // 2 :: _STEP])
            v, u = _STEP * rows + _STEP // 2, _STEP * columns + _STEP // 2
            if len(v) == 0:
                continue
            z = depth[v, u].astype(np.float64)
            points = camera.position + z[:, None] * camera.rays(np.c_[u, v] + 0.5)
            eyes = np.tile(camera.position, (len(points), 1))
            found.append(self.coverage(points, eyes, z / focal).mean())
        return float(np.median(found)) if found else 1.0

    @cached_property
    def positions(self) -> DoubleArray:
        """Centres of projection (V, 3), world."""
        return np.array([camera.position for camera in self.cameras])

    def coverage(self, points: DoubleArray, eyes: DoubleArray, pixel: DoubleArray) -> BoolArray:
        """Which points (N, 3) enough photos saw from about where ``eyes`` (N, 3) are.

        ``pixel`` (N,): size of a pixel of the view at the point, scene units.
        """
        seen = np.zeros(len(points), np.int32)
        rays = points - eyes
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
        for camera, depth, focal in zip(self.cameras, self.depths, self.focals, strict=True):
            pixels, z = camera.project(points)
            inside = camera.shows(pixels, z)
            column, row = np.where(inside[:, None], pixels, 0).astype(np.int64).T
            on_surface = np.abs(depth[row, column] - z) < _SAME_DEPTH * z
            own = points - camera.position
            own /= np.maximum(np.linalg.norm(own, axis=1, keepdims=True), 1e-12)
            aligned = (own * rays).sum(axis=1) > _ANGLE
            seen += inside & on_surface & aligned & (z / focal < _NEARER * pixel)
        return seen >= min(_PHOTOS, len(self.cameras))


def photos_stage(
    gaussians: Gaussians, cameras: Sequence[Camera], up: DoubleArray, rasterizer: Rasterizer
) -> Stage[Photos]:
    """Draw the depth that each photo saw of the scene as it is."""
    small, depths, alphas = list[Camera](), list[FloatArray](), list[FloatArray]()
    empty: list[float] = []
    for i, camera in enumerate(cameras):
        yield Progress("Look through the photos", i, len(cameras), camera.name)
        view = camera.at_most(_SIDE)
        frame = rasterizer.render(gaussians, view)
        small.append(view)
        depths.append(frame.median_depth)
        alphas.append(frame.alpha)
        empty.append(float((frame.alpha < _SOLID).mean()))
    focals = tuple(float(camera.K[0, 0]) for camera in cameras)
    emptiest = float(np.percentile(empty, 90))
    return Photos(tuple(small), tuple(depths), tuple(alphas), focals, emptiest, up)


def lens(cameras: Sequence[Camera], width: int, height: int) -> DoubleArray:
    """K (3, 3) of new views: the middle focal length of the photos, as wide as they are."""
    focal = float(np.median([c.K[0, 0] / c.width for c in cameras])) * width
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])


def proposal(
    photos: Photos,
    K: DoubleArray,
    size: tuple[int, int],
    target: DoubleArray,
    rng: np.random.Generator,
    attempt: int,
    closer: tuple[float, float],
) -> Camera:
    """A view of ``target`` (3,) between two photos that show it; ever nearer to one of them.

    ``closer``: least and largest distance, times that of the photo.
    """
    free = 1 - attempt / (TRIES - 1)
    positions = photos.positions
    shown = [bool(camera.shows(*camera.project(target[None]))[0]) for camera in photos.cameras]
    near = np.flatnonzero(shown) if any(shown) else np.arange(len(shown))
    first = int(rng.choice(near))
    order = np.argsort(np.linalg.norm(positions[near] - positions[first], axis=1))
    other = int(near[order[int(rng.integers(0, min(len(near), _NEIGHBOURS + 1)))]])
    share = free * rng.uniform(0, 0.5)
    ends = positions[[first, other]] - target
    # Along an arc: on the line between two photos a view is nearer than both.
    weights, lengths = np.array([1 - share, share]), np.linalg.norm(ends, axis=1)
    distance = max(float(weights @ lengths) * (1 + free * (rng.uniform(*closer) - 1)), 1e-9)
    way = weights @ ends
    eye = target + way * distance / max(float(np.linalg.norm(way)), 1e-9)
    eye = eye + free * _JITTER * distance * rng.normal(0, 0.5, 3)
    aim = target + _AIM * distance * free * rng.normal(0, 1, 3)
    pose = look_at(eye, aim, photos.up)
    roll = free * rng.normal(0, _ROLL)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]
    return Camera(K, turn @ pose, *size)


def judged(
    photos: Photos,
    camera: Camera,
    drawn: Labelled,
    motions: Mapping[int, DoubleArray],  # (4, 4) world map of each moved object
) -> float:
    """Share of the picture that photos showed, 0..1; moved objects count where they stood."""
    rows, columns = (np.arange(_STEP // 2, n, _STEP) for n in drawn.alpha.shape)
    grid = np.ix_(rows, columns)
    v, u = np.meshgrid(rows + 0.5, columns + 0.5, indexing="ij")
    alpha, z = drawn.alpha[grid].ravel(), drawn.median_depth[grid].ravel().astype(np.float64)
    solid = (alpha >= _SOLID) & (z > 0)
    if (~solid).mean() > photos.empty + _EMPTY or not solid.any():
        return 0.0
    z = z[solid]
    points = camera.position + z[:, None] * camera.rays(np.c_[u.ravel(), v.ravel()][solid])
    eyes = np.tile(camera.position, (len(points), 1))
    ids = drawn.outlines.labels[grid].ravel()[solid]
    for group, motion in motions.items():
        own = ids == group
        back = np.linalg.inv(motion)
        points[own] = points[own] @ back[:3, :3].T + back[:3, 3]
        eyes[own] = eyes[own] @ back[:3, :3].T + back[:3, 3]
    return float(photos.coverage(points, eyes, z / camera.K[0, 0]).mean())
