"""Cameras of the photos in the world of exported splats."""

from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.io.cameras_json import write_cameras_json
from gaga_core.scene.export import exported_indices
from gaga_core.scene.export_options import ExportOptions
from gaga_core.scene.frame import carried_cameras
from gaga_core.scene.project import Project
from gaga_core.scene.selection.algebra import world_means


def export_cameras(project: Project, path: Path, options: ExportOptions | None = None) -> int:
    """Write the photos' cameras as a cameras.json; returns their number.

    They see what `export_scene_stage` with the same ``options`` writes as the photos saw the scene,
    however that was aligned, scaled and moved as a whole. Raises ``GagaError`` without cameras.
    """
    folder, options = project.placed_folder, options or ExportOptions()
    if folder is None or not folder.cameras:
        raise GagaError("Cameras belong to a scene folder with photos. Name that instead.")
    scene = project.scene
    splats = options.inside(scene, exported_indices(scene))
    world = np.diag([options.scale, options.scale, options.scale, 1.0])
    world[:3, 3] = -options.scale * options.origin(world_means(scene, splats))
    write_cameras_json(path, carried_cameras(folder.cameras, world))
    return len(folder.cameras)
