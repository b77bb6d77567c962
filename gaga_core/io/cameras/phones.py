"""Poses of phones (ARKit, ARCore): Polycam's raw data, Record3D, 3D Scanner App, Stray Scanner.

All are in metres, with y up and cameras that look along -z, as ARKit has them.
"""

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
    cam_from,
    cam_from_opengl,
    checked,
    numbers,
    rigid,
)
from gaga_core.io.depth_maps import DepthMap
from gaga_core.io.json_file import read_bytes, read_foreign_json

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


class Record(msgspec.Struct, frozen=True):
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
    record = read_foreign_json(file, Record, most_bytes=MOST_BYTES)
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


def read_stray(file: Path, photos: Photos) -> GivenPoses:
    """Poses of Stray Scanner's odometry.csv, next to camera_matrix.csv; photo N is frame N.

    Its cameras look along z, with y down. Raises ``GagaError`` when a file is damaged.
    """
    rows = stray_poses(file)
    path = file.with_name("camera_matrix.csv")
    text = read_bytes(path, "Export it again.", MOST_BYTES).decode(errors="replace")
    K = np.array(numbers(text, 9, str(path))).reshape(3, 3)
    poses = []
    for stem, name in photos.stems().items():
        if not stem.isdigit() or int(stem) not in rows:
            continue
        place, (x, y, z, w) = rows[int(stem)][:3], rows[int(stem)][3:]
        turn = quats_to_matrices(np.array([[w, x, y, z]]))[0]
        pose = cam_from(rigid(turn, np.array(place)))
        lens = brown_lens(photos.size(name), (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]))
        depth = _depth_of(file.parent / "depth" / f"{int(stem):06d}.png")
        poses.append(GivenPose(name, lens, pose, None, depth))
    found = GivenPoses("Stray Scanner", file, tuple(poses), is_metric=True, up=_ARKIT_UP)
    return checked(found, photos)


def stray_poses(file: Path) -> dict[int, list[float]]:
    """x, y, z, qx, qy, qz, qw of each frame of an odometry.csv, world_from_cam.

    A last line without an end may be cut off and is left out.
    """
    text = read_bytes(file, "Export it again.", MOST_BYTES).decode(errors="replace")
    lines = text.rpartition("\n")[0].splitlines()
    rows = [
        numbers(",".join(line.split(",")[:9]), 9, f"{file}, line {i}")
        for i, line in enumerate(lines[1:], start=2)
        if line
    ]
    return {int(row[1]): row[2:] for row in rows}
