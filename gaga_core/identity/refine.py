"""Mode "refine": a few training steps from the closed form, kept only if held-out views agree.

Each step takes a share of the cached rows of all training views. One view in eight is held out; the
encodings with the most right pixels there win, the closed form (step 0) included.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.closed_form import ClosedForm
from gaga_core.identity.field import Identity, LiftFigures
from gaga_core.identity.rows import Batch, RowConfig, ViewRows, held_out, mixed_batches, sample_rows
from gaga_core.identity.training_step import (
    Fit,
    IdentityGradients,
    IdentityRates,
    Training,
    adam_step,
    batch_of_step,
    cross_entropy,
)
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer


@dataclass(frozen=True)
class RefineConfig:
    """Settings of mode "refine"."""

    steps: int = 60  # at most
    check_every: int = 5  # steps between two evaluations of the held-out views
    patience: int = 4  # evaluations without a gain before it stops
    rates: IdentityRates = field(default_factory=IdentityRates)
    rows: RowConfig = field(default_factory=RowConfig)

    def __post_init__(self) -> None:
        if not 1 <= self.steps <= 100:
            raise ValueError("steps: must lie in 1..100; longer training fits the masks' noise")
        if self.check_every < 1 or self.patience < 1:
            raise ValueError("check_every and patience: must be positive")


def refine_identity(
    gaussians: Gaussians,
    start: ClosedForm,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    rasterizer: Rasterizer,
    config: RefineConfig | None = None,
) -> Stage[tuple[Identity, LiftFigures]]:
    """Improve ``start`` on the masks of ``cameras``; never worse than it on the held-out rows.

    Gaussians that no row touches keep their code. The confidence of a Gaussian whose label changes
    is what the vote left for other labels. Deterministic.
    """
    config = config or RefineConfig()
    views = yield from sample_rows(gaussians, cameras, label_map, rasterizer, config.rows)
    n_rows = sum(len(view.labels) for view in views)
    batches, tests = _split(views, len(gaussians))
    training = Training.of(start.identity.field)
    gradients = IdentityGradients.zeros(training)
    before = best = _fit(training, tests)
    best_field, best_step, since = start.identity.field, 0, 0
    while training.step < config.steps and since < config.patience:
        batch = batches[batch_of_step(training.step, len(batches), config.rows.seed)]
        gradients.clear()
        cross_entropy(training, batch, gradients)
        adam_step(training, gradients, config.rates)
        message = f"{100 * best.accuracy:.2f} % of held-out pixels right"
        yield Progress("Refine identities", training.step, config.steps, message)
        if training.step % config.check_every and training.step < config.steps:
            continue
        fit = _fit(training, tests)
        since += 1
        if fit.accuracy > best.accuracy:
            best, best_field, best_step, since = fit, training.field(), training.step, 0
    labels, probability = best_field.classify(best_field.encodings)
    voted = start.identity
    left = np.minimum(probability, 1 - voted.confidence)
    sure = np.where(labels == voted.labels, voted.confidence, left).astype(np.float32)
    figures = LiftFigures(
        rows=n_rows,
        steps=training.step,
        best_step=best_step,
        accuracy_before=before.accuracy,
        accuracy=best.accuracy,
        loss_before=before.loss,
        loss=best.loss,
    )
    return Identity(best_field, labels, sure, "refine"), figures


def _split(views: list[ViewRows], n_gaussians: int) -> tuple[list[Batch], list[Batch]]:
    """Training batches of mixed rows, and the held-out ones; a lone view is both."""
    held = held_out(len(views))
    kept = [view for i, view in enumerate(views) if i not in held]
    tested = [view for i, view in enumerate(views) if i in held]
    views.clear()
    batches = mixed_batches(kept or tested, n_gaussians)
    return batches, mixed_batches(tested, n_gaussians)


def _fit(training: Training, batches: Sequence[Batch]) -> Fit:
    fits = [cross_entropy(training, batch) for batch in batches]
    sizes = [len(batch.labels) for batch in batches]
    return Fit(
        float(np.average([fit.loss for fit in fits], weights=sizes)),
        float(np.average([fit.accuracy for fit in fits], weights=sizes)),
    )
