"""Settings of a benchmark, as the command gives them. This module is light."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from gaga_core.errors import GagaError
from gaga_core.pipeline.settings import ReconstructConfig

Lift = Literal["paper", "refine", "vote", "none"]
Preset = Literal["robust", "paper"]


@dataclass(frozen=True)
class FindConfig:
    """Answer by a detector in the first view, else an index of pictures, else words alone."""

    detector: Path | None = None  # folder of a Grounding DINO or OWLv2 model
    embedder: Path | None = None  # folder of a CLIP or SigLIP model
    segmenter: str | None = None  # name or folder of a Segment Anything model, for masks in boxes

    def __post_init__(self) -> None:
        if self.segmenter is not None and self.detector is None:
            raise GagaError("Masks in boxes need a detector that finds the boxes. Name one, too.")


@dataclass(frozen=True)
class BenchmarkConfig:
    """Settings of the runs over every scene."""

    preset: Preset = "robust"
    """robust: groups by the consensus of all views. paper: the published method to the letter."""
    lift: Lift | None = None
    """How the groups become the identities whose maps are scored (see gaga lift --mode); none: the
    groups themselves. Default: paper (10,000 iterations) with preset paper, vote with robust."""
    masks: str | None = None
    """Name of the mask folder in every scene (masks/NAME, raw_sam_mask, ...); default: the only
    one, or the weights-free regions where there is none."""
    shares: tuple[float, ...] = ()
    """Of the train views, in addition to all of them."""
    seed: int = 0
    """Of the choice of those views."""
    find: FindConfig = field(default_factory=FindConfig)
    """The method that answers text prompts."""
    pred: Path | None = None
    """Score the predictions of this folder (<scene>/<view>.png, or <scene>/<view>/<prompt>.png)
    and run nothing."""
    redo: bool = False
    """Run again what is finished."""
    train: ReconstructConfig = field(default_factory=lambda: ReconstructConfig(quality="standard"))
    """Of splats that are missing."""
    retrain_sparse: bool = False
    """Train splats on each of those choices of views; default: use those of all training views."""

    def __post_init__(self) -> None:
        for name, kind in (("preset", Preset), ("lift", Lift)):
            value = getattr(self, name)
            if value is not None and value not in get_args(kind):
                known = ", ".join(get_args(kind))
                raise GagaError(f"There is no {name} {value!r}. Choose {known}.")
        for share in self.shares:
            if not 0 < share < 1:
                raise GagaError(f"{share:.4g} is no share of the views. Choose one in (0, 1).")
        if self.pred is not None and self.shares:
            raise GagaError("Given predictions have no train views. Leave the shares of them out.")
        if self.retrain_sparse and not self.shares:
            raise GagaError(
                "--retrain-sparse needs --sparse: which shares of the views to train on."
            )

    @property
    def lifted_by(self) -> Lift:
        """How identities are made from the groups: as asked for, else as the preset has it."""
        return self.lift or ("paper" if self.preset == "paper" else "vote")

    @property
    def title(self) -> str:
        """The scored predictions, for tables."""
        if self.pred is not None:
            return "given predictions"
        kind = self.lifted_by
        return f"{self.preset}, " + ("groups" if kind == "none" else f"identities by {kind}")

    def runs(self) -> tuple[float, ...]:
        """The share of the train views in every run, all of them first."""
        return (1.0, *sorted(set(self.shares), reverse=True))
