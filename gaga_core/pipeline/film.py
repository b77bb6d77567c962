"""Films and pictures of a scene, drawn without a window."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, UInt8Array
from gaga_core.camera import NEAR, Camera
from gaga_core.color import depth_colors
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.files import atomic_write
from gaga_core.io.video import VideoConfig, video_suffix, write_video_stage
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.camera_path import CameraPath
from gaga_core.scene.objects import group_colors, object_table
from gaga_core.scene.scene import RGB, Scene

# --- How long films and pictures take.

# Seconds on two cores, of the demo at 320 x 180 to 3840 x 2160 and of films of 640 x 360 and 1280 x
# 720: to draw a picture, by its splats and pixels, and to write one, by its pixels.
_DRAWN = 2e-7, 4.5e-8
_WRITTEN = {".mp4": 4.2e-8, ".webm": 9.1e-8, ".png": 1.9e-7, ".jpg": 1e-8, ".jpeg": 1e-8}


def usual_seconds(
    suffix: str, size: tuple[int, int], n_splats: int, n_written: int, n_drawn: int
) -> float:
    """Seconds that a film, or a picture, usually takes of which ``n_drawn`` pictures of a ``size``
    are drawn by the rasterizer and ``n_written`` are written."""
    n_pixels = size[0] * size[1]
    each = _DRAWN[0] * n_splats + _DRAWN[1] * n_pixels
    return n_drawn * each + n_written * n_pixels * _WRITTEN[suffix.lower()]


# --- Two pictures in one, with a line between them.


What = Literal["rgb", "groups", "depth"]
_LINE = 400  # widths of the line that a picture is wide


def _check_kind(what: str) -> None:
    if what not in get_args(What):
        kinds = ", ".join(get_args(What))
        raise GagaError(f"There is nothing called {what!r} to film. Choose of {kinds}.")


@dataclass(frozen=True)
class Split:
    """Content left of the line in a film, and the place of the line."""

    left: What = "rgb"
    at: float = 0.5  # share of the width that is left of the line
    sweeps: bool = False  # the line goes once from the left edge to the right one, and back

    def __post_init__(self) -> None:
        _check_kind(self.left)
        if not 0 <= self.at <= 1:
            raise GagaError(f"The line of a split film must be between 0 and 1, not {self.at}.")

    def share(self, t: float) -> float:
        """The share of the width left of the line at a time 0..1 of the film."""
        return 0.5 - 0.5 * float(np.cos(2 * np.pi * t)) if self.sweeps else self.at


def joined(left: UInt8Array, right: UInt8Array, share: float) -> UInt8Array:
    """The left picture up to ``share`` of the width, the right one from there on, (H, W, 3).

    Between them is a white line; there is none at the edges, where one picture is whole.
    """
    if left.shape != right.shape:
        raise ValueError(f"left: expected {right.shape}, got {left.shape}")
    width = right.shape[1]
    at = round(min(max(share, 0.0), 1.0) * width)
    picture = np.concatenate([left[:, :at], right[:, at:]], axis=1)
    if 0 < at < width:
        half = max(width // _LINE, 2) // 2
        picture[:, max(at - half, 0) : at + half] = 255
    return picture


Painter = Callable[[Camera], UInt8Array]  # the picture (H, W, 3 or 4) of a view
_LARGEST_PICTURE = 16384  # pixels of a side
_KINDS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}


@dataclass(frozen=True)
class FilmConfig:
    """Settings of a film or a picture."""

    what: What = "rgb"
    background: RGB = (0.0, 0.0, 0.0)
    split: Split | None = None  # of a film: something else left of a line
    antialiased: bool | None = None  # low-pass of mip-splatting; None = as the file's comments say
    video: VideoConfig = field(default_factory=VideoConfig)

    def __post_init__(self) -> None:
        _check_kind(self.what)


@dataclass(frozen=True, eq=False)
class LeftSide:
    """Whose picture lies left of the line of a split film, and who draws it."""

    scene: Scene | None = None  # None: the same
    painter: Painter | None = None  # None: the rasterizer


def film_stage(
    scene: Scene,
    path: CameraPath,
    target: Path,
    config: FilmConfig,
    *,
    painter: Painter | None = None,
    left: LeftSide | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[Path]:
    """Write what is visible along ``path`` as a video, .mp4 or .webm.

    ``painter`` draws the pictures (the window's), else ``rasterizer`` (default: the best here);
    ``left`` says whose picture lies left of the line of ``config.split``.
    Works on the scene as it is at the call. Raises ``GagaError`` when the path is too short or
    the file cannot be written; cancelling leaves nothing.
    """
    if len(path.keyframes) < 2:
        raise GagaError("A film needs two keyframes at least. Add some, or make a turntable.")
    video_suffix(target)
    left, frozen = left or LeftSide(), replace(scene)
    lefts, left_painter = frozen if left.scene is None else replace(left.scene), left.painter

    def stage() -> Stage[Path]:
        size, split = config.video.size, config.split
        times = path.frame_times(config.video.fps)
        cameras = [key.shot.camera(*size) for key in path.keyframes]
        paint, paint_left = painter, left_painter
        if paint is None:
            paint = yield from painter_stage(frozen, cameras, config, rasterizer)
        if split is not None and paint_left is None:
            other = replace(config, what=split.left)
            paint_left = yield from painter_stage(lefts, cameras, other, rasterizer)

        def frame(index: int) -> UInt8Array:
            assert paint is not None
            camera = path.shot(float(times[index])).camera(*size, f"frame {index}")
            picture = paint(camera)
            if split is None or paint_left is None:
                return picture
            return joined(paint_left(camera), picture, split.share(index / max(len(times) - 1, 1)))

        return (yield from write_video_stage(target, len(times), frame, config.video))

    return stage()


def picture_stage(
    scene: Scene,
    camera: Camera,
    target: Path,
    config: FilmConfig,
    *,
    transparent: bool = False,
    painter: Painter | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[Path]:
    """Write what ``camera`` sees as .png or .jpg of the camera's size.

    ``transparent``: no background, but an alpha channel (.png only). Raises ``GagaError`` when the
    size or the name will not do, or the disk says no.
    """
    check_picture(target, (camera.width, camera.height), transparent)
    frozen = replace(scene)

    def stage() -> Stage[Path]:
        yield Progress("Save picture", 0, 2)
        paint = painter
        if paint is None:
            one = [camera]
            paint = yield from painter_stage(
                frozen, one, config, rasterizer, transparent=transparent
            )
        yield Progress("Save picture", 1, 2)
        save_picture(target, paint(camera))
        return target

    return stage()


def check_picture(target: Path, size: tuple[int, int], transparent: bool) -> None:
    """Raise ``GagaError`` with the cure when such a picture cannot be written."""
    if target.suffix.lower() not in _KINDS:
        raise GagaError(f"{target.name}: choose a name that ends in .png or .jpg.")
    if transparent and target.suffix.lower() != ".png":
        raise GagaError("A JPEG cannot be transparent. Choose a name that ends in .png.")
    if not all(1 <= side <= _LARGEST_PICTURE for side in size):
        raise GagaError(
            f"A picture cannot be {size[0]} x {size[1]}. Choose sides up to {_LARGEST_PICTURE}."
        )


def save_picture(target: Path, picture: UInt8Array) -> None:
    """Write (H, W, 3) or, with alpha, (H, W, 4) as PNG or JPEG, whole or not at all."""
    with atomic_write(target) as temporary:
        Image.fromarray(picture).save(temporary, format=_KINDS[target.suffix.lower()], quality=95)


def painter_stage(
    scene: Scene,
    cameras: Sequence[Camera],
    config: FilmConfig,
    rasterizer: Rasterizer | None = None,
    *,
    transparent: bool = False,
) -> Stage[Painter]:
    """The renderer of the visible splats, edits applied. ``cameras`` give depth its range."""
    shown = np.flatnonzero(scene.visible)
    gaussians = yield from bake_stage(scene, indices=shown)
    if config.antialiased is not None:
        gaussians = gaussians.with_antialiasing(config.antialiased)
    engine = rasterizer or choose()
    channels: FloatArray | None = None
    if config.what == "groups":
        ids, row = np.unique(scene.labels[shown], return_inverse=True)
        table = object_table(scene)  # as the window shows them: large surfaces are muted
        channels = table.colors[np.searchsorted(table.ids, ids)][row]
    span = (0.0, 1.0)
    if config.what == "depth":
        channels = np.zeros((len(gaussians), 1), np.float32)
        span = depth_span(gaussians, cameras)

    def paint(camera: Camera) -> UInt8Array:
        frame = engine.render(gaussians, camera, channels=channels)
        image = frame.image
        if config.what == "depth":
            image = depth_colors(frame.expected_depth, span) * frame.alpha[..., None]
        if transparent:
            straight = image / np.maximum(frame.alpha, 1e-6)[..., None]  # as PNG wants it
            return as_bytes(np.concatenate([straight, frame.alpha[..., None]], axis=2))
        behind = np.asarray(config.background, np.float32)
        return as_bytes(image + (1 - frame.alpha[..., None]) * behind)

    return paint


def depth_span(gaussians: Gaussians, cameras: Sequence[Camera]) -> tuple[float, float]:
    """Logs of the depths that get the ends of the color map: the same for a whole film."""
    step = max(1, len(gaussians) // 20_000)
    points = gaussians.means[::step].astype(np.float64)
    depths = []
    for camera in cameras:
        pixels, depth = camera.project(points)
        inside = (depth > NEAR) & (pixels >= 0).all(axis=1)
        inside &= (pixels < [camera.width, camera.height]).all(axis=1)
        depths.append(depth[inside])
    seen: DoubleArray = np.concatenate(depths) if depths else np.zeros(0)
    if len(seen) == 0:
        return 0.0, 1.0
    near, far = np.log(np.percentile(seen, [2, 98]))
    return float(near), max(float(far), float(near) + 1e-6)


def painted_labels(labels: IntArray) -> UInt8Array:
    """A map (H, W) of groups in their colors (H, W, 3); no group is black."""
    ids, row = np.unique(labels, return_inverse=True)
    colors = group_colors(ids.astype(np.int32))
    colors[ids == 0] = 0
    return as_bytes(colors[row.reshape(labels.shape)])


def as_bytes(image: FloatArray) -> UInt8Array:
    """A picture of colors 0..1 as 8-bit values."""
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)
