"""Mode "paper": identity encodings trained from zeros (section 3.3 and supplement).

Cross-entropy over ln(K) on splatted encodings, a view a step, views in random order without
replacement; every fifth step the 3D regulariser of Gaussian Grouping over cached nearest
neighbours; Adam; 10k iterations of which, as in the published code, the last takes no step.

The geometry is frozen, so F = W E: rows of W are cached instead of rasterizing every step. With
``rows.per_view = 0`` and ``rows.w_min = 0`` a step does the arithmetic of one that rasterizes its
view, as published (`identity.lift.LiftConfig.of`); by default it takes 16k stratified pixels of the
view, drawn once, without the smallest weights. The regulariser's neighbours are those among all
Gaussians (published: among 200k random ones).

Mode "refine": a few training steps from the closed form, kept only if held-out views agree.

Each step takes a share of the cached rows of all training views. One view in eight is held out; the
encodings with the most right pixels there win, the closed form (step 0) included.
"""

import hashlib
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.closed_form import ClosedForm
from gaga_core.identity.field import Identity, LiftFigures
from gaga_core.identity.linear_kernels import D
from gaga_core.identity.rows import (
    BYTES_PER_ENTRY,
    Batch,
    LinearRows,
    RowConfig,
    ViewRows,
    WholeViews,
    held_out,
    mixed_batches,
    sample_rows,
    view_batches,
    whole_views,
)
from gaga_core.identity.training_step import (
    Fit,
    IdentityGradients,
    IdentityRates,
    Training,
    adam_step,
    agreement,
    batch_of_step,
    cross_entropy,
    nearest,
    start_from_zeros,
)
from gaga_core.io.arrays_file import TEXT, Column, damage, read_columns
from gaga_core.io.files import atomic_write
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer

# --- A training run on disk: what it takes to go on as if it had never stopped.


_NEVER = np.float32(-1e9)  # bias of a class that no softmax takes part in
_VALUES = ("encodings", "weight", "bias")
_MOMENTS = tuple(f"{kind}_{name}" for name in _VALUES for kind in ("mean", "square"))

FILE = "identity.checkpoint.npz"  # of an unfinished run of mode "paper", in the work folder


def digest_of(batches: Sequence[Batch], settings: str) -> str:
    """Digest of the data that a run trains on and of its settings: equal only for the same run."""
    digest = hashlib.sha256(settings.encode())
    for batch in batches:
        weights = batch.rows.by_pixel
        for array in (batch.labels, weights.indices, weights.weights, weights.indptr):
            digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def save_checkpoint(path: Path, training: Training, digest: str) -> None:
    """Write the state of a run; ``GagaError`` when the place cannot be written."""
    arrays: dict[str, AnyArray] = {name: getattr(training, name) for name in _VALUES}
    arrays |= dict(zip(_MOMENTS, training.moments, strict=True))
    arrays |= {"step": np.array(training.step), "digest": np.array(digest)}
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


def load_checkpoint(path: Path, digest: str, n_gaussians: int, n_groups: int) -> Training | None:
    """The state of the run with this ``digest``; None when the file is of another run.

    Raises ``GagaError`` when the file is damaged.
    """
    cure = "Remove it to train from the start."
    if str(read_columns(path, cure, {"digest": TEXT})["digest"]) != digest:
        return None
    shapes = (n_gaussians, D), (n_groups + 1, D), (n_groups + 1,)
    columns = {"step": Column(np.int64, low=0)}
    for name, shape in zip(_VALUES, shapes, strict=True):
        kinds = (name, f"mean_{name}", f"square_{name}")
        columns |= {kind: Column(np.float32, shape) for kind in kinds}
    arrays = read_columns(path, cure, columns)
    with damage(path, cure):
        values, moments = ([arrays[name] for name in names] for names in (_VALUES, _MOMENTS))
        return Training(values[0], values[1], values[2], tuple(moments), int(arrays["step"]))


STAGE, REFINES = "Train identities", "Refine identities"


@dataclass(frozen=True)
class PaperConfig:
    """Settings of mode "paper": those of the released code but for the sample of pixels."""

    iterations: int = 10_000
    rates: IdentityRates = field(default_factory=IdentityRates)
    reg_every: int = 5  # iterations between two uses of the 3D regulariser; 0 = never
    reg_factor: float = 2.0  # lambda
    reg_samples: int = 1000  # Gaussians of one use
    reg_neighbours: int = 5  # of each, itself included
    rows: RowConfig = field(default_factory=RowConfig)
    has_none: bool = True  # class 0, "none", is one of the softmax; False: groups alone
    checkpoint_every: int = 1000  # iterations

    def __post_init__(self) -> None:
        if self.iterations < 2 or self.checkpoint_every < 1:
            raise ValueError("iterations: at least 2; checkpoint_every: at least 1")
        if self.reg_every < 0 or self.reg_samples < 1 or self.reg_neighbours < 1:
            raise ValueError("reg_every, reg_samples, reg_neighbours: too small")
        if self.rows.train_void and not self.has_none:
            raise ValueError("train_void: needs the class 0")


@dataclass(frozen=True)
class TimeEstimate:
    """Estimated time of a run; the payload of the first progress, before anything is trained."""

    seconds: float
    seconds_per_step: float


def train_identity(
    gaussians: Gaussians,
    n_groups: int,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    rasterizer: Rasterizer,
    config: PaperConfig | None = None,
    *,
    checkpoint: Path | None = None,
) -> Stage[tuple[Identity, LiftFigures]]:
    """Train encodings and layer on the pseudo labels ``label_map`` of ``cameras``.

    The first progress carries a `TimeEstimate`, measured on one view. With ``checkpoint`` the state
    is saved there now and then and when the run is cancelled; a run with the same data and settings
    goes on from it and ends as one that was never stopped (``iterations`` may differ). The file is
    the caller's to remove once the result is safe.
    Labels are the argmax of the layer on each Gaussian's own encoding, confidence its softmax.
    """
    config = config or PaperConfig()
    run = yield from _prepare(gaussians, n_groups, cameras, label_map, rasterizer, config)
    training = start_from_zeros(len(gaussians), n_groups, config.rows.seed)
    if not config.has_none:
        training.bias[0] = _NEVER
    if checkpoint is not None and checkpoint.is_file():
        found = load_checkpoint(checkpoint, run.digest, len(gaussians), n_groups)
        training = training if found is None else found
    resumed_at = training.step
    fits: list[Fit] = []
    try:
        yield from _train(training, run, config, checkpoint, fits)
    except GeneratorExit:  # the stage is closed in the middle
        if checkpoint is not None and training.step:
            save_checkpoint(checkpoint, training, run.digest)
        raise
    few = max(1, min(len(run.batches), len(fits)))
    nothing = [Fit(math.nan, math.nan)]
    first, last = fits[:few] or nothing, fits[-few:] or nothing
    field = training.field()
    figures = LiftFigures(
        rows=run.n_rows,
        steps=training.step,
        resumed_at=resumed_at,
        accuracy=float(np.mean([fit.accuracy for fit in last])),
        loss_before=float(np.mean([fit.loss for fit in first])),
        loss=float(np.mean([fit.loss for fit in last])),
    )
    return Identity(field, *field.classify(field.encodings), "paper"), figures


@dataclass(frozen=True, eq=False)
class _Run:
    """Constants of a training."""

    batches: Sequence[Batch]  # one a view
    near: IntArray  # (N, k) nearest neighbours, itself first
    digest: str
    n_rows: int  # of all batches


def _prepare(
    gaussians: Gaussians,
    n_groups: int,
    cameras: Sequence[Camera],
    label_map: LabelMap,
    rasterizer: Rasterizer,
    config: PaperConfig,
) -> Stage[_Run]:
    """Cached rows and neighbours; the estimate comes after the first view."""
    is_whole = config.rows.per_view == 0
    sampling: Stage[WholeViews | list[ViewRows]] = (whole_views if is_whole else sample_rows)(
        gaussians, cameras, label_map, rasterizer, config.rows
    )
    start, estimated = time.perf_counter(), False
    while True:
        try:
            progress = next(sampling)
        except StopIteration as end:
            views: WholeViews | list[ViewRows] = end.value
            break
        if not estimated and isinstance(progress.payload, ViewRows):
            estimated = True
            sampling_time = (time.perf_counter() - start) * len(cameras) / progress.done
            estimate = _estimate(progress.payload, len(gaussians), n_groups, config, sampling_time)
            if is_whole:
                per_view = BYTES_PER_ENTRY * len(progress.payload.weights.indices)
                kept = min(1.0, config.rows.memory_bytes / max(per_view * len(cameras), 1))
                per_step = estimate.seconds_per_step + (1 - kept) * sampling_time / len(cameras)
                estimate = TimeEstimate(config.iterations * per_step, per_step)
            message = f"about {max(1, round(estimate.seconds / 60))} min"
            yield replace(progress, message=message, payload=estimate)
        yield Progress(progress.stage, progress.done, progress.total, progress.message)
    settings = replace(config, iterations=2, checkpoint_every=1)
    text = f"{asdict(settings)} {n_groups}"
    batches: Sequence[Batch]
    if isinstance(views, WholeViews):
        batches, n_rows, digest = views, views.n_rows, f"{views.digest} {text}"
        digest = hashlib.sha256(digest.encode()).hexdigest()
    else:
        batches = view_batches(views, len(gaussians))
        n_rows, digest = sum(len(batch.labels) for batch in batches), digest_of(batches, text)
    near = np.zeros((0, 1), np.int32)
    if config.reg_every:
        near = yield from nearest(gaussians.means, config.reg_neighbours)
    return _Run(batches, near, digest, n_rows)


def _estimate(
    view: ViewRows, n_gaussians: int, n_groups: int, config: PaperConfig, sampling: float
) -> TimeEstimate:
    """Time of a few steps on the first view, thrown away."""
    batch = Batch(LinearRows.of(view.weights, n_gaussians), view.labels)
    training = start_from_zeros(n_gaussians, n_groups, config.rows.seed)
    gradients = IdentityGradients.zeros(training)
    # Any Gaussians will do as neighbours: the arithmetic is the same.
    size = (min(config.reg_samples, n_gaussians), config.reg_neighbours)
    near = np.random.default_rng(0).integers(0, n_gaussians, size).astype(np.int32)
    _step(training, batch, gradients, config, None)  # the first one compiles
    plain: list[float] = []
    regular: list[float] = []
    for times, sample in ((plain, None), (plain, None), (plain, None), (regular, near)):
        start = time.perf_counter()
        _step(training, batch, gradients, config, sample)
        times.append(time.perf_counter() - start)
    per_step = statistics.median(plain)
    if config.reg_every:
        per_step += max(0.0, regular[0] - per_step) / config.reg_every
    return TimeEstimate(sampling + config.iterations * per_step, per_step)


def _train(
    training: Training,
    run: _Run,
    config: PaperConfig,
    checkpoint: Path | None,
    fits: list[Fit],  # appended to
) -> Stage[None]:
    gradients = IdentityGradients.zeros(training)
    while training.step < config.iterations - 1:
        step = training.step
        fit = _step(
            training,
            run.batches[batch_of_step(step, len(run.batches), config.rows.seed)],
            gradients,
            config,
            _sample(run.near, step, config),
        )
        fits.append(fit)
        message = f"loss {fit.loss:.3f}, {100 * fit.accuracy:.1f} % of pixels right"
        yield Progress(STAGE, step + 1, config.iterations, message)
        if checkpoint is not None and training.step % config.checkpoint_every == 0:
            save_checkpoint(checkpoint, training, run.digest)


def _sample(near: IntArray, step: int, config: PaperConfig) -> IntArray | None:
    """Neighbours of the Gaussians sampled in this step; None when it has no regulariser."""
    if config.reg_every == 0 or step % config.reg_every:
        return None
    rng = np.random.default_rng([config.rows.seed, 3, step])
    n = min(config.reg_samples, len(near))
    return near[rng.choice(len(near), n, replace=False, shuffle=False)]


def _step(
    training: Training,
    batch: Batch,
    gradients: IdentityGradients,
    config: PaperConfig,
    near: IntArray | None,
) -> Fit:
    """One iteration; the loss returned is cross-entropy / ln K."""
    n_classes = len(training.weight) - (not config.has_none)
    scale = 1 / math.log(max(n_classes, 2))
    gradients.clear()
    fit = cross_entropy(training, batch, gradients, scale)
    if near is not None:
        # The loss is divided by the number of classes, of which `agreement` counts class 0.
        factor = config.reg_factor * len(training.weight) / max(n_classes, 1)
        agreement(training, near, factor, gradients)
    adam_step(training, gradients, config.rates)
    return Fit(fit.loss * scale, fit.accuracy)


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
        yield Progress(REFINES, training.step, config.steps, message)
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
