"""COLMAP models: posed views and sparse points, text or binary, through pycolmap.

``python -m gaga_core.io.cameras.colmap MODEL`` reads one in a process of its own: on damaged files
the C++ reader may abort or ask for absurd memory, and neither may end the window.
"""

import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, UInt8Array
from gaga_core.camera import MOST_PIXELS, Camera, is_usable
from gaga_core.errors import GagaError
from gaga_core.geometry import matrices_to_quats
from gaga_core.io.cameras.given import FOCALS, Lens
from gaga_core.io.files import check_memory, explain_os_error, open_file, write_text
from gaga_core.io.folder.processes import end_with_parent
from gaga_core.io.splats.packing import FARTHEST, say_changes
from gaga_core.progress import say

_PINHOLE = ("PINHOLE", "SIMPLE_PINHOLE")
_SECONDS = 300
_FURTHER = ("rigs", "frames")  # files that a model may have
# Least bytes of one record. A count that asks for more than the file holds is damage: pycolmap
# would allocate for it first, for half a minute.
_RECORD = {"cameras": 24, "images": 73, "points3D": 51}
# Address space beyond what the interpreter has: a damaged count asks for far more, and filling
# even 8 GiB before the refusal takes half a minute.
_CPU_SECONDS, _BYTES_PER_SECOND = 4, 1 << 20  # a tenth of what a whole model is read at
_MEMORY = 1 << 30  # bytes
_MEMORY_PER_BYTE = 20  # of the model's files


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
            "COLMAP models are read, and photos placed, with pycolmap, which is not installed. "
            "Install pycolmap, or give the cameras as cameras.json."
        )


def has_colmap(folder: Path) -> bool:
    """Whether ``folder`` holds the files of a COLMAP model."""
    return any((folder / f"images.{kind}").is_file() for kind in ("bin", "txt"))


class ColmapReading:
    """A model that is being read in a process of its own; `result` waits for it.

    Start one, do other work, then take the result: the reader costs a third of a second.
    """

    def __init__(self, folder: Path, *, is_quiet: bool = False) -> None:
        self._folder, self._is_quiet = Path(folder), is_quiet
        if not has_colmap(self._folder):
            raise GagaError(
                f"{folder} holds no COLMAP model (images.bin or images.txt). "
                "Choose a folder that COLMAP wrote."
            )
        _check_files(self._folder)
        require_pycolmap()
        # Without a name: nothing is left if we are killed.
        self._out = tempfile.TemporaryFile()  # noqa: SIM115  closed by `close`
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(self._folder)],
            stdout=self._out,
            stderr=subprocess.DEVNULL,
        )

    def result(self) -> ColmapModel:
        """The model; ``GagaError`` when it is damaged."""
        try:
            status = self._process.wait(_SECONDS)
            self._out.seek(0)
            if status != 0:
                why = self._out.read().decode(errors="replace").strip() or _why_ended(status)
                raise GagaError(
                    f"The COLMAP model in {self._folder} cannot be read ({why}). "
                    "Copy or reconstruct it again."
                )
            with np.load(self._out, allow_pickle=False) as stored:
                return _model_of(self._folder, dict(stored), is_quiet=self._is_quiet)
        except subprocess.TimeoutExpired as error:
            raise GagaError(
                f"The COLMAP model in {self._folder} takes too long to read."
            ) from error
        finally:
            self.close()

    def close(self) -> None:
        """End the reader and remove what it wrote."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._out.close()


def _why_ended(status: int) -> str:
    """Say why a reader ended that could not say it itself."""
    if sys.platform != "win32" and status == -signal.SIGXCPU:
        return "its reader was stopped at the time limit for a model of this size"
    if status < 0:
        return f"its reader was ended by signal {-status}"
    return f"its reader ended with status {status}"


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
            raise GagaError(
                f"The COLMAP model in {folder} cannot be read ({file.name} is truncated). "
                "Copy or reconstruct it again."
            )


def read_colmap(folder: Path, *, with_lenses: bool = False) -> ColmapModel:
    """Read ``folder`` (cameras, images, points3D as .bin or .txt).

    Distorted cameras are used by their pinhole part, which is said (`gaga_core.progress.say`)
    unless their ``lenses`` are what is wanted: undistort the photos for exact overlays. Raises
    ``GagaError`` when files are missing or damaged.
    """
    return ColmapReading(folder, is_quiet=with_lenses).result()


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


def _model_of(folder: Path, arrays: dict[str, AnyArray], *, is_quiet: bool) -> ColmapModel:
    models = arrays["models"]
    distorted = sorted({str(m) for m in models if str(m) not in _PINHOLE})
    if unknown := set(distorted) - set(FOCALS):
        raise GagaError(f"The lens model {unknown.pop()} of {folder} is not read.")
    if distorted and not is_quiet:
        say(
            f"The COLMAP model in {folder} has distorted cameras ({', '.join(distorted)}); their "
            "pinhole part is used. Undistort the photos for exact overlays."
        )
    cameras, lenses = [], []
    ends = np.cumsum(arrays["n_params"])
    for i, name in enumerate(arrays["names"].tobytes().decode().split("\0")[:-1]):
        pose = np.eye(4)
        pose[:3] = arrays["poses"][i]
        width, height = (int(v) for v in arrays["sizes"][i])
        K = arrays["K"][i]
        has_size = 0 < width <= MOST_PIXELS and 0 < height <= MOST_PIXELS
        if not (has_size and is_usable(K, pose)):
            raise GagaError(
                f"The COLMAP model in {folder} has no usable camera for {name}. Reconstruct it "
                "again."
            )
        cameras.append(Camera(K, pose, width, height, name))
        params = arrays["params"][ends[i] - arrays["n_params"][i] : ends[i]].tolist()
        lenses.append(Lens(str(models[i]), width, height, tuple(params)))
    if not cameras:
        raise GagaError(f"The COLMAP model in {folder} has no views. Reconstruct it again.")
    points = arrays["points"]
    good: BoolArray = np.all(np.abs(points) <= FARTHEST, axis=1)  # False for NaN
    what = "points with numbers that are not finite or out of range were left out"
    say_changes(folder, {what: len(good) - int(good.sum())})
    return ColmapModel(tuple(cameras), points[good], arrays["colors"][good], tuple(lenses))


# --- the process that reads


def main(folder: Path) -> int:
    """Write the arrays of a model to standard output, or one line about the failure (status 1)."""
    import pycolmap

    end_with_parent()
    _limit(folder)
    try:
        model = pycolmap.Reconstruction(str(folder))
        # pycolmap reads a cut-off cameras.bin without a word and leaves zeros for what is missing.
        file = folder / "cameras.bin"
        wanted = 8 + sum(24 + 8 * len(camera.params) for camera in model.cameras.values())
        if file.is_file() and file.stat().st_size < wanted:
            raise ValueError("cameras.bin is truncated")
        images = sorted(model.images.values(), key=lambda image: str(image.name))
        if any("\0" in image.name for image in images):  # no file has such a name
            raise ValueError("the name of a photo holds a zero byte")
        used = [model.cameras[image.camera_id] for image in images]
        poses = [np.asarray(image.cam_from_world().matrix()) for image in images]
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OverflowError) as error:
        said = (str(error).splitlines() or ["damaged"])[0]
        sys.stdout.write(re.sub(r"^\[[\w.]+:\d+\] (Check failed: )?", "", said)[:120])
        return 1
    points = list(model.points3D.values())
    np.savez(
        sys.stdout.buffer,
        # Not an array of text, in which each name takes the room of the longest.
        names=np.frombuffer("".join(f"{image.name}\0" for image in images).encode(), np.uint8),
        K=np.array([c.calibration_matrix() for c in used], np.float64).reshape(-1, 3, 3),
        sizes=np.array([(c.width, c.height) for c in used], np.int64).reshape(-1, 2),
        n_params=np.array([len(c.params) for c in used], np.int64),
        params=np.concatenate([np.zeros(0), *(np.asarray(c.params, np.float64) for c in used)]),
        models=np.array([str(c.model.name) for c in used], dtype=np.str_),
        poses=np.array(poses, np.float64).reshape(-1, 3, 4),
        points=np.array([p.xyz for p in points], np.float64).reshape(-1, 3),
        colors=np.array([p.color for p in points], np.uint8).reshape(-1, 3),
    )
    return 0


def _limit(folder: Path) -> None:
    if sys.platform.startswith("linux"):
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        held = pages * resource.getpagesize()
        files = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
        limit = held + _MEMORY + _MEMORY_PER_BYTE * files
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        # A cut frames.bin keeps pycolmap counting what is not there for minutes.
        seconds = int(time.process_time()) + _CPU_SECONDS + files // _BYTES_PER_SECOND
        # The soft limit ends it with SIGXCPU, which the caller tells from other ends.
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
