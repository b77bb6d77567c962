"""Few photos of a real scene as a training gets them: true poses, points from these photos alone.

The points that come with a scene were found in all of its photos; training on a few must not see
them. They are triangulated again between the chosen photos, at the known poses, and cached in the
user's cache folder.
"""

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from gaga_core.arrays import DoubleArray, UInt8Array
from gaga_core.cache_folder import user_cache
from gaga_core.camera import Camera
from gaga_core.io.cameras.colmap import ColmapModel, read_colmap
from gaga_core.training.views import TrainView, TrainViews, read_view
from tests.bench.figures import data_folder

_DISTORTED = ("fox", "sceaux")  # scenes whose photos are straightened first
_FILM_SIDE = 800  # pixels of photos in which points of whole sets are looked for
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # camera axes of OpenGL to those of OpenCV


@dataclass(frozen=True, eq=False)
class Subset:
    """Views to train on and to measure on, and the points that the first ones show."""

    views: TrainViews
    points: DoubleArray  # (P, 3) world
    colors: UInt8Array  # (P, 3)


def draw_subset(name: str, n_train: int, seed: int, longest_side: int, n_test: int = 16) -> Subset:
    """``n_train`` photos of scene ``name`` drawn by ``seed``, and ``n_test`` others, evenly."""
    folder, model = _undistorted(name)
    order = np.random.default_rng(seed).permutation(len(model.cameras))
    chosen, rest = np.sort(order[:n_train]), np.sort(order[n_train:])
    rest = rest[np.unique(np.linspace(0, len(rest) - 1, n_test).astype(int))]
    train = [model.cameras[i] for i in chosen]
    points, colors = _triangulated(f"{name}-{n_train}-{seed}", folder, train)

    def views(cameras: list[Camera]) -> tuple[TrainView, ...]:
        return tuple(read_view(c, folder / "images" / c.name, longest_side) for c in cameras)

    held_out = [model.cameras[i] for i in rest]
    return Subset(TrainViews(views(train), views(held_out)), points, colors)


def draw_whole(name: str, longest_side: int) -> Subset:
    """All photos of a scene, every 8th held out, with points from the others."""
    folder, model = _undistorted(name)
    train = [c for i, c in enumerate(model.cameras) if i % 8]
    if len(model.points):
        points, colors = model.points, model.point_colors
    else:
        points, colors = _triangulated(f"{name}-whole", folder, train, is_film=True)
    views = [read_view(c, folder / "images" / c.name, longest_side) for c in model.cameras]
    parts = [tuple(v for i, v in enumerate(views) if (i % 8 == 0) == held) for held in (0, 1)]
    return Subset(TrainViews(*parts), points, colors)


def _cache() -> Path:
    path = user_cache() / "bench"
    path.mkdir(parents=True, exist_ok=True)
    return path


def _undistorted(name: str) -> tuple[Path, ColmapModel]:
    """A folder with images/ that pinhole cameras took, and these cameras."""
    folder = data_folder(name)
    if name not in _DISTORTED:
        return folder, read_colmap(folder / "sparse" / "0")
    out = _cache() / name
    if not out.is_dir():
        sparse = folder / "sparse" / "0"
        model = pycolmap.Reconstruction(sparse) if sparse.is_dir() else _of_transforms(folder)
        with tempfile.TemporaryDirectory(dir=_cache()) as work:
            model.write(work)
            pycolmap.undistort_images(f"{work}/out", work, folder / "images")
            Path(work, "out").rename(out)
    read = read_colmap(out / "sparse")
    # Held-out photos found these points too.
    return out, replace(read, points=read.points[:0], point_colors=read.point_colors[:0])


def _of_transforms(folder: Path) -> pycolmap.Reconstruction:
    """The cameras of transforms.json as instant-ngp writes it."""
    values = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
    lens = [values[key] for key in ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")]
    poses = {
        Path(frame["file_path"]).name: np.linalg.inv(np.array(frame["transform_matrix"]) @ _FLIP)
        for frame in values["frames"]
    }
    camera = pycolmap.Camera(
        model="OPENCV", width=int(values["w"]), height=int(values["h"]), params=lens, camera_id=1
    )
    return _posed(camera, {name: (i, poses[name]) for i, name in enumerate(sorted(poses), 1)})


def _posed(
    camera: pycolmap.Camera, poses: dict[str, tuple[int, DoubleArray]]
) -> pycolmap.Reconstruction:
    """A model without points: of each photo its number and ``cam_from_world``."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for name, (number, pose) in poses.items():
        image = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    return model


def _triangulated(
    key: str, folder: Path, cameras: list[Camera], *, is_film: bool = False
) -> tuple[DoubleArray, UInt8Array]:
    """Points that at least two of the ``cameras`` see, found by matching their photos: each with
    every other, or those of a film with their neighbours and in smaller pictures."""
    file = _cache() / f"{key}.npz"
    if not file.is_file():
        with tempfile.TemporaryDirectory() as work:
            model = _triangulate(Path(work), folder / "images", cameras, is_film)
        found = list(model.points3D.values())
        np.savez(
            file,
            points=np.array([p.xyz for p in found], np.float64).reshape(-1, 3),
            colors=np.array([p.color for p in found], np.uint8).reshape(-1, 3),
        )
    with np.load(file) as arrays:
        return arrays["points"], arrays["colors"]


def _triangulate(
    work: Path, images: Path, cameras: list[Camera], is_film: bool
) -> pycolmap.Reconstruction:
    first, database, cpu = cameras[0], work / "database.db", pycolmap.Device.cpu
    K = first.K
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE"
    reader.camera_params = f"{K[0, 0]},{K[1, 1]},{K[0, 2]},{K[1, 2]}"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.max_image_size = _FILM_SIDE if is_film else -1
    pycolmap.extract_features(
        database,
        images,
        image_names=[c.name for c in cameras],
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=cpu,
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    match = pycolmap.match_sequential if is_film else pycolmap.match_exhaustive
    match(database, matching, device=cpu)
    opened = pycolmap.Database.open(database)
    numbers = {str(image.name): int(image.image_id) for image in opened.read_all_images()}
    camera = opened.read_all_cameras()[0]
    opened.close()
    model = _posed(camera, {c.name: (numbers[c.name], c.cam_from_world) for c in cameras})
    return pycolmap.triangulate_points(model, database, images, work)
