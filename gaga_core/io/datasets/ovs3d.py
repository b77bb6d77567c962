"""3D-OVS (Liu et al., NeurIPS 2023): forward-facing scenes with masks of every class.

``<scene>/{images/<i>.jpg, segmentations/classes.txt, segmentations/<i>/<class>.png}`` with
``poses_bounds.npy`` (LLFF) or a COLMAP model. The views that have masks are the test views; all
classes of classes.txt are expected in each.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_array
from gaga_core.io.cameras.colmap import has_colmap, read_colmap
from gaga_core.io.datasets.base import (
    DatasetScene,
    DatasetViews,
    Layout,
    PromptTruth,
    by_stem,
    photos_of,
    picture_size,
    posed_camera,
    scene_of,
)
from gaga_core.io.datasets.lerf_mask import prompts_of
from gaga_core.io.files import read_names
from gaga_core.io.folder.splits import split_views


def read_ovs3d(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene of 3D-OVS; ``GagaError`` when photos, masks, classes or cameras are gone."""
    photos = photos_of(root / "images")
    if not photos:
        raise GagaError(f"{root} has no photos in images/. Copy them there.")
    truth = root / "segmentations"
    if not (truth / "classes.txt").is_file():
        raise GagaError(f"{root} has no segmentations/classes.txt. Copy the scene again.")
    stems = by_stem(photos)
    keys = sorted(path.name for path in truth.iterdir() if path.is_dir())
    views = {key: stems[key] for key in keys if key in stems}
    if not views:
        raise GagaError(f"{root} has no masks segmentations/<photo>/<class>.png. Copy them.")
    _check_classes(truth, views)
    cameras = (
        read_colmap(root / "sparse" / "0").cameras
        if has_colmap(root / "sparse" / "0")
        else _llff_cameras(root, photos)
    )
    found = DatasetViews(cameras, photos, split_views(root, photos))
    prompts = PromptTruth(truth, views, prompts_of(truth, views))
    return scene_of(root, model, "3D-OVS", found, prompts=prompts, truth_from="segmentations")


def _check_classes(truth: Path, views: Mapping[str, str]) -> None:
    classes = read_names(truth / "classes.txt")
    absent = [
        f"{key}/{name}"
        for key in views
        for name in classes
        if not (truth / key / f"{name}.png").is_file()
    ]
    if absent:
        raise GagaError(
            f"{len(absent)} of {len(classes) * len(views)} class masks are not in {truth} "
            f"(first: {absent[0]}.png). Copy the scene again."
        )


def _llff_cameras(root: Path, photos: Mapping[str, Path]) -> list[Camera]:
    """Cameras of ``poses_bounds.npy`` in the order of the photos' names.

    A row is a 3 x 5 matrix and two bounds: world_from_cam whose axes point down, right, backwards,
    then height, width and focal length in pixels (Mildenhall et al., LLFF, SIGGRAPH 2019).
    """
    rows = _pose_rows(root / "poses_bounds.npy")
    if len(rows) != len(photos):
        raise GagaError(
            f"{root / 'poses_bounds.npy'} has {len(rows)} poses for {len(photos)} photos. "
            "Copy the scene again, or add a COLMAP model (sparse/0)."
        )
    cameras = []
    for row, (name, path) in zip(rows, sorted(photos.items()), strict=True):
        matrix = row[:15].reshape(3, 5)
        width, height = picture_size(path)
        focal = matrix[2, 4] * width / matrix[1, 4]  # the photos may have been shrunk
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        pose = np.eye(4)
        pose[:3] = np.stack([matrix[:, 1], matrix[:, 0], -matrix[:, 2], matrix[:, 3]], axis=1)
        camera = posed_camera(K, pose, (width, height), name)
        if camera is not None:
            cameras.append(camera)
    return cameras


def _pose_rows(path: Path) -> DoubleArray:
    rows = read_array(path, "Copy it again.")
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind != "f":
        raise GagaError(f"{path} must hold 17 numbers a photo. Copy it again.")
    result: DoubleArray = rows.astype(np.float64)
    return result


LAYOUTS = (
    Layout(
        "3D-OVS",
        "<scene>/images, segmentations/classes.txt and poses_bounds.npy or sparse/0",
        lambda root: (root / "segmentations").is_dir(),
        read_ovs3d,
    ),
)
