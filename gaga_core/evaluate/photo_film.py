"""A film through the photos of a scene: each photo, its truth or the errors left of a line, what
was made of the view right of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array, check_shape
from gaga_core.camera import Camera
from gaga_core.color import group_palette
from gaga_core.errors import GagaError
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.folder.scene_folder import select_views
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import label_files_of, read_labels
from gaga_core.io.video import VideoConfig, video_suffix, write_video_stage
from gaga_core.masks import resize_labels
from gaga_core.pipeline.film import FilmConfig, Split, What, joined, painter_stage
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.project import Project

# --- Ground truth of a photo as pictures: its true map in colors, and where groups are wrong.


TRUTH = Path("gt") / "instance"  # where a scene folder has its true maps
# Right, wrong and missing pixels: told apart by color-blind eyes, too.
_VERDICTS = np.array([[0, 0, 0], [70, 130, 180], [214, 50, 40], [250, 190, 50]], np.float32)
_SHARES = np.array([0.0, 0.35, 0.85, 0.85], np.float32)  # of those colors over the gray photo
_GRAY = 0.6  # brightness of the photo under them


def true_labels(folder: Path, name: str, side: int) -> IntArray:
    """The true map (H, W) int32 of the view ``name``, no side longer than ``side`` pixels.

    ``GagaError`` when ``folder`` has none.
    """
    path = label_files_of(folder, [name]).get(name) if folder.is_dir() else None
    if path is None:
        raise GagaError(f"There is no true map of {name} in {folder}.")
    labels = read_labels(path)
    height, width = labels.shape
    scale = min(1.0, side / max(height, width))
    return resize_labels(labels, max(round(width * scale), 1), max(round(height * scale), 1))


def truth_picture(folder: Path, name: str, side: int) -> UInt8Array:
    """The true map (H, W, 3) of a view in colors; black where nothing is. See `true_labels`."""
    labels = true_labels(folder, name, side)
    colors = group_palette(int(labels.max(initial=0)))
    colors[0] = 0
    return (colors[labels] * 255).astype(np.uint8)


def error_picture(photo: UInt8Array, groups: IntArray, truth: IntArray) -> tuple[UInt8Array, float]:
    """The photo (H, W, 3) in gray with right, wrong and missing pixels colored, and the share that
    is right. ``groups`` and ``truth`` are ids (H, W), 0 = none; see `error_map`."""

    found = error_map(groups, truth)
    gray = photo.mean(axis=2, keepdims=True) * _GRAY
    share = _SHARES[found.verdicts][..., None]
    picture = gray * (1 - share) + _VERDICTS[found.verdicts] * share
    return np.clip(picture, 0, 255).astype(np.uint8), found.share_right


PhotoSide = Literal["photo", "truth", "errors"]


@dataclass(frozen=True)
class PhotoFilmConfig:
    """Settings of a film through the photos."""

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


# --- Agreement of a view's groups with the true objects, pixel by pixel.


class Verdict(IntEnum):
    """Judgement of a pixel."""

    VOID = 0  # no true object is there
    RIGHT = 1  # the group that stands for the true object
    WRONG = 2  # another group
    MISSING = 3  # no group


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """The comparison of one view."""

    verdicts: UInt8Array  # (H, W) `Verdict`
    group_of: dict[
        int, int
    ]  # the group that stands for each true id; one that has none is left out

    @property
    def share_right(self) -> float:
        """Share of the pixels of true objects that have the right group; 1 without any."""
        counts = np.bincount(self.verdicts.ravel(), minlength=4)
        n = int(counts[1:].sum())
        return float(counts[Verdict.RIGHT] / n) if n else 1.0


def error_map(groups: IntArray, truth: IntArray) -> ErrorMap:
    """Compare group ids with true ids, both (H, W), 0 = none.

    Each true object is matched to one group, and no group to two objects, so that the sum of their
    IoU in this view is greatest (the pairing of the supplement's Algorithm 1, for a single image
    without void).
    """
    from scipy.optimize import linear_sum_assignment  # slow to import: the window starts without

    check_shape("groups", groups, ("H", "W"), np.int32)
    check_shape("truth", truth, groups.shape, np.int32)
    inside = truth > 0
    true_ids, row = np.unique(truth[inside], return_inverse=True)
    group_ids, column = np.unique(groups[inside], return_inverse=True)
    counts = np.zeros((len(true_ids), len(group_ids)), np.int64)
    np.add.at(counts, (row, column), 1)
    union = counts.sum(axis=1, keepdims=True) + counts.sum(axis=0, keepdims=True) - counts
    overlap = np.where(group_ids > 0, counts / np.maximum(union, 1), 0.0)
    pairs = zip(*linear_sum_assignment(overlap, maximize=True), strict=True)
    group_of = {int(true_ids[i]): int(group_ids[j]) for i, j in pairs if overlap[i, j] > 0}
    lookup = np.full(int(truth.max(initial=0)) + 1, -1, np.int32)
    lookup[list(group_of)] = list(group_of.values())
    verdicts = np.where(groups == lookup[np.maximum(truth, 0)], Verdict.RIGHT, Verdict.WRONG)
    verdicts = np.where(groups == 0, Verdict.MISSING, verdicts)
    return ErrorMap(np.where(inside, verdicts, Verdict.VOID).astype(np.uint8), group_of)
