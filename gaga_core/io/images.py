"""Pictures: photos in, renders out. Nothing else opens a picture file."""

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from gaga_core.arrays import AnyArray, FloatArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, check_memory, explain_os_error, open_file

if TYPE_CHECKING:
    import rawpy

HEIF_SUFFIXES = (".heic", ".heif")  # of phones; read where pi-heif is installed
RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")  # ... rawpy
HAS_HEIF, HAS_RAW = (find_spec(name) is not None for name in ("pi_heif", "rawpy"))
IMAGE_SUFFIXES = (
    *(".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff"),
    *(HEIF_SUFFIXES if HAS_HEIF else ()),
    *(RAW_SUFFIXES if HAS_RAW else ()),
)
_FORMATS = {".jpg": "JPEG", ".jpeg": "JPEG", ".png": "PNG", ".webp": "WEBP"}
# What a file may hold, whatever its suffix; JPEG with further pictures (MPO, of phones) is read as
# JPEG. Pillow knows 40 more, and hands PostScript to a program that executes it.
_READ = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
# What Pillow raises on files with wrong bytes beyond OSError, found by flipping and setting bytes.
_DAMAGED = (
    ValueError,
    SyntaxError,
    TypeError,
    LookupError,
    ArithmeticError,
    AttributeError,
    RuntimeError,
    EOFError,
    struct.error,
)
_POINTER = 8  # bytes that Pillow keeps for each row of a picture
# Times the size wanted to which a JPEG is decoded: 12 Mpx to 640 pixels lie 55.6 dB from the same
# of all pixels, in a quarter of the time; 1 would be 52.3 dB in a ninth.
_DECODED = 2
_BLOCK = 1 << 20  # pixels that are converted at a time
# Bytes a pixel that the decoder takes next to the picture: libwebp keeps two canvases and gives a
# third, libtiff takes strips whole. Measured on 36 megapixels: 15.0 and 4.0.
_OF_DECODER = {"WEBP": 16, "TIFF": 8, "HEIF": 8}
_OF_RAW = 40  # bytes a pixel that LibRaw takes: sensor, 4 channels of 16 bits twice, 3 of 8
_OF_COEFFICIENTS = 2  # bytes a pixel and channel that libjpeg keeps of a progressive JPEG

# Sizes are checked here, and odd tags harm nobody: both would be warnings on the terminal.
warnings.filterwarnings("ignore", module=r"PIL\.")


def pictures_in(folder: Path, pattern: str = "*") -> dict[str, Path]:
    """Pictures of a folder by their path from there, in order; none when there is no such folder.

    ``pattern`` "**/*": those of its subfolders, too. Hidden files are left out.
    """
    files = (path for path in sorted(folder.glob(pattern)) if path.name[0] != ".")
    pictures = (path for path in files if path.suffix.lower() in IMAGE_SUFFIXES)
    return {path.relative_to(folder).as_posix(): path for path in pictures}


@contextmanager
def image_header(
    path: Path, data: bytes | None = None, *, per_pixel: int = 0, side: int = 0, held: int = 0
) -> Iterator[Image.Image]:
    """Open a picture with pillow; pixels are read when they are asked for.

    ``data``: its bytes where it lies in the file ``path``. What reading takes is checked first: the
    picture, its decoder, ``held`` bytes, and ``per_pixel`` bytes of each pixel, of a picture no
    longer than ``side`` if given. Raises ``GagaError`` when it is none, damaged or too large.
    """
    if data is None and HAS_RAW and path.suffix.lower() in RAW_SUFFIXES:
        yield _raw(path, held=held)
        return
    try:
        with (
            open_file(path) if data is None else BytesIO(data) as file,
            Image.open(file, formats=_formats(path)) as image,
        ):
            n = image.width * image.height
            result = per_pixel * (min(n, side * side) if side else n)
            n_bytes = held + _bytes_held(image) + max(_bytes_to_decode(image), result)
            check_memory(path, n_bytes, f"{image.width:,} x {image.height:,} pixels")
            yield image
    except UnidentifiedImageError as error:
        if data is not None:
            raise GagaError(f"{path} is damaged (what it holds is no picture).") from error
        raise GagaError(
            f"{path} is not a picture in JPEG, PNG, WebP, BMP or TIFF. Remove it or save it again."
        ) from error
    except OSError as error:
        if error.errno is None:  # pillow's word for a truncated file
            raise GagaError(f"{path} is damaged ({error}). Copy it again.") from error
        raise GagaError(explain_os_error(error, path)) from error
    except MemoryError as error:  # a part of the file says that it has gigabytes
        raise GagaError(f"{path} is damaged, or too large for this machine.") from error
    except Image.DecompressionBombError as error:
        most = 2 * (Image.MAX_IMAGE_PIXELS or 0) // 1_000_000
        raise GagaError(f"{path} has more than {most} megapixels. Make it smaller.") from error
    except _DAMAGED as error:
        raise GagaError(f"{path} is damaged ({error}). Copy it again.") from error


def _formats(path: Path) -> tuple[str, ...]:
    """What a file may hold: HEIF only where its name says so, by a reader that is loaded then."""
    if not (HAS_HEIF and path.suffix.lower() in HEIF_SUFFIXES):
        return _READ
    import pi_heif

    # Depth and further pictures of a file are not looked at. It turns pictures upright itself.
    pi_heif.register_heif_opener(depth_images=False, aux_images=False, thumbnails=False)
    return (*_READ, "HEIF")


def _raw(path: Path, *, held: int) -> Image.Image:
    """The picture that a raw photo gives with the white balance of the camera, upright, sRGB, with
    the EXIF of its preview. Raises ``GagaError`` when it is damaged or too large."""
    import rawpy

    try:
        with open_file(path) as file, rawpy.imread(file) as raw:
            n = raw.sizes.raw_width * raw.sizes.raw_height
            check_memory(path, held + _OF_RAW * n, f"{n:,} pixels")
            # Each photo as bright as it was exposed: LibRaw would stretch each for itself.
            made = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=8)
            image = Image.fromarray(made)
            exif = _exif_of_preview(path, raw)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except rawpy.LibRawFileUnsupportedError as error:
        raise GagaError(
            f"{path} is not a picture of a raw kind that is read. Remove it or save it as JPEG."
        ) from error
    except (rawpy.LibRawError, MemoryError, *_DAMAGED) as error:
        raise GagaError(f"{path} is damaged ({error}). Copy it again.") from error
    exif[ExifTags.Base.Orientation] = 1  # LibRaw has turned it
    image.info["exif"] = exif.tobytes()
    return image


def _exif_of_preview(path: Path, raw: "rawpy.RawPy") -> Image.Exif:
    import rawpy

    try:
        preview = raw.extract_thumb()
        if preview.format == rawpy.ThumbFormat.JPEG:
            with image_header(path, bytes(preview.data)) as image:
                return image.getexif()
    except (rawpy.LibRawError, GagaError):
        pass  # without a preview the focal length is not known
    return Image.Exif()


def _in_srgb(image: Image.Image) -> Image.Image:
    """CMYK and HEIF by their color profile; others keep their numbers, as they always did."""
    from PIL import ImageCms

    profile = image.info.get("icc_profile")
    if not profile or (image.mode != "CMYK" and image.format != "HEIF"):
        return image
    try:
        source = ImageCms.ImageCmsProfile(BytesIO(profile))
        target = ImageCms.createProfile("sRGB")
        made = ImageCms.profileToProfile(image, source, target, outputMode="RGB")
    except (ImageCms.PyCMSError, OSError, *_DAMAGED):  # a profile that is none
        return image
    return image if made is None else made


def _bytes_held(image: Image.Image) -> int:
    """Bytes of a picture in Pillow's memory."""
    small = 1 if image.mode in ("1", "L", "P") else 2 if image.mode.startswith("I;16") else 4
    return image.height * (_POINTER + image.width * small)


def _bytes_to_decode(image: Image.Image) -> int:
    """Bytes that decoding, and turning it upright, take next to the picture."""
    decoder = _OF_DECODER.get(image.format or "", 0)
    if image.info.get("progressive"):
        decoder = _OF_COEFFICIENTS * len(image.getbands())
    # Pillow would read a PNG whole to find its tag.
    is_turned = image.format != "PNG" and image.getexif().get(ExifTags.Base.Orientation, 1) != 1
    turned = image.width * _POINTER + _bytes_held(image) if is_turned else 0
    return max(decoder * image.width * image.height, turned)


def open_image(
    path: Path,
    data: bytes | None = None,
    *,
    per_pixel: int = 0,
    side: int = 0,
    held: int = 0,
    shrunk_to: int = 0,
) -> Image.Image:
    """Read a picture with pillow, turned as its EXIF tag says; arguments as of `image_header`.

    ``shrunk_to``: the longest side that it will have. A JPEG that is larger is decoded at an
    eighth, a quarter or a half of its size where that has whole pixels, but not below `_DECODED`
    times that side.
    """
    with image_header(path, data, per_pixel=per_pixel, side=side, held=held) as image:
        if shrunk_to:
            times = max(image.size) / (_DECODED * shrunk_to)
            # Others would be wider by the pixels that fill the last block.
            whole = (n for n in (8, 4, 2) if n <= times and not any(x % n for x in image.size))
            if n := next(whole, 0):
                image.draft(None, (image.width // n, image.height // n))
        ImageOps.exif_transpose(image, in_place=True)
        return image.convert("LA") if image.mode == "La" else image  # Pillow converts La to LA only


def blocks(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Parts of a picture (H, W), in order, so that what is made of one takes little memory."""
    columns = min(width, _BLOCK)
    rows = _BLOCK // max(columns, 1)
    for top in range(0, height, rows):
        for left in range(0, width, columns):
            yield slice(top, min(top + rows, height)), slice(left, min(left + columns, width))


def block_of(image: Image.Image, where: tuple[slice, slice], mode: str | None = None) -> AnyArray:
    """Pixels of one of the `blocks` of a picture, converted to ``mode`` if given."""
    rows, columns = where
    block = image.crop((columns.start, rows.start, columns.stop, rows.stop))
    return np.asarray(block if mode in (None, block.mode) else block.convert(mode))


def read_rgb(path: Path, longest_side: int = 0, shrunk_to: int = 0) -> UInt8Array:
    """Picture (H, W, 3) uint8; transparency over black; shrunk to ``longest_side`` if given.

    ``shrunk_to`` as of `open_image`, where it is shrunk afterwards.
    """
    image = open_image(
        path,
        per_pixel=4 if longest_side else 3,
        side=longest_side,
        shrunk_to=longest_side or shrunk_to,
    )
    if image.mode[0] in "IF":  # 16 bits or more
        image = Image.fromarray(_eight_bits(image))
    image = _in_srgb(image)
    if longest_side:
        image.thumbnail((longest_side, longest_side))
    picture = np.empty((image.height, image.width, 3), np.uint8)
    for where in blocks(image.height, image.width):
        if "A" in image.getbands():
            rgba = Image.fromarray(block_of(image, where, "RGBA"))
            black = Image.new("RGBA", rgba.size, (0, 0, 0, 255))
            picture[where] = np.asarray(Image.alpha_composite(black, rgba))[..., :3]
        else:
            picture[where] = block_of(image, where, "RGB")
    return picture


def _eight_bits(image: Image.Image) -> UInt8Array:
    """Gray values (H, W): those of 0..255 as they are, else 0..65535 on that scale."""
    parts = list(blocks(image.height, image.width))
    gray = np.empty((image.height, image.width), np.uint8)
    top = max(float(np.nan_to_num(block_of(image, where)).max()) for where in parts)
    top = 65535.0 if top > 255 else 255.0
    for where in parts:
        values = np.nan_to_num(block_of(image, where)).astype(np.float64)
        gray[where] = np.clip(values / top * 255, 0, 255)
    return gray


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
