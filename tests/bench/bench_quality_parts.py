"""Quality of the presets, both with identities, on scenes of 150 objects of parts (`parts`).

Five seeds, mean and standard deviation; settings were chosen on seeds 36 and 37. Each variant is
associated from the masks, lifted in closed form, and decoded in views that took no part; Algorithm
1, void left out:

* paper, vote: the bank of section 3.2, identities in closed form;
* robust, vote: the preset;
* same masks, true groups: each mask under the object that it shows most of, what no association of
  these masks can beat by much;
* true labels: the true object of every Gaussian.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaga_core.arrays import IntArray
from gaga_core.evaluate.baselines import Inputs, label_gaussians, true_masks
from gaga_core.evaluate.group_scores import Score, score_pairs
from gaga_core.grouping.associate import AssociateConfig, associate_stage
from gaga_core.identity.field import IdentityField
from gaga_core.identity.lift import Mode, lift_groups, task_of_association
from gaga_core.masks import MaskSet
from gaga_core.pipeline.lift import decode_groups
from gaga_core.progress import run_stage
from gaga_core.raster import choose
from tests.bench.figures import Figure
from tests.bench.known_scenes import held_out_score
from tools.scenes.parts import parts_scene
from tools.scenes.rooms import Bench

SEEDS = (31, 32, 33, 34, 35)
KEYS = ("iou", "precision", "recall")


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over the seeds, in points."""

    mean: float
    deviation: float

    @staticmethod
    def of(scores: Sequence[Score], key: str) -> "Spread":
        """Of one figure of several scores."""
        values = [100 * float(getattr(score, key)) for score in scores]
        return Spread(float(np.mean(values)), float(np.std(values)))


def figures() -> list[Figure]:
    """Every variant's scores with their spread, and what robust gains over paper."""
    found = measured(SEEDS)
    rows = []
    for name, scores in found.items():
        for key in KEYS:
            spread = Spread.of(scores, key)
            rows.append(Figure(f"parts: {name}, {key}", spread.mean, "points"))
            rows.append(Figure(f"parts: {name}, {key}, spread", spread.deviation, "points"))
    for key in KEYS:
        gains = [
            100 * (getattr(ours, key) - getattr(theirs, key))
            for ours, theirs in zip(found["robust, vote"], found["paper, vote"], strict=True)
        ]
        worst = min(gains)
        rows.append(Figure(f"parts: robust over paper, {key}", float(np.mean(gains)), "points"))
        rows.append(Figure(f"parts: robust over paper, {key}, worst seed", worst, "points", ">= 0"))
    ours, truth = (Spread.of(found[name], "iou").mean for name in ("robust, vote", "true labels"))
    share = ours / truth
    rows.append(Figure("parts: robust, IoU as a share of true labels'", share, "", ">= 0.95"))
    return rows


def measured(seeds: Sequence[int]) -> dict[str, list[Score]]:
    """The scores of every variant, one a seed."""
    found: dict[str, list[Score]] = {name: [] for name in VARIANTS}
    for seed in seeds:
        bench = parts_scene(seed)
        for name, variant in VARIANTS.items():
            found[name].append(variant(bench))
    return found


def with_identities(bench: Bench, preset: str, mode: Mode = "vote") -> Score:
    """The preset, lifted in this mode, decoded from splatted encodings."""
    engine = choose("cpu")
    config = AssociateConfig.of(preset)
    found = run_stage(associate_stage(bench.gaussians, bench.train, bench.masks, engine, config))
    grouping = found.labels, found.confidence, found.bank
    task = task_of_association(bench.gaussians, bench.train, bench.masks, grouping, engine)
    identity, _ = run_stage(lift_groups(task, mode))
    return decoded(bench, identity.field)


def decoded(bench: Bench, field: IdentityField) -> Score:
    """Algorithm 1 on the held-out views, as the encodings say."""
    engine = choose("cpu")
    shown = (decode_groups(engine, bench.gaussians, camera, field) for camera in bench.test)
    truth = (bench.truth[camera.name] for camera in bench.test)
    return score_pairs(zip(truth, shown, strict=True))[1]


def with_true_groups(bench: Bench) -> Score:
    """The same masks under true groups, by vote."""
    engine = choose("cpu")
    loaders = {name: partial(bench.truth.__getitem__, name) for name in bench.truth}
    truth = MaskSet(loaders, "truth")
    inputs = Inputs.of(bench.gaussians, bench.train, bench.masks, engine)
    groups = run_stage(true_masks(inputs, truth))
    return splatted(bench, run_stage(label_gaussians(inputs, groups)))


def splatted(bench: Bench, labels: IntArray) -> Score:
    """Algorithm 1 on the held-out views, as labels (N,) of the Gaussians say."""
    return held_out_score(bench.gaussians, labels, bench.test, bench.truth)


VARIANTS: Mapping[str, Callable[[Bench], Score]] = {
    "paper, vote": lambda bench: with_identities(bench, "paper"),
    "robust, vote": lambda bench: with_identities(bench, "robust"),
    "same masks, true groups": with_true_groups,
    "true labels": lambda bench: splatted(bench, bench.labels),
}
