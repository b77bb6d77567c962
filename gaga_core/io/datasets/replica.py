"""Replica as Semantic-NeRF renders it (Zhi et al., ICCV 2021), and as Gaga's scripts rearrange it.

Semantic-NeRF: ``<scene>/Sequence_1/{rgb/rgb_<i>.png, semantic_instance/semantic_instance_<i>.png,
traj_w_c.txt}``, 900 frames; row i of the trajectory is world_from_cam (4 x 4, OpenCV axes); the
field of view is 90 degrees across and the principal point (W-1)/2, (H-1)/2 in its convention of
pixel centres at whole numbers. Train frames are 0, 5, 10, ..., test frames 2 later (180 each). The
instance maps come as an archive of their own: Replica_Instance_Segmentation/<scene>/Sequence_1.
Gaga: ``<scene>/{images|input}/{train|test}_rgb_<i>.png`` with a COLMAP model of its own and
``semantic_instance/{train|test}_semantic_instance_<i>.png``.
"""

from functools import partial
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.datasets.base import (
    DatasetScene,
    DatasetViews,
    Layout,
    numbered,
    photos_of,
    picture_size,
    posed_camera,
    read_numbers,
    scene_of,
)
from gaga_core.io.folder.splits import REPLICA_AFTER, REPLICA_EVERY, split_views
from gaga_core.io.masks.label_maps import read_labels

TRUTH = "semantic_instance"
_INSTANCES = "Replica_Instance_Segmentation"


def read_semantic_nerf(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene in Semantic-NeRF's layout; a COLMAP model in ``root/sparse/0`` wins over the
    trajectory, because splats trained on it live in its frame."""
    sequence = root / "Sequence_1" if (root / "Sequence_1").is_dir() else root
    photos = numbered(sequence / "rgb")
    if not photos:
        raise GagaError(f"{sequence} has no photos rgb/rgb_<number>.png. Unpack the scene there.")
    chosen = {i: path for i, path in photos.items() if i % REPLICA_EVERY in (0, REPLICA_AFTER)}
    names = {i: path.name for i, path in chosen.items()}
    truth = {
        names[i]: partial(read_labels, path)
        for i, path in numbered(_instance_folder(root, sequence)).items()
        if i in names
    }
    if has_colmap(root / "sparse" / "0"):
        cameras = [
            c for c in read_colmap(root / "sparse" / "0").cameras if c.name in set(names.values())
        ]
    else:
        poses = read_numbers(sequence / "traj_w_c.txt", (-1, 4, 4))
        width, height = picture_size(next(iter(chosen.values())))
        # Our pixel centres lie at +0.5, so (W-1)/2 in theirs is W/2 in ours.
        K = np.array([[width / 2, 0, width / 2], [0, width / 2, height / 2], [0, 0, 1.0]])
        posed = [
            posed_camera(K, poses[i], (width, height), name)
            for i, name in names.items()
            if i < len(poses)
        ]
        cameras = [camera for camera in posed if camera is not None]
    views = DatasetViews(
        cameras,
        {names[i]: path for i, path in chosen.items()},
        split_views(root, names.values()),
    )
    return scene_of(root, model, "Semantic-NeRF", views, truth=truth, truth_from=TRUTH)


def _instance_folder(root: Path, sequence: Path) -> Path:
    """The instance maps: in the scene, or in the archive's folder next to or above it."""
    own = sequence / "semantic_instance"
    tail = Path(root.name) / "Sequence_1" / "semantic_instance"
    places = [own, root.parent / _INSTANCES / tail, root.parent.parent / _INSTANCES / tail]
    return next((place for place in places if place.is_dir()), own)


def read_gaga_replica(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene in Gaga's layout."""
    photos = photos_of(root / "images") or photos_of(root / "input")
    if not photos:
        raise GagaError(f"{root} has no photos in images/. Copy them there.")
    if not has_colmap(root / "sparse" / "0"):
        raise GagaError(f"{root} has no COLMAP model in sparse/0. Reconstruct the cameras first.")
    maps = {path.stem: path for path in photos_of(root / "semantic_instance").values()}
    truth = {}
    for name in photos:
        path = maps.get(Path(name).stem.replace("_rgb_", "_semantic_instance_"))
        if path is not None:
            truth[name] = partial(read_labels, path)
    cameras = read_colmap(root / "sparse" / "0").cameras
    views = DatasetViews(cameras, photos, split_views(root, photos))
    return scene_of(root, model, "Gaga", views, truth=truth, truth_from=TRUTH)


LAYOUTS = (
    Layout(
        "Semantic-NeRF",
        "<scene>/Sequence_1/rgb, semantic_instance and traj_w_c.txt",
        lambda root: (root / "Sequence_1" / "rgb").is_dir() or (root / "traj_w_c.txt").is_file(),
        read_semantic_nerf,
    ),
    Layout(
        "Gaga",
        "<scene>/images/train_rgb_*.png, semantic_instance and sparse/0",
        lambda root: any(
            next((root / folder).glob("t*_rgb_*"), None) is not None
            for folder in ("images", "input")
        ),
        read_gaga_replica,
    ),
)
