"""Align two captures by their photos: features that photos of both show.

Each capture triangulates its features alone, from the poses that it has. Features that match across
say where one point lies in both worlds: a similarity by RANSAC (Fischler 1981) from three of them,
then the one with the least errors in the photos. How far it moves when other photos are drawn
(Efron 1979, bootstrap) says how sure it is.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, LongArray
from gaga_core.camera import Camera, natural_order
from gaga_core.geometry import fit_similarity
from gaga_core.io.arrays_file import TEXT, Column, read_columns
from gaga_core.io.cameras.given import Lens
from gaga_core.placing import photos as looking
from gaga_core.placing.photos import Photo, PhotoSet, prepare_photos
from gaga_core.placing.sfm import TITLES, CameraGroup, SfmConfig, run_matching, run_step
from gaga_core.progress import Progress, Stage, mapped, part
from gaga_core.scene.captures.alignment import (
    CURES,
    Alignment,
    By,
    Capture,
    NotAlignedError,
    difference,
    trusted,
)
from gaga_core.scene.frame import inverse

STAGE = "Align captures"
# What steps are called that work on drawn surfaces, by their names for photos.
OF_SURFACES = {looking.STAGE: "Look at the drawn surfaces", TITLES["match"]: "Match surfaces"}
_NOTHING_SHARED: Mapping[By, str] = {
    "photos": "No photo of one capture shows what photos of the other show.",
    "surfaces": "No surface of one capture looks like one of the other.",
}
MOST_PHOTOS = 24  # of a capture, spread over it: all pairs of both are matched
_PHOTO_SIDE = 1600  # pixels: larger photos are shrunk
_SCORED = 1500  # points that draws are judged by, and all refinements but the last
_LEAST = 6  # points: three make a similarity, and three more contradict it
_FLAT = 1e-12  # determinant of a similarity of points on a line
_SIDES = ("a", "b")  # folders of the photos of the two captures
_FEATURES = {
    "names": replace(TEXT, shape=("A",)),
    "first": Column(np.int64, ("A1",), low=0),
    "places": Column(np.float64, ("F", 2)),
    "matches": Column(np.int64, ("M", 2), low=0, below="F"),
}


@dataclass(frozen=True)
class PhotoConfig:
    """How photos are matched, and what fits. Errors are in shares of the focal length: 0.001 is a
    pixel of a photo with a focal length of 1,000 pixels."""

    track_error: float = 0.004  # of a feature to the point that it is of
    fit_error: float = 0.006  # of a point of the other capture
    least_angle: float = 0.02  # radians: smallest angle between the rays of a point
    draws: int = 3000  # of three points
    bootstrap: int = 24  # draws of photos


_CONFIG = PhotoConfig()
_TURNS = 3  # of choosing the points that fit and refining the similarity
_DRAWN = 1 + _TURNS + _CONFIG.bootstrap  # steps of finding the similarity of shared points


@dataclass(frozen=True, eq=False)
class Shared:
    """M features that match across: one point in both worlds, side by side (first, second)."""

    points: DoubleArray  # (2, M, 3) in the world of its capture
    poses: DoubleArray  # (2, M, 3, 4) cam_from_world of the photo that shows it
    seen: DoubleArray  # (2, M, 2) where, x and y over depth
    focal: DoubleArray  # (2, M) pixels, of that photo
    photos: LongArray  # (2, M) number of that photo
    tracks: LongArray  # (2, M) number of the point

    def __len__(self) -> int:
        return len(self.points[0])

    def take(self, rows: LongArray | BoolArray) -> "Shared":
        """Some of them."""
        return Shared(*(getattr(self, name)[:, rows] for name in self.__dataclass_fields__))


def align_by_photos_stage(
    first: Capture,
    second: Capture,
    workspace: Path,  # a new folder of its own
    *,
    threads: int = 0,
    seed: int = 0,
    by: By = "photos",
) -> Stage[Alignment]:
    """How ``second`` lies in the world of ``first``; ``by`` what the photos are: "surfaces" that
    were drawn.

    Raises ``NotAlignedError`` where the photos do not say.
    """
    names = OF_SURFACES if by == "surfaces" else {}
    matching = _matched(first, second, workspace, threads, seed)
    shared = yield from mapped(
        matching, lambda step: replace(step, stage=names.get(step.stage, step.stage))
    )
    return trusted((yield from align_shared_stage(shared, seed=seed, by=by)))


def _matched(
    first: Capture,
    second: Capture,
    workspace: Path,
    threads: int,
    seed: int,
) -> Stage[Shared]:
    sets: list[Photo] = []
    posed: dict[str, Camera] = {}
    lenses: dict[str, Lens] = {}
    for i, (side, capture) in enumerate(zip(_SIDES, (first, second), strict=True)):
        shown = [camera for camera in capture.cameras if camera.name in capture.photos]
        shown.sort(key=lambda camera: natural_order(camera.name))
        rows = np.linspace(0, len(shown) - 1, min(len(shown), MOST_PHOTOS)).round()
        chosen = {capture.photos[shown[k].name]: shown[k] for k in rows.astype(int)}
        root = Path(os.path.commonpath([path.parent for path in chosen]))
        # Each by itself: a photo that both captures have is no copy that is left out.
        preparing = prepare_photos(
            list(chosen), workspace / "photos" / side, root=root, longest_side=_PHOTO_SIDE
        )
        found = yield from part(preparing, i, len(_SIDES), looking.STAGE)
        for photo in found.photos:
            camera = chosen[Path(photo.source)]
            focal = float(camera.K[0, 0]) * photo.width / camera.width
            sets.append(replace(photo, name=f"{side}/{photo.name}", focal=focal))
            posed[sets[-1].name] = camera
            if camera.name in capture.lenses:
                lenses[sets[-1].name] = capture.lenses[camera.name]
    photos = PhotoSet(tuple(sets))
    sfm = SfmConfig.of("draft", threads=threads, seed=seed)
    sfm = replace(sfm, pairs="exhaustive", camera_model="PINHOLE")
    groups = _groups(photos, posed, lenses) if lenses else ()
    yield from run_matching(photos, workspace, sfm, groups=groups)
    yield from run_step("export_features", photos, workspace, sfm)
    arrays = read_columns(workspace / "features.npz", "Try again.", _FEATURES)
    return shared_of(arrays, posed)


def _groups(
    photos: PhotoSet, posed: Mapping[str, Camera], lenses: Mapping[str, Lens]
) -> tuple[CameraGroup, ...]:
    """The photos of each lens: that in ``lenses``, else the pinhole of the camera."""
    groups: dict[Lens, list[str]] = {}
    for photo in photos.photos:
        lens = lenses.get(photo.name) or _pinhole(posed[photo.name])
        groups.setdefault(lens.resized(photo.width, photo.height), []).append(photo.name)
    return tuple(
        CameraGroup(tuple(names), lens.width, lens.height, None, lens.model, lens.params)
        for lens, names in groups.items()
    )


def _pinhole(camera: Camera) -> Lens:
    params = (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2])
    return Lens("PINHOLE", camera.width, camera.height, tuple(map(float, params)))


def shared_of(arrays: Mapping[str, np.ndarray], posed: Mapping[str, Camera]) -> Shared:
    """Points that both captures know, from the features of `placing.worker.write_features`."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    names, first, places = arrays["names"].tolist(), arrays["first"], arrays["places"]
    views = [posed[name] for name in names]
    photo = np.repeat(np.arange(len(names)), np.diff(first))  # (F,)
    sizes = np.array([(view.width, view.height) for view in views], np.float64)
    focal = np.array([(view.K[0, 0], view.K[1, 1]) for view in views])
    middle = np.array([view.K[:2, 2] for view in views])
    poses = np.array([view.cam_from_world[:3] for view in views], np.float64)
    seen = (places * sizes[photo] - middle[photo]) / focal[photo]  # (F, 2)
    is_second = np.array([name.startswith(_SIDES[1]) for name in names])[photo]
    matches = arrays["matches"]
    is_across = is_second[matches[:, 0]] != is_second[matches[:, 1]]
    i, j = matches[~is_across].T
    n = len(photo)
    graph = coo_matrix((np.ones(len(i), np.bool_), (i, j)), (n, n))
    track: LongArray = connected_components(graph, directed=False)[1].astype(np.int64)
    points, good = _triangulated(track, photo, seen, poses)
    across = matches[is_across]
    across = np.where(is_second[across[:, :1]], across[:, ::-1], across).T  # (2, M)
    known = good[track[across]].all(axis=0)
    error = _errors(points[track[across]], poses[photo[across]], seen[across])
    across = across[:, known & (error < _CONFIG.track_error).all(axis=0)]
    at = photo[across]
    return Shared(points[track[across]], poses[at], seen[across], focal[at, 0], at, track[across])


def _errors(points: DoubleArray, poses: DoubleArray, seen: DoubleArray) -> DoubleArray:
    """Distance (...,) between where points (..., 3) project and where they are ``seen``; infinite
    behind the camera."""
    # Written out for each coordinate: einsum of small matrices takes twice the time.
    x, y, z = (points[..., k] for k in range(3))
    u, v, depth = (
        p[..., 0] * x + p[..., 1] * y + p[..., 2] * z + p[..., 3]
        for p in (poses[..., i, :] for i in range(3))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.sqrt((u / depth - seen[..., 0]) ** 2 + (v / depth - seen[..., 1]) ** 2)
    result: DoubleArray = np.where(depth > 1e-9, off, np.inf)
    return result


def _triangulated(
    track: LongArray, photo: LongArray, seen: DoubleArray, poses: DoubleArray
) -> tuple[DoubleArray, BoolArray]:
    """Points (T, 3) of the tracks, and which are well known: rays that do not fit are left out."""
    n = int(track.max(initial=-1)) + 1
    rays = np.einsum("fji,fj->fi", poses[photo, :, :3], np.c_[seen, np.ones(len(seen))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    centres = -np.einsum("vji,vj->vi", poses[:, :, :3], poses[:, :, 3])[photo]
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    side = np.einsum("fij,fj->fi", across, centres)
    used = np.bincount(track, minlength=n)[track] > 1
    points, good = np.zeros((n, 3)), np.zeros(n, np.bool_)
    for _ in range(3):
        normal, right = np.zeros((n, 3, 3)), np.zeros((n, 3))
        np.add.at(normal, track[used], across[used])
        np.add.at(right, track[used], side[used])
        # The least eigenvalue of two rays at an angle t is 1 - cos(t), about t^2 / 2.
        good = np.linalg.eigvalsh(normal)[:, 0] > _CONFIG.least_angle**2 / 2
        points[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
        error = _errors(points[track], poses[photo], seen)
        worst = np.zeros(n)
        np.maximum.at(worst, track[used], np.minimum(error[used], 1e9))
        good &= worst < _CONFIG.track_error
        used &= (error < _CONFIG.track_error) | (error < 0.5 * worst[track])
    return points, good


def align_shared_stage(shared: Shared, *, seed: int = 0, by: By = "photos") -> Stage[Alignment]:
    """The similarity that most of the shared points fit. Raises ``NotAlignedError`` without any."""
    said = f"{len(shared):,} shared features"
    yield Progress(STAGE, 0, _DRAWN, said)
    n_all = len(np.unique(shared.tracks[0]))
    rng = np.random.default_rng(seed)
    best = _ransac(shared, rng) if n_all >= _LEAST else np.eye(4)
    for turn in range(_TURNS):
        yield Progress(STAGE, 1 + turn, _DRAWN, said)
        fits = np.flatnonzero(_fit_errors(best, shared).max(axis=0) < _CONFIG.fit_error)
        if n_all < _LEAST or len(fits) < _LEAST:
            raise NotAlignedError(f"{_NOTHING_SHARED[by]} {CURES[by]}")
        # The first turns only choose points: some of them say enough. The last one uses all.
        some = fits if turn == _TURNS - 1 else rng.permutation(fits)[:_SCORED]
        best = _refined(best, shared.take(some))
    moved = shared.points[1, fits] @ best[:3, :3].T + best[:3, 3]
    apart = np.linalg.norm(moved - shared.points[0, fits], axis=1)
    n_points = len(np.unique(shared.tracks[0, fits]))
    pixels = _fit_errors(best, shared)[:, fits] * shared.focal[:, fits]
    angle, scale = yield from _spread(best, shared.take(fits), rng)
    off = float(np.median(pixels)) if by == "photos" else None
    share, residual = n_points / n_all, float(np.median(apart))
    return Alignment(best, by, n_points, share, residual, off, angle, scale)


def _fit_errors(world: DoubleArray, shared: Shared) -> DoubleArray:
    """Errors (2, M) of the other capture's points in the photos, as shares of the focal length."""
    back = inverse(world)
    first = shared.points[1] @ world[:3, :3].T + world[:3, 3]
    second = shared.points[0] @ back[:3, :3].T + back[:3, 3]
    return _errors(np.stack([first, second]), shared.poses, shared.seen)


def _ransac(shared: Shared, rng: np.random.Generator) -> DoubleArray:
    """The best of many similarities (4, 4) that fit three points exactly."""
    _, rows = np.unique(shared.tracks[0], return_index=True)  # each point once
    rows = rng.permutation(rows)[:_SCORED]
    some = shared.take(rows)
    chosen = np.array([rng.choice(len(rows), 3, replace=False) for _ in range(_CONFIG.draws)])
    source, target = some.points[1][chosen], some.points[0][chosen]
    best, most = np.eye(4), -1
    for linear in fit_similarity(source, target):
        world = np.vstack([linear, [0, 0, 0, 1]])
        if not np.linalg.det(linear[:, :3]) > _FLAT:
            continue
        n = int((_fit_errors(world, some).max(axis=0) < _CONFIG.fit_error).sum())
        if n > most:
            best, most = world, n
    return best


def _refined(start: DoubleArray, shared: Shared) -> DoubleArray:
    """The similarity (4, 4) near ``start`` with the least errors in the photos, outliers damped."""
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    middle = shared.points[0].mean(axis=0)
    extent = float(np.linalg.norm(shared.points[0] - middle, axis=1).mean())

    def changed(x: DoubleArray) -> DoubleArray:
        change = np.eye(4)
        change[:3, :3] = np.exp(x[3]) * Rotation.from_rotvec(x[:3]).as_matrix()
        change[:3, 3] = middle - change[:3, :3] @ middle + extent * x[4:]
        return change @ start

    def errors(x: DoubleArray) -> DoubleArray:
        return np.minimum(_fit_errors(changed(x), shared), 1.0).ravel()

    damped = _CONFIG.fit_error / 4
    found = least_squares(errors, np.zeros(7), loss="soft_l1", f_scale=damped, max_nfev=20)
    return changed(found.x)


def _spread(
    best: DoubleArray, shared: Shared, rng: np.random.Generator
) -> Stage[tuple[float, float]]:
    """Standard errors of rotation (radians) and scale (relative), by draws of the photos."""
    views = np.unique(shared.photos)
    off = []
    for i in range(_CONFIG.bootstrap):
        yield Progress(STAGE, _DRAWN - _CONFIG.bootstrap + i, _DRAWN, "how sure it is")
        weight = np.bincount(rng.choice(views, len(views)), minlength=int(views.max()) + 1)
        count = weight[shared.photos].prod(axis=0)  # of each feature in this draw
        rows = np.repeat(np.arange(len(count)), count)
        if len(np.unique(shared.tracks[0, rows])) >= _LEAST:
            rows = rng.permutation(rows)[:_SCORED]
            off.append(difference(best, _refined(best, shared.take(rows))))
    if len(off) < _CONFIG.bootstrap / 2:  # two or three photos hold all of it
        return np.inf, np.inf
    turn, scale = np.sqrt(np.mean(np.square(off), axis=0)).tolist()
    return turn, scale
