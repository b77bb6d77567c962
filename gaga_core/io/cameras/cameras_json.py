"""``cameras.json`` of the original 3DGS work: one pinhole camera an entry."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.camera import MOST_PIXELS, Camera, is_usable
from gaga_core.errors import GagaError
from gaga_core.io.files import write_text
from gaga_core.io.json_file import read_json
from gaga_core.io.masks.label_maps import view_key

_MOST_BYTES = 1 << 30  # a camera has some 500 bytes
_Side = Annotated[int, msgspec.Meta(ge=1, le=MOST_PIXELS)]
_Focal = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
_Number = Annotated[float, msgspec.Meta(ge=-1e18, le=1e18)]
_Row = tuple[_Number, _Number, _Number]


class CameraEntry(msgspec.Struct, frozen=True):
    """One camera of cameras.json."""

    width: _Side
    height: _Side
    fx: _Focal  # pixels
    fy: _Focal
    position: _Row  # of the camera, world
    rotation: tuple[_Row, _Row, _Row]  # world from camera
    img_name: str | int | None = None
    id: str | int = ""


def read_cameras_json(path: Path) -> tuple[Camera, ...]:
    """Cameras in file order. ``position`` and ``rotation`` are world_from_cam; the principal point
    is the middle of the picture. Raises ``GagaError`` when the file is damaged."""
    cure = "Copy the cameras.json of the training again."
    entries = read_json(path, list[CameraEntry], cure, most_bytes=_MOST_BYTES)
    return tuple(_camera_of(entry, path) for entry in entries)


def write_cameras_json(path: Path, cameras: Sequence[Camera]) -> None:
    """Write cameras; the principal point is not part of this format."""
    entries = [
        {
            "id": i,
            "img_name": view_key(camera.name),
            "width": camera.width,
            "height": camera.height,
            "position": camera.position.tolist(),
            "rotation": camera.cam_from_world[:3, :3].T.tolist(),
            "fy": float(camera.K[1, 1]),
            "fx": float(camera.K[0, 0]),
        }
        for i, camera in enumerate(cameras)
    ]
    write_text(path, json.dumps(entries, indent=1))


def _camera_of(entry: CameraEntry, path: Path) -> Camera:
    rotation, position = np.array(entry.rotation), np.array(entry.position)
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ position
    middle = entry.width / 2, entry.height / 2
    K = np.array([[entry.fx, 0, middle[0]], [0, entry.fy, middle[1]], [0, 0, 1.0]])
    name = entry.id if entry.img_name is None else entry.img_name
    if not is_usable(K, pose):
        raise GagaError(
            f"{path} has no usable camera {name}: its focal length or rotation cannot be. Copy it "
            "again."
        )
    return Camera(K, pose, entry.width, entry.height, str(name))
