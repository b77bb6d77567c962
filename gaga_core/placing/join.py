"""Parts of one scene that a mapping could not place together, joined by a similarity.

An incremental mapping starts again where too few points link the next photo to what is placed. The
models that it leaves share points all the same: those of a photo that is in both, and those on the
two sides of verified matches. All of them together give the similarity between two parts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pycolmap

from gaga_core.arrays import DoubleArray, LongArray

_WIDE = 3.0  # times the tolerances of triangulation, in the first round
_CONVERGED = 1e-6  # relative change of the cost at which the adjustment ends


@dataclass(frozen=True)
class JoinConfig:
    """What holds two parts together."""

    tolerance: float = 0.04  # of the depth: how far apart the two copies of a point may lie
    fewest: int = 12  # points that agree
    share: float = 0.4  # ... of all that the two parts have in common


def join_parts(
    models: Sequence[pycolmap.Reconstruction],  # of one mapping, largest first
    database: Path,
    pictures: Path,
    options: pycolmap.IncrementalPipelineOptions,
    config: JoinConfig | None = None,
) -> list[pycolmap.Reconstruction]:
    """The models with those joined that can be, each adjusted; as many as before when none can.

    The result is a proposal: whether the matches between the parts agree with it is for
    `sfm_checks` to say.
    """
    config = config or JoinConfig()
    opened = pycolmap.Database.open(database)
    matches = list(_verified(opened))
    opened.close()
    rest, found = list(models), list[pycolmap.Reconstruction]()
    while rest:
        joined, others = rest.pop(0), list(rest)
        while others:
            links = [common_points(joined, part, matches) for part in others]
            best = max(range(len(links)), key=lambda i: len(links[i][0]))
            ours, theirs = links[best]
            part = others.pop(best)
            to_ours = similarity(theirs, ours, config.tolerance * _depth(joined), config)
            if to_ours is not None:
                united = _united(joined, part, to_ours, database)
                joined = _adjusted(united, database, pictures, options)
                rest.remove(part)
        found.append(joined)
    return found


def similarity(
    source: DoubleArray,  # (P, 3) points of one part
    target: DoubleArray,  # (P, 3) the same points in the other
    tolerance: float,  # distance in the target's units
    config: JoinConfig | None = None,
) -> pycolmap.Sim3d | None:
    """The similarity that takes ``source`` to ``target``; None when too few points agree on it."""
    config = config or JoinConfig()
    if len(source) < config.fewest:
        return None
    ransac = pycolmap.RANSACOptions()
    ransac.max_error = tolerance
    ransac.random_seed = 0
    found: Any = pycolmap.estimate_sim3d_robust(source, target, ransac)
    if found is None or found["num_inliers"] < max(config.fewest, config.share * len(source)):
        return None
    to_target: pycolmap.Sim3d = found["tgt_from_src"]
    return to_target


def common_points(
    ours: pycolmap.Reconstruction,
    theirs: pycolmap.Reconstruction,
    matches: Sequence[tuple[int, int, LongArray]],
) -> tuple[DoubleArray, DoubleArray]:
    """The same points (P, 3), (P, 3) in two models, as far as photos and matches know them.

    ``matches``: two image ids and the features (M, 2) that were matched, of each pair of photos.
    """
    a, b = _points_of_features(ours), _points_of_features(theirs)
    pairs = {
        (a[image][feature], b[image][feature])
        for image in a.keys() & b.keys()
        for feature in a[image].keys() & b[image].keys()
    }
    for first, second, features in matches:
        for i, j, columns in ((first, second, (0, 1)), (second, first, (1, 0))):
            if i in a and j in b and i not in b and j not in a:
                rows = features[:, columns].tolist()
                pairs |= {(a[i][m], b[j][n]) for m, n in rows if m in a[i] and n in b[j]}
    ordered = sorted(pairs)
    return (
        np.array([ours.points3D[p].xyz for p, _ in ordered], np.float64).reshape(-1, 3),
        np.array([theirs.points3D[q].xyz for _, q in ordered], np.float64).reshape(-1, 3),
    )


def _verified(database: pycolmap.Database) -> Iterator[tuple[int, int, LongArray]]:
    """Image ids and verified matches (M, 2) of each pair of photos."""
    keys, geometries = database.read_two_view_geometries()
    for key, geometry in zip(keys, geometries, strict=True):
        rows = np.asarray(geometry.inlier_matches, np.int64).reshape(-1, 2)
        if len(rows):
            first, second = pycolmap.pair_id_to_image_pair(key)
            yield int(first), int(second), rows


def _points_of_features(model: pycolmap.Reconstruction) -> dict[int, dict[int, int]]:
    """Of each placed image the point that each of its features belongs to."""
    return {
        int(image.image_id): {
            k: int(p.point3D_id) for k, p in enumerate(image.points2D) if p.has_point3D()
        }
        for image in model.images.values()
        if image.has_pose
    }


def _depth(model: pycolmap.Reconstruction) -> float:
    """Median distance of a point from a camera that sees it."""
    centres = {
        int(i): image.projection_center() for i, image in model.images.items() if image.has_pose
    }
    far = [
        np.linalg.norm(point.xyz - centres[int(point.track.elements[0].image_id)])
        for point in model.points3D.values()
    ]
    return float(np.median(far))


def _united(
    ours: pycolmap.Reconstruction,
    theirs: pycolmap.Reconstruction,
    to_ours: pycolmap.Sim3d,
    database: Path,
) -> pycolmap.Reconstruction:
    """All photos of both with their poses in our frame, without points.

    A photo that both hold has the pose that more points carry: the last photo that a mapping
    places before it ends is often wrong.
    """
    opened = pycolmap.Database.open(database)
    cache = pycolmap.DatabaseCache.create(opened, pycolmap.DatabaseCacheOptions())
    opened.close()
    moved = pycolmap.Reconstruction(theirs)
    moved.transform(to_ours)
    united = pycolmap.Reconstruction()
    united.load(cache)
    for number in sorted({*moved.reg_frame_ids(), *ours.reg_frame_ids()}):
        owner = max((ours, moved), key=lambda model: _n_points(model, number))
        united.frame(number).rig_from_world = owner.frame(number).rig_from_world
        united.register_frame(number)
    for number, camera in {**moved.cameras, **ours.cameras}.items():
        united.cameras[number].params = list(camera.params)
    return united


def _n_points(model: pycolmap.Reconstruction, frame: int) -> int:
    """Points that the photos of a frame see in ``model``; -1 when it is not placed there."""
    if frame not in model.reg_frame_ids():
        return -1
    ids = model.frame(frame).image_ids
    return sum(model.image(data.id).num_points3D for data in ids)


def _adjusted(
    model: pycolmap.Reconstruction,
    database: Path,
    pictures: Path,
    options: pycolmap.IncrementalPipelineOptions,
) -> pycolmap.Reconstruction:
    """Triangulated and adjusted, first with wide tolerances: the parts do not meet exactly."""
    wide = pycolmap.IncrementalPipelineOptions(options.todict())
    for name in ("create_max_angle_error", "continue_max_angle_error"):
        setattr(wide.triangulation, name, _WIDE * getattr(options.triangulation, name))
    for name in ("merge_max_reproj_error", "complete_max_reproj_error"):
        setattr(wide.triangulation, name, _WIDE * getattr(options.triangulation, name))
    wide.mapper.filter_max_reproj_error = _WIDE * options.mapper.filter_max_reproj_error
    adjustment = pycolmap.BundleAdjustmentOptions()
    adjustment.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    adjustment.ceres.solver_options.num_threads = options.num_threads
    adjustment.ceres.solver_options.function_tolerance = _CONVERGED
    adjustment.print_summary = False
    with TemporaryDirectory() as folder:
        for step in (wide, options, options):
            model = pycolmap.triangulate_points(
                model, database, pictures, folder, clear_points=True, options=step
            )
            pycolmap.bundle_adjustment(model, adjustment)
    model.normalize()
    return model
