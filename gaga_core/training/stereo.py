"""Dense points from posed photos by multi-view stereo, for a training to start from.

Structure from motion finds a few hundred points in a dozen photos, and splats that grow from so few
settle wherever the training photos allow: as haze in front of every other camera. Where photos
overlap, matching small windows between them tells the depth of each pixel. PatchMatch over planes
(Barnes 2009; Bleyer 2011) finds it, and only depths that other photos confirm are taken
(Schoenberger 2016).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree

from gaga_core.arrays import (
    BoolArray,
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    UInt8Array,
    UInt32Array,
    check_shape,
)
from gaga_core.camera import Camera
from gaga_core.progress import Progress, Stage
from gaga_core.threads import n_threads, run_chunks
from gaga_core.training import stereo_kernels as kernels
from gaga_core.training.settings import STEREO_SIDE, STEREO_VIEWS
from gaga_core.training.views import TrainView

T = TypeVar("T")
STAGE = "Match surfaces"
_SOURCES = 4  # photos that each photo is compared with
_FEWEST = 8  # points that two photos share, for either to be compared with the other
_ANGLE = 10.0  # degrees between two views of a point that tell its depth best
_NARROW, _WIDE = 5.0, 20.0  # degrees: how fast smaller and larger angles lose worth
_SWEEPS = 4
_STEEPEST = 2.0  # tangent of the largest slant of a surface, about
_NEAREST, _FARTHEST = 1.7, 0.3  # x the largest and smallest inverse depth of the known points
_TAIL = 0.01  # quantile of known points that may be wrong
_LEAST_SCORE = 0.7  # correlation
_TOLERANCE = 0.01  # relative difference of two depths of one surface
_CONFIRMED = 2  # photos that must agree
# Of one object alone: pixels of the longest side of what is cut out, room around its splats there,
# fewest pixels of a side, and how well depths must agree. Half of the tolerance of whole scenes
# finds as much of the inside of a mug (ycb_table) and half as much that is not there. A score of
# 0.5 opens insides a tenth more, and the wall of a bowl with them.
_OBJECT_SIDE, _ROOM, _SMALLEST = 128, 8, 16
OBJECT_VIEWS = 40  # enough of an object
_OBJECT_TOLERANCE = 0.005


@dataclass(frozen=True, eq=False)
class _Photo:
    """A photo at matching size with its place in the list of all pixels."""

    view: TrainView
    grey: FloatArray  # (H, W) in 0..1
    offset: int

    @property
    def camera(self) -> Camera:
        return self.view.camera

    @property
    def place(self) -> tuple[int, int, int]:
        """Data of a source for the kernels."""
        return self.offset, self.camera.width, self.camera.height


@dataclass(frozen=True, eq=False)
class _Sources:
    """The photos that one photo is compared with, and how its pixels are seen there."""

    numbers: LongArray  # (S,)
    places: LongArray  # (S, 3) offset, width, height
    M: DoubleArray  # (S, 3, 3)
    t: DoubleArray  # (S, 3)


@dataclass(frozen=True, eq=False)
class DepthView:
    """How far what a photo shows of an object is, where other photos confirm it."""

    camera: Camera  # of the part of the photo that shows it
    depth: DoubleArray  # (H, W) along the viewing direction; 0 = not known


@dataclass(frozen=True, eq=False)
class _DepthMap:
    planes: DoubleArray  # (H, W, 3) inverse depth, and its change by a pixel right and down
    scores: FloatArray  # (H, W) correlation, -1..1


def stereo_points_stage(
    points: DoubleArray,  # (P, 3) world
    views: Sequence[TrainView],
    most: int,
    seed: int = 0,
) -> Stage[tuple[DoubleArray, UInt8Array]]:
    """At most ``most`` points (Q, 3) world on the surfaces that several views see, with colors.

    ``points`` of structure from motion tell which photos show the same, and how far they are. The
    result does not depend on the number of threads.
    """
    check_shape("points", points, ("P", 3))
    photos = _photos(evenly(views, STEREO_VIEWS), STEREO_SIDE)
    sources, maps = yield from _matched_stage(points, photos)
    found, colors = _confirmed(photos, sources, maps)
    if len(found) > most:
        chosen = np.sort(np.random.default_rng(seed).permutation(len(found))[:most])
        found, colors = found[chosen], colors[chosen]
    return found, colors


def object_depths_stage(
    points: DoubleArray,  # (P, 3) of its splats, world
    views: Sequence[TrainView],
) -> Stage[list[DepthView]]:
    """What ``views`` say of where an object is: its part of each of them."""
    check_shape("points", points, ("P", 3))
    parts = [part for view in views if (part := _part_of(view, points)) is not None]
    photos = _photos(parts, _OBJECT_SIDE)
    sources, maps = yield from _matched_stage(points, photos)
    counts, _ = _agreeing(photos, sources, maps, _OBJECT_TOLERANCE)
    return [
        DepthView(photo.camera, np.where(n >= _CONFIRMED, 1 / found.planes[..., 0], 0.0))
        for photo, n, found in zip(photos, counts, maps, strict=True)
        if found.planes[..., 0].all()
    ]


def evenly(views: Sequence[T], most: int) -> list[T]:
    """At most ``most`` of ``views``, or of their cameras, evenly among all."""
    n = min(len(views), most)
    return [views[i] for i in np.unique(np.linspace(0, len(views) - 1, n).astype(int))]


def _part_of(view: TrainView, points: DoubleArray) -> TrainView | None:
    """The part of a view around ``points``; None where it shows little of them."""
    pixels, depths = view.camera.project(points)
    if not (depths > 0).all():
        return None
    size = np.array([view.camera.width, view.camera.height])
    lo = np.clip(np.floor(pixels.min(axis=0)) - _ROOM, 0, size).astype(int)
    hi = np.clip(np.ceil(pixels.max(axis=0)) + _ROOM, 0, size).astype(int)
    if (hi - lo < _SMALLEST).any():
        return None
    K = view.camera.K.copy()
    K[:2, 2] -= lo
    width, height = (hi - lo).tolist()
    camera = replace(view.camera, K=K, width=width, height=height)
    rows, columns = slice(lo[1], hi[1]), slice(lo[0], hi[0])
    return TrainView(camera, np.ascontiguousarray(view.picture[rows, columns]))


def _photos(views: Sequence[TrainView], side: int) -> list[_Photo]:
    """``views`` with no side longer than ``side`` pixels."""
    photos, offset = list[_Photo](), 0
    for whole in views:
        view = whole.smaller(min(1.0, side / max(whole.camera.width, whole.camera.height)))
        grey = view.target() @ np.array([0.299, 0.587, 0.114], np.float32)
        photos.append(_Photo(view, np.ascontiguousarray(grey, np.float32), offset))
        offset += grey.size
    return photos


def _matched_stage(
    points: DoubleArray, photos: Sequence[_Photo]
) -> Stage[tuple[list[_Sources], list[_DepthMap]]]:
    """What each photo is compared with, and its depth map."""
    seen = [photo.camera.shows(*photo.camera.project(points)) for photo in photos]
    sources = [_sources(i, photos, points, seen) for i in range(len(photos))]
    none = np.zeros(0, np.uint32)
    pixels = np.concatenate([none, *(kernels.packed(photo.grey) for photo in photos)])
    maps: list[_DepthMap] = []
    while len(maps) < len(photos):
        yield Progress(STAGE, len(maps), len(photos), "depth")
        some = range(len(maps), min(len(maps) + n_threads(), len(photos)))
        maps += _match(some, photos, sources, pixels, [points[s] for s in seen])
    return sources, maps


def _sources(
    index: int, photos: Sequence[_Photo], points: DoubleArray, seen: Sequence[BoolArray]
) -> _Sources:
    """The photos that share most points with photo ``index``, at angles that tell depth."""
    own = photos[index].camera
    worth = np.zeros(len(photos))
    for j, other in enumerate(photos):
        both = seen[index] & seen[j]
        if j != index and both.sum() >= _FEWEST:
            angles = _angles(own.position, other.camera.position, points[both])
            width = np.where(angles < _ANGLE, _NARROW, _WIDE)
            worth[j] = np.exp(-0.5 * ((angles - _ANGLE) / width) ** 2).sum()
    order = np.argsort(-worth, kind="stable")[:_SOURCES]
    numbers = np.sort(order[worth[order] > 0])
    relations = [_relation(own, photos[j].camera) for j in numbers]
    return _Sources(
        numbers,
        np.array([photos[j].place for j in numbers], np.int64).reshape(-1, 3),
        np.array([M for M, _ in relations]).reshape(-1, 3, 3),
        np.array([t for _, t in relations]).reshape(-1, 3),
    )


def _angles(a: DoubleArray, b: DoubleArray, points: DoubleArray) -> DoubleArray:
    """Angles in degrees at which ``points`` (P, 3) see positions ``a`` and ``b``."""
    to_a, to_b = a - points, b - points
    lengths = np.linalg.norm(to_a, axis=1) * np.linalg.norm(to_b, axis=1)
    cosine = (to_a * to_b).sum(axis=1) / np.maximum(lengths, 1e-12)
    result: DoubleArray = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return result


def _relation(camera: Camera, source: Camera) -> tuple[DoubleArray, DoubleArray]:
    """M (3, 3) and t (3,) of `stereo_kernels`, between pixel indices of two cameras."""
    to_index = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
    pose = source.cam_from_world @ camera.world_from_cam
    K, K_source = to_index @ camera.K, to_index @ source.K
    return K_source @ pose[:3, :3] @ np.linalg.inv(K), K_source @ pose[:3, 3]


def _match(
    some: range,
    photos: Sequence[_Photo],
    sources: Sequence[_Sources],
    pixels: UInt32Array,
    known: Sequence[DoubleArray],
) -> list[_DepthMap]:
    """The depth maps of ``some`` photos, one a thread."""
    maps = [_first_map(photos[i].camera, known[i]) for i in some]

    def work(start: int, stop: int) -> None:
        for i, found in zip(some[start:stop], maps[start:stop], strict=True):
            camera, inverse = photos[i].camera, found.planes[..., 0]
            if len(sources[i].numbers) == 0 or not inverse.any():
                continue
            kernels.match_view(
                photos[i].grey,
                pixels,
                sources[i].places,
                sources[i].M,
                sources[i].t,
                float(inverse.min()) * _FARTHEST,
                float(inverse.max()) * _NEAREST,
                _STEEPEST / camera.K[0, 0],
                _SWEEPS,
                i + 1,
                found.planes,
                found.scores,
            )

    run_chunks(work, len(maps), 1)
    return maps


def _first_map(camera: Camera, points: DoubleArray) -> _DepthMap:
    """Everywhere the depth of the nearest of ``points`` in the picture, facing the camera."""
    planes = np.zeros((camera.height, camera.width, 3))
    scores = np.full(planes.shape[:2], -1, np.float32)
    if len(points) >= _FEWEST:
        pixels, depths = camera.project(points)
        inverse = 1 / depths
        inverse = np.clip(inverse, *np.quantile(inverse, [_TAIL, 1 - _TAIL]))
        v, u = np.indices(scores.shape)
        at = np.stack([u.ravel(), v.ravel()], axis=1) + 0.5
        planes[..., 0] = inverse[cKDTree(pixels).query(at)[1]].reshape(scores.shape)
    return _DepthMap(planes, scores)


def _confirmed(
    photos: Sequence[_Photo], sources: Sequence[_Sources], maps: Sequence[_DepthMap]
) -> tuple[DoubleArray, UInt8Array]:
    """Points (Q, 3) and colors where depth maps agree; a surface is taken from the first photo."""
    points, colors = [], []
    agreeing = zip(*_agreeing(photos, sources, maps, _TOLERANCE), strict=True)
    for photo, near, found, (counts, is_new) in zip(photos, sources, maps, agreeing, strict=True):
        v, u = np.nonzero((counts >= max(1, min(_CONFIRMED, len(near.numbers)))) & is_new)
        K, pose = photo.camera.K, photo.camera.world_from_cam
        rays = np.stack(
            [(u + 0.5 - K[0, 2]) / K[0, 0], (v + 0.5 - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=1
        )
        points.append(rays / found.planes[v, u, :1] @ pose[:3, :3].T + pose[:3, 3])
        colors.append(photo.view.picture[v, u])
    return np.concatenate(points), np.concatenate(colors)


def _agreeing(
    photos: Sequence[_Photo],
    sources: Sequence[_Sources],
    maps: Sequence[_DepthMap],
    tolerance: float,
) -> tuple[list[IntArray], list[BoolArray]]:
    """Of each pixel (H, W): how many sources agree with it, and whether none before it does."""
    inverse = [np.where(m.scores >= _LEAST_SCORE, m.planes[..., 0], 0).ravel() for m in maps]
    joined = np.concatenate([np.zeros(0), *inverse]).astype(np.float32)
    all_counts, all_new = [], []
    for i, (photo, near, found) in enumerate(zip(photos, sources, maps, strict=True)):
        counts = np.zeros(found.scores.shape, np.int32)
        is_new = np.ones(found.scores.shape, np.bool_)
        own = joined[photo.offset : photo.offset + counts.size].reshape(counts.shape)
        kernels.count_agreeing(
            own,
            joined,
            near.places,
            near.M,
            near.t,
            near.numbers < i,
            tolerance,
            counts,
            is_new,
        )
        all_counts.append(counts)
        all_new.append(is_new)
    return all_counts, all_new
