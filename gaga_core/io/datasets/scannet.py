"""ScanNet: raw as its reader exports it, as DM-NeRF's script selects it, and as Gaga's does.

Raw: ``<scene>/{color/<n>.jpg, pose/<n>.txt, intrinsic/intrinsic_{color,depth}.txt,
instance-filt/<n>.png}``. DM-NeRF (Wang et al., ICLR 2023): ``<scene>/{train,test}/{s}_images,
{s}_pose, {s}_ins/<n>.npz`` with instance ids in ``ins_2d_label_id``, -1 = void, of the classes
that DM-NeRF keeps; ``{s}_ins_full/<n>.png``, all instances, are the truth where they are. Gaga:
``<scene>/{s}/{s}_images, {s}_ins_full/<n>.png`` (ids of the raw maps) with a COLMAP model over
``images/``. Poses are world_from_cam (4 x 4, OpenCV axes); frames that tracking lost have -inf.
"""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.datasets.base import (
    DatasetScene,
    DatasetViews,
    Layout,
    by_stem,
    numbered,
    photos_of,
    picture_size,
    posed_camera,
    read_numbers,
    scene_of,
)
from gaga_core.io.folder.splits import PARTS, split_views
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.masks import Loader

_KEY = "ins_2d_label_id"
# What the truth is: all instances of DM-NeRF's frames as published, those of its classes, raw ones.
FULL, SOME, RAW = "ins_full", "ins_2d_label_id (only DM-NeRF's classes)", "instance-filt (raw)"


def read_raw_scannet(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene as ScanNet's reader exports it. It has no split of its own: unless
    train_split.txt and test_split.txt are there, every 8th usable frame is a test view."""
    photos = numbered(root / "color")
    if not photos:
        raise GagaError(f"{root} has no photos color/<number>.jpg. Export the scene's frames.")
    maps = numbered(root / "instance-filt")
    truth: dict[str, Loader] = {
        path.name: partial(read_labels, maps[n]) for n, path in photos.items() if n in maps
    }
    cameras = _cameras(root, photos, numbered(root / "pose", (".txt",)))
    split = split_views(root, (camera.name for camera in cameras))
    views = DatasetViews(cameras, {p.name: p for p in photos.values()}, split)
    return scene_of(root, model, "ScanNet", views, truth=truth, truth_from=RAW)


def read_dm_nerf(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene in DM-NeRF's layout."""
    photos: dict[int, Path] = {}
    poses: dict[int, Path] = {}
    truth: dict[str, Loader] = {}
    full: dict[str, Loader] = {}  # of all instances
    for part in PARTS:
        found = numbered(root / part / f"{part}_images")
        if not found:
            raise GagaError(f"{root} has no photos in {part}/{part}_images. Copy them there.")
        maps = numbered(root / part / f"{part}_ins", (".npz",))
        truth |= {p.name: partial(read_instances, maps[n]) for n, p in found.items() if n in maps}
        full |= {
            found[n].name: partial(read_labels, path)
            for n, path in numbered(root / part / f"{part}_ins_full").items()
            if n in found
        }
        poses |= numbered(root / part / f"{part}_pose", (".txt",))
        photos |= found
    cameras = _cameras(root, photos, poses)
    of_photos = {path.name: path for path in photos.values()}
    views = DatasetViews(cameras, of_photos, split_views(root, of_photos))
    return scene_of(
        root, model, "DM-NeRF", views, truth=full or truth, truth_from=FULL if full else SOME
    )


def read_gaga_scannet(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene in Gaga's layout."""
    photos = photos_of(root / "images") or photos_of(root / "input")
    if not photos:
        raise GagaError(f"{root} has no photos in images/. Copy them there.")
    if not has_colmap(root / "sparse" / "0"):
        raise GagaError(f"{root} has no COLMAP model in sparse/0. Reconstruct the cameras first.")
    names, truth = by_stem(photos), {}
    for part in PARTS:
        for path in photos_of(root / part / f"{part}_ins_full").values():
            if path.stem in names:
                truth[names[path.stem]] = partial(read_labels, path)
    cameras = read_colmap(root / "sparse" / "0").cameras
    views = DatasetViews(cameras, photos, split_views(root, photos))
    return scene_of(root, model, "Gaga", views, truth=truth, truth_from=FULL)


def read_instances(path: Path) -> IntArray:
    """Label map (H, W) of an ``.npz`` of DM-NeRF: its ids are one lower, its void is -1."""
    arrays = read_arrays(path, "Copy it again.")
    ids = arrays.get(_KEY)
    if ids is None or ids.ndim != 2 or ids.dtype.kind not in "iu":
        raise GagaError(f"{path} holds no label map {_KEY}. Copy it again.")
    result: IntArray = np.maximum(ids.astype(np.int32) + 1, 0)
    return result


def _cameras(root: Path, photos: Mapping[int, Path], poses: Mapping[int, Path]) -> list[Camera]:
    """Cameras of the frames: the COLMAP model of ``root/sparse/0`` if there is one (splats trained
    on it live in its frame), else ScanNet's poses."""
    if has_colmap(root / "sparse" / "0"):
        stems = by_stem(path.name for path in photos.values())
        return [c for c in read_colmap(root / "sparse" / "0").cameras if c.name in stems.values()]
    if not poses:
        raise GagaError(f"{root} has no poses <number>.txt. Export the scene's poses.")
    width, height = picture_size(next(iter(photos.values())))
    K = _intrinsics(root / "intrinsic", width, height)
    posed = [
        posed_camera(K, read_numbers(poses[n], (4, 4)), (width, height), path.name)
        for n, path in photos.items()
        if n in poses
    ]
    return [camera for camera in posed if camera is not None]


def _intrinsics(folder: Path, width: int, height: int) -> DoubleArray:
    """K (3, 3) for photos of this size: of the color or the depth camera, whichever is nearer in
    size (photos shrunk to 640 x 480 go with the depth camera, as in DM-NeRF), scaled to fit."""
    files = [folder / f"intrinsic_{kind}.txt" for kind in ("color", "depth")]
    found = [read_numbers(file, (4, 4))[:3, :3] for file in files if file.is_file()]
    if not found:
        raise GagaError(f"{folder} has no intrinsic_color.txt. Export the scene's intrinsics.")
    K = min(found, key=lambda k: abs(np.log(2 * k[0, 2] / width)) if k[0, 2] > 0 else np.inf)
    # The principal point lies near the middle, so twice it tells the size that K is meant for.
    scale = width / (2 * K[0, 2]) if K[0, 2] > 0 else 1.0
    if 0.8 < scale < 1.25:
        return K
    return np.diag([scale, height / (2 * K[1, 2]), 1.0]) @ K


LAYOUTS = (
    Layout(
        "DM-NeRF",
        "<scene>/{train,test}/{train,test}_{images,pose,ins} and intrinsic/",
        lambda root: (
            (root / "train" / "train_ins").is_dir() or (root / "train" / "train_pose").is_dir()
        ),
        read_dm_nerf,
    ),
    Layout(
        "Gaga",
        "<scene>/images, {train,test}/{train,test}_ins_full and sparse/0",
        lambda root: (root / "train" / "train_ins_full").is_dir(),
        read_gaga_scannet,
    ),
    Layout(
        "ScanNet",
        "<scene>/color, pose, intrinsic and instance-filt",
        lambda root: (root / "color").is_dir(),
        read_raw_scannet,
    ),
)
