"""Photos and cameras as a training takes them: at one size, in memory."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import DoubleArray, FloatArray, UInt8Array, check_shape
from gaga_core.camera import Camera
from gaga_core.errors import GagaError, counted
from gaga_core.gaussians import Gaussians
from gaga_core.io.depth_maps import read_scene_depth
from gaga_core.io.images import read_rgb
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.training.losses import psnr, ssim

READ_STAGE = "Read photos"
_FEWEST = 2  # views to train on
_IS_OBJECT = 127  # alpha of 255 above which a pixel is one of the object
_SHAPES_APART = 0.02  # a photo may differ from its camera by this in width over height


@dataclass(frozen=True, eq=False)
class TrainView:
    """A posed photo. The camera has the size of the picture."""

    camera: Camera
    picture: UInt8Array  # (H, W, 3)
    alpha: UInt8Array | None = None  # (H, W) 0 = background that is left out, 255 = object
    depth: FloatArray | None = None  # (H', W') measured, scene units, 0 = not known; of any size

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        check_shape("picture", self.picture, (*shape, 3), np.uint8)
        if self.alpha is not None:
            check_shape("alpha", self.alpha, shape, np.uint8)

    def target(self, background: FloatArray | None = None) -> FloatArray:
        """The picture (H, W, 3) in 0..1, before ``background`` (3,), black if not given."""
        picture = self.picture * np.float32(1 / 255)
        if self.alpha is None:
            return picture
        share = (self.alpha * np.float32(1 / 255))[..., None]
        behind = np.zeros(3, np.float32) if background is None else background
        result: FloatArray = (picture * share + behind * (1 - share)).astype(np.float32)
        return result

    def backdrop(self, default: FloatArray) -> FloatArray:
        """Mean color (3,) of what is left out, 0..1; ``default`` (3,) where nothing is."""
        out = self.alpha is not None and self.alpha <= _IS_OBJECT
        if not np.any(out):
            return default
        return (self.picture[out].mean(axis=0) / 255).astype(np.float32)

    def smaller(self, times: float) -> "TrainView":
        """The view at ``times`` its size, at least one pixel."""
        width = max(1, round(self.camera.width * times))
        height = max(1, round(self.camera.height * times))
        alpha = None if self.alpha is None else shrunk(self.alpha, width, height)
        picture = shrunk(self.picture, width, height)
        return TrainView(self.camera.resized(width, height), picture, alpha, self.depth)


@dataclass(frozen=True, eq=False)
class TrainViews:
    """Views to train on, and held-out ones to measure on."""

    train: tuple[TrainView, ...]
    test: tuple[TrainView, ...]

    def __post_init__(self) -> None:
        if len(self.train) < _FEWEST:
            n = len(self.train)
            photos = f"There {'is' if n == 1 else 'are'} {counted(n, 'photo')}"
            raise GagaError(
                f"{photos} to train on, and it takes at least {_FEWEST}."
                " Take more photos, all around the scene."
            )

    def smaller(self, times: float) -> "TrainViews":
        """All views at ``times`` their size."""
        train, test = (tuple(v.smaller(times) for v in vs) for vs in (self.train, self.test))
        return TrainViews(train, test)


def load_views_stage(
    cameras: Sequence[Camera],
    image_paths: Mapping[str, Path],  # by view name
    test: Sequence[str],  # names of the held-out views
    longest_side: int,  # pixels
    foreground: Mapping[str, Path] | None = None,  # masks of the object, by view name
    depth: Mapping[str, Path] | None = None,  # of the scene folder, by view name
) -> Stage[TrainViews]:
    """Read the photos of ``cameras`` that are on disk, shrunk to ``longest_side``.

    Raises ``GagaError`` when a photo cannot be read, has another shape than its camera, or when
    fewer than two are left to train on.
    """
    held_out, parts = set(test), {True: list[TrainView](), False: list[TrainView]()}
    present = [camera for camera in cameras if camera.name in image_paths]
    for i, camera in enumerate(present):
        yield Progress(READ_STAGE, i, len(present), camera.name)
        mask = (foreground or {}).get(camera.name)
        view = read_view(camera, image_paths[camera.name], longest_side, mask)
        if depth is not None and camera.name in depth:
            view = replace(view, depth=read_scene_depth(depth[camera.name]))
        parts[camera.name in held_out].append(view)
    return TrainViews(tuple(parts[False]), tuple(parts[True]))


def read_view(camera: Camera, path: Path, longest_side: int, mask: Path | None = None) -> TrainView:
    """One photo with its camera, shrunk so that no side is longer than ``longest_side``; where
    ``mask`` is black is its background."""
    picture = read_rgb(path, shrunk_to=longest_side)
    height, width = picture.shape[:2]
    apart = (width / height) / (camera.width / camera.height)
    if not 1 / (1 + _SHAPES_APART) < apart < 1 + _SHAPES_APART:
        raise GagaError(
            f"{path.name} has {width} x {height} pixels, but its camera {camera.width} x "
            f"{camera.height}. Put the photo back that the model was made from."
        )
    times = min(1.0, longest_side / max(width, height))
    width, height = max(1, round(width * times)), max(1, round(height * times))
    resized = camera.resized(width, height)
    alpha = None if mask is None else shrunk(read_rgb(mask)[..., 0], width, height)
    return TrainView(replace(resized, name=camera.name), shrunk(picture, width, height), alpha)


def shrunk(picture: UInt8Array, width: int, height: int) -> UInt8Array:
    """The picture (H, W, 3) or (H, W) at another size, without aliasing."""
    if picture.shape[:2] == (height, width):
        return picture
    image = Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS)
    return np.array(image)


# --- Quality of Gaussians in views that they were not trained on.


MEASURE_STAGE = "Measure on held-out views"


@dataclass(frozen=True)
class HeldOutView:
    """One view: the picture against the photo."""

    name: str
    psnr: float  # dB
    ssim: float


@dataclass(frozen=True)
class HeldOutQuality:
    """Means over the views, and each of them."""

    psnr: float  # dB, mean over views
    ssim: float
    views: tuple[HeldOutView, ...]


def quality_stage(
    gaussians: Gaussians,
    views: Sequence[TrainView],
    rasterizer: Rasterizer,
    background: DoubleArray | FloatArray,
) -> Stage[HeldOutQuality | None]:
    """PSNR and SSIM of ``views``, colors clipped to 0..1; None when there are none.

    Where a background is left out, PSNR is over the pixels of the object, before the mean color of
    what is left out: masks that were found take some of the backdrop, each photo another piece.
    """
    found = []
    for i, view in enumerate(views):
        yield Progress(MEASURE_STAGE, i, len(views), view.camera.name)
        behind = view.backdrop(np.asarray(background, np.float32))
        image = rasterizer.render(gaussians, view.camera, background=behind).image
        image = np.clip(image, 0, 1)
        target = view.target(behind)
        value = psnr(image, target)
        if view.alpha is not None and (view.alpha > _IS_OBJECT).any():
            value = psnr(image[view.alpha > _IS_OBJECT], target[view.alpha > _IS_OBJECT])
        found.append(HeldOutView(view.camera.name, value, ssim(image, target)))
    if not found:
        return None
    return HeldOutQuality(
        float(np.mean([v.psnr for v in found])),
        float(np.mean([v.ssim for v in found])),
        tuple(found),
    )
