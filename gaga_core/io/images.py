"""Pictures: photos in, renders out."""

from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from gaga_core.arrays import FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")
_FORMATS = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".webp": "WEBP"}


def pictures_in(folder: Path, pattern: str = "*") -> dict[str, Path]:
    """Pictures of a folder by their path from there, in order; none when there is no such folder.

    ``pattern`` "**/*": those of its subfolders, too. Hidden files are left out.
    """
    files = (path for path in sorted(folder.glob(pattern)) if path.name[0] != ".")
    pictures = (path for path in files if path.suffix.lower() in IMAGE_SUFFIXES)
    return {path.relative_to(folder).as_posix(): path for path in pictures}


def open_image(path: Path) -> Image.Image:
    """Open a picture with pillow, turned as its EXIF tag says; ``GagaError`` if it is none."""
    try:
        with Image.open(path) as image:
            image.load()
            return ImageOps.exif_transpose(image)
    except UnidentifiedImageError as error:
        raise GagaError(f"{path} is not a picture. Remove it or save it again.") from error
    except OSError as error:
        if error.errno is None:  # pillow's word for a truncated file
            raise GagaError(f"{path} is damaged ({error}). Copy it again.") from error
        raise GagaError(explain_os_error(error, path)) from error
    except MemoryError as error:  # a part of the file says that it has gigabytes
        raise GagaError(f"{path} is damaged, or too large for this machine.") from error
    except (ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise GagaError(f"{path} is damaged ({error}). Copy it again.") from error


def read_rgb(path: Path, longest_side: int = 0) -> UInt8Array:
    """Picture (H, W, 3) uint8; transparency over black; shrunk to ``longest_side`` if given."""
    image = open_image(path)
    if longest_side:
        image.thumbnail((longest_side, longest_side))
    if image.mode in ("I;16", "I", "F"):
        values = np.asarray(image, np.float64)
        top = 65535.0 if values.max(initial=0) > 255 else 255.0
        gray = np.clip(values / top * 255, 0, 255).astype(np.uint8)
        return np.repeat(gray[:, :, None], 3, axis=2)
    if "A" in image.getbands():
        black = Image.new("RGBA", image.size, (0, 0, 0, 255))
        image = Image.alpha_composite(black, image.convert("RGBA"))
    return np.array(image.convert("RGB"))


def write_rgb(path: Path, picture: FloatArray | UInt8Array, quality: int = 93) -> None:
    """Write (H, W, 3) uint8, or float in 0..1 (clipped, rounded), as PNG, JPEG or WebP."""
    if picture.dtype != np.uint8:
        unit = np.clip(np.asarray(picture, np.float32), 0, 1)
        picture = (unit * 255 + 0.5).astype(np.uint8)
    kind = _FORMATS.get(path.suffix.lower())
    if kind is None:
        raise GagaError(f"{path.name}: choose a name that ends in .png, .jpg or .webp.")
    with atomic_write(path) as temporary:
        Image.fromarray(picture).save(temporary, format=kind, quality=quality)
