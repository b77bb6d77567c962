"""``gaga info``: what a file or folder holds, in plain values."""

from pathlib import Path

import numpy as np

from gaga_core.errors import GagaError
from gaga_core.pipeline.describe import list_objects
from gaga_core.pipeline.level_of_detail import open_project_lod
from gaga_core.progress import Stage
from gaga_core.scene.project import Project, open_path_stage


def describe(path: Path) -> Stage[dict[str, object]]:
    """Open ``path`` (scene folder, file of splats or project) and describe it."""
    project = yield from open_path_stage(path)
    values = _splats(project)
    folder = project.folder
    if folder is not None:
        values["views"] = len(folder.cameras)
        values["photos_on_disk"] = len(folder.image_paths)
        values["train_views"] = len(folder.train)
        values["test_views"] = len(folder.test)
        values["split"] = folder.split
        values["masks"] = list(folder.mask_folders)
    files = [item.path for item in project.scene.added if not item.is_made]
    if files:
        values["added_files"] = files
    objects = list_objects(project)
    values["groups"] = len(objects)
    values["objects"] = objects
    folders = project.scene.folders
    values["folders"] = {path: list(folders.groups(path)) for path in folders.paths}
    values["level_of_detail"] = _level_of_detail(project)
    values["saved_project"] = str(project.path) if project.path else "none"
    return values


def _level_of_detail(project: Project) -> str:
    """Where the tree of merged splats is, if there is one that fits the model."""
    try:
        tree = open_project_lod(project)
    except GagaError as error:
        return f"damaged: {error}"
    return "none" if tree is None else f"{len(tree.sizes)} levels in {tree.folder}"


def _splats(project: Project) -> dict[str, object]:
    gaussians = project.scene.gaussians
    # Outliers far away are common; percentiles say how large the scene is to a person.
    low, high = np.percentile(gaussians.means, [1, 99], axis=0)
    return {
        "model": str(project.model_path),
        "gaussians": len(gaussians),
        "visible": int(project.scene.visible.sum()),
        "sh_degree": gaussians.sh_degree,
        "look": "antialiased" if gaussians.is_antialiased else "classic",
        "size": " x ".join(f"{v:.3g}" for v in high - low) + " scene units",
        "extra_columns": [name for name in gaussians.extra if name not in ("nx", "ny", "nz")],
    }
