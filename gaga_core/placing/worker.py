"""``python -m gaga_core.placing.worker SETTINGS.json``: one step of structure from motion.

Run in a process of its own: pycolmap's C++ may abort, and ending the process is how a step is
cancelled. Prints one JSON object a line: ``{"done": 3, "total": 11, "message": ".."}`` for
progress, ``{"failed": ".."}`` for a failure (exit status 1), among the lines of COLMAP's log. All
state is in the workspace folder, so a step that was ended is simply run again.
"""

import json
import shutil
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pycolmap

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, LongArray
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.cameras.given import PINHOLES
from gaga_core.io.depth_maps import DEPTH, read_scene_depth, write_scene_depth
from gaga_core.io.files import atomic_write
from gaga_core.io.folder.processes import end_with_parent
from gaga_core.io.images import read_rgb
from gaga_core.io.json_file import read_json
from gaga_core.placing.photos import DEPTH_MAPS, MASKS, prefix_of_view, turn_of_view
from gaga_core.placing.poses import centres, moved_by, similarity_between
from gaga_core.placing.sfm import FEW_PHOTOS, MATCH_SIDE, UPRIGHT, CameraGroup, StepSettings

# --- What the checks read of a model: plain arrays that the worker writes.


_STILL = 1 / 1000  # x longer side, a pixel at least: a match that moved less stands still
_FEWEST_MATCHES = 15  # unverified ones of a pair, to say how many of them stand still
_CELLS = 12  # across and down, to see where a picture has features
_TURN_MATCHES = 60  # from which a pair says how its cameras are turned
_MATCHES_OF_PAIR = 100  # verified matches of a pair that are kept, evenly spread


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
    matching = _Matching.read(database)
    all_names = [str(image.name) for image in matching.images]
    view_of_name = {str(image.name): i for i, image in enumerate(images)}
    view_of = [view_of_name.get(name, -1) for name in all_names]
    rays = [_rays(model, image) for image in images]
    seen = [_point_rows(image, points) for image in images]
    rows, ray_pairs = [np.zeros((0, 4), np.int64)], [np.zeros((0, 2, 3))]
    for (a, b), matches in zip(matching.pairs, matching.matches, strict=True):
        va, vb = view_of[a], view_of[b]
        if len(matches) and va >= 0 and vb >= 0:
            ka, kb = _sample(matches).T
            rows.append(np.c_[np.tile([va, vb], (len(ka), 1)), seen[va][ka], seen[vb][kb]])
            ray_pairs.append(np.stack([rays[va][ka], rays[vb][kb]], axis=1))
    found = np.concatenate(rows)
    return {
        "all_names": np.array(all_names, np.str_),
        "pairs": matching.pairs,
        "pair_matches": matching.counts,
        "match_views": found[:, :2],
        "match_points": found[:, 2:],
        "match_rays": np.concatenate(ray_pairs),
    }


@dataclass(frozen=True, eq=False)
class _Matching:
    """Content of a database: A photos by name, Q pairs that were matched."""

    images: list[pycolmap.Image]  # (A,)
    cameras: list[pycolmap.Camera]  # (A,) of each photo
    pairs: LongArray  # (Q, 2) indices of photos
    geometries: list[pycolmap.TwoViewGeometry]  # (Q,)
    matches: list[AnyArray]  # (Q,) verified ones (M, 2), indices of features

    @staticmethod
    def read(database: Path) -> "_Matching":
        opened = pycolmap.Database.open(database)
        images = sorted(opened.read_all_images(), key=lambda image: str(image.name))
        cameras = {int(c.camera_id): c for c in opened.read_all_cameras()}
        keys, geometries = opened.read_two_view_geometries()
        opened.close()
        place = {int(image.image_id): i for i, image in enumerate(images)}
        pairs = [[place[int(i)] for i in pycolmap.pair_id_to_image_pair(key)] for key in keys]
        return _Matching(
            images,
            [cameras[int(image.camera_id)] for image in images],
            np.array(pairs, np.int64).reshape(-1, 2),
            geometries,
            [np.asarray(geometry.inlier_matches).reshape(-1, 2) for geometry in geometries],
        )

    @property
    def names(self) -> AnyArray:
        return np.array([str(image.name) for image in self.images], np.str_)

    @property
    def counts(self) -> LongArray:
        """Verified matches (Q,) of each pair."""
        return np.array([len(matches) for matches in self.matches], np.int64)

    def keypoints(self, database: Path) -> list[DoubleArray]:
        """Pixels (F, 2) of the features of each photo."""
        opened = pycolmap.Database.open(database)
        read = opened.read_keypoints
        found = [np.asarray(read(image.image_id), np.float64)[:, :2] for image in self.images]
        opened.close()
        return found


def _sample(matches: AnyArray) -> AnyArray:
    """At most `_MATCHES_OF_PAIR` of ``matches`` (M, 2), evenly spread."""
    rows = np.linspace(0, len(matches) - 1, min(_MATCHES_OF_PAIR, len(matches))).astype(int)
    return matches.take(rows, axis=0)


def write_match_facts(path: Path, database: Path) -> None:
    """Write the arrays of `diagnosis.MatchFacts`: what the matching says before any model."""
    found = _Matching.read(database)
    points, used = found.keypoints(database), found.cameras
    sides = np.array([max(camera.width, 1) for camera in used], np.float64)
    still, turns, opened = [], [], pycolmap.Database.open(database)
    for (a, b), geometry in zip(found.pairs, found.geometries, strict=True):
        # Of all matches: the verified ones are of the background alone, or of the object alone.
        m = np.asarray(opened.read_matches(found.images[a].image_id, found.images[b].image_id))
        moved = np.linalg.norm(points[a][m[:, 0]] - points[b][m[:, 1]], axis=1)
        bound = max(1.0, _STILL * sides[a])
        still.append(float((moved < bound).mean()) if len(m) >= _FEWEST_MATCHES else np.nan)
        turns.append(_turn(used[a], points[a], used[b], points[b], geometry))
    opened.close()
    coverage = [_coverage(p, camera) for p, camera in zip(points, used, strict=True)]
    _write(
        path,
        {
            "names": found.names,
            "n_features": np.array([len(p) for p in points], np.int64),
            "coverage": np.array(coverage),
            "pairs": found.pairs,
            "pair_matches": found.counts,
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
    found = _Matching.read(database)
    cameras = zip(found.keypoints(database), found.cameras, strict=True)
    points = [pixels / (camera.width, camera.height) for pixels, camera in cameras]
    views, places = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2, 2))]
    for (a, b), matches in zip(found.pairs, found.matches, strict=True):
        ka, kb = _sample(matches).T
        views.append(np.tile([a, b], (len(ka), 1)))
        places.append(np.stack([points[a][ka], points[b][kb]], axis=1))
    _write(
        path,
        {
            "names": found.names,
            "pairs": found.pairs,
            "pair_matches": found.counts,
            "match_names": np.concatenate(views),
            "match_places": np.concatenate(places),
        },
    )


def write_features(path: Path, database: Path) -> None:
    """Write all verified matches with the features that they join, of A photos with F features.

    Arrays: names (A,), first (A + 1,) where the features of each photo begin, places (F, 2) xy over
    width and height as the pinhole of the lens sees them, matches (M, 2) of features.
    """
    found = _Matching.read(database)
    cameras = zip(found.keypoints(database), found.cameras, strict=True)
    places = [_unbent(pixels, cam) / (cam.width, cam.height) for pixels, cam in cameras]
    first = np.cumsum([0, *map(len, places)]).astype(np.int64)
    matches = [
        first[pair] + m.astype(np.int64) for pair, m in zip(found.pairs, found.matches, strict=True)
    ]
    _write(
        path,
        {
            "names": found.names,
            "first": first,
            "places": np.concatenate([np.zeros((0, 2)), *places]),
            "matches": np.concatenate([np.zeros((0, 2), np.int64), *matches]),
        },
    )


def _unbent(pixels: DoubleArray, camera: pycolmap.Camera) -> DoubleArray:
    """Where the pinhole with the focal length and centre of a lens sees its ``pixels`` (F, 2)."""
    if camera.model_name in PINHOLES or len(pixels) == 0:
        return pixels
    # Outside of what the lens model covers a ray is not known: then it fits no point.
    flat = np.nan_to_num(np.asarray(camera.cam_from_img(pixels), np.float64))
    straight: DoubleArray = (np.c_[flat, np.ones(len(flat))] @ camera.calibration_matrix().T)[:, :2]
    return straight


def _coverage(points: AnyArray, camera: pycolmap.Camera) -> float:
    """Share of the cells of a picture that hold a feature."""
    size = np.array([camera.width, camera.height], np.float64)
    cells = np.clip((points / size * _CELLS).astype(np.int64), 0, _CELLS - 1)
    return len(np.unique(cells[:, 0] * _CELLS + cells[:, 1])) / _CELLS**2


def _rays(model: pycolmap.Reconstruction, image: pycolmap.Image) -> DoubleArray:
    """Unit viewing directions (F, 3), camera frame, of all features of a view."""
    pixels = np.array([p.xy for p in image.points2D], np.float64).reshape(-1, 2)
    flat = np.asarray(model.cameras[image.camera_id].cam_from_img(pixels))
    rays = np.c_[flat, np.ones(len(flat))]
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _point_rows(image: pycolmap.Image, points: dict[int, int]) -> LongArray:
    return np.array(
        [points[int(p.point3D_id)] if p.has_point3D() else -1 for p in image.points2D], np.int64
    )


# --- Which photos to match when there are too many for all pairs: those that look alike.
# Each photo becomes one vector: its local features, summed relative to the nearest of a few
# centres that are learned from the photos themselves (VLAD, Jegou 2010). No vocabulary has to be
# shipped.


_CENTRES = 64
_CENTRE_SAMPLE = 20_000  # features that the centres are learned from
_FEATURES_OF_PHOTO = 800  # strongest features of a photo that describe it


def similar_pairs(
    descriptors: Sequence[AnyArray],  # (F, 128) of each photo
    neighbours: int,
    seed: int = 0,
) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of each photo and the ``neighbours`` that look most like it.

    Neighbours by name are among them too: photos are mostly taken in a walk.
    """
    n = len(descriptors)
    pairs = {(i, j) for i in range(n) for j in range(i + 1, min(n, i + 1 + neighbours // 4))}
    vectors = photo_vectors(descriptors, seed)
    alike = vectors @ vectors.T
    np.fill_diagonal(alike, -np.inf)
    for i in range(n):
        for j in np.argsort(-alike[i], kind="stable")[: min(neighbours, n - 1)]:
            pairs.add((min(i, int(j)), max(i, int(j))))
    return sorted(pairs)


def photo_vectors(descriptors: Sequence[AnyArray], seed: int = 0) -> DoubleArray:
    """One vector a photo (n, centres * 128): unit length, or zero for a photo without features."""
    # Loaded when it is its turn: a third of the start of every step.
    from scipy.cluster.vq import kmeans2
    from scipy.spatial.distance import cdist

    rng = np.random.default_rng(seed)
    some = [np.asarray(d[:_FEATURES_OF_PHOTO], np.float64) for d in descriptors]
    each = max(1, _CENTRE_SAMPLE // max(1, len(some)))
    sample = np.concatenate([d[rng.permutation(len(d))[:each]] for d in some])
    k = max(1, min(_CENTRES, len(sample) // 10))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of a centre that nothing is near to
        centres = kmeans2(sample, k, iter=10, minit="points", rng=rng, missing="warn")[0]
    vectors = np.zeros((len(some), k * sample.shape[1]))
    for i, d in enumerate(some):
        if len(d) == 0:
            continue
        nearest = cdist(d, centres, "sqeuclidean").argmin(axis=1)
        sums = np.zeros_like(centres)
        np.add.at(sums, nearest, d - centres[nearest])
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
        vectors[i] = (np.sign(sums) * np.sqrt(np.abs(sums))).ravel()
    vectors /= np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    return vectors


_DECIMALS = 7  # of poses, points and lenses: far finer than any photo shows
_MOST_MODELS = 4  # of one mapping that are looked at
_BETTER_LENS = 0.97  # x error: a lens with three more numbers must fit so much better
_PAIR_BLOCK = 1000  # pairs of a list that share one look-up of features


def main() -> int:
    """Run the step that the settings name."""
    end_with_parent()
    settings = read_json(Path(sys.argv[1]), StepSettings, "")
    pycolmap.set_random_seed(settings.config.seed)
    try:
        STEPS[settings.step](settings, Path(settings.workspace))
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OSError) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        _say({"failed": said[:200]})
        return 1
    return 0


def _say(values: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def _features(settings: StepSettings, workspace: Path) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = settings.config.threads
    options.max_image_size = settings.config.feature_side
    options.sift.max_num_features = settings.config.n_features
    options.sift.estimate_affine_shape = settings.config.affine
    options.sift.domain_size_pooling = settings.config.affine
    options.sift.peak_threshold = settings.config.least_contrast
    database = workspace / "database.db"
    for suffix in ("", "-wal", "-shm"):  # what an ended process left may be half-written
        database.with_name(database.name + suffix).unlink(missing_ok=True)
    pycolmap.Database.open(database).close()  # makes it
    readers, pictures = [], Path(settings.pictures)
    masks = pictures.with_name(MASKS)
    for group in settings.groups:
        reader = pycolmap.ImageReaderOptions()
        if masks.is_dir():
            reader.mask_path = str(masks)
        reader.camera_model = group.model
        if group.params or group.focal is not None:
            reader.camera_params = _camera_params(group)
        readers.append((group, reader))
    single = pycolmap.CameraMode.SINGLE
    for group, reader in readers:  # first, so that numbers do not depend on who is ready first
        pycolmap.import_images(database, pictures, single, group.names, reader)
    for group, reader in readers:
        options.sift.first_octave = -1 if settings.config.doubles(group) else 0
        pycolmap.extract_features(
            database,
            pictures,
            image_names=group.names,
            camera_mode=single,
            reader_options=reader,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )
    _mount(database, settings.groups)


def _mount(database: Path, groups: Sequence[CameraGroup]) -> None:
    """Mount the views of each panorama together, turned as they were cut."""
    rigs: dict[int, list[pycolmap.RigConfigCamera]] = {}
    for group in sorted(groups, key=lambda group: group.view or 0):
        if group.view is not None:
            camera = pycolmap.RigConfigCamera()
            camera.image_prefix = prefix_of_view(group.view, group.width)
            camera.ref_sensor = group.view == 0
            if group.view > 0:
                turn = pycolmap.Rotation3d(turn_of_view(group.view).T)
                camera.cam_from_rig = pycolmap.Rigid3d(turn, np.zeros(3))
            rigs.setdefault(group.width, []).append(camera)
    if rigs:
        opened = pycolmap.Database.open(database)
        pycolmap.apply_rig_config(
            [pycolmap.RigConfig(cameras=cameras) for cameras in rigs.values()], opened
        )
        opened.close()


def _camera_params(group: CameraGroup) -> str:
    """COLMAP's parameter text of a camera: the whole one if known, else without distortion."""
    if group.params:
        return ",".join(str(value) for value in group.params)
    model, focal = group.model, group.focal
    cx, cy = group.width / 2, group.height / 2
    tail = {"SIMPLE_PINHOLE": 0, "SIMPLE_RADIAL": 1, "RADIAL": 2}
    if model in tail:
        values = [focal, cx, cy, *[0.0] * tail[model]]
    else:
        values = [focal, focal, cx, cy, *[0.0] * {"PINHOLE": 0, "OPENCV": 4}[model]]
    return ",".join(str(value) for value in values)


def _match(settings: StepSettings, workspace: Path) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.num_threads = settings.config.threads
    matching.guided_matching = settings.config.guided
    matching.skip_image_pairs_in_same_frame = True
    verification = _verification(settings)
    device = pycolmap.Device.cpu
    n = _n_photos(settings)
    database = workspace / "database.db"
    if settings.config.pairs == "sequential":
        sequential = pycolmap.SequentialPairingOptions()
        sequential.overlap = settings.config.overlap
        pycolmap.match_sequential(database, matching, sequential, verification, device)
    elif settings.config.pairs in ("similar", "listed"):
        if settings.config.pairs == "similar":
            _write_similar(settings, workspace, settings.config.neighbours)
        listed = pycolmap.ImportedPairingOptions()
        listed.match_list_path = str(workspace / "pairs.txt")
        listed.block_size = _PAIR_BLOCK
        pycolmap.match_image_pairs(database, matching, listed, verification, device)
    else:
        exhaustive = pycolmap.ExhaustivePairingOptions()
        exhaustive.block_size = max(4, min(50, n // 5))  # one block is one step of progress
        pycolmap.match_exhaustive(database, matching, exhaustive, verification, device)
    write_match_facts(workspace / "matches.npz", database)


def _verification(settings: StepSettings) -> pycolmap.TwoViewGeometryOptions:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = settings.config.seed
    options.filter_stationary_matches = settings.config.moving_only
    return options


def _verify(settings: StepSettings, workspace: Path) -> None:
    """Verify the matches that are there again, as the settings say."""
    database = workspace / "database.db"
    opened = pycolmap.Database.open(database)
    opened.clear_two_view_geometries()
    opened.close()
    threads = pycolmap.GeometricVerifierOptions()
    threads.num_threads = settings.config.threads
    pycolmap.geometric_verification(
        database, threads, two_view_geometry_options=_verification(settings)
    )
    write_match_facts(workspace / "matches.npz", database)


def _write_similar(settings: StepSettings, workspace: Path, neighbours: int) -> None:
    """Write the pairs of photos that look alike to pairs.txt."""
    database = pycolmap.Database.open(workspace / "database.db")
    images = sorted(database.read_all_images(), key=lambda image: str(image.name))
    descriptors = [np.asarray(database.read_descriptors(i.image_id).data) for i in images]
    database.close()
    pairs = similar_pairs(descriptors, neighbours, settings.config.seed)
    lines = [f"{images[i].name} {images[j].name}\n" for i, j in pairs]
    (workspace / "pairs.txt").write_text("".join(lines), encoding="utf-8")


# --- Matches of a learned model that has no detector: each pair has places of its own. Tracks over
# many photos need shared features: in each cell of a photo the place that most matches mean, as
# hloc joins them (Sarlin 2019).


_ALL_PAIRS = 16  # photos up to which all pairs are matched by a learned model: 120 pairs
_LIKELY = 8  # photos that each of more is matched with
_CELL, _NEAR = 8.0, 1.5  # pixels at `MATCH_SIDE`: coarse cells of EfficientLoFTR; of one feature


def _likely_pairs(settings: StepSettings, workspace: Path) -> None:
    """Write pairs.txt for a learned model, in any order: time may end before all are matched."""
    n, file = _n_photos(settings), workspace / "pairs.txt"
    _write_similar(settings, workspace, n if n <= _ALL_PAIRS else _LIKELY)
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    order = np.random.default_rng(settings.config.seed).permutation(len(lines))
    file.write_text("".join(lines[i] for i in order), encoding="utf-8")


def _learned(settings: StepSettings, workspace: Path) -> None:
    """Add the matches of learned.npz to those in the database, and verify all of them."""
    arrays = read_arrays(workspace / "learned.npz", "Remove it and run again.")
    found = _Matching.read(workspace / "database.db")
    index = {str(name): i for i, name in enumerate(found.names)}
    views = np.array([index[str(name)] for name in arrays["names"].ravel()]).reshape(-1, 2)
    views = np.repeat(views, arrays["counts"], axis=0)  # (M, 2)
    places, scores = arrays["places"], arrays["scores"]  # (M, 2, 2) xy over width and height
    features = np.full((len(views), 2), -1, np.int64)
    masks = Path(settings.pictures).with_name(MASKS)
    database = pycolmap.Database.open(workspace / "database.db")
    for i, (image, camera) in enumerate(zip(found.images, found.cameras, strict=True)):
        rows, sides = np.nonzero(views == i)
        size = np.array([camera.width, camera.height], np.float64)
        pixels = places[rows, sides] * size
        inside = _in_mask(masks / f"{image.name}.png", pixels)
        rows, sides, pixels = rows[inside], sides[inside], pixels[inside]
        times = max(size.max() / MATCH_SIDE, 1.0)
        shared, which = shared_features(pixels, scores[rows], _CELL * times, _NEAR * times)
        known = np.asarray(database.read_keypoints(image.image_id))
        rest = {6: (1, 0, 0, 1), 4: (1, 0)}.get(known.shape[1], ())  # round, as large as a pixel
        more = np.c_[shared, np.tile(rest, (len(shared), 1))].astype(np.float32)
        database.update_keypoints(image.image_id, np.concatenate([known, more]))
        features[rows, sides] = np.where(which < 0, -1, which + len(known))
    starts = np.cumsum([0, *arrays["counts"]])
    for start, end in pairwise(starts.tolist()):
        if start < end:
            a, b = (found.images[k].image_id for k in views[start])
            before = np.asarray(database.read_matches(a, b)).reshape(-1, 2)
            new = one_to_one(features[start:end], scores[start:end])
            if len(before):
                database.delete_matches(a, b)
            database.write_matches(a, b, np.concatenate([before, new]).astype(np.uint32))
    database.close()
    _verify(settings, workspace)


def _in_mask(mask: Path, pixels: DoubleArray) -> BoolArray:
    """Which pixels (M, 2) are on the object; all without a mask."""
    if not mask.is_file():
        return np.ones(len(pixels), bool)
    shown = read_rgb(mask)[..., 0] > 0
    x, y = np.clip(pixels.astype(np.int64), 0, np.array(shown.shape[::-1]) - 1).T
    return np.asarray(shown[y, x])


def shared_features(
    places: DoubleArray,  # (M, 2) pixels of one photo, of all its matches
    scores: AnyArray,  # (M,)
    cell: float,  # pixels, at most one feature in each
    near: float,  # pixels
) -> tuple[DoubleArray, LongArray]:
    """Features (K, 2) that matches share, and which one (M,) each match means, -1 = none.

    A feature is where the matches of its cell have the greatest sum of scores within ``near``.
    """
    if len(places) == 0:
        return np.zeros((0, 2)), np.zeros(0, np.int64)
    of_cell = np.unique(np.floor(places / cell), axis=0, return_inverse=True)[1].ravel()
    bins = np.unique(
        np.c_[of_cell, np.floor(places / near)], axis=0, return_index=True, return_inverse=True
    )
    of_bin = bins[2].ravel()
    sums = np.bincount(of_bin, scores)
    best = np.full(of_cell.max() + 1, -1, np.int64)
    order = np.argsort(sums, kind="stable")
    best[of_cell[bins[1][order]]] = order  # the last one stays
    chosen = best[of_cell] == of_bin
    weights = np.bincount(of_cell[chosen], scores[chosen])
    sums_of = [np.bincount(of_cell[chosen], scores[chosen] * axis) for axis in places[chosen].T]
    features: DoubleArray = np.stack(sums_of, axis=1) / weights[:, None]
    apart = np.linalg.norm(places - features[of_cell], axis=1)
    return features, np.where(apart <= near, of_cell, -1).astype(np.int64)


def one_to_one(features: LongArray, scores: AnyArray) -> LongArray:
    """Of matches (M, 2) the surest of each feature on either side; none with -1."""
    rows = np.argsort(-scores, kind="stable")
    rows = rows[(features[rows] >= 0).all(axis=1)]
    for side in (0, 1):
        rows = rows[np.sort(np.unique(features[rows, side], return_index=True)[1])]
    return features[rows]


def _map(settings: StepSettings, workspace: Path) -> None:
    """An incremental mapping; with weaker demands when it finds no pair to start from."""
    models = _incremental(settings, workspace)
    _write_all(settings, workspace, "", models or _incremental(settings, workspace, relaxed=True))


def _map_relaxed(settings: StepSettings, workspace: Path) -> None:
    _write_all(settings, workspace, "relaxed", _incremental(settings, workspace, relaxed=True))


def _incremental(
    settings: StepSettings, workspace: Path, *, relaxed: bool = False
) -> dict[int, pycolmap.Reconstruction]:
    """Models of an incremental mapping with `_mapping_options`."""
    n_photos = _n_photos(settings)
    out = _empty(workspace / "mapping")
    placed = 2

    def next_photo() -> None:
        nonlocal placed
        placed += 1
        _say({"done": min(placed, n_photos), "total": n_photos, "message": "photos placed"})

    options = _mapping_options(settings, relaxed=relaxed)
    views = {name for group in settings.groups if group.view is not None for name in group.names}
    opened = pycolmap.Database.open(workspace / "database.db")
    options.constant_cameras = {  # of views of panoramas: as they were cut
        image.camera_id for image in opened.read_all_images() if image.name in views
    }
    opened.close()
    _say({"done": 0, "total": n_photos, "message": "looking for the first pair"})
    models = pycolmap.incremental_mapping(
        workspace / "database.db",
        Path(settings.pictures),
        out,
        options,
        next_image_callback=next_photo,
    )
    if settings.config.camera_model == "auto":
        return {key: _widened(model) for key, model in models.items()}
    return models


def _widened(model: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """``model`` with OPENCV lenses where these fit clearly better than the simple ones.

    A mapping that knows no focal length starts from any with a simple lens; a rich one takes the
    error of the focal length up in its distortion and runs away, as on a narrow ring.
    """
    rich = pycolmap.Reconstruction(model)
    counts = Counter(image.camera_id for image in rich.images.values() if image.has_pose)
    for key, camera in rich.cameras.items():
        if camera.model_name == "SIMPLE_RADIAL" and counts[key] >= FEW_PHOTOS:
            focal, cx, cy, k = camera.params
            camera.model = pycolmap.CameraModelId.OPENCV
            camera.params = [focal, focal, cx, cy, k, 0.0, 0.0, 0.0]
    if all(camera.model_name != "OPENCV" for camera in rich.cameras.values()):
        return model
    pycolmap.bundle_adjustment(rich, pycolmap.BundleAdjustmentOptions())
    rich.update_point_3d_errors()
    model.update_point_3d_errors()
    simple_error, error = (
        model.compute_mean_reprojection_error(),
        rich.compute_mean_reprojection_error(),
    )
    return rich if error < _BETTER_LENS * simple_error else model


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _n_photos(settings: StepSettings) -> int:
    return sum(len(group.names) for group in settings.groups)


def _least_model(settings: StepSettings) -> int:
    """Photos of the smallest model that is kept."""
    return max(2, min(10, _n_photos(settings) // 3))


def _write_all(
    settings: StepSettings,
    workspace: Path,
    folder: str,  # in the workspace
    models: dict[int, pycolmap.Reconstruction],
) -> None:
    """Write folder/model, model_2 .. with facts.npz, facts_2.npz .. for the checks."""
    target = workspace / folder
    target.mkdir(exist_ok=True)
    chosen = _chosen_models(models)
    sizes = [model.num_reg_images() for model in chosen]
    for i, model in enumerate(chosen):
        number = "" if i == 0 else f"_{i + 1}"
        _round(model)
        model.write_binary(_empty(target / f"model{number}"))
        write_facts(target / f"facts{number}.npz", model, workspace / "database.db", sizes)
    shutil.rmtree(workspace / "mapping", ignore_errors=True)


def _chosen_models(
    models: dict[int, pycolmap.Reconstruction],
) -> list[pycolmap.Reconstruction]:
    """The largest models, without those that hold photos of a larger one mostly."""
    if not models:
        raise ValueError("no model")
    taken: set[str] = set()
    chosen: list[pycolmap.Reconstruction] = []
    for model in sorted(models.values(), key=lambda m: (-m.num_reg_images(), -m.num_points3D())):
        names = {str(image.name) for image in model.images.values() if image.has_pose}
        if len(chosen) < _MOST_MODELS and len(names & taken) <= len(names) // 2:
            chosen.append(model)
            taken |= names
    return chosen


def _round(model: pycolmap.Reconstruction) -> None:
    """Drop the last digits, which processors and libraries round differently.

    A training makes another scene of another last digit. COLMAP's scenes have a size of about 10.
    """
    for frame in model.frames.values():
        pose = frame.rig_from_world
        rotation = pycolmap.Rotation3d(np.round(pose.rotation.quat, _DECIMALS))
        rotation.normalize()
        frame.rig_from_world = pycolmap.Rigid3d(rotation, np.round(pose.translation, _DECIMALS))
    for point in model.points3D.values():
        point.xyz = np.round(point.xyz, _DECIMALS)
    for camera in model.cameras.values():
        camera.params = np.round(camera.params, _DECIMALS)


def _mapping_options(
    settings: StepSettings, *, relaxed: bool
) -> pycolmap.IncrementalPipelineOptions:
    """COLMAP's defaults, with a seed.

    ``relaxed``: starts from a pair with fewer matches and places photos by fewer points.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = settings.config.threads
    options.random_seed = settings.config.seed
    options.mapper.random_seed = settings.config.seed
    options.triangulation.random_seed = settings.config.seed
    options.min_model_size = _least_model(settings)
    options.ba_refine_sensor_from_rig = False
    if relaxed:
        options.mapper.init_min_num_inliers = 30
        options.mapper.init_min_tri_angle = 4.0
        options.mapper.abs_pose_min_num_inliers = 15
    return options


def _undistort(settings: StepSettings, workspace: Path) -> None:
    """Pictures without distortion in undistorted/images, their model in undistorted/sparse/0,
    turned upright where the workspace says how."""
    out = workspace / "undistorted"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    options = pycolmap.UndistortCameraOptions()
    options.max_image_size = settings.picture_side
    placed = workspace / "model"
    if (workspace / UPRIGHT).is_file():
        model = pycolmap.Reconstruction(placed)
        turn = np.array(read_json(workspace / UPRIGHT, list[list[float]], "Run again."))
        model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(turn), np.zeros(3)))
        placed = out / "upright"
        placed.mkdir()
        model.write(placed)
    pycolmap.undistort_images(
        out,
        placed,
        Path(settings.pictures),
        undistort_options=options,
        jpeg_quality=97,
        num_threads=settings.config.threads,
    )
    masks = Path(settings.pictures).with_name(MASKS)
    if masks.is_dir():
        _undistort_masks(masks, workspace, out, options)
    depths = masks.with_name(DEPTH_MAPS)
    if depths.is_dir():
        _undistort_depth(depths, workspace, out)
    for entry in out.iterdir():
        if entry.name not in ("images", "sparse", MASKS, DEPTH):
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    (out / "sparse" / "0").mkdir()
    for file in (out / "sparse").iterdir():
        if file.is_file():
            file.rename(out / "sparse" / "0" / file.name)


def _undistort_masks(
    masks: Path, workspace: Path, out: Path, options: pycolmap.UndistortCameraOptions
) -> None:
    """Masks like the pictures, in out/masks: NAME.png."""
    (out / MASKS).mkdir()
    model = pycolmap.Reconstruction(workspace / "model")
    for image in model.images.values():
        mask = pycolmap.Bitmap.read(masks / f"{image.name}.png", as_rgb=False)
        if image.has_pose and mask is not None:
            flat, _ = pycolmap.undistort_image(options, mask, image.camera)
            flat.write(out / MASKS / f"{Path(str(image.name)).stem}.png")


def _undistort_depth(depths: Path, workspace: Path, out: Path) -> None:
    """Depth maps like the pictures, at their own size, by the nearest pixel."""
    (out / DEPTH).mkdir()
    model, flat = (pycolmap.Reconstruction(f) for f in (workspace / "model", out / "sparse"))
    targets = {str(image.name): image for image in flat.images.values()}
    for image in model.images.values():
        file = depths / f"{image.name}.png"
        target = targets.get(str(image.name))
        if target is None or not file.is_file():
            continue
        depth = read_scene_depth(file)
        size = np.array(depth.shape[::-1])
        v, u = np.mgrid[0 : size[1], 0 : size[0]].reshape(2, -1) + 0.5
        pinhole, lens = (np.array([i.camera.width, i.camera.height]) for i in (target, image))
        rays = np.asarray(target.camera.cam_from_img(np.c_[u, v] / size * pinhole))
        bent = image.camera.img_from_cam(np.c_[rays, np.ones(len(rays))], check_cheirality=False)
        x, y = np.floor(np.nan_to_num(bent, nan=-1.0) / lens * size).astype(np.int64).T
        inside = (x >= 0) & (x < size[0]) & (y >= 0) & (y < size[1])
        flattened = np.zeros(depth.size, np.float32)
        flattened[inside] = depth[y[inside], x[inside]]
        stem = Path(str(image.name)).stem
        write_scene_depth(out / DEPTH / f"{stem}.png", flattened.reshape(depth.shape))


def _export(settings: StepSettings, workspace: Path) -> None:
    write_pair_matches(workspace / "pair_matches.npz", workspace / "database.db")


# --- Given poses: triangulated as they are, refined, and the better of both.


_HELD_OUT = 0.1  # share of the features whose matches are held out
_LENS_PHOTOS = 12  # of one lens, from which on it is refined, too
_FEWEST_POINTS = 15  # of a photo: with less its pose stays as it was given
_TOLERANCES = (1.0, 60.0)  # pixels of a reprojection in a round: the least and the most
_NOISE = 6  # tolerances are so many times the median error: 4 deviations of what lies right
_POINTS = 4.0  # pixels of a reprojection: points of refined poses; poses of less need one round
_STEPS, _LAST_STEPS = 10, 40  # of the solver, in a round and in the last; 100 gain nothing
_CAPPED = 20.0  # pixels: what is further off is a wrong match, however far


class GivenFile(msgspec.Struct, frozen=True):
    """What the worker reads of given poses."""

    names: list[str]  # prepared photos
    poses: list[list[float]]  # cam_from_world (3, 4) by rows
    refine: bool


def _given(settings: StepSettings, workspace: Path) -> None:
    """Writes given/model, facts.npz and report.json."""
    given = read_json(workspace / "poses.json", GivenFile, "")
    target = _empty(workspace / "given")
    database, held = workspace / "database.db", target / "held_out.db"
    matches = _hold_out(database, held, settings.config.seed)
    model = _posed(database, given)
    poses = _poses_of(model)
    off = _off_lines(model, matches)
    before = _mean_off(off)
    refined, after = model, None
    if given.refine:
        tolerance, n = _tolerance(off), 0
        while tolerance > _POINTS:
            _say({"done": n, "total": n + 2, "message": "refine the given poses"})
            refined = _triangulated(settings, refined, held, target, tolerance)
            _adjust(refined, poses, tolerance, is_last=False)
            tolerance, n = min(_tolerance(_off_lines(refined, matches)), tolerance / 2), n + 1
        _say({"done": n, "total": n + 2, "message": "refine the given poses"})
        refined = _triangulated(settings, refined, held, target, tolerance)
        _adjust(refined, poses, tolerance, is_last=True)
        after = _mean_off(_off_lines(refined, matches))
    is_refined = after is not None and after < before
    _say({"done": 1, "total": 2, "message": "triangulate"})
    chosen = refined if is_refined else model
    tolerance = _POINTS if is_refined else max(_POINTS, 3 * before)
    final = _triangulated(settings, chosen, database, target, tolerance)
    held.unlink()
    report = {"given": before, "refined": after, "is_refined": is_refined}
    (target / "report.json").write_text(
        json.dumps(report | _moved(poses, _poses_of(final))), encoding="utf-8"
    )
    _round(final)
    final.write_binary(_empty(target / "model"))
    write_facts(target / "facts.npz", final, database, [final.num_reg_images()])


def _to_given(settings: StepSettings, workspace: Path) -> None:
    """Brings workspace/model to the world of the given poses; writes given/report.json."""
    given = read_json(workspace / "poses.json", GivenFile, "")
    model = pycolmap.Reconstruction(str(workspace / "model"))
    rows = dict(zip(given.names, given.poses, strict=True))
    named = {n: np.array(rows[n]).reshape(3, 4) for n in _poses_of(model) if n in rows}
    if len(named) < 3:
        raise ValueError("too few placed photos have a given pose")
    _align(model, named)
    target = _empty(workspace / "given")
    report = {"given": 0.0, "refined": None, "is_refined": True}
    text = json.dumps(report | _moved(named, _poses_of(model)))
    (target / "report.json").write_text(text, encoding="utf-8")
    model.write_binary(_empty(workspace / "model"))


def _posed(database: Path, given: GivenFile) -> pycolmap.Reconstruction:
    """A model without points: the cameras and photos of ``database`` with their given poses."""
    found = _Matching.read(database)
    rows = dict(zip(given.names, given.poses, strict=True))
    model = pycolmap.Reconstruction()
    for camera in {int(c.camera_id): c for c in found.cameras}.values():
        model.add_camera_with_trivial_rig(camera)
    for image, points in zip(found.images, found.keypoints(database), strict=True):
        pose = np.array(rows[str(image.name)]).reshape(3, 4)
        rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
        new = pycolmap.Image(
            name=str(image.name),
            keypoints=points,
            camera_id=int(image.camera_id),
            image_id=int(image.image_id),
        )
        model.add_image_with_trivial_frame(new, rigid)
    return model


def _poses_of(model: pycolmap.Reconstruction) -> dict[str, DoubleArray]:
    """Poses (3, 4), cam_from_world, by name."""
    placed = [image for image in model.images.values() if image.has_pose]
    return {str(i.name): np.array(i.cam_from_world().matrix(), np.float64) for i in placed}


def _moved(before: Mapping[str, DoubleArray], after: Mapping[str, DoubleArray]) -> dict[str, float]:
    """The way and turn of the cameras that have both poses: median and most."""
    names = [name for name in before if name in after]
    way, turn = moved_by(*(np.array([poses[n] for n in names]) for poses in (before, after)))
    return {
        "moved": float(np.median(way)),
        "moved_most": float(way.max()),
        "turned": float(np.median(turn)),
        "turned_most": float(turn.max()),
    }


_HeldOut = list[tuple[str, str, AnyArray, AnyArray]]  # two photos, pixels (M, 2) in each


def _hold_out(database: Path, held: Path, seed: int) -> _HeldOut:
    """Copy ``database`` to ``held`` without the matches of some features; returns those."""
    found = _Matching.read(database)
    rng = np.random.default_rng(seed)
    points = found.keypoints(database)
    out = [rng.random(len(p)) < _HELD_OUT for p in points]
    result: _HeldOut = []
    shutil.copyfile(database, held)
    opened = pycolmap.Database.open(held)
    opened.clear_two_view_geometries()
    for (a, b), m, geometry in zip(found.pairs, found.matches, found.geometries, strict=True):
        if not len(m):
            continue
        is_out = out[a][m[:, 0]] | out[b][m[:, 1]]
        some = m[is_out]
        result.append(
            (found.names[a], found.names[b], points[a][some[:, 0]], points[b][some[:, 1]])
        )
        geometry.inlier_matches = m[~is_out]
        opened.write_two_view_geometry(found.images[a].image_id, found.images[b].image_id, geometry)
    opened.close()
    return result


def _off_lines(model: pycolmap.Reconstruction, matches: _HeldOut) -> DoubleArray:
    """Distances (M,) of matches from their epipolar lines (Sampson), pixels."""
    images = {str(image.name): image for image in model.images.values()}
    parts = [np.zeros(0)]
    for a, b, pixels_a, pixels_b in matches:
        cameras = [model.cameras[images[name].camera_id] for name in (a, b)]
        rays = [
            np.c_[np.asarray(camera.cam_from_img(pixels)), np.ones(len(pixels))]
            for camera, pixels in zip(cameras, (pixels_a, pixels_b), strict=True)
        ]
        pose_a, pose_b = (np.asarray(images[n].cam_from_world().matrix()) for n in (a, b))
        turn = pose_b[:, :3] @ pose_a[:, :3].T
        x, y, z = pose_b[:, 3] - turn @ pose_a[:, 3]
        essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ turn
        line_b, line_a = rays[0] @ essential.T, rays[1] @ essential
        error = np.abs((rays[1] * line_b).sum(axis=1))
        slope = np.sqrt((line_a[:, :2] ** 2).sum(axis=1) + (line_b[:, :2] ** 2).sum(axis=1))
        focal = np.mean([camera.mean_focal_length() for camera in cameras])
        parts.append(focal * error / np.maximum(slope, 1e-18))
    # A lens may say nothing of a pixel at its rim.
    return np.nan_to_num(np.concatenate(parts), nan=_CAPPED, posinf=_CAPPED)


def _tolerance(off: DoubleArray) -> float:
    """Pixels that a reprojection may be off where held-out matches lie ``off`` their lines."""
    return float(np.clip(_NOISE * np.median(off), *_TOLERANCES)) if len(off) else _POINTS


def _mean_off(off: DoubleArray) -> float:
    return float(np.minimum(off, _CAPPED).mean()) if len(off) else 0.0


def _triangulated(
    settings: StepSettings,
    model: pycolmap.Reconstruction,
    database: Path,
    target: Path,
    tolerance: float,  # pixels
) -> pycolmap.Reconstruction:
    """Points of the matches in ``database`` by the poses of ``model``, which stay."""
    options = _mapping_options(settings, relaxed=False)
    focal = np.median([camera.mean_focal_length() for camera in model.cameras.values()])
    angle = max(2.0, float(np.degrees(np.arctan(tolerance / focal))))
    options.mapper.filter_max_reproj_error = tolerance
    triangulation = options.triangulation
    triangulation.create_max_angle_error = triangulation.continue_max_angle_error = angle
    triangulation.merge_max_reproj_error = triangulation.complete_max_reproj_error = tolerance
    triangulation.ignore_two_view_tracks = False
    out, pictures = _empty(target / "points"), Path(settings.pictures)
    points = pycolmap.Reconstruction(model)  # a copy: COLMAP fills the one that it is given
    points = pycolmap.triangulate_points(points, database, pictures, out, options=options)
    shutil.rmtree(out, ignore_errors=True)
    return points


def _adjust(
    model: pycolmap.Reconstruction,
    given: Mapping[str, DoubleArray],
    tolerance: float,
    *,
    is_last: bool,
) -> None:
    """Bundle adjustment, back in the given world; in the last round with the places as prior."""
    options = pycolmap.BundleAdjustmentOptions()
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = tolerance / 4
    options.ceres.solver_options.max_num_iterations = _LAST_STEPS if is_last else _STEPS
    options.print_summary = False
    counts: dict[int, int] = {}
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        config.add_image(image.image_id)
        counts[image.camera_id] = counts.get(image.camera_id, 0) + 1
    for camera_id, n in counts.items():
        is_known = model.cameras[camera_id].has_prior_focal_length
        # While poses are off, a lens would make up for them.
        if is_known and (n < _LENS_PHOTOS or not is_last):
            config.set_constant_cam_intrinsics(camera_id)
    if is_last:
        now = _poses_of(model)
        way = np.linalg.norm(
            [centres(now[n][None])[0] - centres(given[n][None])[0] for n in given], axis=1
        )
        deviation = max(float(np.median(way)), 1e-9)
        priors = [
            pycolmap.PosePrior(
                corr_data_id=image.data_id,
                position=centres(given[str(image.name)][None])[0],
                position_covariance=deviation**2 * np.eye(3),
                coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
            )
            for image in model.images.values()
        ]
        prior = pycolmap.PosePriorBundleAdjustmentOptions()
        prior.ceres.prior_position_loss_function_type = pycolmap.LossFunctionType.CAUCHY
        adjuster = pycolmap.create_pose_prior_bundle_adjuster(options, prior, config, priors, model)
    else:
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
        adjuster = pycolmap.create_default_bundle_adjuster(options, config, model)
    adjuster.solve()
    _align(model, given)
    for image in model.images.values():
        if image.num_points3D < _FEWEST_POINTS:
            pose = given[str(image.name)]
            rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:, :3]), pose[:, 3])
            model.frames[image.frame_id].rig_from_world = rigid


def _align(model: pycolmap.Reconstruction, given: Mapping[str, DoubleArray]) -> None:
    """Bring a model into the world of given poses."""
    now = _poses_of(model)
    names = [name for name in given if name in now]
    world = similarity_between(*(np.array([p[n] for n in names]) for p in (now, given)))
    scale = float(np.cbrt(np.linalg.det(world[:3, :3])))
    rotation = pycolmap.Rotation3d(world[:3, :3] / scale)
    model.transform(pycolmap.Sim3d(scale, rotation, world[:3, 3]))


def _export_features(settings: StepSettings, workspace: Path) -> None:
    write_features(workspace / "features.npz", workspace / "database.db")


STEPS: dict[str, Callable[[StepSettings, Path], None]] = {
    "features": _features,
    "match": _match,
    "verify": _verify,
    "likely_pairs": _likely_pairs,
    "learned": _learned,
    "map": _map,
    "map_relaxed": _map_relaxed,
    "given": _given,
    "to_given": _to_given,
    "export": _export,
    "export_features": _export_features,
    "undistort": _undistort,
}


if __name__ == "__main__":
    sys.exit(main())
