"""What the checks need to know of a model: plain arrays that the worker writes."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pycolmap

from gaga_core.arrays import AnyArray, DoubleArray, LongArray
from gaga_core.io.files import atomic_write

_STILL = 0.004  # x width: a match that moved less stands still in the picture
_CELLS = 12  # across and down, to see where a picture has features
_TURN_MATCHES = 60  # from which a pair says how its cameras are turned
_MATCHES = 100  # verified matches of a pair that are kept, evenly spread


def write_facts(
    path: Path, model: pycolmap.Reconstruction, database: Path, model_sizes: Sequence[int]
) -> None:
    """Write the arrays of `measures.SfmFacts` for ``model`` and the matches in ``database``."""
    images = sorted(model.images.values(), key=lambda image: str(image.name))
    images = [image for image in images if image.has_pose]
    points = {int(key): i for i, key in enumerate(model.points3D)}
    arrays = _model_arrays(model, images)
    arrays |= _observations(model, images, points)
    arrays |= _matches(model, images, points, database)
    arrays["model_sizes"] = np.array(model_sizes, np.int64)
    _write(path, arrays)


def _write(path: Path, arrays: Mapping[str, AnyArray]) -> None:
    """Write named arrays whole or not at all: the next run reads what a killed one has left."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def _model_arrays(
    model: pycolmap.Reconstruction, images: Sequence[pycolmap.Image]
) -> dict[str, AnyArray]:
    used = [model.cameras[image.camera_id] for image in images]
    points = list(model.points3D.values())
    focal = [(c.focal_length_x, c.focal_length_y) for c in used]
    return {
        "names": np.array([str(image.name) for image in images], np.str_),
        "poses": np.array(
            [image.cam_from_world().matrix() for image in images], np.float64
        ).reshape(-1, 3, 4),
        "focal": np.array(focal, np.float64).reshape(-1, 2),
        "sizes": np.array([(c.width, c.height) for c in used], np.int64).reshape(-1, 2),
        "points": np.array([p.xyz for p in points], np.float64).reshape(-1, 3),
        "track_lengths": np.array([p.track.length() for p in points], np.int64),
    }


def _observations(
    model: pycolmap.Reconstruction, images: Sequence[pycolmap.Image], points: dict[int, int]
) -> dict[str, AnyArray]:
    """Which point is seen in which view, and how far from where it should be."""
    columns: list[tuple[LongArray, LongArray, DoubleArray]] = []
    for i, image in enumerate(images):
        seen = [p for p in image.points2D if p.has_point3D()]
        if not seen:
            continue
        rows = np.array([points[int(p.point3D_id)] for p in seen], np.int64)
        xyz = np.array([model.points3D[int(p.point3D_id)].xyz for p in seen], np.float64)
        pose = np.asarray(image.cam_from_world().matrix())
        in_camera = xyz @ pose[:, :3].T + pose[:, 3]
        found = np.array([p.xy for p in seen], np.float64)
        expected = model.cameras[image.camera_id].img_from_cam(in_camera, check_cheirality=False)
        errors = np.linalg.norm(np.asarray(expected) - found, axis=1)
        columns.append((rows, np.full(len(rows), i, np.int64), errors))
    empty: tuple[AnyArray, ...] = (np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    joined = [np.concatenate(c) for c in zip(*columns, strict=True)] if columns else list(empty)
    return dict(zip(("seen_points", "seen_views", "seen_errors"), joined, strict=True))


def _matches(
    model: pycolmap.Reconstruction,
    images: Sequence[pycolmap.Image],
    points: dict[int, int],
    database: Path,
) -> dict[str, AnyArray]:
    """A sample of the verified matches: their views, viewing rays and points (-1 = none)."""
    view_of = {int(image.image_id): i for i, image in enumerate(images)}
    opened = pycolmap.Database.open(database)
    all_names = sorted(str(image.name) for image in opened.read_all_images())
    name_of = {int(image.image_id): str(image.name) for image in opened.read_all_images()}
    keys, geometries = opened.read_two_view_geometries()
    opened.close()
    ids = np.array([_pair_of(int(key)) for key in keys], np.int64).reshape(-1, 2)
    inliers = [np.asarray(geometry.inlier_matches) for geometry in geometries]
    counts = np.array([len(matches) for matches in inliers], np.int64)
    place = {name: i for i, name in enumerate(all_names)}
    rays = [_rays(model, image) for image in images]
    seen = [_point_rows(image, points) for image in images]
    rows: list[AnyArray] = []
    ray_pairs: list[AnyArray] = []
    for (a, b), matches in zip(ids, inliers, strict=True):
        if len(matches) == 0 or int(a) not in view_of or int(b) not in view_of:
            continue
        chosen = matches[np.linspace(0, len(matches) - 1, min(_MATCHES, len(matches))).astype(int)]
        va, vb = view_of[int(a)], view_of[int(b)]
        ka, kb = chosen[:, 0], chosen[:, 1]
        views = np.tile([va, vb], (len(chosen), 1))
        rows.append(np.c_[views, seen[va][ka], seen[vb][kb]])
        ray_pairs.append(np.stack([rays[va][ka], rays[vb][kb]], axis=1))
    names_of_pairs = [[place[name_of[int(i)]] for i in pair] for pair in ids]
    return {
        "all_names": np.array(all_names, np.str_),
        "pairs": np.array(names_of_pairs, np.int64).reshape(-1, 2),
        "pair_matches": counts,
        "match_views": np.concatenate(rows)[:, :2] if rows else np.zeros((0, 2), np.int64),
        "match_points": np.concatenate(rows)[:, 2:] if rows else np.zeros((0, 2), np.int64),
        "match_rays": np.concatenate(ray_pairs) if rows else np.zeros((0, 2, 3)),
    }


def write_match_facts(path: Path, database: Path) -> None:
    """Write the arrays of `sfm_diagnosis.MatchFacts`: what the matching says before any model."""
    opened = pycolmap.Database.open(database)
    images = sorted(opened.read_all_images(), key=lambda image: str(image.name))
    place = {int(image.image_id): i for i, image in enumerate(images)}
    cameras = {int(c.camera_id): c for c in opened.read_all_cameras()}
    points = [np.asarray(opened.read_keypoints(i.image_id), np.float64)[:, :2] for i in images]
    keys, geometries = opened.read_two_view_geometries()
    opened.close()
    sides = np.array([max(cameras[int(i.camera_id)].width, 1) for i in images], np.float64)
    pairs = [[place[i] for i in _pair_of(int(key))] for key in keys]
    matches = [np.asarray(geometry.inlier_matches).reshape(-1, 2) for geometry in geometries]
    still = []
    for (a, b), m in zip(pairs, matches, strict=True):
        moved = points[a][m[:, 0]] / sides[a] - points[b][m[:, 1]] / sides[b]
        still.append(float((np.linalg.norm(moved, axis=1) < _STILL).mean()) if len(m) else 0.0)
    used = [cameras[int(image.camera_id)] for image in images]
    turns = [
        _turn(used[a], points[a], used[b], points[b], geometry)
        for (a, b), geometry in zip(pairs, geometries, strict=True)
    ]
    _write(
        path,
        {
            "names": np.array([str(image.name) for image in images], np.str_),
            "n_features": np.array([len(p) for p in points], np.int64),
            "coverage": np.array(
                [
                    _coverage(p, cameras[int(i.camera_id)])
                    for p, i in zip(points, images, strict=True)
                ]
            ),
            "pairs": np.array(pairs, np.int64).reshape(-1, 2),
            "pair_matches": np.array([len(m) for m in matches], np.int64),
            "still": np.array(still, np.float64),
            "turns": np.array(turns, np.float64).reshape(-1, 3, 3),
        },
    )


def _turn(
    first: pycolmap.Camera,
    first_points: AnyArray,  # (F, 2) pixels
    second: pycolmap.Camera,
    second_points: AnyArray,
    geometry: pycolmap.TwoViewGeometry,
) -> DoubleArray:
    """Rotation (3, 3) from the first camera to the second; NaN where the matches do not say.

    Few matches do not, and planes have two answers. Where no focal length is known, COLMAP's guess
    stands in: good enough for large contradictions.
    """
    kinds = pycolmap.TwoViewGeometryConfiguration
    has_depth = geometry.config in (int(kinds.CALIBRATED), int(kinds.UNCALIBRATED))
    if has_depth and len(geometry.inlier_matches) >= _TURN_MATCHES:
        pycolmap.estimate_two_view_geometry_pose(
            first, first_points, second, second_points, geometry
        )
        if geometry.cam2_from_cam1 is not None:
            return np.array(geometry.cam2_from_cam1.rotation.matrix(), np.float64)
    return np.full((3, 3), np.nan)


def write_pair_matches(path: Path, database: Path) -> None:
    """Write what `pose_check` compares with given poses: matched places as shares of the pictures.

    Arrays: names (A,), pairs (Q, 2), pair_matches (Q,), match_names (M, 2) indices into names,
    match_places (M, 2, 2) xy over width and height.
    """
    opened = pycolmap.Database.open(database)
    images = sorted(opened.read_all_images(), key=lambda image: str(image.name))
    place = {int(image.image_id): i for i, image in enumerate(images)}
    cameras = {int(c.camera_id): c for c in opened.read_all_cameras()}
    sizes = [(cameras[int(i.camera_id)].width, cameras[int(i.camera_id)].height) for i in images]
    points = [
        np.asarray(opened.read_keypoints(image.image_id))[:, :2] / size
        for image, size in zip(images, sizes, strict=True)
    ]
    keys, geometries = opened.read_two_view_geometries()
    opened.close()
    pairs = np.array([[place[i] for i in _pair_of(int(key))] for key in keys], np.int64)
    inliers = [np.asarray(geometry.inlier_matches).reshape(-1, 2) for geometry in geometries]
    views, places = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2, 2))]
    for (a, b), matches in zip(pairs.reshape(-1, 2), inliers, strict=True):
        step = np.linspace(0, len(matches) - 1, min(_MATCHES, len(matches))).astype(int)
        chosen = matches[step]
        views.append(np.tile([a, b], (len(chosen), 1)))
        places.append(np.stack([points[a][chosen[:, 0]], points[b][chosen[:, 1]]], axis=1))
    _write(
        path,
        {
            "names": np.array([str(image.name) for image in images], np.str_),
            "pairs": pairs.reshape(-1, 2),
            "pair_matches": np.array([len(matches) for matches in inliers], np.int64),
            "match_names": np.concatenate(views),
            "match_places": np.concatenate(places),
        },
    )


def _coverage(points: AnyArray, camera: pycolmap.Camera) -> float:
    """Share of the cells of a picture that hold a feature."""
    size = np.array([camera.width, camera.height], np.float64)
    cells = np.clip((points / size * _CELLS).astype(np.int64), 0, _CELLS - 1)
    return len(np.unique(cells[:, 0] * _CELLS + cells[:, 1])) / _CELLS**2


def _pair_of(key: int) -> tuple[int, int]:
    """Image ids of COLMAP's pair id."""
    low = key % 2147483647
    return (key - low) // 2147483647, low


def _rays(model: pycolmap.Reconstruction, image: pycolmap.Image) -> DoubleArray:
    """Unit viewing directions (F, 3), camera frame, of all features of a view."""
    pixels = np.array([p.xy for p in image.points2D], np.float64).reshape(-1, 2)
    flat = np.asarray(model.cameras[image.camera_id].cam_from_img(pixels))
    rays = np.c_[flat, np.ones(len(flat))]
    result: DoubleArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return result


def _point_rows(image: pycolmap.Image, points: dict[int, int]) -> LongArray:
    return np.array(
        [points[int(p.point3D_id)] if p.has_point3D() else -1 for p in image.points2D], np.int64
    )
