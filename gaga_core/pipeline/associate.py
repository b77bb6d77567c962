"""Association as a stage over a scene folder: what the command and the window run.

Results are built in a hidden folder next to their place and moved there at the end, so a stage that
is cancelled or fails leaves the scene folder as it was.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.bank_file import save_bank
from gaga_core.grouping.views import load_labels
from gaga_core.grouping.votes import associated_labels
from gaga_core.io.masks import mask_folder, view_key, write_labels
from gaga_core.io.scene_folder import (
    SceneFolder,
    mask_path_of,
    read_model,
    select_views,
    with_entry,
)
from gaga_core.io.staging import publish_all, staging_folder
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer


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
    known = [camera.name for camera in folder.cameras]
    mask_set = mask_folder(mask_path, [camera.name for camera in cameras], known)
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
        publish_all(staging, ["masks", "bank.npz", "labels.npz", "report.json"], folder.work)
    return association


def _write_pseudo_labels(
    folder: Path, cameras: Sequence[Camera], masks: MaskSet, association: Association
) -> Stage[None]:
    """One PNG a view: its masks with their groups' ids."""
    folder.mkdir()
    views = [camera for camera in cameras if camera.name in association.mask_groups]
    for i, camera in enumerate(views):
        labels, _ = load_labels(masks, camera)
        groups = associated_labels(labels, association.mask_groups[camera.name])
        write_labels(folder / f"{view_key(camera.name)}.png", groups)
        yield Progress("Write label maps", i + 1, len(views), camera.name)
