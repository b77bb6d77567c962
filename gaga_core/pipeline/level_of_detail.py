"""The tree of an opened project: where it lies, and of which rows it is."""

from pathlib import Path

from gaga_core.gaussians import Gaussians
from gaga_core.io.files import fingerprint
from gaga_core.progress import Stage
from gaga_core.scene.edits.placement_values import first_rows
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.tree import FOLDER, LodTree, open_lod
from gaga_core.scene.project import Project


def lod_folder(project: Project) -> Path:
    """Folder of the tree: ``gaga/lod`` of a scene folder, ``NAME.gaga/lod`` next to a file."""
    if project.folder is not None:
        return project.folder.work / FOLDER
    return project.model_path.with_suffix(".gaga") / FOLDER


def open_project_lod(project: Project) -> LodTree | None:
    """The tree of what is open; None where there is none, or one of another model.

    Raises ``GagaError`` when it is damaged.
    """
    folder = lod_folder(project)
    if not folder.is_dir():
        return None
    n_sh = project.scene.gaussians.sh.shape[1]
    return open_lod(folder, _digest(project), project.scene.n_opened, n_sh)


def build_project_lod_stage(project: Project) -> Stage[LodTree]:
    """Build the tree of the opened model with progress, see `build_lod_stage`."""
    opened = opened_rows(project)
    return (yield from build_lod_stage(opened, lod_folder(project), _digest(project)))


def opened_rows(project: Project) -> Gaussians:
    """The Gaussians of the opened model: a prefix of the scene."""
    gaussians, n = project.scene.gaussians, project.scene.n_opened
    return gaussians if n == len(gaussians) else first_rows(gaussians, n)


def _digest(project: Project) -> str:
    return project.model_fingerprint or fingerprint(project.model_path)
