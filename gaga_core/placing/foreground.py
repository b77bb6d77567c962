"""Masks of the object in the photos, when the background must not count.

On a turntable the object turns and the room is static: matches of the room say that nothing
moved. A mask keeps features to the object, and what lies outside is painted black before splats are
trained on it.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes, label

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.io.images import IMAGE_SUFFIXES, open_image, read_rgb
from gaga_core.placing.photos import Photo, PhotoSet, shrunk
from gaga_core.placing.sfm import option
from gaga_core.progress import Progress, Stage

_LOOK_SIDE = 320  # pixels: the moving part is looked for at this size
_MOST_PHOTOS = 40  # photos that it is looked for in
_MOVING_DEVIATION = 10.0  # of 255: deviation over the photos of a pixel that something moves over
_LEAST_SHARE = 0.01  # share of the picture: smaller moving parts are noise
_NAMED = 3


def masks_from_folder(photos: PhotoSet, folder: Path, target: Path) -> Stage[None]:
    """Write the masks of ``folder`` (NAME.png or NAME.jpg.png, not black = object) for COLMAP.

    Raises ``GagaError`` when a photo has none, or one without any object.
    """
    files = {path.name.lower(): path for path in folder.glob("*") if path.is_file()}
    target.mkdir(parents=True, exist_ok=True)
    missing, empty = list[str](), list[str]()
    for i, photo in enumerate(photos.photos):
        yield Progress("Read masks", i, len(photos.photos), photo.name)
        path = _mask_of(photo, files)
        if path is None:
            missing.append(Path(photo.source).name)
            continue
        mask = read_rgb(path).max(axis=2) > 0
        if not mask.any():
            empty.append(path.name)
        _write(target, photo, mask)
    if missing or empty:
        what = "no mask" if missing else "a black mask"
        names = missing or empty
        listed = ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")
        raise GagaError(
            f"{len(names)} of {len(photos.photos)} photos have {what} in {folder}: {listed}. "
            "Add NAME.png for each photo, black where the background is."
        )


def masks_of_what_moves(photos: PhotoSet, pictures: Path, target: Path) -> Stage[None]:
    """Write one mask for all photos of a fixed camera: the part in which something moved.

    Raises ``GagaError`` when the photos differ in size, or nothing is static.
    """
    chosen = photos.photos[:: max(1, len(photos.photos) // _MOST_PHOTOS)]
    if len({(photo.width, photo.height) for photo in photos.photos}) > 1:
        raise GagaError(
            "The photos differ in size: the camera was not fixed. Give masks of the object "
            f"with {option('--foreground')}."
        )
    stack = []
    for i, photo in enumerate(chosen):
        yield Progress("Look for what moves", i, len(chosen), photo.name)
        stack.append(shrunk(read_rgb(pictures / photo.name), _LOOK_SIDE).astype(np.float32))
    moving = moving_part(np.array(stack).std(axis=0).max(axis=2) > _MOVING_DEVIATION)
    if not _LEAST_SHARE < moving.mean() < 1 - _LEAST_SHARE:
        raise GagaError(
            f"These photos have no static background. Leave {option('--turntable')} out, or "
            f"give masks of the object with {option('--foreground')}."
        )
    target.mkdir(parents=True, exist_ok=True)
    for photo in photos.photos:
        _write(target, photo, moving)


def moving_part(differs: BoolArray) -> BoolArray:
    """The largest connected part (H, W) of the pixels that differ, without holes and noise."""
    closed = binary_fill_holes(binary_closing(differs, iterations=6))
    parts, n = label(closed)
    if n == 0:
        return np.zeros_like(differs)
    sizes = np.bincount(parts.ravel())[1:]
    return binary_dilation(parts == 1 + int(sizes.argmax()), iterations=3)


def paint_background(photos: Sequence[Photo], pictures: Path, masks: Path) -> Stage[None]:
    """Make the photos in ``pictures`` black where their mask is."""
    for i, photo in enumerate(photos):
        yield Progress("Leave out the background", i, len(photos), photo.name)
        picture = read_rgb(pictures / photo.name)
        mask = np.asarray(open_image(masks / f"{photo.name}.png")) > 0
        Image.fromarray(np.where(mask[..., None], picture, np.uint8(0))).save(
            pictures / photo.name, quality=97, subsampling=0
        )


def _mask_of(photo: Photo, files: dict[str, Path]) -> Path | None:
    source = Path(photo.source)
    names = [f"{source.name}.png", f"{photo.name}.png"]
    names += [
        f"{Path(n).stem}{suffix}" for n in (source.name, photo.name) for suffix in IMAGE_SUFFIXES
    ]
    return next((files[name.lower()] for name in names if name.lower() in files), None)


def _write(target: Path, photo: Photo, mask: BoolArray) -> None:
    """As large as the photo, under the name that COLMAP looks for."""
    image = Image.fromarray(mask.astype(np.uint8) * np.uint8(255))
    size = (photo.width, photo.height)
    image.resize(size, Image.Resampling.NEAREST).save(target / f"{photo.name}.png")
