"""The stages over a scene folder: what the command and the window's one-button offers run.

Each is a generator of `Progress`. Results are built in a hidden folder beside their place and moved
there at the end, so a stage that is cancelled or fails leaves the scene folder as it was.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.bank_file import save_bank
from gaga_core.grouping.views import load_labels
from gaga_core.identity.votes import associated_labels
from gaga_core.io.arrays_file import read_arrays
from gaga_core.io.images import write_rgb
from gaga_core.io.masks import mask_folder, write_labels
from gaga_core.io.scene_folder import SceneFolder
from gaga_core.io.splat_files import read_splats_stage
from gaga_core.io.staging import publish, staging_folder
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import LabelFrame, Rasterizer
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.export import exported_indices
from gaga_core.scene.project import Project

What = Literal["rgb", "groups", "depth"]
VOID_BELOW = 0.3  # summed weight under which a pixel shows no group


def associate_scene(
    folder: SceneFolder,
    masks: str | Path | None = None,
    config: AssociateConfig | None = None,
    *,
    gaussians: Gaussians | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[Association]:
    """Associate the masks of the train views and write the result into ``folder.work``.

    ``masks`` is a provider's name, a folder of label maps, or None for the only provider there is.
    ``gaussians`` saves reading the model again. Written: bank.npz, labels.npz (labels, confidence),
    masks/<stem>.png (uint16 group ids of the train views) and the entry "associate" of report.json.
    """
    config = config or AssociateConfig()
    mask_path = mask_path_of(folder, masks)
    cameras = select_views(folder, "train")
    mask_set = mask_folder(mask_path, [camera.name for camera in cameras])
    if gaussians is None:
        gaussians = yield from read_model(folder)
    start = time.perf_counter()
    association = yield from associate_stage(
        gaussians, cameras, mask_set, rasterizer or choose(), config
    )
    summary = association.to_json() | {
        "mask_folder": str(mask_path),
        "config": asdict(config),
        "seconds": round(time.perf_counter() - start, 3),
    }
    with staging_folder(folder.work) as staging:
        save_bank(staging / "bank.npz", association.bank)
        np.savez_compressed(
            staging / "labels.npz", labels=association.labels, confidence=association.confidence
        )
        yield from _write_pseudo_labels(staging / "masks", cameras, mask_set, association)
        report = with_entry(folder.work / "report.json", "associate", summary)
        (staging / "report.json").write_text(report, encoding="utf-8")
        for name in ("masks", "bank.npz", "labels.npz", "report.json"):
            publish(staging, name, folder.work)
    return association


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

    One <stem>.png a view: "rgb" 8-bit color; "groups" uint16 group ids, 0 = none; "depth" uint16
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
    labels = read_groups(folder, len(model))[0] if what == "groups" else np.zeros(0, np.int32)

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
    """``paint`` a <stem>.png of every camera and move them to ``target`` when all are done."""
    written = []
    with staging_folder(target) as staging:
        for i, camera in enumerate(cameras):
            yield Progress(f"Render {what}", i, len(cameras), camera.name)
            path = staging / f"{Path(camera.name).stem}.png"
            paint(path, camera)
            written.append(path.name)
        for name in written:
            publish(staging, name, target)
    yield Progress(f"Render {what}", len(cameras), len(cameras), f"{len(written)} files")
    return tuple(target / name for name in written)


def export_masks(
    project: Project, out: Path, *, rasterizer: Rasterizer | None = None
) -> Stage[tuple[Path, ...]]:
    """Group maps of every view as the edited scene shows them: one uint16 <stem>.png a view.

    Hidden and deleted splats take no part, and moved ones show where they stand. Raises
    ``GagaError`` when the project has no views or nothing is visible.
    """
    if project.folder is None or not project.folder.cameras:
        raise GagaError("Group maps need the views of a scene folder. Open that instead of a .ply.")
    shown = exported_indices(project.scene)
    if len(shown) == 0:
        raise GagaError("Nothing is visible, so there are no group maps to export.")
    gaussians = yield from bake_stage(project.scene, indices=shown)
    labels, engine = project.scene.labels[shown], rasterizer or choose()
    cameras = project.folder.cameras
    with staging_folder(out) as staging:
        for i, camera in enumerate(cameras):
            yield Progress("Export masks", i, len(cameras), camera.name)
            path = staging / f"{Path(camera.name).stem}.png"
            write_labels(path, splat_groups(engine, gaussians, camera, labels))
        written = sorted(path.name for path in staging.iterdir())
        for name in written:
            publish(staging, name, out)
    return tuple(out / name for name in written)


def mask_path_of(folder: SceneFolder, masks: str | Path | None) -> Path:
    """The folder of label maps meant by ``masks``: a provider's name, a path, None = the only one.

    Raises ``GagaError`` when there is none, or no telling which.
    """
    providers = folder.mask_folders
    if masks is None:
        if not providers:
            raise GagaError(f"There are no masks in {folder.root / 'masks'}. Make masks first.")
        if len(providers) > 1:
            names = ", ".join(sorted(providers))
            raise GagaError(f"There are several mask folders: {names}. Choose one of them.")
        return next(iter(providers.values()))
    if str(masks) in providers:
        return providers[str(masks)]
    for path in (Path(masks), folder.root / masks):
        if path.is_dir():
            return path
    known = ", ".join(sorted(providers)) or "none"
    raise GagaError(f"There is no mask folder {masks}. In this scene: {known}.")


def select_views(folder: SceneFolder, views: str | Sequence[str]) -> tuple[Camera, ...]:
    """Cameras of "train", "test", "all", or of names (with or without suffix, comma-separated)."""
    by_name = {camera.name: camera for camera in folder.cameras}
    if not by_name:
        raise GagaError(f"There are no cameras in {folder.root}. Add a COLMAP model (sparse/0).")
    if not isinstance(views, str) and len(views) == 1:
        views = views[0]
    if views == "all":
        return folder.cameras
    if isinstance(views, str) and views in ("train", "test"):
        names = folder.train if views == "train" else folder.test
        if not names:
            raise GagaError(f"No views are set apart as {views} in {folder.root}.")
        return tuple(by_name[name] for name in names)
    wanted = views.split(",") if isinstance(views, str) else views
    by_stem = {Path(name).stem: camera for name, camera in by_name.items()}
    found = {name: by_name.get(name) or by_stem.get(name) for name in wanted}
    unknown = [name for name, camera in found.items() if camera is None]
    if unknown or not found:
        raise GagaError(f"There is no view {', '.join(unknown)} among {len(by_name)} views.")
    return tuple(camera for camera in found.values() if camera is not None)


def read_model(folder: SceneFolder) -> Stage[Gaussians]:
    """Read the scene's splats."""
    if folder.model_path is None:
        raise GagaError(
            f"There is no model in {folder.root}. Put a point_cloud.ply there, or name one."
        )
    return (yield from read_splats_stage(folder.model_path))


def read_groups(folder: SceneFolder, n_gaussians: int) -> tuple[IntArray, FloatArray]:
    """Labels and confidence (N,) that `associate_scene` left; ``GagaError`` if they do not fit."""
    path = folder.work / "labels.npz"
    if not path.is_file():
        raise GagaError(f"There are no groups in {folder.work} yet. Associate the masks first.")
    arrays = read_arrays(path, "Associate the masks again.")
    if not {"labels", "confidence"} <= set(arrays):
        raise GagaError(f"{path} is damaged. Associate the masks again.")
    labels = arrays["labels"].astype(np.int32)
    confidence = arrays["confidence"].astype(np.float32)
    if labels.shape != (n_gaussians,) or confidence.shape != (n_gaussians,):
        raise GagaError(
            f"{path} is for {len(labels)} Gaussians, the model has {n_gaussians}. "
            "Associate the masks again."
        )
    return labels, confidence


def splat_groups(
    rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera, labels: IntArray
) -> IntArray:
    """Group ids (H, W) of a view: the label of greatest summed blending weight at each pixel.

    Label 0 competes like a group, so unlabelled splats hide what is behind them. A pixel whose
    winner weighs less than `VOID_BELOW` shows background and is 0.
    """
    frame: LabelFrame = rasterizer.label_splat(gaussians, camera, labels)
    return np.where(frame.confidence < VOID_BELOW, np.int32(0), frame.labels)


def _depth_thousandths(rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera) -> IntArray:
    channels = np.zeros((len(gaussians), 1), np.float32)
    depth = rasterizer.render(gaussians, camera, channels=channels).expected_depth
    result: IntArray = np.minimum(np.rint(depth * 1000.0), 65535).astype(np.int32)
    return result


def _write_pseudo_labels(
    folder: Path, cameras: Sequence[Camera], masks: MaskSet, association: Association
) -> Stage[None]:
    """One PNG a view: its masks with their groups' ids."""
    folder.mkdir()
    views = [camera for camera in cameras if camera.name in association.mask_groups]
    for i, camera in enumerate(views):
        labels, _ = load_labels(masks, camera)
        groups = associated_labels(labels, association.mask_groups[camera.name])
        write_labels(folder / f"{Path(camera.name).stem}.png", groups)
        yield Progress("Write label maps", i + 1, len(views), camera.name)


def with_entry(path: Path, key: str, value: dict[str, object]) -> str:
    """The text of report.json with one entry replaced; an unreadable report starts anew."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        report = {}
    if not isinstance(report, dict):
        report = {}
    return json.dumps({**report, key: value}, indent=2) + "\n"
