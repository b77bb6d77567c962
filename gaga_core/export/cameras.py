"""Cameras of the photos in the world of exported splats."""

import hashlib
import json
from enum import StrEnum
from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.export.export import exported_indices
from gaga_core.export.options import ExportOptions
from gaga_core.io.cameras.cameras_json import write_cameras_json
from gaga_core.io.cameras.colmap import count_points, has_colmap, note_of, read_colmap, write_colmap
from gaga_core.io.cameras.transforms_json import write_transforms_json
from gaga_core.io.folder.scene_folder import SceneFolder, find_sparse, sparse_folders
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.project import Project, require_other_file
from gaga_core.scene.selection.algebra import world_means

# Measured on garden, ycb_table and ycb_crowd: 469 to 497, 565 to 621, some 200; 44 to 46 a point.
_CAMERA_BYTES = {"cameras.json": 490, "transforms.json": 600, "colmap": 220}  # of a view, about
_POINT_BYTES = 45  # of a point of a COLMAP model as text, about


class CameraForm(StrEnum):
    """A form of cameras; the value is how the name of its file ends."""

    CAMERAS_JSON = "cameras.json"  # of the original 3DGS work
    TRANSFORMS_JSON = "transforms.json"  # of nerfstudio and instant-ngp
    COLMAP = "colmap"  # a folder with a model as text, of any name


def camera_form_of(path: Path) -> CameraForm:
    """The form that a name asks for: a name without ``.json`` is a folder for a COLMAP model."""
    name = path.name.lower()
    if name.endswith(CameraForm.TRANSFORMS_JSON):
        return CameraForm.TRANSFORMS_JSON
    return CameraForm.CAMERAS_JSON if name.endswith(".json") else CameraForm.COLMAP


def export_cameras(project: Project, path: Path, options: ExportOptions | None = None) -> int:
    """Write the photos' cameras in the form that ``path`` asks for; returns their number.

    They see what `export_scene_stage` with the same ``options`` writes as the photos saw the scene,
    however that was aligned, scaled and moved as a whole. A COLMAP model keeps the points of the
    scene's own, without their tracks. Raises ``GagaError`` without cameras, for a suffix that no
    form has, where the scene's own cameras are read from, and where a COLMAP model lies that was
    exported neither from this folder nor from a scene with the same cameras.
    """
    folder, options = project.placed_folder, options or ExportOptions()
    if folder is None or not folder.cameras:
        raise GagaError("Cameras belong to a scene folder with photos. Name that instead.")
    form = camera_form_of(path)
    require_other_file(project, path)
    _check_target(folder, path, form)
    scene = project.scene
    splats = options.inside(scene, exported_indices(scene))
    world = np.diag([options.scale, options.scale, options.scale, 1.0])
    world[:3, 3] = -options.scale * options.origin(world_means(scene, splats))
    cameras = carried_cameras(folder.cameras, world)
    if form is CameraForm.CAMERAS_JSON:
        write_cameras_json(path, cameras)
    elif form is CameraForm.TRANSFORMS_JSON:
        write_transforms_json(path, cameras, folder.image_paths)
    else:
        points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        if (sparse := find_sparse(folder.root)) is not None:
            model, moved = read_colmap(sparse), world @ scene.frame.world
            points, colors = model.points @ moved[:3, :3].T + moved[:3, 3], model.point_colors
        write_colmap(path, cameras, points, colors, _note(folder))
    return len(cameras)


def estimated_camera_bytes(folder: SceneFolder, form: CameraForm) -> int:
    """About how many bytes `export_cameras` writes, without reading points."""
    n_bytes = _CAMERA_BYTES[form] * len(folder.cameras)
    sparse = find_sparse(folder.root) if form is CameraForm.COLMAP else None
    return n_bytes + (_POINT_BYTES * count_points(sparse) if sparse is not None else 0)


def _note(folder: SceneFolder) -> str:
    """What an exported model says of where it is from, in a line: a folder, and a digest of its
    cameras, which is the same wherever the folder lies."""
    place = json.dumps(str(folder.root.resolve()))
    cameras = [
        (camera.name, camera.K.round(3).tolist(), (camera.cam_from_world.round(6) + 0).tolist())
        for camera in folder.cameras
    ]
    digest = hashlib.sha256(json.dumps(cameras).encode()).hexdigest()[:16]
    return f"Exported by gaga-studio from {place}, cameras {digest}"


def _check_target(folder: SceneFolder, path: Path, form: CameraForm) -> None:
    """Raise ``GagaError`` for a place that cannot be written to, or that the scene is read from."""
    if form is CameraForm.COLMAP and (path.is_file() or path.suffix[1:].isalpha()):
        raise GagaError(
            f"Cameras are not written as {path.name}. Name a file cameras.json or transforms.json, "
            "or a folder for a COLMAP model."
        )
    # A model in any of these folders takes the place of the cameras that the scene has.
    own = list(sparse_folders(folder.root))
    if find_sparse(folder.root) is None:
        own.append(folder.root / "cameras.json")
    is_other = form is CameraForm.COLMAP and has_colmap(path)
    if is_other:  # exported neither from this folder nor from one with the same cameras?
        place, _, cameras = _note(folder).partition(", cameras ")
        note = note_of(path)
        is_ours = note.partition(", cameras ")[0] == place
        is_other = not is_ours and not note.endswith(f", cameras {cameras}")
    if is_other or path.resolve() in [place.resolve() for place in own]:
        raise GagaError(f"{path} holds cameras that a scene is read from. Choose another place.")
