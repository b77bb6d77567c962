"""A film through the photos of a scene: each photo, its truth or the errors left of a line, what
was made of the view right of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from PIL import Image

from gaga_core.arrays import UInt8Array
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.evaluate.photo_pictures import TRUTH, error_picture, true_labels, truth_picture
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.images import read_rgb
from gaga_core.io.scene_folder import select_views
from gaga_core.io.video_out import VideoConfig, video_suffix, write_video_stage
from gaga_core.masks import resize_labels
from gaga_core.pipeline.split_picture import Split, What, joined
from gaga_core.pipeline.video import FilmConfig, painter_stage
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.project import Project

PhotoSide = Literal["photo", "truth", "errors"]


@dataclass(frozen=True)
class PhotoFilmConfig:
    """What a film through the photos shows."""

    left: PhotoSide = "photo"
    right: What = "groups"
    at: float = 0.5  # share of the width that is left of the line
    sweeps: bool = False  # over each photo, from the left edge to the right one and back
    seconds: float = 2.0  # of each photo
    video: VideoConfig = field(default_factory=VideoConfig)

    def __post_init__(self) -> None:
        if self.left not in get_args(PhotoSide):
            kinds = ", ".join(get_args(PhotoSide))
            raise GagaError(f"A photo has no side {self.left!r}. Choose of {kinds}.")
        if not 0 < self.seconds <= 3600:
            raise GagaError(f"A photo cannot be shown for {self.seconds:g} s. Choose 2, say.")


def photo_film_stage(
    project: Project,
    target: Path,
    config: PhotoFilmConfig,
    views: str | Sequence[str] = "test",
    rasterizer: Rasterizer | None = None,
) -> Stage[Path]:
    """Write a film that goes through ``views`` (train, test, all, or names), .mp4 or .webm.

    Pictures fill the film's size as far as their shape allows. Raises ``GagaError`` when the scene
    has no photos there, no true maps (sides truth and errors), or the file cannot be written;
    cancelling leaves nothing.
    """
    folder = project.placed_folder
    if folder is None:
        raise GagaError("A film through photos needs a scene folder. Open that instead of a .ply.")
    cameras = select_views(folder, views)
    for camera in cameras:
        folder.require_image(camera.name)
    truth = folder.root / TRUTH
    if config.left != "photo":
        for camera in cameras:
            true_labels(truth, camera.name, 1)
    video_suffix(target)
    engine, scene = rasterizer or choose(), project.scene
    fitting = [_fitting(camera, config.video.size) for camera in cameras]
    paint = yield from painter_stage(scene, fitting, FilmConfig(config.right), engine)
    shown = np.flatnonzero(scene.visible)
    gaussians = yield from bake_stage(scene, indices=shown)
    labels = scene.labels[shown]
    split = Split(at=config.at, sweeps=config.sweeps)

    def left(camera: Camera) -> UInt8Array:
        size = camera.width, camera.height
        if config.left == "truth":
            found = truth_picture(truth, camera.name, max(size))
            return np.asarray(Image.fromarray(found).resize(size, Image.Resampling.NEAREST))
        photo = np.asarray(Image.fromarray(read_rgb(folder.image_paths[camera.name])).resize(size))
        if config.left == "photo":
            return photo
        groups = splat_groups(engine, gaussians, camera, labels)
        true = resize_labels(true_labels(truth, camera.name, max(size)), *size)
        return error_picture(photo, groups, true)[0]

    @lru_cache(maxsize=1)
    def sides(at: int) -> tuple[UInt8Array, UInt8Array]:
        return left(fitting[at]), paint(fitting[at])

    n_each = max(round(config.seconds * config.video.fps), 1)

    def frame(index: int) -> UInt8Array:
        at, within = divmod(index, n_each)
        return _centred(joined(*sides(at), split.share(within / n_each)), config.video.size)

    return (yield from write_video_stage(target, n_each * len(cameras), frame, config.video))


def _fitting(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera with the largest picture that fits into ``size`` (width, height)."""
    scale = min(size[0] / camera.width, size[1] / camera.height)
    width, height = round(camera.width * scale), round(camera.height * scale)
    return camera.resized(max(width, 1), max(height, 1))


def _centred(picture: UInt8Array, size: tuple[int, int]) -> UInt8Array:
    """The picture in the middle of a black one of ``size`` (width, height)."""
    height, width = picture.shape[:2]
    whole = np.zeros((size[1], size[0], 3), np.uint8)
    top, start = (size[1] - height) // 2, (size[0] - width) // 2
    whole[top : top + height, start : start + width] = picture
    return whole
