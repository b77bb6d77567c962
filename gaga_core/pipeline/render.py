"""Renders of the views of a scene, one picture a view: color, depth, groups, identities."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.export.export import exported_indices
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import read_groups
from gaga_core.grouping.votes import splat_groups
from gaga_core.identity.field import encoding_colors
from gaga_core.io.folder.scene_folder import SCENE_INPUTS, SceneFolder, read_model, select_views
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.images import write_rgb
from gaga_core.io.masks.label_maps import view_keys, write_labels
from gaga_core.pipeline.lift import decode_groups, read_identity
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.project import Project, groups_of_folder

What = Literal["rgb", "groups", "depth", "identity", "encodings"]
_Paint = Callable[[Path, Camera], None]


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
    with which the scene opens (`scene.opened_labels`); "depth" uint16 thousandths of the scene unit
    of the expected depth, 0 = nothing there, 65535 = that or more; "identity" group ids that the
    rendered identity encodings decode to; "encodings" these as colors, as the window shows them.
    ``out`` is ``folder.work / "renders" / what`` unless given. Other files there stay. Raises
    ``GagaError`` where there are no groups, or no lift, to draw, and where ``out`` holds
    files that the scene was given.
    """
    if what not in get_args(What):
        kinds = ", ".join(get_args(What))
        raise GagaError(f"There is nothing called {what!r} to render. Choose one of {kinds}.")
    cameras = select_views(folder, views)
    if gaussians is None:
        gaussians = yield from read_model(folder)
    paint = _painter(folder, what, gaussians, rasterizer or choose())
    target = out or folder.work / "renders" / what
    _require_apart(folder, target)
    return (yield from _paint_views(cameras, target, f"Render {what}", paint))


def _painter(folder: SceneFolder, what: What, model: Gaussians, engine: Rasterizer) -> _Paint:
    """The function that writes the picture of a view."""
    n = len(model)
    if what == "groups":
        read_groups(folder, n)  # its errors say what to do
        labels = groups_of_folder(folder.work, n).labels
        return lambda path, camera: write_labels(path, splat_groups(engine, model, camera, labels))
    if what == "identity":
        field = read_identity(folder, n).field
        return lambda path, camera: write_labels(path, decode_groups(engine, model, camera, field))
    if what == "rgb":
        return lambda path, camera: write_rgb(path, engine.render(model, camera).image)
    channels = np.zeros((n, 1), np.float32)
    if what == "encodings":
        colors = encoding_colors(read_identity(folder, n).field.encodings)
        channels = colors.astype(np.float32) / np.float32(255)

    def paint(path: Path, camera: Camera) -> None:
        frame = engine.render(model, camera, channels=channels)
        if what == "encodings":
            write_rgb(path, frame.image)
            return
        thousandths = np.minimum(np.rint(frame.expected_depth * 1000.0), 65535)
        write_labels(path, thousandths.astype(np.int32))

    return paint


def _paint_views(
    cameras: Sequence[Camera], target: Path, title: str, paint: _Paint
) -> Stage[tuple[Path, ...]]:
    """``paint`` a <stem>.png of every camera and move them to ``target`` when all are done.

    Pictures of photos in a subfolder lie in one of its name (`view_key`).
    """
    names = {name: f"{key}.png" for name, key in view_keys(c.name for c in cameras).items()}
    with staging_folder(target) as staging:
        for i, camera in enumerate(cameras):
            yield Progress(title, i, len(cameras), camera.name)
            paint(staging / names[camera.name], camera)
        publish_all(staging, sorted(names.values()), target)
    yield Progress(title, len(cameras), len(cameras), f"{len(names)} files")
    return tuple(target / names[camera.name] for camera in cameras)


def _require_apart(folder: SceneFolder, out: Path) -> None:
    """Raise ``GagaError`` where files in ``out`` could replace what the scene was given."""
    target, root = out.resolve(), folder.root.resolve()
    is_given = any(target.is_relative_to(root / name) for name in SCENE_INPUTS)
    is_given = is_given and target.is_dir() and any(target.iterdir())
    of_photos = {path.parent for path in folder.image_paths.values()}
    if is_given or target in {parent.resolve() for parent in of_photos}:
        raise GagaError(f"{out} holds files of this scene. Choose another place.")


def export_masks(project: Project, out: Path) -> Stage[tuple[Path, ...]]:
    """Group maps of every view as the edited scene shows them: one uint16 <stem>.png a view.

    Maps of photos in a subfolder lie in one of its name (`view_key`). Hidden and deleted splats
    take no part, and moved ones show where they stand. Raises ``GagaError`` when the project has no
    views or nothing is visible, or ``out`` holds files that the scene was given.
    """
    folder = project.placed_folder
    if folder is None or not folder.cameras:
        raise GagaError("Group maps need the views of a scene folder. Open that instead of a .ply.")
    _require_apart(folder, out)
    shown = exported_indices(project.scene)
    if len(shown) == 0:
        raise GagaError("Nothing is visible, so there are no group maps to export.")
    gaussians = yield from bake_stage(project.scene, indices=shown)
    labels, engine = project.scene.labels[shown], choose()

    def paint(path: Path, camera: Camera) -> None:
        write_labels(path, splat_groups(engine, gaussians, camera, labels))

    written = yield from _paint_views(folder.cameras, out, "Export masks", paint)
    return tuple(sorted(written))
