"""``transforms.json``: poses of nerfstudio, instant-ngp, Blender and of phone programs."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.io.cameras.given import (
    FOCALS,
    MOST_BYTES,
    OPENGL,
    GivenPose,
    GivenPoses,
    Lens,
    Photos,
    brown_lens,
    cam_from_opengl,
    checked,
    file_near,
)
from gaga_core.io.depth_maps import MILLIMETRES, DepthMap
from gaga_core.io.files import write_text
from gaga_core.io.json_file import PathText, read_foreign_json

_Number = Annotated[float, msgspec.Meta(ge=-1e18, le=1e18)]
_Row = tuple[_Number, _Number, _Number, _Number]
_BLENDER = ("transforms_train.json", "transforms_val.json", "transforms_test.json")
_SPLIT = 1e-6  # of a scale: below, nothing could be divided by it


class _Intrinsics(msgspec.Struct, frozen=True):
    """Of the whole file, or of one frame."""

    camera_model: str | None = None
    is_fisheye: bool | None = None
    w: _Number | None = None
    h: _Number | None = None
    fl_x: _Number | None = None
    fl_y: _Number | None = None
    cx: _Number | None = None
    cy: _Number | None = None
    camera_angle_x: _Number | None = None
    camera_angle_y: _Number | None = None
    k1: _Number | None = None
    k2: _Number | None = None
    k3: _Number | None = None
    k4: _Number | None = None
    p1: _Number | None = None
    p2: _Number | None = None


class _Frame(_Intrinsics, frozen=True):
    file_path: PathText = ""
    transform_matrix: tuple[_Row, ...] = ()
    mask_path: PathText | None = None
    depth_file_path: PathText | None = None
    depth_path: PathText | None = None  # instant-ngp, NeRFCapture


class _File(_Intrinsics, frozen=True):
    frames: list[_Frame] = []
    applied_transform: tuple[_Row, ...] = ()
    applied_scale: _Number = 1.0
    integer_depth_scale: _Number | None = None


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
            "transform_matrix": (np.linalg.inv(camera.cam_from_world) @ OPENGL).tolist(),
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


def read_transforms_json(path: Path, photos: Photos) -> GivenPoses:
    """Poses of a transforms.json in the world before ``applied_transform`` and ``applied_scale``.

    Depth maps next to the photos come with poses in metres. Of Blender's files the training,
    validation and test photos are read together. Raises ``GagaError`` when the file is damaged.
    """
    files = [path]
    if path.name in _BLENDER:
        files = [file for name in _BLENDER if (file := path.with_name(name)).is_file()]
    poses: list[GivenPose] = []
    notes: set[str] = set()
    whole = _File()
    for file in files:
        whole = read_foreign_json(file, _File, most_bytes=MOST_BYTES)
        undo = _undone(whole, file)
        unit = whole.integer_depth_scale or MILLIMETRES
        for frame in whole.frames:
            name = photos.find(frame.file_path)
            if name is not None:
                pose = _pose_of(frame, undo, file)
                lens = _lens_of(frame, whole, photos.size(name), file, notes)
                mask = file_near(file, frame.mask_path)
                depth = file_near(file, frame.depth_file_path or frame.depth_path)
                known = None if depth is None else DepthMap(depth, unit)
                poses.append(GivenPose(name, lens, pose, mask, known))
    is_blender = path.name in _BLENDER
    has_depth = any(f.depth_file_path or f.depth_path for f in whole.frames)
    up = _up(whole, is_known=is_blender or has_depth)
    program = "Blender" if is_blender else "transforms.json"
    return checked(
        GivenPoses(program, path, tuple(poses), has_depth, up, notes=tuple(sorted(notes))), photos
    )


def _undone(whole: _File, file: Path) -> np.ndarray:
    """The map (4, 4) from the world of the file to that of the program it came from."""
    applied = np.eye(4)
    if whole.applied_transform:
        if len(whole.applied_transform) < 3:
            raise GagaError(f"{file}: applied_transform has too few rows. Export it again.")
        applied[:3] = whole.applied_transform[:3]
    if not whole.applied_scale > _SPLIT or abs(np.linalg.det(applied[:3, :3])) < _SPLIT:
        raise GagaError(f"{file}: applied_transform or applied_scale is not usable.")
    undo: np.ndarray = np.linalg.inv(applied)
    undo[:3, :3] /= whole.applied_scale
    return undo


def _up(whole: _File, *, is_known: bool) -> tuple[float, float, float] | None:
    """These worlds have z up, where the program knew the vertical: before the applied transform
    that is another axis."""
    if not is_known:
        return None
    if not whole.applied_transform:
        return (0.0, 0.0, 1.0)
    x, y, z = np.array(whole.applied_transform)[2, :3].tolist()
    return (x, y, z)


def _pose_of(frame: _Frame, undo: np.ndarray, file: Path) -> np.ndarray:
    if len(frame.transform_matrix) not in (3, 4):
        raise GagaError(f"{file}: transform_matrix of {frame.file_path} has not 4 rows.")
    pose = np.eye(4)
    pose[:3] = frame.transform_matrix[:3]
    moved = undo @ pose
    scale = np.cbrt(abs(np.linalg.det(undo[:3, :3])))
    moved[:3, :3] /= scale
    return cam_from_opengl(moved)


def _lens_of(
    frame: _Frame, whole: _File, photo: tuple[int, int], file: Path, notes: set[str]
) -> Lens | None:
    def get(name: str) -> float | None:
        own = getattr(frame, name)
        value = getattr(whole, name) if own is None else own
        return None if value is None else float(value)

    size = round(get("w") or photo[0]), round(get("h") or photo[1])
    fx, angle, angle_y = get("fl_x"), get("camera_angle_x"), get("camera_angle_y")
    fy = get("fl_y")
    if fx is None and angle:
        fx = size[0] / 2 / float(np.tan(angle / 2))
    if fy is None and angle_y:
        fy = size[1] / 2 / float(np.tan(angle_y / 2))
    if fx is None:
        return None
    fy = fx if fy is None else fy
    cx, cy = get("cx"), get("cy")
    centre = size[0] / 2 if cx is None else cx, size[1] / 2 if cy is None else cy
    k1, k2, k3, k4, p1, p2 = (get(name) or 0.0 for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    model = (frame.camera_model or whole.camera_model or "OPENCV").upper()
    if model == "OPENCV_FISHEYE" or frame.is_fisheye or whole.is_fisheye:
        return Lens("OPENCV_FISHEYE", *size, (fx, fy, *centre, k1, k2, k3, k4))
    if model in ("EQUIRECTANGULAR", "ORTHOPHOTO") or (
        model not in FOCALS and model not in ("PERSPECTIVE",)
    ):
        raise GagaError(f"{file}: camera_model {model} is no lens that is read.")
    if model in ("PINHOLE", "SIMPLE_PINHOLE"):
        k1 = k2 = k3 = k4 = p1 = p2 = 0.0
    if k4:
        notes.add("The lens has k4, which is left out.")
    return brown_lens(size, (fx, fy), centre, (k1, k2, k3), (p1, p2))
