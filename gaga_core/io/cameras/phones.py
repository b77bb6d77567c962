"""Poses of phones (ARKit, ARCore): Polycam's raw data, Record3D, 3D Scanner App.

All are in metres, with y up and cameras that look along -z, as ARKit has them.
"""

import re
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.errors import GagaError
from gaga_core.geometry import quats_to_matrices
from gaga_core.io.cameras.given import (
    MOST_BYTES,
    GivenPose,
    GivenPoses,
    Photos,
    brown_lens,
    cam_from_opengl,
    checked,
    rigid,
)
from gaga_core.io.depth_maps import DepthMap
from gaga_core.io.json_file import decode_json, read_foreign_json
from gaga_core.progress import Progress, Stage

_Number = Annotated[float, msgspec.Meta(ge=-1e18, le=1e18)]
_Side = Annotated[float, msgspec.Meta(gt=0, le=65_536)]
_ARKIT_UP = (0.0, 1.0, 0.0)


class _Keyframe(msgspec.Struct, frozen=True):
    """A file of Polycam's keyframes/cameras."""

    fx: _Number
    fy: _Number
    cx: _Number
    cy: _Number
    width: _Side
    height: _Side
    t_00: _Number
    t_01: _Number
    t_02: _Number
    t_03: _Number
    t_10: _Number
    t_11: _Number
    t_12: _Number
    t_13: _Number
    t_20: _Number
    t_21: _Number
    t_22: _Number
    t_23: _Number

    def pose(self) -> list[list[float]]:
        """Rows of world_from_cam (3, 4)."""
        return [[getattr(self, f"t_{i}{j}") for j in range(4)] for i in range(3)]


class _Frame(msgspec.Struct, frozen=True):
    """A frame_00000.json of 3D Scanner App."""

    cameraPoseARFrame: list[_Number]  # noqa: N815  the file's name; (16,) by rows
    intrinsics: list[_Number]  # (9,) by rows


class _Record(msgspec.Struct, frozen=True):
    """The metadata of Record3D."""

    w: _Side
    h: _Side
    K: list[_Number]  # (9,) by columns
    poses: list[list[_Number]]  # qx, qy, qz, qw, x, y, z
    dw: int = 0  # pixels of its depth files
    dh: int = 0
    perFrameIntrinsicCoeffs: list[list[_Number]] = []  # noqa: N815  fx, fy, cx, cy


def _depth_of(path: Path, size: tuple[int, int] | None = None) -> DepthMap | None:
    """The depth map ``path``, where it is, with the confidence that its program writes next to it:
    confidence/NAME.png, conf_NAME.png or NAME.conf."""
    if not path.is_file():
        return None
    name = path.name.replace("depth_", "conf_").replace(".depth", ".conf")
    others = (path.parent.with_name("confidence") / path.name, path.with_name(name))
    confidence = next((p for p in others if p != path and p.is_file()), None)
    return DepthMap(path, confidence=confidence, size=size)


def read_polycam(folder: Path, photos: Photos) -> GivenPoses:
    """Poses of keyframes/cameras or corrected_cameras: one JSON file for each photo."""
    poses = []
    for file in sorted(folder.glob("*.json")):
        name = photos.find(file.stem)
        if name is None:
            continue
        key = read_foreign_json(file, _Keyframe)
        size = round(key.width), round(key.height)
        lens = brown_lens(size, (key.fx, key.fy), (key.cx, key.cy))
        world_from_cam = np.vstack([key.pose(), [0, 0, 0, 1.0]])
        depth = _depth_of(folder.parent / "depth" / f"{file.stem}.png")
        poses.append(GivenPose(name, lens, cam_from_opengl(world_from_cam), None, depth))
    return checked(
        GivenPoses("Polycam", folder, tuple(poses), is_metric=True, up=_ARKIT_UP), photos
    )


def read_scanner_app(folder: Path, photos: Photos) -> GivenPoses:
    """Poses of frame_NNNNN.json of 3D Scanner App (ARKit), next to the photos."""
    poses, photos_missing = [], list(photos.missing)
    for file in sorted(folder.glob("frame_*.json")):
        name = photos.find(file.stem)
        if name is None:  # depth has more frames than there are photos
            continue
        frame = read_foreign_json(file, _Frame)
        if len(frame.cameraPoseARFrame) != 16 or len(frame.intrinsics) != 9:
            raise GagaError(f"{file}: cameraPoseARFrame or intrinsics has a wrong length.")
        K = np.array(frame.intrinsics).reshape(3, 3)
        lens = brown_lens(photos.size(name), (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]))
        pose = cam_from_opengl(np.array(frame.cameraPoseARFrame).reshape(4, 4))
        depth = _depth_of(file.with_name(file.name.replace("frame_", "depth_")).with_suffix(".png"))
        poses.append(GivenPose(name, lens, pose, None, depth))
    photos.missing = photos_missing
    found = GivenPoses("3D Scanner App", folder, tuple(poses), is_metric=True, up=_ARKIT_UP)
    return checked(found, photos)


def read_record3d(file: Path, photos: Photos) -> GivenPoses:
    """Poses of Record3D's metadata; photo N is that of pose N. Raises ``GagaError`` when there are
    more photos than poses."""
    record = read_foreign_json(file, _Record, most_bytes=MOST_BYTES)
    if len(record.K) != 9 or any(len(pose) != 7 for pose in record.poses):
        raise GagaError(f"{file}: K or poses have a wrong length. Export it again.")
    numbered = {int(stem): name for stem, name in photos.stems().items() if stem.isdigit()}
    if not numbered or max(numbered) >= len(record.poses):
        raise GagaError(
            f"{file} has {len(record.poses)} poses, but the photos in {photos.folder} are not "
            f"numbered from 0 to {len(record.poses) - 1}. Give the folder that Record3D exported."
        )
    K = np.array(record.K).reshape(3, 3).T
    poses = []
    for i, name in sorted(numbered.items()):
        x, y, z, w, *place = record.poses[i]
        turn = quats_to_matrices(np.array([[w, x, y, z]]))[0]
        focal, centre = (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2])
        if len(record.perFrameIntrinsicCoeffs) > i and len(record.perFrameIntrinsicCoeffs[i]) == 4:
            fx, fy, cx, cy = record.perFrameIntrinsicCoeffs[i]
            focal, centre = (fx, fy), (cx, cy)
        lens = brown_lens((round(record.w), round(record.h)), focal, centre)
        photo = photos.paths[name]
        depth = _depth_of(photo.with_suffix(".depth"), (record.dw, record.dh))
        depth = depth or _depth_of(photo.parent.parent / "depth" / f"{photo.stem}.exr")
        pose = cam_from_opengl(rigid(turn, np.array(place)))
        poses.append(GivenPose(name, lens, pose, None, depth))
    return checked(GivenPoses("Record3D", file, tuple(poses), is_metric=True, up=_ARKIT_UP), photos)


# --- Recordings of Record3D (.r3d): an archive with the metadata and rgbd/N.jpg, N.depth, N.conf.


R3D = ".r3d"
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
    """Whether ``path`` is a recording of Record3D."""
    return path.suffix.lower() == R3D and path.is_file()


def look_at_r3d(path: Path) -> Recording:
    """The frames of a recording that are far enough from each other.

    Raises ``GagaError`` when it is damaged.
    """
    with _opened(path) as archive:
        record = decode_json(_member(archive, "metadata"), _Record, f"{path}", "Export it again.")
        names = (_MEMBER.fullmatch(name) for name in archive.namelist())
        numbers = sorted(int(m[1]) for m in names if m is not None and m[2] == "jpg")
    poses = np.array([p for p in record.poses if len(p) == 7], np.float64).reshape(-1, 7)
    there = np.array([n for n in numbers if n < len(poses)], np.int64)
    if len(there) == 0 or len(poses) < len(record.poses):
        raise GagaError(f"{path} has no photos with poses. Export it again.")
    turns, places = poses[there, :4], poses[there, 4:]
    turned = 2 * np.arccos(np.clip(np.abs((turns[1:] * turns[:-1]).sum(axis=1)), 0, 1))
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1) / _STEP + turned / _TURN
    way = np.r_[0.0, np.cumsum(steps)]
    at = np.linspace(0, way[-1], min(int(way[-1]) + 1, _MOST_FRAMES))
    frames = tuple(there[np.unique(np.searchsorted(way, at))].tolist())
    told = f"Record3D: {len(frames)} of {len(there)} frames of {path.name}, with metres and depth"
    return Recording(frames, (round(record.w), round(record.h)), told)


def unpack_r3d_stage(path: Path, target: Path) -> Stage[None]:
    """Unpack the frames that are taken, and the metadata, as Record3D's folders have them.

    ``target`` appears at the end; one that holds this recording is kept. Raises ``GagaError`` when
    the recording is damaged, or other files are there.
    """
    recording = look_at_r3d(path)
    with _opened(path) as archive:
        metadata = _member(archive, "metadata")
        mark = target / "metadata"
        if mark.is_file() and mark.read_bytes() == metadata:
            return
        if target.exists():
            raise GagaError(f"{target} holds other photos. Choose another scene folder.")
        part = target.with_name(f".{target.name}.part")
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        (part / "metadata").write_bytes(metadata)
        known = set(archive.namelist())
        for i, frame in enumerate(recording.frames):
            yield Progress("Read frames", i, len(recording.frames))
            for kind in ("jpg", "depth", "conf"):
                name = f"rgbd/{frame}.{kind}"
                if name in known:
                    (part / f"{frame}.{kind}").write_bytes(_member(archive, name))
        part.rename(target)


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
