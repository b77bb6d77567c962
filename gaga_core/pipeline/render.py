"""Renders of the views of a scene: color, groups or depth, one picture a view."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.export.export import exported_indices
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import read_groups
from gaga_core.grouping.votes import splat_groups
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import view_keys, write_labels
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.project import Project, groups_of_folder

What = Literal["rgb", "groups", "depth"]


def render_views(
    folder: SceneFolder,
    out: Path | None = None,
    *,
    what: What = "groups",
    views: str | Sequence[str] = "test",
    gaussians: Gaussians | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[tuple[Path, ...]]:
    """Render ``views`` (train, test, all, or names) into ``out`` and return the files.

    One <stem>.png a view: "rgb" 8-bit color; "groups" uint16 group ids, 0 = none, of the labels
    with which the scene opens (`scene.opened_labels`); "depth" uint16
    thousandths of the scene unit of the expected depth, 0 = nothing there, 65535 = that or more.
    ``out`` is ``folder.work / "renders" / what`` unless given. Other files there stay.
    `lift.render_identity` renders what the identity encodings say.
    """
    if what not in get_args(What):
        kinds = ", ".join(get_args(What))
        raise GagaError(f"There is nothing called {what!r} to render. Choose one of {kinds}.")
    cameras = select_views(folder, views)
    if gaussians is None:
        gaussians = yield from read_model(folder)
    model, engine = gaussians, rasterizer or choose()
    labels = np.zeros(0, np.int32)
    if what == "groups":
        read_groups(folder, len(model))  # its errors say what to do
        labels = groups_of_folder(folder.work, len(model)).labels

    def paint(path: Path, camera: Camera) -> None:
        if what == "groups":
            write_labels(path, splat_groups(engine, model, camera, labels))
        elif what == "depth":
            write_labels(path, _depth_thousandths(engine, model, camera))
        else:
            write_rgb(path, engine.render(model, camera).image)

    return (yield from paint_views(cameras, out or folder.work / "renders" / what, what, paint))


def paint_views(
    cameras: Sequence[Camera], target: Path, what: str, paint: Callable[[Path, Camera], None]
) -> Stage[tuple[Path, ...]]:
    """``paint`` a <stem>.png of every camera and move them to ``target`` when all are done.

    Pictures of photos in a subfolder lie in one of its name (`view_key`).
    """
    keys = view_keys(camera.name for camera in cameras)
    written = []
    with staging_folder(target) as staging:
        for i, camera in enumerate(cameras):
            yield Progress(f"Render {what}", i, len(cameras), camera.name)
            name = f"{keys[camera.name]}.png"
            paint(staging / name, camera)
            written.append(name)
        publish_all(staging, written, target)
    yield Progress(f"Render {what}", len(cameras), len(cameras), f"{len(written)} files")
    return tuple(target / name for name in written)


def export_masks(
    project: Project, out: Path, *, rasterizer: Rasterizer | None = None
) -> Stage[tuple[Path, ...]]:
    """Group maps of every view as the edited scene shows them: one uint16 <stem>.png a view.

    Maps of photos in a subfolder lie in one of its name (`view_key`). Hidden and deleted splats
    take no part, and moved ones show where they stand. Raises ``GagaError`` when the project has no
    views or nothing is visible.
    """
    folder = project.placed_folder
    if folder is None or not folder.cameras:
        raise GagaError("Group maps need the views of a scene folder. Open that instead of a .ply.")
    shown = exported_indices(project.scene)
    if len(shown) == 0:
        raise GagaError("Nothing is visible, so there are no group maps to export.")
    gaussians = yield from bake_stage(project.scene, indices=shown)
    labels, engine = project.scene.labels[shown], rasterizer or choose()
    cameras = folder.cameras
    names = {name: f"{key}.png" for name, key in view_keys(c.name for c in cameras).items()}
    with staging_folder(out) as staging:
        for i, camera in enumerate(cameras):
            yield Progress("Export masks", i, len(cameras), camera.name)
            path = staging / names[camera.name]
            write_labels(path, splat_groups(engine, gaussians, camera, labels))
        written = sorted(names.values())
        publish_all(staging, written, out)
    return tuple(out / name for name in written)


def _depth_thousandths(rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera) -> IntArray:
    channels = np.zeros((len(gaussians), 1), np.float32)
    depth = rasterizer.render(gaussians, camera, channels=channels).expected_depth
    result: IntArray = np.minimum(np.rint(depth * 1000.0), 65535).astype(np.int32)
    return result
