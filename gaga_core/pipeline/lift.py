"""The stage that lifts groups to identity encodings (section 3.3): SCENE/gaga/identity.npz."""

import time
from dataclasses import asdict, dataclass
from typing import get_args

from gaga_core.arrays import IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import load_bank, read_groups
from gaga_core.grouping.views import load_labels, views_as_masked
from gaga_core.grouping.votes import VOID_BELOW
from gaga_core.identity.field import (
    FILE,
    Identity,
    IdentityField,
    LiftFigures,
    decode_view,
    load_identity,
    save_identity,
)
from gaga_core.identity.lift import (
    LiftConfig,
    LiftTask,
    Mode,
    lift_groups,
    mode_of_preset,
    pseudo_labels,
)
from gaga_core.identity.train import FILE as CHECKPOINT
from gaga_core.io.folder.scene_folder import SceneFolder, read_model, select_views, with_entry
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.pipeline.settings import IdentitySettings
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer

_AGAIN = "Associate the masks again."


@dataclass(frozen=True)
class LiftReport:
    """Outcome of a lift."""

    mode: str
    file: str
    gaussians: int
    groups: int
    labelled: int  # Gaussians with a group
    mean_confidence: float  # of those
    seconds: float
    figures: LiftFigures

    def to_json(self) -> dict[str, object]:
        """All figures that this mode has, in one level."""
        values = asdict(self)
        figures = values.pop("figures")
        return values | {name: v for name, v in figures.items() if v is not None}


def lift_scene(
    folder: SceneFolder,
    mode: Mode | None = None,
    config: LiftConfig | IdentitySettings | None = None,
    *,
    gaussians: Gaussians | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[LiftReport]:
    """Encode the groups of an associated scene; write identity.npz and the report's entry "lift".

    Mode "vote" is votes and least squares, "refine" trains that a little, "paper" from zeros; None
    is the mode of the preset that made the groups (`identity.lift.mode_of_preset`). Settings change
    those of that preset; a `LiftConfig` is taken as it is. The result
    appears whole or not at all. A run of "paper" that is stopped leaves a checkpoint next to it
    (and nothing else), from which the next run with the same settings goes on.
    """
    if mode is not None and mode not in get_args(Mode):
        raise GagaError(f"There is no mode {mode!r}. Choose one of {', '.join(get_args(Mode))}.")
    if gaussians is None:
        gaussians = yield from read_model(folder)
    task, mode = _task(folder, gaussians, rasterizer or choose(), config, mode)
    start, config = time.perf_counter(), task.config
    identity, figures = yield from lift_groups(task, mode)
    labelled = identity.labels > 0
    path = folder.work / FILE
    report = LiftReport(
        mode=mode,
        file=str(path),
        gaussians=len(gaussians),
        groups=identity.field.n_groups,
        labelled=int(labelled.sum()),
        mean_confidence=float(identity.confidence[labelled].mean()) if labelled.any() else 0.0,
        seconds=round(time.perf_counter() - start, 3),
        figures=figures,
    )
    settings = asdict(getattr(config, mode))
    if mode != "paper":
        settings["fit"] = asdict(config.fit)
    entry = report.to_json() | {"config": settings}
    with staging_folder(folder.work) as staging:
        save_identity(staging / path.name, identity)
        text = with_entry(folder.work / "report.json", "lift", entry)
        (staging / "report.json").write_text(text, encoding="utf-8")
        publish_all(staging, [path.name, "report.json"], folder.work)
    if mode == "paper" and task.checkpoint is not None:
        task.checkpoint.unlink(missing_ok=True)
    return report


def read_identity(folder: SceneFolder, n_gaussians: int) -> Identity:
    """What `lift_scene` left; ``GagaError`` when there is nothing, or it does not fit the model."""
    path = folder.work / FILE
    if not path.is_file():
        raise GagaError(f"There are no identities in {folder.work} yet. Lift the groups first.")
    identity = load_identity(path)
    if len(identity.labels) != n_gaussians:
        raise GagaError(
            f"{path} is for {len(identity.labels)} Gaussians, the model has {n_gaussians}. "
            "Lift the groups again."
        )
    return identity


def decode_groups(
    rasterizer: Rasterizer, gaussians: Gaussians, camera: Camera, field: IdentityField
) -> IntArray:
    """Group ids (H, W) of a view as the identity encodings say; 0 where little is drawn."""
    return decode_view(field, gaussians, camera, rasterizer, void_below=VOID_BELOW).labels


def _task(
    folder: SceneFolder,
    gaussians: Gaussians,
    rasterizer: Rasterizer,
    config: LiftConfig | IdentitySettings | None,
    mode: Mode | None,
) -> tuple[LiftTask, Mode]:
    """What is to be lifted, and how."""
    labels, confidence = read_groups(folder, len(gaussians))
    if not (folder.work / "bank.npz").is_file() or not (folder.work / "masks").is_dir():
        raise GagaError(f"{folder.work} lacks the memory bank or its label maps. {_AGAIN}")
    bank = load_bank(folder.work / "bank.npz")
    if len(bank.group) != len(gaussians) or labels.max(initial=0) > bank.n_groups:
        raise GagaError(f"{folder.work / 'bank.npz'} does not fit the labels. {_AGAIN}")
    mode = mode or mode_of_preset(bank.preset)
    if not isinstance(config, LiftConfig):
        config = (config or IdentitySettings()).config(bank.preset, mode)
    cameras = select_views(folder, "train")
    known = [camera.name for camera in folder.cameras]
    masks = mask_folder(folder.work / "masks", [camera.name for camera in cameras], known)

    def of_masks(camera: Camera) -> IntArray:
        groups = load_labels(masks, camera)[0]
        if groups.max() > bank.n_groups:
            raise GagaError(f"The label map of {camera.name} names unknown groups. {_AGAIN}")
        return groups

    task = LiftTask(
        gaussians=gaussians,
        cameras=views_as_masked(cameras, masks, bank.preset),
        labels=labels,
        confidence=confidence,
        bank=bank,
        label_map=pseudo_labels(config.pseudo, of_masks, gaussians, bank, rasterizer),
        rasterizer=rasterizer,
        config=config,
        checkpoint=folder.work / CHECKPOINT,
    )
    return task, mode
