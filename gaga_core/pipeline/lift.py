"""The stage that lifts groups to identity encodings (section 3.3): SCENE/gaga/identity.npz."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import load_bank, read_groups
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.grouping.views import load_labels, views_with_masks
from gaga_core.grouping.votes import VOID_BELOW, LabelMap, splat_groups
from gaga_core.identity.closed_form import VoteConfig, Voted, vote_identity
from gaga_core.identity.field import (
    Identity,
    IdentityField,
    decode_view,
    load_identity,
    save_identity,
)
from gaga_core.identity.fit import FitConfig, Fitted, fit_identity
from gaga_core.identity.paper import PaperConfig, train_identity
from gaga_core.identity.refine import RefineConfig, refine_identity
from gaga_core.io.masks import mask_folder, write_labels
from gaga_core.io.scene_folder import SceneFolder, read_model, select_views, with_entry
from gaga_core.io.staging import publish_all, staging_folder
from gaga_core.pipeline.render import paint_views
from gaga_core.progress import Stage
from gaga_core.raster import choose
from gaga_core.raster.base import Rasterizer

Mode = Literal["vote", "refine", "paper"]
FILE = "identity.npz"
CHECKPOINT = "identity.checkpoint.npz"  # of an unfinished run of mode "paper"
_AGAIN = "Associate the masks again."


@dataclass(frozen=True)
class LiftConfig:
    """Settings of all modes; a mode reads its own."""

    vote: VoteConfig = field(default_factory=VoteConfig)
    fit: FitConfig = field(default_factory=FitConfig)  # on top of the vote, also before refining
    refine: RefineConfig = field(default_factory=RefineConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    pseudo: Literal["masks", "bank"] = "masks"  # labels to train on: masks, or the splatted bank

    def __post_init__(self) -> None:
        if self.pseudo not in ("masks", "bank"):
            raise ValueError(f"pseudo: {self.pseudo!r} is neither 'masks' nor 'bank'")


@dataclass(frozen=True)
class LiftFigures:
    """What a mode counted and measured; None where it has no such figure."""

    from_bank: int | None = None  # Gaussians labelled by the memory bank alone
    from_neighbours: int | None = None  # Gaussians that no view shows, labelled by neighbours
    max_cosine: float | None = None  # of the two closest codes
    sweeps: int | None = None  # of the fit to the vote; 0 = the vote was not improved
    rows: int | None = None  # sampled pixels fitted to or trained on
    steps: int | None = None
    best_step: int | None = None  # refine: 0 = the vote was not improved
    resumed_at: int | None = None  # paper: step that the run went on from
    accuracy_before: float | None = None  # right pixels, held out
    accuracy: float | None = None  # vote, refine: held out; paper: of the last views trained on
    loss_before: float | None = None  # refine: nats, held out; paper: over ln(classes)
    loss: float | None = None


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


@dataclass(frozen=True, eq=False)
class _Task:
    gaussians: Gaussians
    cameras: tuple[Camera, ...]  # training views with label maps
    labels: IntArray  # (N,) of the association
    confidence: FloatArray  # (N,)
    bank: MemoryBank
    label_map: LabelMap
    rasterizer: Rasterizer
    config: LiftConfig
    checkpoint: Path


def lift_scene(
    folder: SceneFolder,
    mode: Mode = "vote",
    config: LiftConfig | None = None,
    *,
    gaussians: Gaussians | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[LiftReport]:
    """Encode the groups of an associated scene; write identity.npz and the report's entry "lift".

    Mode "vote" is votes and least squares, "refine" trains that a little, "paper" from zeros. The
    result appears whole or not at all. A run of "paper" that is stopped leaves a checkpoint next
    to it (and nothing else), from which the next run with the same settings goes on.
    """
    if mode not in get_args(Mode):
        raise GagaError(f"There is no mode {mode!r}. Choose one of {', '.join(get_args(Mode))}.")
    config = config or LiftConfig()
    if gaussians is None:
        gaussians = yield from read_model(folder)
    task = _task(folder, gaussians, rasterizer or choose(), config)
    start = time.perf_counter()
    identity, figures = yield from _run(mode, task)
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
    if mode == "paper":
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


def render_identity(
    folder: SceneFolder,
    out: Path | None = None,
    *,
    views: str | Sequence[str] = "test",
    gaussians: Gaussians | None = None,
    rasterizer: Rasterizer | None = None,
) -> Stage[tuple[Path, ...]]:
    """Write the groups that the rendered encodings decode to: one uint16 <stem>.png a view.

    Ids are those of `render.render_views` with "groups", 0 = none. ``out`` is
    ``folder.work / "renders" / "identity"`` unless given. Raises ``GagaError`` without a lift.
    """
    cameras = select_views(folder, views)
    if gaussians is None:
        gaussians = yield from read_model(folder)
    model, engine = gaussians, rasterizer or choose()
    field = read_identity(folder, len(model)).field

    def paint(path: Path, camera: Camera) -> None:
        write_labels(path, decode_groups(engine, model, camera, field))

    target = out or folder.work / "renders" / "identity"
    return (yield from paint_views(cameras, target, "identity", paint))


def _task(
    folder: SceneFolder, gaussians: Gaussians, rasterizer: Rasterizer, config: LiftConfig
) -> _Task:
    labels, confidence = read_groups(folder, len(gaussians))
    if not (folder.work / "bank.npz").is_file() or not (folder.work / "masks").is_dir():
        raise GagaError(f"{folder.work} lacks the memory bank or its label maps. {_AGAIN}")
    bank = load_bank(folder.work / "bank.npz")
    if len(bank.group) != len(gaussians) or labels.max(initial=0) > bank.n_groups:
        raise GagaError(f"{folder.work / 'bank.npz'} does not fit the labels. {_AGAIN}")
    cameras = select_views(folder, "train")
    known = [camera.name for camera in folder.cameras]
    masks = mask_folder(folder.work / "masks", [camera.name for camera in cameras], known)

    def of_masks(camera: Camera) -> IntArray:
        groups = load_labels(masks, camera)[0]
        if groups.max() > bank.n_groups:
            raise GagaError(f"The label map of {camera.name} names unknown groups. {_AGAIN}")
        return groups

    owners = np.maximum(bank.group, 0)

    def of_bank(camera: Camera) -> IntArray:
        return splat_groups(rasterizer, gaussians, camera, owners)

    return _Task(
        gaussians=gaussians,
        cameras=views_with_masks(cameras, masks),
        labels=labels,
        confidence=confidence,
        bank=bank,
        label_map=of_bank if config.pseudo == "bank" else of_masks,
        rasterizer=rasterizer,
        config=config,
        checkpoint=folder.work / CHECKPOINT,
    )


def _run(mode: Mode, task: _Task) -> Stage[tuple[Identity, LiftFigures]]:
    if mode == "vote":
        voted = yield from _vote(task)
        return voted.closed.identity, _vote_figures(voted)
    if mode == "refine":
        return (yield from _refine(task))
    return (yield from _paper(task))


def _vote(task: _Task) -> Stage[Fitted]:
    closed = yield from vote_identity(
        task.gaussians,
        Voted(task.labels, task.confidence),
        task.bank.group,
        task.bank.n_groups,
        task.cameras,
        task.rasterizer,
        task.config.vote,
    )
    return (
        yield from fit_identity(
            task.gaussians, closed, task.cameras, task.label_map, task.rasterizer, task.config.fit
        )
    )


def _vote_figures(voted: Fitted) -> LiftFigures:
    closed = voted.closed
    return LiftFigures(
        from_bank=closed.n_from_bank,
        from_neighbours=closed.n_from_neighbours,
        max_cosine=closed.max_cosine,
        sweeps=voted.sweeps,
        accuracy_before=voted.before,
        accuracy=voted.after,
        rows=voted.n_rows,
    )


def _refine(task: _Task) -> Stage[tuple[Identity, LiftFigures]]:
    voted = yield from _vote(task)
    refined = yield from refine_identity(
        task.gaussians,
        voted.closed,
        task.cameras,
        task.label_map,
        task.rasterizer,
        task.config.refine,
    )
    figures = replace(
        _vote_figures(voted),
        rows=refined.n_rows,
        steps=refined.steps,
        best_step=refined.best_step,
        accuracy_before=refined.before.accuracy,
        accuracy=refined.after.accuracy,
        loss_before=refined.before.loss,
        loss=refined.after.loss,
    )
    return refined.identity, figures


def _paper(task: _Task) -> Stage[tuple[Identity, LiftFigures]]:
    trained = yield from train_identity(
        task.gaussians,
        task.bank.n_groups,
        task.cameras,
        task.label_map,
        task.rasterizer,
        task.config.paper,
        checkpoint=task.checkpoint,
    )
    figures = LiftFigures(
        rows=trained.n_rows,
        steps=trained.steps,
        resumed_at=trained.resumed_at,
        accuracy=trained.accuracy,
        loss_before=trained.first_loss,
        loss=trained.last_loss,
    )
    return trained.identity, figures
