"""The tree of an opened project: where it lies, and of which rows it is.

The opened model has a tree of its own; files that were added to it share one with it.
"""

import hashlib
from pathlib import Path

from gaga_core.gaussians import Gaussians
from gaga_core.io.splats.splat_files import model_fingerprint
from gaga_core.progress import Stage
from gaga_core.scene.edits.values import first_rows
from gaga_core.scene.lod.build import build_lod_stage
from gaga_core.scene.lod.tree import FOLDER, LodTree, open_lod
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene

WITH_ADDED = "lod-added"  # folder of the tree of the model and the files that were added to it


def lod_folder(project: Project, name: str = FOLDER) -> Path:
    """Folder of the tree: ``gaga/lod`` of a scene folder, ``NAME.gaga/lod`` next to a file."""
    return project.first_path / name


def open_project_lod(project: Project) -> LodTree | None:
    """The tree of what is open, of as many of its files as there is one of; None without any.

    Raises ``GagaError`` when it is damaged.
    """
    n_sh = project.scene.gaussians.sh.shape[1]
    n_opened = project.scene.n_opened
    for name, n in ((WITH_ADDED, rows_of_files(project.scene)), (FOLDER, n_opened)):
        folder = lod_folder(project, name)
        if (name == FOLDER or n > n_opened) and folder.is_dir():
            tree = open_lod(folder, _digest(project, n), n, n_sh)
            if tree is not None:
                return tree
    return None


def build_project_lod_stage(project: Project) -> Stage[LodTree]:
    """Build the tree of the opened model and of the files that were added, with progress.

    See `build_lod_stage`.
    """
    n = rows_of_files(project.scene)
    folder = lod_folder(project, WITH_ADDED if n > project.scene.n_opened else FOLDER)
    rows = rows_of(project, n)
    return (yield from build_lod_stage(rows, folder, _digest(project, n)))


def rows_of_files(scene: Scene) -> int:
    """Leading rows of the scene that are those of the opened and of added files, as they lie there.

    They end where splats were copied, or made by an edit, before the next file was added.
    """
    n = scene.n_opened
    for item in scene.added:
        is_there = n == item.first and n + item.n <= len(scene)
        if item.is_made or not is_there or scene.source[n] != n:
            break
        n += item.n
    return n


def is_of(tree: LodTree, project: Project) -> bool:
    """Whether ``tree`` is of the leading rows of what is open now: edits add files and undo it."""
    scene = project.scene
    ends = {scene.n_opened, *(item.first + item.n for item in scene.added)}
    n = len(tree)
    fits = n in ends and n <= rows_of_files(scene) and tree.n_sh == scene.gaussians.sh.shape[1]
    return fits and tree.digest == _digest(project, n)


def rows_of(project: Project, n: int) -> Gaussians:
    """The first ``n`` Gaussians of the scene."""
    gaussians = project.scene.gaussians
    return gaussians if n == len(gaussians) else first_rows(gaussians, n)


def _digest(project: Project, n: int) -> str:
    """Of the files that the first ``n`` rows are of; of the opened one alone its fingerprint."""
    if not project.model_fingerprint:
        project.model_fingerprint = model_fingerprint(project.model_path)
    opened, added = project.model_fingerprint, project.scene.added
    parts = [f"{item.fingerprint} {item.n}" for item in added if item.first + item.n <= n]
    if not parts:
        return opened
    return hashlib.sha256("\n".join([opened, *parts]).encode()).hexdigest()
