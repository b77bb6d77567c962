"""Association as a stage over a scene folder: what the command and the window run.

Results are built in a hidden folder next to their place and moved there at the end, so a stage that
is cancelled or fails leaves the scene folder as it was.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.add_views import FormerGroups, add_views_stage
from gaga_core.grouping.associate import AssociateConfig, Association, associate_stage
from gaga_core.grouping.bank_file import load_bank, read_groups, read_labels, save_bank
from gaga_core.grouping.memory_bank import Preset, ids_of_first_view
from gaga_core.grouping.views import load_labels
from gaga_core.grouping.votes import associated_labels
from gaga_core.io.folder.scene_folder import (
    AssociateEntry,
    SceneFolder,
    mask_path_of,
    read_model,
    read_report_entry,
    select_views,
    with_entry,
)
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.masks.label_maps import mask_folder, view_key, write_labels
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
    adds: bool = False,
) -> Stage[Association]:
    """Associate the masks of the train views and write the result into ``folder.work``.

    ``adds``: only views that are not in the saved bank, which joins them (`add_views_stage`), by
    its own preset (`saved_preset`). Raises ``GagaError`` when the bank is of another preset or of
    other masks.

    ``masks`` is a provider's name, a folder of label maps, or None for the only provider there is.
    ``gaussians`` saves reading the model again. Written: bank.npz, labels.npz (labels, confidence,
    weight of all votes), masks/<stem>.png (uint16 group ids of the train views) and the entry
    "associate" of report.json.
    """
    config = config or AssociateConfig()
    mask_path = mask_path_of(folder, masks)
    cameras = select_views(folder, "train")
    known = [camera.name for camera in folder.cameras]
    mask_set = mask_folder(mask_path, [camera.name for camera in cameras], known)
    config = with_silhouettes(config, folder, mask_set)
    if gaussians is None:
        gaussians = yield from read_model(folder)
    start = time.perf_counter()
    engine = rasterizer or choose()
    if adds:
        former = _read_former(folder, len(gaussians), mask_path)
        if config.preset != former.bank.preset:
            raise GagaError(
                f"These groups were made with the preset {former.bank.preset}. Choose it."
            )
        stage = add_views_stage(gaussians, cameras, mask_set, former, engine, config)
    else:
        stage = associate_stage(gaussians, cameras, mask_set, engine, config)
    association = yield from stage
    summary = association.to_json() | {
        "first_view": {str(g): m for g, m in ids_of_first_view(association.bank).items()},
        "mask_folder": _recorded(folder, mask_path),
        "config": asdict(config),
        "seconds": round(time.perf_counter() - start, 3),
    }
    with staging_folder(folder.work) as staging:
        save_bank(staging / "bank.npz", association.bank)
        arrays = {"labels": association.labels, "confidence": association.confidence}
        if association.weight is not None:
            arrays["weight"] = association.weight
        np.savez_compressed(staging / "labels.npz", **arrays)  # type: ignore[arg-type]
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


def with_silhouettes(
    config: AssociateConfig, folder: SceneFolder, masks: MaskSet
) -> AssociateConfig:
    """The same; where the background was left out and no model made the masks, those of the
    coarsest level are silhouettes of objects."""
    if not (masks.are_regions and config.hierarchy is not None and folder.foreground):
        return config
    return replace(config, hierarchy=replace(config.hierarchy, silhouettes=True))


def saved_preset(folder: SceneFolder) -> Preset:
    """The preset that made the groups of the scene; ``GagaError`` when there are none."""
    path = folder.work / "bank.npz"
    if not path.is_file():
        raise GagaError(f"There are no groups in {folder.work} yet. Associate the masks first.")
    return load_bank(path).preset


def views_to_add(folder: SceneFolder) -> tuple[str, ...]:
    """Train views whose masks took no part in the saved groups and can join them.

    Masks count that lie next to those that the groups were made of. None where there are no groups,
    or such as nothing joins: groups with levels of detail are made of all views at once.
    """
    bank_path, labels_path = folder.work / "bank.npz", folder.work / "labels.npz"
    masks = associated_masks(folder)
    if masks is None or not (bank_path.is_file() and labels_path.is_file()):
        return ()
    drawn = folder.work / "masks"  # a label map of every view that took part
    new = [name for name in folder.train if not (drawn / f"{view_key(name)}.png").is_file()]
    mask_set = mask_folder(masks, new, [camera.name for camera in folder.cameras])
    if len(mask_set) == 0 or mask_set.are_regions:
        return ()
    bank = load_bank(bank_path)
    if bank.levels is not None or "weight" not in read_labels(labels_path, len(bank.group)):
        return ()
    known = {decision.view for decision in bank.log}
    return tuple(
        name
        for name in new
        if name in mask_set and name not in known and mask_set.loaders[name]().any()
    )


def associated_masks(folder: SceneFolder) -> Path | None:
    """The folder of masks that the groups were made of; None when it is not known or gone."""
    entry = read_report_entry(folder.work / "report.json", "associate", AssociateEntry)
    if entry is None or not entry.mask_folder:
        return None
    made_of = folder.root / entry.mask_folder
    # By name where it is gone: older reports hold the whole path of a scene that may have moved.
    is_there = os.path.isdir  # False also of names that are too long to be one
    found = made_of if is_there(made_of) else folder.mask_folders.get(made_of.name, made_of)
    return found if is_there(found) else None


def are_associated(folder: SceneFolder, masks: Path | None) -> bool:
    """Whether the groups were made of the masks in the folder ``masks``."""
    made_of = associated_masks(folder)
    return made_of is not None and masks is not None and made_of.resolve() == masks.resolve()


def _recorded(folder: SceneFolder, mask_path: Path) -> str:
    """How a report names a folder of masks: from the scene folder on, so that both may move."""
    root, path = folder.root.resolve(), mask_path.resolve()
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else str(path)


def _read_former(folder: SceneFolder, n_gaussians: int, mask_path: Path) -> FormerGroups:
    """Bank and labels of the last association, to add views to; ``GagaError`` when they are not
    there, do not fit, are of other masks, or were saved without the weight of their votes."""
    entry = read_report_entry(folder.work / "report.json", "associate", AssociateEntry)
    if entry is not None and entry.mask_folder and not are_associated(folder, mask_path):
        raise GagaError(
            f"These groups were made from the masks in {entry.mask_folder}. Choose those, or "
            "associate without --add."
        )
    labels, confidence = read_groups(folder, n_gaussians)
    bank = load_bank(folder.work / "bank.npz", N=n_gaussians)
    weight = read_labels(folder.work / "labels.npz", n_gaussians).get("weight")
    if weight is None:
        raise GagaError(
            "These groups were saved without the weight of their votes. Associate once more "
            "without --add."
        )
    return FormerGroups(bank, labels, confidence, weight)
