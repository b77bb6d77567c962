"""Masks refined by 3D: label maps of every view rendered from the groups, as a data set.

2D masks go in that disagree between views; after association each pixel says which group its splats
belong to, the same id everywhere. What is written trains or tests 2D and 3D segmenters.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import ExifTags

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.color import colorize_labels
from gaga_core.errors import GagaError, counted
from gaga_core.export.export import exported_indices
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.folder.scene_folder import SceneFolder
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import image_header, open_image, read_rgb, write_rgb
from gaga_core.io.masks.coco import (
    CocoJson,
    LabelledPicture,
    instances_document,
    panoptic_document,
    panoptic_picture,
    segments_of,
    write_json,
)
from gaga_core.io.masks.label_maps import view_key, view_keys, write_labels
from gaga_core.masks import resize_labels
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.objects import group_colors, group_name
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene

Form = Literal["coco", "dataset"]
_STAGE = "Export masks"
_FOLDERS = ("images", "labels", "panoptic", "previews")
_PREVIEW = 640  # pixels of the longest side
_TINT = 0.6  # share of the group's color over the photo


@dataclass(frozen=True)
class MaskDataset:
    """The written files."""

    folder: Path
    views: tuple[str, ...]
    without_photo: tuple[str, ...]  # views left out of a data set because their photo is gone
    n_groups: int  # that are seen in a view
    n_masks: int  # in all views

    @property
    def sentence(self) -> str:
        """What is not in it, for people; "" where all is."""
        n = len(self.without_photo)
        are, its = ("is", "its photo is") if n == 1 else ("are", "their photos are")
        return f"{counted(n, 'view')} {are} left out: {its} gone." if n else ""

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return {
            "folder": str(self.folder),
            "views": len(self.views),
            "views_without_photo": list(self.without_photo),
            "groups": self.n_groups,
            "masks": self.n_masks,
        }


def export_mask_dataset(project: Project, out: Path, form: Form = "dataset") -> Stage[MaskDataset]:
    """Write the groups as every view shows them, as the edited scene stands, into ``out``.

    "coco": instances.json, COCO's instance format with compressed run lengths. "dataset": images/
    (the photos), labels/<stem>.png (uint16 group ids, 0 = none, at the photo's size),
    previews/<stem>.jpg, panoptic/<stem>.png with panoptic.json, instances.json and groups.json
    ({version, labels, groups: [{id, name, color, folder, parent, pixels, views}]}). Files of photos
    in a subfolder lie in one of its name (`view_key`). Views whose photo is gone have no place in a
    data set. Everything appears together at the end. Raises ``GagaError`` when there
    are no views, no photos or nothing visible.
    """
    folder = project.placed_folder
    if folder is None or not folder.cameras:
        raise GagaError("Group maps need the views of a scene folder. Open that instead of a .ply.")
    _check_target(folder, out, form)
    shown = exported_indices(project.scene)
    if len(shown) == 0 or not (project.scene.labels[shown] > 0).any():
        raise GagaError("No group is visible, so there are no group maps to export.")
    cameras = [c for c in folder.cameras if form == "coco" or c.name in folder.image_paths]
    without = tuple(c.name for c in folder.cameras if c not in cameras)
    if not cameras:
        raise GagaError(f"There are no photos in {folder.root / 'images'}. Put them back.")
    view_keys(camera.name for camera in cameras)
    gaussians = yield from bake_stage(project.scene, indices=shown)
    labels, engine = project.scene.labels[shown], choose()
    pictures = []
    with staging_folder(out) as staging:
        for i, camera in enumerate(cameras):
            yield Progress(_STAGE, i, len(cameras), camera.name)
            # At the size of its photo, that label maps and photos fit each other.
            photo = folder.image_paths.get(camera.name)
            size = (camera.width, camera.height) if photo is None else open_image(photo).size
            view = camera if size == (camera.width, camera.height) else camera.resized(*size)
            groups = splat_groups(engine, gaussians, view, labels)
            pictures.append(_write_view(staging, folder, view, groups, form))
        _write_tables(staging, pictures, project.scene, form)
        publish_all(staging, sorted(path.name for path in staging.iterdir()), out)
    yield Progress(_STAGE, len(cameras), len(cameras), f"{len(cameras)} views")
    seen = {s.group for picture in pictures for s in picture.segments}
    n_masks = sum(len(picture.segments) for picture in pictures)
    names = tuple(camera.name for camera in cameras)
    return MaskDataset(out, names, without, len(seen), n_masks)


def _check_target(folder: SceneFolder, out: Path, form: Form) -> None:
    """A data set's folders replace those of the same names: only an older data set's may go."""
    if form == "coco" or not out.is_dir():
        return
    present = {path.name for path in out.iterdir()}
    is_ours = {"groups.json", "instances.json", "panoptic.json"} <= present
    if out.resolve() == folder.root.resolve() or (present & set(_FOLDERS) and not is_ours):
        raise GagaError(f"{out} holds other files. Choose an empty or a new folder.")


def _write_view(
    staging: Path, folder: SceneFolder, camera: Camera, groups: IntArray, form: Form
) -> LabelledPicture:
    stem = view_key(camera.name)
    if form == "dataset":
        source = folder.image_paths[camera.name]
        photo = staging / "images" / f"{stem}{source.suffix.lower()}"
        _copy_photo(source, photo)
        write_labels(staging / "labels" / f"{stem}.png", groups)
        write_rgb(staging / "panoptic" / f"{stem}.png", panoptic_picture(groups))
        write_rgb(staging / "previews" / f"{stem}.jpg", _preview(source, groups))
        name = photo.relative_to(staging / "images").as_posix()
    else:
        name = camera.name
    return LabelledPicture(name, f"{stem}.png", camera.width, camera.height, segments_of(groups))


def _copy_photo(source: Path, target: Path) -> None:
    """The file itself; upright pixels instead where a tag says that it lies on its side."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with image_header(source) as raw:
        is_upright = raw.getexif().get(ExifTags.Base.Orientation, 1) == 1
    if is_upright:
        shutil.copyfile(source, target)
    else:
        open_image(source).save(target, quality=95)


def _preview(source: Path, groups: IntArray) -> FloatArray:
    """The photo, small, with each group in its color."""
    photo: FloatArray = read_rgb(source, _PREVIEW).astype(np.float32) / np.float32(255)
    labels = resize_labels(groups, photo.shape[1], photo.shape[0])
    mixed = photo * (1 - _TINT) + colorize_labels(labels) * _TINT
    return np.where((labels > 0)[..., None], mixed, photo * (1 - _TINT))


def _write_tables(
    staging: Path, pictures: Sequence[LabelledPicture], scene: Scene, form: Form
) -> None:
    seen = sorted({s.group for picture in pictures for s in picture.segments})
    names = {group: group_name(scene, group) for group in seen}
    write_json(staging / "instances.json", instances_document(pictures, names))
    if form == "coco":
        return
    write_json(staging / "panoptic.json", panoptic_document(pictures, names))
    groups: list[CocoJson] = []
    colors = group_colors(np.array(list(names), np.int32), scene.colors)
    for (group, name), color in zip(names.items(), colors, strict=True):
        areas = [s.area for picture in pictures for s in picture.segments if s.group == group]
        groups.append(
            {
                "id": group,
                "name": name,
                "color": [round(float(c), 4) for c in color],
                "folder": scene.folders.places.get(group, ""),
                "parent": scene.folders.nearest(group, names),
                "pixels": sum(areas),
                "views": len(areas),
            }
        )
    document = {"version": 1, "labels": "labels/<stem>.png", "none": 0, "groups": groups}
    write_json(staging / "groups.json", document)
