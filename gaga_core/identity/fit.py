"""Least squares on top of the vote: encodings whose splatted mixtures decode best, labels kept.

A vote gives each Gaussian the label of most of its pixels, as if it were alone in them. Pixels are
mixtures: at an object's outline a few faint splats of the object stand before the table's, and
codes of equal length let the table win. The encodings E that fit the label maps best minimise
|W E - s C[label]|^2 over cached rows of W (s: the row's sum, C: the code book). SIRT (Gilbert 1972)
approaches that minimum from the vote, normalised by row and column sums: there is no step size to
choose, and a sweep is one product with W and one with W^T.

Left alone, the fit would label hidden Gaussians by their last scrap of weight. So each encoding is
taken back until its own label is what the vote said: selecting an object gives the same Gaussians,
and pictures of encodings get their outlines right. Masks that are wrong at random are better not
fitted closely: one view in eight is held out, and of 0, 1, 2, 4, ... sweeps those are taken whose
pictures have the most right pixels there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.closed_form import ClosedForm
from gaga_core.identity.field import IdentityField
from gaga_core.identity.linear_kernels import keep_labels
from gaga_core.identity.rows import Batch, RowConfig, held_out, sample_rows, view_batches
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.threads import run_chunks

STAGE = "Fit encodings"
_CHUNK = 4096  # Gaussians of one piece of work
_TINY = np.float32(1e-6)  # under any kept weight: sums that small are those of nothing


@dataclass(frozen=True)
class FitConfig:
    """Settings of the least-squares fit."""

    sweeps: int = 16  # at most; 0 = the bare vote
    margin: float = 0.05  # least lead of a Gaussian's own label, in scores of unit codes
    rows: RowConfig = field(default_factory=RowConfig)

    def __post_init__(self) -> None:
        if self.sweeps < 0 or not 0 < self.margin < 1:
            raise ValueError("sweeps: must not be negative; margin: must lie between 0 and 1")


@dataclass(frozen=True, eq=False)
class Fitted:
    """Result of the fit."""

    closed: ClosedForm  # the vote's, with the fitted encodings
    n_rows: int  # cached
    sweeps: int  # taken; 0: the vote was not improved
    before: float  # share of right pixels held out, of the vote
    after: float


def fit_identity(
    gaussians: Gaussians,
    start: ClosedForm,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    rasterizer: Rasterizer,
    config: FitConfig | None = None,
) -> Stage[Fitted]:
    """Fit the encodings of ``start`` to the label maps of ``cameras``; all labels stay.

    Never worse than the vote on the held-out rows. Gaussians that no labelled pixel shows keep
    their code. Deterministic. Raises ``GagaError`` when no pixel is labelled.
    """
    config = config or FitConfig()
    if config.sweeps == 0:
        return Fitted(start, 0, 0, 0.0, 0.0)
    sampled = yield from sample_rows(gaussians, cameras, label_map, rasterizer, config.rows)
    batches = view_batches(sampled, len(gaussians))
    held = held_out(len(batches))
    tests = [batches[i] for i in held]
    kept = [batch for i, batch in enumerate(batches) if i not in held] or tests
    field = best_field = start.identity.field
    before = best = _accuracy(field, tests)
    best_sweep = 0
    # SIRT from the codes of the labels: what rows lack, divided by their sums, goes back to the
    # Gaussians, divided by the sums of their columns.
    codes, labels = np.ascontiguousarray(start.codes), np.ascontiguousarray(start.identity.labels)
    encodings = np.ascontiguousarray(codes[labels])
    sums, columns = [], np.zeros(len(encodings), np.float64)
    for batch in kept:
        weights = batch.rows.by_pixel
        columns += np.bincount(weights.indices, weights.weights, len(encodings))
        owner = np.repeat(np.arange(len(batch.rows)), np.diff(weights.indptr))
        of_rows = np.bincount(owner, weights.weights, len(batch.rows)).astype(np.float32)
        sums.append(of_rows[:, None])
    shares = [(1 / np.maximum(of_rows, _TINY)).astype(np.float32) for of_rows in sums]
    scale = (1 / np.maximum(columns, _TINY)).astype(np.float32)[:, None]
    step, back = np.empty_like(encodings), np.empty_like(encodings)
    total = config.sweeps * len(kept)
    for sweep in range(1, config.sweeps + 1):
        step[:] = 0
        for i, batch in enumerate(kept):
            yield Progress(STAGE, (sweep - 1) * len(kept) + i, total)
            rows = batch.rows
            residual = sums[i] * codes[batch.labels] - rows.multiply(encodings)
            rows.multiply_transposed(shares[i] * residual, back)
            step[rows.touched] += back[rows.touched]
        step *= scale
        encodings += step
        if sweep & (sweep - 1) == 0 or sweep == config.sweeps:  # after 1, 2, 4, ... sweeps
            field = replace(field, encodings=encodings.copy())
            leads = partial(keep_labels, field.encodings, codes, labels, config.margin)
            run_chunks(leads, len(encodings), _CHUNK)
            accuracy = _accuracy(field, tests)
            if accuracy > best:
                best, best_field, best_sweep = accuracy, field, sweep
            yield Progress(STAGE, sweep * len(kept), total, f"sweep {sweep}")
    return Fitted(
        closed=replace(start, identity=replace(start.identity, field=best_field)),
        n_rows=sum(len(batch.labels) for batch in batches),
        sweeps=best_sweep,
        before=before,
        after=best,
    )


def _accuracy(field: IdentityField, batches: Sequence[Batch]) -> float:
    """Share of rows whose splatted encoding decodes to their label."""
    hits = [
        (field.classify(b.rows.multiply(field.encodings))[0] == b.labels).sum() for b in batches
    ]
    return float(sum(hits) / sum(len(batch.labels) for batch in batches))
