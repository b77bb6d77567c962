"""Mip-NeRF 360 (Barron et al., CVPR 2022) and any scene with a COLMAP model.

``<scene>/{images[_2|_4|_8], sparse/0}``; every 8th photo by name is a test view unless split.json
says otherwise. Photos at a quarter of the size (images_4) are used where they are there, as the
paper does; else those wider than 1600 pixels are used in a smaller folder, as the 3DGS trainer
shrinks them. There are no true maps, except where ``gt/instance`` holds some (the layout of our own
scenes): the data set is shown, not scored.
"""

from functools import partial
from pathlib import Path

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.datasets.base import (
    DatasetScene,
    DatasetViews,
    Layout,
    photos_of,
    picture_size,
    scene_of,
)
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.folder.splits import ViewSplit
from gaga_core.io.masks.label_maps import read_labels

WIDEST = 1600  # pixels
_QUARTER = "images_4"  # the factor of the paper
_FOLDERS = ("images", "images_2", "images_8")


def read_mipnerf360(root: Path, model: Path | None = None) -> DatasetScene:
    """A scene with a COLMAP model; its true maps, if any, lie in gt/instance."""
    folder = open_scene_folder(root, model)
    if not folder.cameras:
        raise GagaError(f"{root} has no COLMAP model in sparse/0. Copy it there.")
    photos, size = _photos(root)
    if not photos:
        raise GagaError(f"{root} has no photos in images/. Copy them there.")
    cameras = [_at_size(camera, size) for camera in folder.cameras]
    stems = {Path(camera.name).stem: camera.name for camera in cameras}
    found = {stems[path.stem]: path for path in photos.values() if path.stem in stems}
    maps = photos_of(root / "gt" / "instance").values()
    truth = {stems[path.stem]: partial(read_labels, path) for path in maps if path.stem in stems}
    split = ViewSplit(folder.train, folder.test, folder.split)
    views = DatasetViews(cameras, found, split)
    truth_from = "gt/instance" if truth else ""
    return scene_of(root, folder.model_path, "COLMAP", views, truth=truth, truth_from=truth_from)


def _photos(root: Path) -> tuple[dict[str, Path], tuple[int, int]]:
    """The photos of a quarter of the size, else the widest that are not too wide, else the
    smallest there are; and their size."""
    found: dict[str, Path] = photos_of(root / _QUARTER)
    if found:
        return found, picture_size(next(iter(found.values())))
    size = (0, 0)
    for name in _FOLDERS:
        photos = photos_of(root / name)
        if photos:
            found, size = photos, picture_size(next(iter(photos.values())))
            if size[0] <= WIDEST:
                break
    return found, size


def _at_size(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera at the size of the photos used; one of another shape stays as it is."""
    width, height = size
    same_shape = abs(camera.width * height - camera.height * width) <= camera.width + camera.height
    return camera.resized(width, height) if same_shape else camera


LAYOUTS = (
    Layout(
        "COLMAP",
        "<scene>/images and sparse/0",
        lambda root: (root / "sparse").is_dir() and (root / "images").is_dir(),
        read_mipnerf360,
    ),
)
