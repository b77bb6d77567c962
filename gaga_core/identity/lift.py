"""From groups to identity encodings (section 3.3) in one of three modes, on values in memory."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.bank_file import bank_digest
from gaga_core.grouping.memory_bank import MemoryBank, Preset, groups_of_masks
from gaga_core.grouping.views import load_labels, views_as_masked
from gaga_core.grouping.votes import LabelMap, associated_labels, splat_groups
from gaga_core.identity.closed_form import STAGE as FITS
from gaga_core.identity.closed_form import (
    FitConfig,
    Fitted,
    VoteConfig,
    Voted,
    fit_identity,
    vote_identity,
)
from gaga_core.identity.field import Identity, LiftFigures
from gaga_core.identity.rows import STAGE as SAMPLES
from gaga_core.identity.rows import RowConfig
from gaga_core.identity.train import (
    REFINES,
    PaperConfig,
    RefineConfig,
    refine_identity,
    train_identity,
)
from gaga_core.identity.train import STAGE as TRAINS
from gaga_core.identity.training_step import IdentityRates
from gaga_core.masks import MaskSet
from gaga_core.progress import Progress, Stage, joined, mapped
from gaga_core.raster.base import Rasterizer

Mode = Literal["vote", "refine", "paper"]
STAGE = "Lift groups"
_SAMPLES_MORE = "Sample more pixels"
# Seconds of the steps on the demo scene (120,565 splats, 40 views of 640x480), two cores. Only what
# they are in parts of each other counts.
_STEP_S = {SAMPLES: 2.8, FITS: 1.2, _SAMPLES_MORE: 7.9, REFINES: 1.7}
_STEPS: dict[Mode, tuple[str, ...]] = {
    "vote": (SAMPLES, FITS),
    "refine": (SAMPLES, FITS, _SAMPLES_MORE, REFINES),
    "paper": (SAMPLES,),
}
_ITERATION_S = 0.035  # of a training from zeros, there
Pseudo = Literal["masks", "bank"]


def mode_of_preset(preset: Preset) -> Mode:
    """How groups of a preset become identities unless something else is asked for.

    Presets paper and released train them as published (section 3.3); robust votes, which takes
    seconds.
    """
    return "vote" if preset == "robust" else "paper"


@dataclass(frozen=True)
class LiftConfig:
    """Settings of all modes; a mode reads its own."""

    vote: VoteConfig = field(default_factory=VoteConfig)
    fit: FitConfig = field(default_factory=FitConfig)  # on top of the vote, also before refining
    refine: RefineConfig = field(default_factory=RefineConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)
    pseudo: Pseudo = "masks"  # labels to train on: masks, or the splatted bank

    def __post_init__(self) -> None:
        if self.pseudo not in ("masks", "bank"):
            raise ValueError(f"pseudo: {self.pseudo!r} is neither 'masks' nor 'bank'")

    @staticmethod
    def of(preset: str, mode: Mode = "paper") -> "LiftConfig":
        """The settings of a preset where it trains. paper: section 3.3, all pixels of the splatted
        bank, classes are the groups. released: all pixels of the masks, void is class 0. The preset
        robust, and modes that do not train from zeros: masks, a sample of their pixels."""
        if preset == "robust" or mode != "paper":
            return LiftConfig()
        is_released = preset == "released"
        rows = RowConfig(per_view=0, w_min=0.0, train_void=is_released)
        rates = IdentityRates(layer_epsilon=1e-8)
        paper = PaperConfig(rates=rates, rows=rows, has_none=is_released)
        return LiftConfig(paper=paper, pseudo="masks" if is_released else "bank")


@dataclass(frozen=True, eq=False)
class LiftTask:
    """Input of every mode: groups of Gaussians, and the views that they came from."""

    gaussians: Gaussians
    cameras: tuple[Camera, ...]  # training views with label maps
    labels: IntArray  # (N,) of the association
    confidence: FloatArray  # (N,) 0..1
    bank: MemoryBank
    label_map: LabelMap  # pseudo labels of a view
    rasterizer: Rasterizer
    config: LiftConfig
    checkpoint: Path | None = None  # of mode "paper"


def pseudo_labels(
    kind: Pseudo,
    of_masks: LabelMap,
    gaussians: Gaussians,
    bank: MemoryBank,
    rasterizer: Rasterizer,
) -> LabelMap:
    """Labels to train on: masks with their groups' ids (figure 2 of the paper, the published code),
    or the bank's groups splatted into the view (the paper's text, section 3.3)."""
    owners = np.maximum(bank.group, 0)

    def of_bank(camera: Camera) -> IntArray:
        return splat_groups(rasterizer, gaussians, camera, owners)

    return of_bank if kind == "bank" else of_masks


def task_of_association(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    masks: MaskSet,
    grouping: tuple[IntArray, FloatArray, MemoryBank],
    rasterizer: Rasterizer,
    config: LiftConfig | None = None,
    *,
    checkpoint: Path | None = None,
) -> LiftTask:
    """What an association in memory gives to be lifted.

    ``masks`` are those that were associated, with the segmenter's own ids; ``grouping`` holds
    labels (N,), their confidence (N,) in 0..1, and the bank whose log says which group each mask
    joined. Raises ``GagaError`` when there are no groups or no view has masks.
    """
    labels, confidence, bank = grouping
    config = config or LiftConfig()
    if bank.n_groups == 0 or len(bank.group) != len(gaussians):
        raise GagaError("There are no groups of this model to lift. Find objects first.")
    views = views_as_masked(cameras, masks, bank.preset)
    groups: Mapping[str, IntArray] = groups_of_masks(bank, [camera.name for camera in views])

    def of_masks(camera: Camera) -> IntArray:
        return associated_labels(load_labels(masks, camera)[0], groups[camera.name])

    return LiftTask(
        gaussians=gaussians,
        cameras=views,
        labels=np.where(labels <= bank.n_groups, labels, 0).astype(np.int32),
        confidence=confidence,
        bank=bank,
        label_map=pseudo_labels(config.pseudo, of_masks, gaussians, bank, rasterizer),
        rasterizer=rasterizer,
        config=config,
        checkpoint=checkpoint,
    )


def lift_groups(task: LiftTask, mode: Mode) -> Stage[tuple[Identity, LiftFigures]]:
    """Encode groups: "vote" in closed form, "refine" trains that a little, "paper" from zeros.

    The identity names the bank that its groups are of (`Identity.bank`). Tells one share of all
    steps.
    """
    runs: Mapping[Mode, Callable[[LiftTask], Stage[tuple[Identity, LiftFigures]]]] = {
        "vote": _voted,
        "refine": _refine,
        "paper": _paper,
    }
    seconds = {step: _STEP_S[step] for step in _STEPS[mode]}
    if mode == "paper":
        seconds[TRAINS] = _ITERATION_S * task.config.paper.iterations
    identity, figures = yield from joined(runs[mode](task), STAGE, seconds)
    return replace(identity, bank=bank_digest(task.bank)), figures


def _voted(task: LiftTask) -> Stage[tuple[Identity, LiftFigures]]:
    voted = yield from _vote(task)
    return voted.closed.identity, _vote_figures(voted)


def _vote(task: LiftTask) -> Stage[Fitted]:
    config, voted = task.config, Voted(task.labels, task.confidence)
    bank, views = task.bank, task.cameras
    closed = yield from vote_identity(
        task.gaussians, voted, bank.group, bank.n_groups, views, task.rasterizer, config.vote
    )
    fit = fit_identity(task.gaussians, closed, views, task.label_map, task.rasterizer, config.fit)
    return (yield from fit)


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


def _refine(task: LiftTask) -> Stage[tuple[Identity, LiftFigures]]:
    voted = yield from _vote(task)
    views, config = task.cameras, task.config.refine
    refined = refine_identity(
        task.gaussians, voted.closed, views, task.label_map, task.rasterizer, config
    )
    identity, figures = yield from mapped(refined, _as_more)
    of_vote = _vote_figures(voted)
    kept = ("from_bank", "from_neighbours", "max_cosine", "sweeps")
    return identity, replace(figures, **{name: getattr(of_vote, name) for name in kept})


def _as_more(step: Progress) -> Progress:
    """The second sampling as a step of its own: it does not begin the first one again."""
    return replace(step, stage=_SAMPLES_MORE) if step.stage == SAMPLES else step


def _paper(task: LiftTask) -> Stage[tuple[Identity, LiftFigures]]:
    return train_identity(
        task.gaussians,
        task.bank.n_groups,
        task.cameras,
        task.label_map,
        task.rasterizer,
        task.config.paper,
        checkpoint=task.checkpoint,
    )
