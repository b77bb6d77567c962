"""Settings of a comparison and of a benchmark, as the command gives them. This module is light."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

from gaga_core.errors import GagaError
from gaga_core.pipeline.settings import GroupSettings, IdentitySettings, ReconstructConfig

Lift = Literal["paper", "refine", "vote", "none"]
Preset = Literal["robust", "paper", "released"]
SAMPLE = 16384  # pixels of a view that a training step takes where not all are


def how_labelled(preset: str, lift: Lift, of: IdentitySettings) -> str:
    """How what is scored was labelled, for names of rows: every departure from the preset."""
    if lift == "none":
        return "groups" if preset == "robust" else "labels by vote"
    words = [f"identities by {lift}"]
    if lift == "paper":
        pixels = SAMPLE if of.pixels is None and preset == "robust" else of.pixels
        words += [f"{pixels:,} pixels a view"] if pixels else []
        words += [f"{of.lift_iterations:,} steps"] if of.lift_iterations is not None else []
    words += [f"pseudo labels {of.pseudo}"] if of.pseudo is not None else []
    words += [f"void {of.void}"] if of.void is not None else []
    return ", ".join(words)


def changes_of(groups: GroupSettings) -> str:
    """Settings of an association that are not the preset's, for names of rows; "" if none."""
    given = {name: value for name, value in vars(groups).items() if value is not None}
    return ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in given.items())


@dataclass(frozen=True)
class FindConfig:
    """Who answers: a detector in the first view, else an index of pictures, else words alone."""

    detector: Path | None = None  # folder of a Grounding DINO or OWLv2 model
    embedder: Path | None = None  # folder of a CLIP or SigLIP model
    segmenter: str | None = None  # name or folder of a Segment Anything model, for masks in boxes

    def __post_init__(self) -> None:
        if self.segmenter is not None and self.detector is None:
            raise GagaError("Masks in boxes need a detector that finds the boxes. Name one, too.")


@dataclass(frozen=True)
class BenchmarkConfig:
    """What is run over every scene."""

    preset: Preset = "robust"
    """robust: groups by the consensus of all views. paper: the paper's text. released: its released
    code."""
    lift: Lift | None = None
    """How the groups become the identities whose maps are scored (see gaga lift --mode); none: the
    groups themselves. Default: vote with preset robust, else paper (10,000 iterations)."""
    masks: str | None = None
    """Name of the mask folder in every scene (masks/NAME, raw_sam_mask, ...); default: the only
    one, or the weights-free regions where there is none."""
    shares: tuple[float, ...] = ()
    """Of the train views, in addition to all of them."""
    seed: int = 0
    """Of the choice of those views."""
    find: FindConfig = field(default_factory=FindConfig)
    """Who answers text prompts."""
    pred: Path | None = None
    """Score the predictions of this folder (<scene>/<view>.png, or <scene>/<view>/<prompt>.png)
    and run nothing."""
    redo: bool = False
    """Run again what is finished."""
    train: ReconstructConfig = field(default_factory=lambda: ReconstructConfig(quality="standard"))
    """Of splats that are missing."""
    retrain_sparse: bool = False
    """Train splats on each of those choices of views; default: use those of all training views."""
    groups: GroupSettings = field(default_factory=GroupSettings)
    """Changes of the preset's association, such as its threshold."""
    identities: IdentitySettings = field(default_factory=IdentitySettings)
    """Changes of the preset's identities."""

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
        return self.lift or ("vote" if self.preset == "robust" else "paper")

    @property
    def title(self) -> str:
        """What is scored, for tables."""
        if self.pred is not None:
            return "given predictions"
        how = how_labelled(self.preset, self.lifted_by, self.identities)
        return ", ".join(filter(None, (self.preset, changes_of(self.groups), how)))

    def runs(self) -> tuple[float, ...]:
        """The share of the train views in every run, all of them first."""
        return (1.0, *sorted(set(self.shares), reverse=True))


# --- One scene by all variants.

RowLift = Literal["none", "preset", "vote", "refine", "paper"]  # of rows that have a memory bank
TITLES: Mapping[str, str] = {
    "robust": "robust",
    "paper": "paper",
    "released": "released",
    "paper-sam2": "paper, masks of SAM 2",
    "all-gaussians": "memory bank, all Gaussians",
    "tracker": "overlap tracker",
    "sam2": "SAM 2 tracks",
    "chained": "chained 3D IoU",
    "lifting": "linear assignment (Panoptic Lifting)",
    "none": "no association",
    "gaussian-grouping": "Gaussian Grouping, given tracks",
    "per-frame": "masks of each test view, matched (upper bound)",
    "rendered": "masks of each rendered test view, matched (upper bound)",
    "true-masks": "same masks, true association (upper bound)",
    "true-maps": "true masks (upper bound)",
}
# The paper with one setting changed, as its ablations do: overlap threshold, inlier factor
# f, depth of a pixel, order of the views.
ABLATIONS: Mapping[str, GroupSettings] = {
    **{
        f"threshold {value:g}": GroupSettings(threshold=value)
        for value in (0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
    },
    **{f"f = {value:g}": GroupSettings(inlier_factor=value) for value in (0.0, 0.5, 1.0, 1.5, 2.0)},
    "median depth": GroupSettings(depth="median"),
    "no depth": GroupSettings(depth="none"),
    "widest views first": GroupSettings(order="coverage"),
}
THRESHOLDS = tuple(name for name in ABLATIONS if name.startswith("threshold"))


@dataclass(frozen=True)
class CompareConfig:
    """What is compared."""

    variants: tuple[str, ...] = tuple(TITLES)
    """Names of rows, such as robust, paper, tracker, "threshold 0.2", "f = 0"; default: presets,
    baselines and bounds, then the sparse rows."""
    sparse: tuple[str, ...] = ("robust", "paper")  # variants of the sparse-view protocol
    shares: tuple[float, ...] = (0.30, 0.20, 0.10, 0.05)  # of the train views, as published
    seeds: tuple[int, ...] = (0,)
    """Draws of the training views for the sparse rows."""
    lift: RowLift | None = None
    """Score identities of the rows that have a memory bank, in this mode (see gaga lift); none:
    their labels by vote. preset: vote for robust, else paper (10,000 steps a row), also for
    baselines. Default: preset; none where rows are ablations, which change the association alone.
    """
    identities: IdentitySettings = field(default_factory=IdentitySettings)
    """Changes of the presets' identities. Training takes `SAMPLE` pixels of a view unless another
    number is given, as a table of all pixels would take a day; names of rows say so."""
    sam2_masks: str = ""
    """Folder of masks of SAM 2 in the scene, for the row "paper-sam2"."""
    tracks: str = "object_mask"
    """Folder of masks with one id per object in all views, for the row "gaussian-grouping"."""
    bound_by: str = ""
    """Provider that makes masks of rendered test views, for the row "rendered" (gaga masks)."""
    lifting_iterations: int = 10_000
    """Training steps of the row "lifting" (linear assignment as Panoptic Lifting does it)."""
    video_model: Path | None = None  # folder of a SAM 2 video model, for variant "sam2"

    def __post_init__(self) -> None:
        known = (*TITLES, *ABLATIONS)
        unknown = [v for v in (*self.variants, *self.sparse) if v not in known]
        if unknown:
            text = f"There is no variant {unknown[0]!r}. Choose among {', '.join(known)}."
            raise GagaError(text)
        if self.lift is not None and self.lift not in get_args(RowLift):
            lifts = ", ".join(get_args(RowLift))
            raise GagaError(f"There is no lift {self.lift!r}. Choose {lifts}.")
        if {"per-frame", "rendered"} & set(self.sparse):
            raise GagaError("The per-frame bound uses no train views. Leave it out of sparse.")

    @property
    def lifted_by(self) -> RowLift:
        """What is scored of rows with a memory bank: as asked for; else identities as the presets
        have them, but groups where ablations are among the rows: they change the association alone.
        """
        ablates = any(variant in ABLATIONS for variant in self.variants)
        return self.lift or ("none" if ablates else "preset")

    def lift_of(self, preset: str) -> Lift:
        """How the groups of a preset, or of a baseline as if it were the preset paper's, become
        identities."""
        if self.lifted_by == "preset":
            return "vote" if preset == "robust" else "paper"
        return self.lifted_by

    @property
    def trained(self) -> IdentitySettings:
        """Changes of the presets' identities, with the number of pixels."""
        pixels = SAMPLE if self.identities.pixels is None else self.identities.pixels
        return replace(self.identities, pixels=pixels)

    def runs(self) -> list[tuple[str, float, int]]:
        """(variant, share, seed) of every run, in order."""
        whole = [(variant, 1.0, 0) for variant in self.variants]
        sparse = [(v, share, s) for v in self.sparse for share in self.shares for s in self.seeds]
        return whole + sparse
