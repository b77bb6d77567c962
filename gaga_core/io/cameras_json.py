"""``cameras.json`` of the original 3DGS work: one pinhole camera an entry."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write, explain_os_error
from gaga_core.io.masks import view_key


def read_cameras_json(path: Path) -> tuple[Camera, ...]:
    """Cameras in file order. ``position`` and ``rotation`` are world_from_cam; the principal point
    is the middle of the picture. Raises ``GagaError`` when the file is damaged."""
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        return tuple(_camera_of(entry) for entry in entries)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    except (ValueError, KeyError, TypeError) as error:
        raise GagaError(f"{path} is not a cameras.json of a 3DGS scene ({error}).") from error


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
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(entries, indent=1), encoding="utf-8")


def _camera_of(entry: dict[str, object]) -> Camera:
    width, height = (int(str(entry[key])) for key in ("width", "height"))
    fx, fy = (float(str(entry[key])) for key in ("fx", "fy"))
    rotation = np.array(entry["rotation"], np.float64).reshape(3, 3)
    position = np.array(entry["position"], np.float64).reshape(3)
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ position
    K = np.array([[fx, 0, width / 2], [0, fy, height / 2], [0, 0, 1.0]])
    return Camera(K, pose, width, height, str(entry.get("img_name", entry.get("id", ""))))
