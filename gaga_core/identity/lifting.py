"""Panoptic Lifting's way to consistent labels: linear assignment inside the training.

Masks of a view have ids of their own. In every step the masks of one view are assigned one-to-one
to the classes of the layer so that their mean probability is greatest (Hungarian algorithm), and
the cross-entropy is taken with these labels (Siddiqui et al., CVPR 2023, section 3.3). Nothing else
ties the views to one another. The paper's ablation calls it linear assignment.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix

from gaga_core.arrays import FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.field import Identity, IdentityField
from gaga_core.identity.rows import Batch, RowConfig, sample_rows, view_batches
from gaga_core.identity.training import (
    IdentityGradients,
    IdentityRates,
    Training,
    adam_step,
    batch_of_step,
    cross_entropy,
    start_from_zeros,
)
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer

STAGE = "Linear assignment"


@dataclass(frozen=True)
class LiftingConfig:
    """Settings of the training; those of the paper's identity training where both have one."""

    iterations: int = 10_000
    slots: float = 2.0  # classes, x the masks of the view that has most
    rates: IdentityRates = field(default_factory=IdentityRates)
    rows: RowConfig = field(default_factory=RowConfig)

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.slots < 1:
            raise ValueError("iterations, slots: must be at least 1")


def lift_by_assignment(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    label_map: LabelMap,  # ids of each view's own masks, 0 = none
    rasterizer: Rasterizer,
    config: LiftingConfig | None = None,
) -> Stage[Identity]:
    """Train encodings on masks whose ids do not agree between views.

    Labels are the argmax of the layer on each Gaussian's own encoding. Raises ``GagaError`` when no
    view has masks.
    """
    config = config or LiftingConfig()
    views = yield from sample_rows(gaussians, cameras, label_map, rasterizer, config.rows)
    batches = view_batches(views, len(gaussians))
    most = max(len(np.unique(batch.labels)) for batch in batches)
    training = start_from_zeros(len(gaussians), round(config.slots * most), config.rows.seed)
    gradients = IdentityGradients.zeros(training)
    for step in range(config.iterations):
        batch = batches[batch_of_step(step, len(batches), config.rows.seed)]
        matched = replace(batch, labels=assigned(training, batch))
        gradients.clear()
        fit = cross_entropy(training, matched, gradients)
        adam_step(training, gradients, config.rates)
        message = f"{100 * fit.accuracy:.1f} % of pixels right"
        yield Progress(STAGE, step + 1, config.iterations, message)
    found = training.field()
    labels, confidence = found.classify(found.encodings)
    return Identity(found, labels, confidence, "lifting")


def assigned(training: Training, batch: Batch) -> IntArray:
    """The class (P,) of each pixel's mask: masks and classes 1..K are paired one-to-one so that
    the sum of the masks' mean probabilities is greatest."""
    ids, place = np.unique(batch.labels, return_inverse=True)
    of_mask = mean_probabilities(training.field(), batch, place, len(ids))
    of_mask[:, 0] = -1.0  # class 0 is "none"
    if ids[0] == 0:  # trained as "none" where void takes part
        of_mask[0] = -1.0
        of_mask[0, 0] = 2.0
    return _paired(of_mask)[place]


def mean_probabilities(
    found: IdentityField, batch: Batch, place: LongArray, n_masks: int
) -> FloatArray:
    """Mean over each mask's pixels of the probability of each class: (M, K + 1)."""
    chance = found.probabilities(batch.rows.multiply(found.encodings))
    n_pixels = np.bincount(place, minlength=n_masks)
    share = (1 / n_pixels[place]).astype(np.float32)
    of_mask = csr_matrix((share, (place, np.arange(len(place)))), (n_masks, len(place)))
    mean: FloatArray = of_mask @ chance
    return mean


def _paired(value: FloatArray) -> IntArray:
    """The column of each row under the one-to-one pairing of greatest sum."""
    from scipy.optimize import linear_sum_assignment

    rows, columns = linear_sum_assignment(value, maximize=True)
    found = np.zeros(len(value), np.int32)
    found[rows] = columns
    return found
