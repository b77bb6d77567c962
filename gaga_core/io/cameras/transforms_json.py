"""``transforms.json`` of nerfstudio and instant-ngp: one pinhole camera a frame."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.io.files import write_text

_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # their cameras look along -z, y is up


def write_transforms_json(
    path: Path, cameras: Sequence[Camera], image_paths: Mapping[str, Path]
) -> None:
    """Write cameras with their photos (by name): relative to ``path`` where they lie below it.

    Photos elsewhere, and those that are missing, are named ``images/NAME``. ``transform_matrix`` is
    world_from_cam with OpenGL's axes; the world is not turned.
    """
    entries = [
        {
            "file_path": _photo(camera.name, image_paths.get(camera.name), path.parent),
            "w": camera.width,
            "h": camera.height,
            "fl_x": float(camera.K[0, 0]),
            "fl_y": float(camera.K[1, 1]),
            "cx": float(camera.K[0, 2]),
            "cy": float(camera.K[1, 2]),
            "transform_matrix": (np.linalg.inv(camera.cam_from_world) @ _OPENGL).tolist(),
        }
        for camera in cameras
    ]
    whole = {"camera_model": "PINHOLE", "frames": entries}
    write_text(path, json.dumps(whole, indent=1))


def _photo(name: str, photo: Path | None, folder: Path) -> str:
    absolute = folder.absolute()
    if photo is not None and photo.absolute().is_relative_to(absolute):
        return photo.absolute().relative_to(absolute).as_posix()
    return f"images/{name}"
