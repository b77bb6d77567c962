"""Depth maps: those that phone programs and converters leave, and those of a scene folder.

A depth is along the viewing direction (z of the camera), 0 where it is not known.
"""

import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path, PurePath

import numpy as np
from PIL import Image

from gaga_core.arrays import AnyArray, FloatArray
from gaga_core.errors import GagaError
from gaga_core.io.arrays_file import read_array
from gaga_core.io.files import atomic_write, check_memory
from gaga_core.io.images import image_header
from gaga_core.io.json_file import read_bytes

DEPTH = "sensor_depth"  # folder of a scene: thousandths of its unit, 16 bit, NAME.png
MILLIMETRES = 0.001  # metres a level, of the 16-bit pictures of all phone programs
_MOST_BYTES = 1 << 22  # of a compressed file: 256 x 192 pixels take 50 kB
_MOST_LEVELS = 65_535
_MAP_FOLDERS = {"depth", "depths", "confidence", "masks"}  # of phone programs and nerfstudio
# Of 3D Scanner App, and of Record3D.
_MAP_NAME = re.compile(r"(depth|conf)_\d+\.png|\d+\.(depth|conf)", re.IGNORECASE)
_PACKAGES = {".exr": "OpenEXR", ".depth": "lzfse", ".conf": "lzfse"}  # of the extra "depth"


@dataclass(frozen=True)
class DepthMap:
    """Depth that a program measured for a photo, lying as the photo is stored."""

    path: Path  # .png, .tif: levels; .exr, .npy, .depth (LZFSE of float32): metres
    unit: float = MILLIMETRES  # metres a level of integers
    confidence: Path | None = None  # per pixel; 0 is the lowest of ARKit's levels
    size: tuple[int, int] | None = None  # width, height, where the file does not say it


def is_map(inside: PurePath) -> bool:
    """Whether a picture, by its path from the folder of photos on, is depth, confidence or a mask
    of a photo, and no photo."""
    in_folder = any(part.lower() in _MAP_FOLDERS for part in inside.parts[:-1])
    return in_folder or _MAP_NAME.fullmatch(inside.name) is not None


def why_unread(path: Path) -> str:
    """A sentence about the package that reading a depth map takes; "" where it is installed."""
    package = _PACKAGES.get(path.suffix.lower())
    if package is None or find_spec(package) is not None:
        return ""
    return f"Depth like {path.name} is read with the package {package}: gaga-studio[depth]."


def read_depth(depth: DepthMap) -> FloatArray:
    """Depth (H, W) in metres, without what has the lowest confidence.

    Raises ``GagaError`` when a file is damaged, or needs a package that is not installed.
    """
    found = _read(depth.path, depth.size)
    if found.dtype.kind in "iu":
        found = found * depth.unit
    result = np.asarray(found, np.float32)
    result = np.where(np.isfinite(result) & (result > 0), result, np.float32(0))
    if depth.confidence is not None:
        sure = _read(depth.confidence, depth.size, np.uint8)
        if sure.shape != result.shape:
            raise GagaError(f"{depth.confidence} has another size than {depth.path.name}.")
        result[sure == 0] = 0
    return result


def _read(path: Path, size: tuple[int, int] | None, raw: type = np.float32) -> AnyArray:
    """Values (H, W) as they are stored; ``raw`` is the type of those without a header."""
    if why := why_unread(path):
        raise GagaError(why)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        found = read_array(path, "Copy it again.")
    elif suffix == ".exr":
        found = _read_exr(path)
    elif suffix in (".depth", ".conf"):
        found = _read_lzfse(path, size, raw)
    else:
        with image_header(path, per_pixel=4) as image:
            found = np.asarray(image)
    if found.ndim != 2 or found.dtype.kind not in "iuf":
        raise GagaError(f"{path} is no depth map: expected one number for each pixel.")
    return found


def _read_exr(path: Path) -> AnyArray:
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            low, high = file.header()["dataWindow"]
            width, height = (int(b - a + 1) for a, b in zip(low, high, strict=True))
        check_memory(path, 16 * width * height, f"{width:,} x {height:,} pixels")
        with OpenEXR.File(str(path)) as file:
            pixels = next(iter(file.channels().values())).pixels
            return pixels[..., 0] if pixels.ndim == 3 else pixels  # R, Y or Z; RGB is joined
    except (RuntimeError, ValueError, TypeError, KeyError, OSError, StopIteration) as error:
        raise GagaError(f"{path} is damaged ({error}). Export it again.") from error


def _read_lzfse(path: Path, size: tuple[int, int] | None, raw: type) -> AnyArray:
    import lzfse

    try:
        content = lzfse.decompress(read_bytes(path, "", _MOST_BYTES))
        values: AnyArray = np.frombuffer(content, raw)
    except (lzfse.error, ValueError, MemoryError) as error:
        raise GagaError(f"{path} is damaged ({error}). Export it again.") from error
    width, height = size or (0, 0)
    if len(values) != width * height:
        raise GagaError(f"{path} has {len(values)} pixels, not {width} x {height}.")
    return values.reshape(height, width)


def read_scene_depth(path: Path) -> FloatArray:
    """Depth (H, W) of a file of `DEPTH`, scene units."""
    return read_depth(DepthMap(path))


def write_scene_depth(path: Path, depth: FloatArray) -> None:
    """Write depth (H, W), scene units, as a file of `DEPTH`; what is beyond 65.5 is not known."""
    levels = np.round(depth / MILLIMETRES)
    levels[levels > _MOST_LEVELS] = 0
    with atomic_write(path) as temporary:
        Image.fromarray(levels.astype(np.uint16)).save(temporary, format="PNG")
