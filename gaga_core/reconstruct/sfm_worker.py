"""``python -m gaga_core.reconstruct.sfm_worker SETTINGS.json``: one step of structure from motion.

Run in a process of its own: pycolmap's C++ may abort, and ending the process is how a step is
cancelled. Prints one JSON object a line: ``{"done": 3, "total": 11, "message": ".."}`` for
progress, ``{"failed": ".."}`` for a failure (exit status 1), among the lines of COLMAP's log. All
state is in the workspace folder, so a step that was ended is simply run again.
"""

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np
import pycolmap

from gaga_core.io.child_process import end_with_parent
from gaga_core.io.json_file import read_json
from gaga_core.reconstruct.foreground import MASKS
from gaga_core.reconstruct.sfm_export import write_facts, write_match_facts, write_pair_matches
from gaga_core.reconstruct.sfm_join import join_parts
from gaga_core.reconstruct.sfm_pairs import similar_pairs
from gaga_core.reconstruct.sfm_scenes import JOINED

_DECIMALS = 7  # of poses, points and lenses: far finer than any photo shows
_MOST_MODELS = 4  # of one mapping that are looked at
_PAIR_BLOCK = 1000  # pairs of a list that share one look-up of features


class CameraGroup(TypedDict):
    """Photos of one camera: same size, same focal length."""

    names: list[str]
    width: int
    height: int
    focal: float | None  # pixels, from EXIF or the user
    model: str  # COLMAP's name of the lens model


class WorkerSettings(TypedDict):
    """What the parent writes for the worker."""

    step: str  # one of `STEPS`
    workspace: str
    pictures: str  # folder of the prepared photos
    groups: list[CameraGroup]
    feature_side: int  # pixels: photos are shrunk to this to look for features
    n_features: int
    doubled: bool  # features are looked for at twice the size too
    affine: bool  # features with affine shape and domain-size pooling
    least_contrast: float  # of a feature, brightness 0..1
    guided: bool  # match again along epipolar lines
    moving_only: bool  # drop matches that stand still in the picture
    pairs: str  # exhaustive, sequential or similar
    neighbours: int  # of a photo among those that look alike
    overlap: int  # of a frame in sequential matching
    threads: int
    seed: int
    picture_side: int  # longest side of undistorted pictures


def main() -> int:
    """Run the step that the settings name."""
    end_with_parent()
    settings: WorkerSettings = read_json(Path(sys.argv[1]), WorkerSettings, "")
    workspace = Path(settings["workspace"])
    pycolmap.set_random_seed(settings["seed"])
    try:
        STEPS[settings["step"]](settings, workspace)
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OSError) as error:
        said = (str(error).splitlines() or [type(error).__name__])[0]
        _say({"failed": said[:200]})
        return 1
    return 0


def _say(values: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def _features(settings: WorkerSettings, workspace: Path) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = settings["threads"]
    options.max_image_size = settings["feature_side"]
    options.sift.max_num_features = settings["n_features"]
    options.sift.first_octave = -1 if settings["doubled"] else 0
    options.sift.estimate_affine_shape = settings["affine"]
    options.sift.domain_size_pooling = settings["affine"]
    options.sift.peak_threshold = settings["least_contrast"]
    database = workspace / "database.db"
    for suffix in ("", "-wal", "-shm"):  # what an ended process left may be half-written
        database.with_name(database.name + suffix).unlink(missing_ok=True)
    pycolmap.Database.open(database).close()  # makes it
    readers, pictures = [], Path(settings["pictures"])
    masks = pictures.with_name(MASKS)
    for group in settings["groups"]:
        reader = pycolmap.ImageReaderOptions()
        if masks.is_dir():
            reader.mask_path = str(masks)
        reader.camera_model = group["model"]
        if group["focal"] is not None:
            reader.camera_params = _camera_params(group)
        readers.append((group["names"], reader))
    single = pycolmap.CameraMode.SINGLE
    for names, reader in readers:  # first, so that numbers do not depend on who is ready first
        pycolmap.import_images(database, pictures, single, names, reader)
    for names, reader in readers:
        pycolmap.extract_features(
            database,
            pictures,
            image_names=names,
            camera_mode=single,
            reader_options=reader,
            extraction_options=options,
            device=pycolmap.Device.cpu,
        )


def _camera_params(group: CameraGroup) -> str:
    """COLMAP's parameter text of a camera without distortion."""
    model, focal = group["model"], group["focal"]
    cx, cy = group["width"] / 2, group["height"] / 2
    tail = {"SIMPLE_PINHOLE": 0, "SIMPLE_RADIAL": 1, "RADIAL": 2}
    if model in tail:
        values = [focal, cx, cy, *[0.0] * tail[model]]
    else:
        values = [focal, focal, cx, cy, *[0.0] * {"PINHOLE": 0, "OPENCV": 4}[model]]
    return ",".join(str(value) for value in values)


def _match(settings: WorkerSettings, workspace: Path) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.num_threads = settings["threads"]
    matching.guided_matching = settings["guided"]
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = settings["seed"]
    verification.filter_stationary_matches = settings["moving_only"]
    device = pycolmap.Device.cpu
    n = _n_photos(settings)
    database = workspace / "database.db"
    if settings["pairs"] == "sequential":
        sequential = pycolmap.SequentialPairingOptions()
        sequential.overlap = settings["overlap"]
        pycolmap.match_sequential(database, matching, sequential, verification, device)
    elif settings["pairs"] == "similar":
        _write_similar(settings, workspace)
        listed = pycolmap.ImportedPairingOptions()
        listed.match_list_path = str(workspace / "pairs.txt")
        listed.block_size = _PAIR_BLOCK
        pycolmap.match_image_pairs(database, matching, listed, verification, device)
    else:
        exhaustive = pycolmap.ExhaustivePairingOptions()
        exhaustive.block_size = max(4, min(50, n // 5))  # one block is one step of progress
        pycolmap.match_exhaustive(database, matching, exhaustive, verification, device)
    write_match_facts(workspace / "matches.npz", database)


def _write_similar(settings: WorkerSettings, workspace: Path) -> None:
    """Write the pairs of photos that look alike to pairs.txt."""
    database = pycolmap.Database.open(workspace / "database.db")
    images = sorted(database.read_all_images(), key=lambda image: str(image.name))
    descriptors = [np.asarray(database.read_descriptors(i.image_id).data) for i in images]
    database.close()
    pairs = similar_pairs(descriptors, settings["neighbours"], settings["seed"])
    lines = [f"{images[i].name} {images[j].name}\n" for i, j in pairs]
    (workspace / "pairs.txt").write_text("".join(lines), encoding="utf-8")


def _map(settings: WorkerSettings, workspace: Path) -> None:
    """An incremental mapping; with weaker demands when it finds no pair to start from."""
    models = _incremental(settings, workspace, "default")
    if models:
        _write_all(settings, workspace, "", models, "default")
    else:
        _write_all(settings, workspace, "", _incremental(settings, workspace, "relaxed"), "relaxed")


def _map_relaxed(settings: WorkerSettings, workspace: Path) -> None:
    models = _incremental(settings, workspace, "relaxed")
    _write_all(settings, workspace, "relaxed", models, "relaxed")


def _map_strict(settings: WorkerSettings, workspace: Path) -> None:
    models = _incremental(settings, workspace, "strict")
    _write_all(settings, workspace, "strict", models, "strict")


def _map_global(settings: WorkerSettings, workspace: Path) -> None:
    """All photos at once (GLOMAP, Pan 2024). It can place every photo and still be wrong."""
    out = _empty(workspace / "mapping")
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = settings["threads"]
    options.random_seed = settings["seed"]
    options.mapper.random_seed = settings["seed"]
    options.mapper.rotation_averaging.random_seed = settings["seed"]
    options.mapper.global_positioning.random_seed = settings["seed"]
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    options.min_model_size = _least_model(settings)
    _say({"done": 0, "total": 0, "message": "all photos at once"})
    found = pycolmap.global_mapping(
        workspace / "database.db", Path(settings["pictures"]), out, options
    )
    _write_all(settings, workspace, "global", found, "default")


def _incremental(
    settings: WorkerSettings, workspace: Path, demands: str
) -> dict[int, pycolmap.Reconstruction]:
    """Models of an incremental mapping with `_mapping_options` of ``demands``."""
    n_photos = _n_photos(settings)
    out = _empty(workspace / "mapping")
    placed = 2

    def next_photo() -> None:
        nonlocal placed
        placed += 1
        _say({"done": min(placed, n_photos), "total": n_photos, "message": "photos placed"})

    _say({"done": 0, "total": n_photos, "message": "looking for the first pair"})
    models: dict[int, pycolmap.Reconstruction] = pycolmap.incremental_mapping(
        workspace / "database.db",
        Path(settings["pictures"]),
        out,
        _mapping_options(settings, demands),
        next_image_callback=next_photo,
    )
    return models


def _empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _n_photos(settings: WorkerSettings) -> int:
    return sum(len(group["names"]) for group in settings["groups"])


def _least_model(settings: WorkerSettings) -> int:
    """Photos of the smallest model that is kept."""
    return max(2, min(10, _n_photos(settings) // 3))


def _write_all(
    settings: WorkerSettings,
    workspace: Path,
    folder: str,  # in the workspace
    models: dict[int, pycolmap.Reconstruction],
    demands: str,
) -> None:
    """Write the models, and to folder/joined what they become where parts can be joined.

    Both are kept: which of them is right is for the checks to say.
    """
    chosen = _chosen_models(models)
    _write_models(workspace, workspace / folder, chosen)
    joined = chosen
    if len(chosen) > 1:
        _say({"done": 0, "total": 0, "message": "joining the parts"})
        options = _mapping_options(settings, demands)
        pictures = Path(settings["pictures"])
        joined = join_parts(chosen, workspace / "database.db", pictures, options)
    shutil.rmtree(workspace / folder / JOINED, ignore_errors=True)
    if len(joined) < len(chosen):
        _write_models(workspace, workspace / folder / JOINED, joined)
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


def _write_models(workspace: Path, target: Path, models: Sequence[pycolmap.Reconstruction]) -> None:
    """Write target/model, model_2 .. with facts.npz, facts_2.npz .. for the checks."""
    target.mkdir(exist_ok=True)
    sizes = [model.num_reg_images() for model in models]
    for i, model in enumerate(models):
        number = "" if i == 0 else f"_{i + 1}"
        _round(model)
        model.write_binary(_empty(target / f"model{number}"))
        write_facts(target / f"facts{number}.npz", model, workspace / "database.db", sizes)


def _round(model: pycolmap.Reconstruction) -> None:
    """Drop the last digits, which differ from run to run: threads add up in any order.

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


def _mapping_options(settings: WorkerSettings, demands: str) -> pycolmap.IncrementalPipelineOptions:
    """COLMAP's defaults, with a seed.

    "relaxed" starts from a pair with fewer matches and places photos by fewer points; "strict"
    believes only pairs with many matches, as things that look alike seldom share so many.
    """
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = settings["threads"]
    options.random_seed = settings["seed"]
    options.mapper.random_seed = settings["seed"]
    options.triangulation.random_seed = settings["seed"]
    options.min_model_size = _least_model(settings)
    if demands == "relaxed":
        options.mapper.init_min_num_inliers = 30
        options.mapper.init_min_tri_angle = 4.0
        options.mapper.abs_pose_min_num_inliers = 15
    if demands == "strict":
        options.min_num_matches = 45
    return options


def _undistort(settings: WorkerSettings, workspace: Path) -> None:
    """Pictures without distortion in undistorted/images, their model in undistorted/sparse/0."""
    out = workspace / "undistorted"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    options = pycolmap.UndistortCameraOptions()
    options.max_image_size = settings["picture_side"]
    pycolmap.undistort_images(
        out,
        workspace / "model",
        Path(settings["pictures"]),
        undistort_options=options,
        jpeg_quality=97,
        num_threads=settings["threads"],
    )
    for entry in out.iterdir():
        if entry.name not in ("images", "sparse"):
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
    (out / "sparse" / "0").mkdir()
    for file in (out / "sparse").iterdir():
        if file.is_file():
            file.rename(out / "sparse" / "0" / file.name)


def _export(settings: WorkerSettings, workspace: Path) -> None:
    write_pair_matches(workspace / "pair_matches.npz", workspace / "database.db")


STEPS = {
    "features": _features,
    "match": _match,
    "map": _map,
    "map_relaxed": _map_relaxed,
    "map_strict": _map_strict,
    "map_global": _map_global,
    "export": _export,
    "undistort": _undistort,
}


if __name__ == "__main__":
    sys.exit(main())
