"""Mode "vote": identity encodings in closed form, without training.

The label that the associated masks vote for is the least-squares optimum of the splatted label map
(see `votes`); a code book turns labels into encodings and a layer that decode to them exactly.
Least squares then adjust the encodings so that splatted mixtures decode best; labels are kept.

A vote gives each Gaussian the label of most of its pixels, as if it were alone in them. Pixels are
mixtures: at an object's outline a few faint splats of the object stand before the table's, and
codes of equal length let the table win. The encodings E that fit the label maps best minimise
|W E - s C[label]|^2 over cached rows of W (s: the row's sum, C: the code book). SIRT (Gilbert 1972)
approaches that minimum from the vote, normalised by row and column sums: there is no step size to
choose, and a sweep is one product with W and one with W^T.

The rows of all views are one operator, so that each Gaussian is asked once in a sweep.

Left alone, the fit would label hidden Gaussians by their last scrap of weight. So each encoding is
taken back until its own label is what the vote said: selecting an object gives the same Gaussians,
and pictures of encodings get their outlines right. Masks that are wrong at random are better not
fitted closely: one view in eight is held out, and of 0, 1, 2, 4, ... sweeps those are taken whose
pictures have the most right pixels there. The first of these with fewer of them is the last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray, check_shape
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.grouping.votes import LabelMap
from gaga_core.identity.field import Identity, IdentityField
from gaga_core.identity.linear_kernels import D, keep_labels, repulsion
from gaga_core.identity.rows import Batch, RowConfig, held_out, joined_batch, sample_rows
from gaga_core.identity.training_step import majority, nearest
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.threads import run_chunks

# --- A code for each group: unit vectors of R^16, as far apart as possible.
# Encodings that are their group's code, with the codes as the classifier, decode to the group by
# one inner product: the closed form of the paper's identity encoding, without training.


_WORK = 200_000_000  # pairs of codes to compare, all steps together: seconds for any G
_MOST_STEPS, _LEAST_STEPS = 300, 20
_FIRST_SHARPNESS, _LAST_SHARPNESS = 4.0, 60.0


@dataclass(frozen=True, eq=False)
class CodeBook:
    """Codes of the groups 0 (none) to G."""

    codes: FloatArray  # (G + 1, D) unit length
    max_cosine: float  # of the two codes that are closest to each other

    def encodings(self, labels: IntArray) -> FloatArray:
        """The code (N, D) of each label (N,) in 0..G."""
        check_shape("labels", labels, ("N",), np.int32)
        return self.codes[labels]


def code_book(n_groups: int, *, seed: int = 0) -> CodeBook:
    """Codes for ``n_groups`` groups and for "none", by repulsion from a random start.

    Each step moves every code away from the others, weighted by exp(sharpness * cosine); as the
    sharpness grows, only the nearest ones count. Same ``seed``, same codes.
    """
    if n_groups < 0:
        raise ValueError(f"n_groups: {n_groups} is negative")
    K = n_groups + 1
    codes = _unit(np.random.default_rng(seed).normal(size=(K, D)).astype(np.float32))
    if K == 1:
        return CodeBook(codes, -1.0)
    best, best_cosine = codes, 1.0
    steps = int(np.clip(_WORK // (K * K), _LEAST_STEPS, _MOST_STEPS))
    for step in range(steps):
        done = step / steps
        sharpness = _FIRST_SHARPNESS * (_LAST_SHARPNESS / _FIRST_SHARPNESS) ** done
        push = np.empty_like(codes)
        cosine = float(repulsion(codes, np.ascontiguousarray(codes.T), sharpness, push))
        if cosine < best_cosine:
            best, best_cosine = codes, cosine
        codes = _unit(codes - np.float32(0.3 * (1 - done)) * push)
    return CodeBook(best, best_cosine)


def _unit(vectors: FloatArray) -> FloatArray:
    """Each row divided by its length."""
    lengths = np.linalg.norm(vectors.astype(np.float64), axis=1, keepdims=True)
    return (vectors / lengths).astype(np.float32)


_BLOCK = 1 << 16  # rows of the majority at a time: temporaries are (rows, k, k)


@dataclass(frozen=True)
class VoteConfig:
    """Settings of mode "vote"."""

    scale: float = 10.0  # of the layer's weights: sharpness of the softmax, no effect on labels
    neighbours: int = 8  # that decide on a Gaussian no view shows
    seed: int = 0  # of the code book

    def __post_init__(self) -> None:
        if self.scale <= 0 or self.neighbours < 1:
            raise ValueError("scale and neighbours: must be positive")


@dataclass(frozen=True, eq=False)
class Voted:
    """Labels of the Gaussians before they become encodings."""

    labels: IntArray  # (N,) 1..G, 0 = none
    confidence: FloatArray  # (N,) share of the vote; of agreeing neighbours where none was cast


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """Result of mode "vote" and what led to it."""

    identity: Identity
    codes: FloatArray  # (G + 1, D) the code book
    max_cosine: float  # of the two closest codes
    n_from_bank: int  # Gaussians labelled by the memory bank alone
    n_from_neighbours: int  # Gaussians that no view shows and no mask claims


def vote_identity(
    gaussians: Gaussians,
    voted: Voted,
    bank_group: IntArray,  # (N,) the memory bank's owner, <= 0 = none
    n_groups: int,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
    config: VoteConfig | None = None,
) -> Stage[ClosedForm]:
    """Encodings of voted labels: the code of the label, and the codes as the layer.

    Gaussians without a vote take the bank's group. Those that still have none and that no camera
    shows take the majority of their nearest neighbours (which may be "none"); who is seen and
    belongs to no mask stays 0.
    """
    config = config or VoteConfig()
    n = len(gaussians)
    check_shape("labels", voted.labels, (n,), np.int32)
    check_shape("confidence", voted.confidence, (n,), np.float32)
    check_shape("bank_group", bank_group, (n,), np.int32)
    if max(voted.labels.max(initial=0), bank_group.max(initial=0)) > n_groups:
        raise ValueError(f"labels: there are more than {n_groups} groups")
    from_bank = (voted.labels == 0) & (bank_group > 0)
    labels = np.where(from_bank, bank_group, voted.labels)
    hidden = labels == 0
    if hidden.any():
        hidden &= ~(yield from _seen(gaussians, cameras, rasterizer))
    labels, confidence = yield from _ask_neighbours(
        gaussians.means, labels, voted.confidence, hidden, config.neighbours
    )
    book = code_book(n_groups, seed=config.seed)
    field = IdentityField(
        encodings=book.encodings(labels),
        weight=np.float32(config.scale) * book.codes,
        bias=np.zeros(n_groups + 1, np.float32),
    )
    return ClosedForm(
        identity=Identity(field, labels, confidence, "vote"),
        codes=book.codes,
        max_cosine=book.max_cosine,
        n_from_bank=int(from_bank.sum()),
        n_from_neighbours=int((hidden & (labels > 0)).sum()),
    )


def _seen(
    gaussians: Gaussians, cameras: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[BoolArray]:
    """Whether any pixel of any view shows a Gaussian."""
    weight = np.zeros((len(gaussians), 1), np.float32)
    for i, camera in enumerate(cameras):
        yield Progress("Find hidden Gaussians", i, len(cameras), camera.name)
        rasterizer.vote(
            gaussians, camera, np.zeros((camera.height, camera.width), np.int32), weight
        )
    return weight[:, 0] > 0


def _ask_neighbours(
    means: FloatArray,
    labels: IntArray,  # (N,)
    confidence: FloatArray,  # (N,) 0 = no vote
    hidden: BoolArray,  # (N,) to be labelled
    k: int,
) -> Stage[tuple[IntArray, FloatArray]]:
    """Labels with the hidden ones filled, and a confidence for all that have a label unvoted.

    Who was not voted on has the confidence of the neighbours that say the same, times their share.
    """
    asks = hidden | ((labels > 0) & (confidence == 0))
    labels, confidence = labels.copy(), confidence.copy()
    known = ~asks
    if not asks.any() or not known.any():
        return labels, confidence
    near = yield from nearest(means, k, of=asks, among=known)
    asking = np.flatnonzero(asks)
    reached = known[near[:, 0]]  # a position that is not finite has only itself
    asking, near = asking[reached], near[reached]
    voted_labels, voted_confidence = labels.copy(), confidence.copy()
    for start in range(0, len(asking), _BLOCK):
        who, by = asking[start : start + _BLOCK], near[start : start + _BLOCK]
        fills = hidden[who]
        labels[who[fills]] = majority(voted_labels, by[fills])[0]
        same = voted_labels[by] == labels[who][:, None]
        confidence[who] = (same * voted_confidence[by]).mean(axis=1)
    return labels, confidence


STAGE = "Fit encodings"
_CHUNK = 4096  # Gaussians of one piece of work
_TINY = np.float32(1e-6)  # under any kept weight: sums that small are those of nothing


@dataclass(frozen=True)
class FitConfig:
    """Settings of the least-squares fit."""

    sweeps: int = 16  # at most; 0 = the bare vote
    margin: float = 0.05  # least lead of a Gaussian's own label, in scores of unit codes
    # At least a quarter of what training takes: IoU 81.2 and 81.3 on ycb_crowd, for 2.1 and 13.4
    # CPU-s; at most as many. Of 150 small objects a quarter costs 1.8 points.
    rows: RowConfig = field(default_factory=lambda: RowConfig(per_view=4096))
    per_group: int = 100  # rows of a view for each group, so that small ones have some

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
    most, groups = RowConfig().per_view, len(start.codes) - 1
    wanted = config.rows.per_view  # 0 = all
    if 0 < wanted < most:
        wanted = min(max(wanted, config.per_group * groups), most)
    rows = replace(config.rows, per_view=wanted)
    sampled = yield from sample_rows(
        gaussians, cameras, label_map, rasterizer, rows, shuffles=False
    )
    n, held = len(gaussians), held_out(len(sampled))
    n_rows = sum(len(view.labels) for view in sampled)
    judges = [sampled[i] for i in held]
    others = [view for i, view in enumerate(sampled) if i not in held]
    sampled.clear()
    test = joined_batch(judges, n)
    kept = joined_batch(others, n) if others else test
    field = best_field = start.identity.field
    before = best = _accuracy(field, test)
    best_sweep = 0
    # SIRT from the codes of the labels: what rows lack, divided by their sums, goes back to the
    # Gaussians, divided by the sums of their columns.
    codes, labels = np.ascontiguousarray(start.codes), np.ascontiguousarray(start.identity.labels)
    encodings = np.ascontiguousarray(codes[labels])
    weights = kept.rows.by_pixel
    columns = np.bincount(weights.indices, weights.weights, n)
    owner = np.repeat(np.arange(len(kept.rows)), np.diff(weights.indptr))
    sums = np.bincount(owner, weights.weights, len(kept.rows)).astype(np.float32)[:, None]
    del owner
    target, share = sums * codes[kept.labels], 1 / np.maximum(sums, _TINY)
    touched = kept.rows.touched
    scale = (1 / np.maximum(columns[touched], _TINY)).astype(np.float32)[:, None]
    back = np.empty_like(encodings)
    for sweep in range(1, config.sweeps + 1):
        yield Progress(STAGE, sweep - 1, config.sweeps)
        residual = target - kept.rows.multiply(encodings)
        residual *= share
        kept.rows.multiply_transposed(residual, back)
        encodings[touched] += scale * back[touched]
        if sweep & (sweep - 1) == 0 or sweep == config.sweeps:  # after 1, 2, 4, ... sweeps
            field = replace(field, encodings=encodings.copy())
            leads = partial(keep_labels, field.encodings, codes, labels, config.margin)
            run_chunks(leads, len(encodings), _CHUNK)
            accuracy = _accuracy(field, test)
            if accuracy > best:
                best, best_field, best_sweep = accuracy, field, sweep
            yield Progress(STAGE, sweep, config.sweeps, f"sweep {sweep}")
            if accuracy < best:
                break
    return Fitted(
        closed=replace(start, identity=replace(start.identity, field=best_field)),
        n_rows=n_rows,
        sweeps=best_sweep,
        before=before,
        after=best,
    )


def _accuracy(field: IdentityField, batch: Batch) -> float:
    """Share of rows whose splatted encoding decodes to their label."""
    shown = field.classify(batch.rows.multiply(field.encodings))[0]
    return float((shown == batch.labels).mean())
