"""Recordings of phone programs, from which frames are taken: .r3d of Record3D (an archive with the
metadata and rgbd/N.jpg, N.depth, N.conf), and folders of Stray Scanner (rgb.mp4 with odometry.csv).
"""

import re
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.io.cameras.phones import Record, stray_poses
from gaga_core.io.json_file import decode_json
from gaga_core.placing.video import extract_numbered_frames, frame_size
from gaga_core.progress import Progress, Stage

R3D = ".r3d"
_FILM, _ODOMETRY = "rgb.mp4", "odometry.csv"  # of Stray Scanner
_MEMBER = re.compile(r"rgbd/(\d+)\.(jpg|depth|conf)")
_MOST_OF_MEMBER = 1 << 26  # bytes of a file in it
_STEP, _TURN = 0.1, np.radians(5.0)  # metres, radians: from one frame that is taken to the next
_MOST_FRAMES = 300  # of a recording: it has thousands
# What zipfile raises on wrong bytes.
_BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, ValueError, KeyError, OSError)


@dataclass(frozen=True)
class Recording:
    """What is taken of a recording."""

    frames: tuple[int, ...]
    size: tuple[int, int]  # width, height of the photos
    told: str


def is_recording(path: Path) -> bool:
    """Whether ``path`` is a recording."""
    is_stray = all((path / name).is_file() for name in (_FILM, _ODOMETRY))
    return is_stray or (path.suffix.lower() == R3D and path.is_file())


def look_at_recording(path: Path) -> Recording:
    """The frames of a recording that are far enough from each other.

    Raises ``GagaError`` when it is damaged.
    """
    if path.is_dir():
        rows = stray_poses(path / _ODOMETRY)
        known = np.array([[n, *rows[n]] for n in sorted(rows)]).reshape(-1, 8)
        size, program = frame_size(path / _FILM), "Stray Scanner"
    else:
        known, size = _r3d_poses(path)
        program = "Record3D"
    if len(known) == 0:
        raise GagaError(f"{path} has no photos with poses. Export it again.")
    turned = 2 * np.arccos(np.clip(np.abs((known[1:, 4:] * known[:-1, 4:]).sum(axis=1)), 0, 1))
    steps = np.linalg.norm(np.diff(known[:, 1:4], axis=0), axis=1) / _STEP + turned / _TURN
    way = np.r_[0.0, np.cumsum(steps)]
    at = np.linspace(0, way[-1], min(int(way[-1]) + 1, _MOST_FRAMES))
    frames = tuple(known[np.unique(np.searchsorted(way, at)), 0].astype(int).tolist())
    told = f"{program}: {len(frames)} of {len(known)} frames of {path.name}, with metres and depth"
    return Recording(frames, size, told)


def _r3d_poses(path: Path) -> tuple[DoubleArray, tuple[int, int]]:
    """Rows of frame, place and turn (N, 8) of the photos, and their size."""
    with _opened(path) as archive:
        record = decode_json(_member(archive, "metadata"), Record, f"{path}", "Export it again.")
        names = (_MEMBER.fullmatch(name) for name in archive.namelist())
        frames = sorted(int(m[1]) for m in names if m is not None and m[2] == "jpg")
    poses = record.poses if all(len(p) == 7 for p in record.poses) else []
    rows = [[n, *poses[n][4:], *poses[n][:4]] for n in frames if n < len(poses)]
    return np.array(rows, np.float64).reshape(-1, 8), (round(record.w), round(record.h))


def unpack_stage(path: Path, target: Path) -> Stage[None]:
    """Write the frames that are taken with their poses and depth, as folders of the program have
    them.

    ``target`` appears at the end; one that holds this recording is kept. Raises ``GagaError`` when
    the recording is damaged, or other files are there.
    """
    recording = look_at_recording(path)
    if path.is_dir():
        mark, content = target / _ODOMETRY, (path / _ODOMETRY).read_bytes()
    else:
        mark = target / "metadata"
        with _opened(path) as archive:
            content = _member(archive, "metadata")
    if mark.is_file() and mark.read_bytes() == content:
        return
    if target.exists():
        raise GagaError(f"{target} holds other photos. Choose another scene folder.")
    part = target.with_name(f".{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        if path.is_dir():
            yield from _unpack_stray(path, part, recording.frames)
        else:
            yield from _unpack_r3d(path, part, recording.frames)
        (part / mark.name).write_bytes(content)
        part.rename(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _unpack_stray(path: Path, part: Path, frames: tuple[int, ...]) -> Stage[None]:
    yield from extract_numbered_frames(path / _FILM, part, frames)
    for name in ("depth", "confidence"):
        (part / name).mkdir()
        for frame in frames:
            if (file := path / name / f"{frame:06d}.png").is_file():
                shutil.copyfile(file, part / name / file.name)
    shutil.copyfile(path / "camera_matrix.csv", part / "camera_matrix.csv")


def _unpack_r3d(path: Path, part: Path, frames: tuple[int, ...]) -> Stage[None]:
    with _opened(path) as archive:
        known = set(archive.namelist())
        for i, frame in enumerate(frames):
            yield Progress("Read frames", i, len(frames))
            for kind in ("jpg", "depth", "conf"):
                name = f"rgbd/{frame}.{kind}"
                if name in known:
                    (part / f"{frame}.{kind}").write_bytes(_member(archive, name))


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except _BROKEN as error:
        raise GagaError(f"{path} is damaged ({error}). Export it again.") from error


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    if archive.getinfo(name).file_size > _MOST_OF_MEMBER:
        raise ValueError(f"{name} is too large")
    return archive.read(name)
