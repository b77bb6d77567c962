"""COLMAP models: posed views and sparse points, text or binary.

The files are read here, not by pycolmap: on damaged ones its C++ reader may abort or ask for absurd
memory, so that it needs a process of its own, which costs a third of a second a model.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, UInt8Array
from gaga_core.camera import MOST_PIXELS, Camera, is_usable
from gaga_core.errors import GagaError
from gaga_core.geometry import matrices_to_quats, quats_to_matrices
from gaga_core.io.cameras.given import FOCALS, Lens
from gaga_core.io.files import check_memory, explain_os_error, open_file, write_text
from gaga_core.io.splats.packing import FARTHEST, say_changes
from gaga_core.progress import say

POINTS_LEFT_OUT = "point{s} with numbers that are not finite or out of range {were} left out"
_PINHOLE = ("PINHOLE", "SIMPLE_PINHOLE")
_FURTHER = ("rigs", "frames")  # files that a model may have; images know their own poses
# Least bytes of one record: a count that asks for more than the file holds is damage.
_RECORD = {"cameras": 24, "images": 73, "points3D": 51}
_MEMORY_PER_BYTE = 20  # of the model's files
# COLMAP's lens models in the order of their numbers, and how many parameters each has.
LENS_MODELS = (
    *(("SIMPLE_PINHOLE", 3), ("PINHOLE", 4), ("SIMPLE_RADIAL", 4), ("RADIAL", 5), ("OPENCV", 8)),
    *(("OPENCV_FISHEYE", 8), ("FULL_OPENCV", 12), ("FOV", 5), ("SIMPLE_RADIAL_FISHEYE", 4)),
    *(("RADIAL_FISHEYE", 5), ("THIN_PRISM_FISHEYE", 12), ("RAD_TAN_THIN_PRISM_FISHEYE", 16)),
    *(("SIMPLE_DIVISION", 4), ("DIVISION", 5), ("SIMPLE_FISHEYE", 3), ("FISHEYE", 4)),
    *(("EUCM", 6), ("EQUIRECTANGULAR", 2)),
)


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """Views by name and the sparse points of a reconstruction, in its own world frame."""

    cameras: tuple[Camera, ...]  # sorted by name; names are file names under images/
    points: DoubleArray  # (P, 3) world
    point_colors: UInt8Array  # (P, 3)
    lenses: tuple[Lens, ...]  # of each camera, with its distortion


def require_pycolmap() -> None:
    """Raise ``GagaError`` where pycolmap is missing: Linux on arm64 has no builds of it."""
    if find_spec("pycolmap") is None:
        raise GagaError(
            "Photos are placed with pycolmap, which is not installed. Install pycolmap, or give "
            "the cameras as cameras.json or as a COLMAP model."
        )


def has_colmap(folder: Path) -> bool:
    """Whether ``folder`` holds the files of a COLMAP model."""
    return any((folder / f"images.{kind}").is_file() for kind in ("bin", "txt"))


def _check_files(folder: Path) -> None:
    """``GagaError`` when a file of the model is missing, or is too short for what it announces."""
    kind = "bin" if (folder / "images.bin").is_file() else "txt"
    for stem in _FURTHER:
        file = folder / f"{stem}.{kind}"
        if file.exists() and not file.is_file():
            raise GagaError(f"{file} is no regular file. Copy the COLMAP model again.")
    for stem, record in _RECORD.items():
        file = folder / f"{stem}.{kind}"
        if not file.is_file():
            raise GagaError(f"The COLMAP model in {folder} has no {file.name}. Copy it again.")
        try:
            with open_file(file) as stream:
                n = int.from_bytes(stream.read(8), "little")
            size = file.stat().st_size
            check_memory(file, _MEMORY_PER_BYTE * size, "a COLMAP model")
        except OSError as error:
            raise GagaError(explain_os_error(error, file)) from error
        if kind == "bin" and size < 8 + n * record:
            raise _unread(folder, f"{file.name} is truncated")


def read_colmap(folder: Path, *, with_lenses: bool = False) -> ColmapModel:
    """Read ``folder`` (cameras, images, points3D as .bin or .txt).

    Distorted cameras are used by their pinhole part, which is said (`gaga_core.progress.say`)
    unless their ``lenses`` are what is wanted: undistort the photos for exact overlays. Raises
    ``GagaError`` when files are missing or damaged.
    """
    folder = Path(folder)
    if not has_colmap(folder):
        raise GagaError(
            f"{folder} holds no COLMAP model (images.bin or images.txt). "
            "Choose a folder that COLMAP wrote."
        )
    _check_files(folder)
    kind = "bin" if (folder / "images.bin").is_file() else "txt"
    found: list[Any] = []
    for stem, read in (_READ_BINARY if kind == "bin" else _READ_TEXT).items():
        file = folder / f"{stem}.{kind}"
        try:
            with open_file(file) as stream:
                found.append(read(stream.read()))
        except OSError as error:
            raise GagaError(explain_os_error(error, file)) from error
        except (ValueError, OverflowError, IndexError, struct.error) as error:
            why = "is truncated" if isinstance(error, struct.error) else f"is damaged: {error}"
            raise _unread(folder, f"{file.name} {why}") from error
    return _model_of(folder, *found, is_quiet=with_lenses)


def _unread(folder: Path, why: str) -> GagaError:
    return GagaError(
        f"The COLMAP model in {folder} cannot be read ({why[:160]}). Copy or reconstruct it again."
    )


def write_colmap(
    folder: Path,
    cameras: Sequence[Camera],
    points: DoubleArray,
    colors: UInt8Array,
    note: str = "",
) -> None:
    """Write a text model: one PINHOLE camera a view, points (P, 3) world without tracks.

    ``note`` is a comment on top of cameras.txt; see `note_of`.
    """
    lines = [f"# {note}"] if note else []
    for i, c in enumerate(cameras, start=1):
        numbers = (c.K[0, 0], c.K[1, 1], c.K[0, 2], c.K[1, 2])
        lines.append(f"{i} PINHOLE {c.width} {c.height} {_exact(numbers)}")
    write_text(folder / "cameras.txt", "\n".join(lines) + "\n")
    lines = []
    for i, camera in enumerate(cameras, start=1):
        quat = matrices_to_quats(camera.cam_from_world[None, :3, :3])[0]
        numbers = (*quat, *camera.cam_from_world[:3, 3])
        lines += [f"{i} {_exact(numbers)} {i} {camera.name}", ""]
    write_text(folder / "images.txt", "\n".join(lines) + "\n")
    lines = [
        f"{i} {x:.9g} {y:.9g} {z:.9g} {r} {g} {b} 0"
        for i, ((x, y, z), (r, g, b)) in enumerate(zip(points, colors, strict=True), start=1)
    ]
    write_text(folder / "points3D.txt", "\n".join(lines) + "\n")


def note_of(folder: Path) -> str:
    """The comment on top of the cameras of a text model; "" without one."""
    file = folder / "cameras.txt"
    if not file.is_file():
        return ""
    with file.open(encoding="utf-8", errors="replace") as stream:
        first = stream.readline(1000)
    return first.removeprefix("#").strip() if first.startswith("#") else ""


def count_points(folder: Path) -> int:
    """The number of points of a model, without reading them; 0 where their file is missing."""
    binary, text = folder / "points3D.bin", folder / "points3D.txt"
    if binary.is_file():
        with binary.open("rb") as stream:
            return int.from_bytes(stream.read(8), "little")
    if not text.is_file():
        return 0
    with text.open("rb") as stream:
        return sum(1 for line in stream if line.strip() and not line.startswith(b"#"))


def _exact(numbers: Iterable[float]) -> str:
    """Decimal text that reads back as the same doubles."""
    return " ".join(repr(float(number)) for number in numbers)


def _model_of(
    folder: Path,
    lenses: dict[int, Lens],
    images: dict[int, "_Image"],
    cloud: tuple[DoubleArray, UInt8Array],
    *,
    is_quiet: bool,
) -> ColmapModel:
    taken = sorted(images.values(), key=lambda image: image.name)
    if any("\0" in image.name for image in taken):  # no file has such a name
        raise _unread(folder, "the name of a photo holds a zero byte")
    if unknown := {image.camera for image in taken} - set(lenses):
        raise _unread(folder, f"it has no camera {unknown.pop()}")
    used = [lenses[image.camera] for image in taken]
    distorted = sorted({lens.model for lens in used} - set(_PINHOLE))
    if foreign := set(distorted) - set(FOCALS):
        raise GagaError(f"The lens model {foreign.pop()} of {folder} is not read.")
    if distorted and not is_quiet:
        say(
            f"The COLMAP model in {folder} has distorted cameras ({', '.join(distorted)}); their "
            "pinhole part is used. Undistort the photos for exact overlays."
        )
    if not taken:
        raise GagaError(f"The COLMAP model in {folder} has no views. Reconstruct it again.")
    with np.errstate(all="ignore"):  # of no length, or not finite: no usable camera
        turns = quats_to_matrices(np.array([image.quat for image in taken]))
    cameras = []
    for image, lens, turn in zip(taken, used, turns, strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = turn, image.shift
        has_size = 0 < lens.width <= MOST_PIXELS and 0 < lens.height <= MOST_PIXELS
        if not (has_size and is_usable(lens.K, pose)):
            raise GagaError(
                f"The COLMAP model in {folder} has no usable camera for {image.name}. Reconstruct "
                "it again."
            )
        cameras.append(Camera(lens.K, pose, lens.width, lens.height, image.name))
    points, colors = cloud
    good: BoolArray = np.all(np.abs(points) <= FARTHEST, axis=1)  # False for NaN
    say_changes(folder, {POINTS_LEFT_OUT: len(good) - int(good.sum())})
    return ColmapModel(tuple(cameras), points[good], colors[good], tuple(used))


# --- the three files, as bytes: binary and text. ``ValueError``, ``OverflowError``, ``IndexError``
# or ``struct.error`` where one is damaged.


@dataclass(frozen=True)
class _Image:
    """A photo that was placed."""

    quat: tuple[float, ...]  # (4,) wxyz, of any length, camera from world
    shift: tuple[float, ...]  # (3,)
    camera: int
    name: str


def _by_number(records: Iterable[tuple[int, Any]]) -> dict[int, Any]:
    found: dict[int, Any] = {}
    for number, record in records:
        if number in found:
            raise ValueError(f"two records have the number {number}")
        found[number] = record
    return found


def _binary_cameras(data: bytes) -> Iterator[tuple[int, Lens]]:
    (n,), at = struct.unpack_from("<Q", data), 8
    for _ in range(n):
        number, model, width, height = struct.unpack_from("<IiQQ", data, at)
        if not 0 <= model < len(LENS_MODELS):
            raise ValueError(f"{model} is the number of no lens model")
        name, n_params = LENS_MODELS[model]
        params = struct.unpack_from(f"<{n_params}d", data, at + 24)
        at += 24 + 8 * n_params
        yield number, Lens(name, width, height, params)


def _binary_images(data: bytes) -> Iterator[tuple[int, _Image]]:
    (n,), at = struct.unpack_from("<Q", data), 8
    for _ in range(n):
        number, *pose, camera = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        (n_seen,) = struct.unpack_from("<Q", data, end + 1)
        yield number, _Image(tuple(pose[:4]), tuple(pose[4:]), camera, data[at + 64 : end].decode())
        at = end + 9 + 24 * n_seen
    _no_longer(data, at)


def _binary_points(data: bytes) -> tuple[DoubleArray, UInt8Array]:
    (n,), at = struct.unpack_from("<Q", data), 8
    starts = np.zeros(n, np.int64)
    for i in range(n):
        starts[i] = at
        at += 51 + 8 * struct.unpack_from("<Q", data, at + 43)[0]  # the photos that see it
    _no_longer(data, at)
    raw = np.frombuffer(data, np.uint8)
    xyz = np.ascontiguousarray(raw[starts[:, None] + np.arange(8, 32)]).view("<f8")
    return xyz.astype(np.float64), raw[starts[:, None] + np.arange(32, 35)]


def _no_longer(data: bytes, end: int) -> None:
    if end > len(data):
        raise struct.error("the last record ends after the file")


def _records(data: bytes) -> Iterator[list[bytes]]:
    """Words of each line that holds some and is no comment."""
    for line in data.splitlines():
        if (words := line.split()) and not words[0].startswith(b"#"):
            yield words


def _text_cameras(data: bytes) -> Iterator[tuple[int, Lens]]:
    known = dict(LENS_MODELS)
    for number, model, width, height, *params in _records(data):
        name = model.decode()
        if name in known and len(params) != known[name]:
            raise ValueError(f"{name} has {known[name]} parameters, not {len(params)}")
        yield int(number), Lens(name, int(width), int(height), tuple(map(float, params)))


def _text_images(data: bytes) -> Iterator[tuple[int, _Image]]:
    lines = iter(data.split(b"\n"))
    for line in lines:
        words = line.strip().split(maxsplit=9)
        if not words or words[0].startswith(b"#"):
            continue
        number, *pose, camera, name = words
        quat, shift = tuple(map(float, pose[:4])), tuple(map(float, pose[4:]))
        yield int(number), _Image(quat, shift, int(camera), name.decode())
        next(lines, None)  # what was seen in it


def _text_points(data: bytes) -> tuple[DoubleArray, UInt8Array]:
    rows = [words[1:7] for words in _records(data)]
    xyz = np.array([[float(x) for x in row[:3]] for row in rows], np.float64).reshape(-1, 3)
    colors = [[int(c) for c in row[3:]] for row in rows]
    return xyz, np.array(colors, np.uint8).reshape(-1, 3)


_READ_BINARY: dict[str, Callable[[bytes], object]] = {
    "cameras": lambda data: _by_number(_binary_cameras(data)),
    "images": lambda data: _by_number(_binary_images(data)),
    "points3D": _binary_points,
}
_READ_TEXT: dict[str, Callable[[bytes], object]] = {
    "cameras": lambda data: _by_number(_text_cameras(data)),
    "images": lambda data: _by_number(_text_images(data)),
    "points3D": _text_points,
}
