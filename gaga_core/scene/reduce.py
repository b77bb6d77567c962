"""Fewer splats of a selection, of objects or of the scene, as an edit: `decimate` in place.

What is merged is deleted, and what it became is added with its group, so that undo, projects and
scripts know it as any other edit. What no pair was found for stays as it is, bit for bit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaga_core.arrays import (
    AnyArray,
    BoolArray,
    DoubleArray,
    IntArray,
    LongArray,
    check_shape,
)
from gaga_core.camera import Camera
from gaga_core.color import SH_C0
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.io.splats.packing import morton_order
from gaga_core.progress import Progress, Stage, joined, part
from gaga_core.raster.base import Rasterizer
from gaga_core.raster.cpu.prepare import for_kernel
from gaga_core.scene.bake import bake_stage
from gaga_core.scene.edits.splats import append_made, delete
from gaga_core.scene.edits.values import Edit, together
from gaga_core.scene.frame import Frame
from gaga_core.scene.merge_splats import merge_splats
from gaga_core.scene.objects import group_name
from gaga_core.scene.scene import Revision, Scene, State
from gaga_core.scene.selection.click import loss_views
from gaga_core.scene.splat_kernels import match_pairs, pair_costs
from gaga_core.threads import n_threads, run_chunks

# --- Fewer splats for the same look. Pairs of neighbours are merged with their moments kept
# (`merge_splats`), those first whose merged splat is nearest to the two: the scheme of Hierarchical
# 3D Gaussians (Kerbl 2024) without its tree.


TITLE, STEP, COMPARES = "Reduce splats", "Merge splats", "Compare pictures"
# Seconds that they take: of the demo's 120,000 splats to the half. Only what they are in parts of
# each other counts.
_STEP_S = {STEP: 9.5, COMPARES: 2.5}
_NEIGHBOURS = 8  # looked at: 12 gain 0.3 dB and cost half as much again
# How a squared difference of colors weighs against one of shape. Measured on ycb_table at a quarter
# of the splats: 3 to 30 are within 0.1 dB of each other.
_COLOR_WEIGHT = 10.0
# Of the splats that are merged away in a round: more, and pairs are merged that fit badly.
_A_ROUND = 0.4
_CHUNK = 1 << 14  # pairs that one thread takes at once
EXACT = 99.0  # dB that stand for "no difference"


def decimate_stage(
    gaussians: Gaussians, share: float, labels: IntArray | None = None
) -> Stage[tuple[Gaussians, LongArray]]:
    """``gaussians`` with about ``share`` (0..1] of the splats (K), merged pair by pair, and of each
    a row (K,) that went into it.

    Splats of different ``labels`` (N,) are never merged, so fewer may go than asked for; splats
    that are not finite stay. 1 gives the same object back. Not in the order of the rows.
    """
    if not 0 < share <= 1:
        raise ValueError(f"share: expected above 0 and up to 1, got {share}")
    if labels is not None:
        check_shape("labels", labels, (len(gaussians),))
    rows = np.arange(len(gaussians))
    target = max(1, round(share * len(gaussians)))
    start = len(gaussians)
    while len(gaussians) > target:
        yield Progress(STEP, start - len(gaussians), start - target, f"{len(gaussians):,} left")
        most = min(len(gaussians) - target, int(_A_ROUND * len(gaussians)) + 1)
        parents, n_pairs = yield from _pairs(gaussians, labels, most)
        if n_pairs == 0:
            break
        gaussians = merge_splats(gaussians, parents)
        first = np.unique(parents)
        rows, labels = rows[first], None if labels is None else labels[first]
    yield Progress(STEP, start - target, start - target)
    return gaussians, rows


def picture_loss_stage(
    before: Gaussians, after: Gaussians, cameras: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[float]:
    """PSNR in dB of pictures of ``after`` against those of ``before``, over all their pixels.

    The higher, the less was lost; 99 where nothing was. Black background.
    """
    total, n = 0.0, 0
    for k, camera in enumerate(cameras):
        yield Progress(COMPARES, k, len(cameras), camera.name)
        pictures = [np.clip(rasterizer.render(g, camera).image, 0, 1) for g in (before, after)]
        error = (pictures[0] - pictures[1]).astype(np.float64)
        total, n = total + float((error**2).sum()), n + error.size
    yield Progress(COMPARES, len(cameras), len(cameras))
    return psnr_of(total, n)


def psnr_of(total: float, n: int) -> float:
    """PSNR in dB of ``n`` numbers whose squared errors make up ``total``; 99 at most."""
    return min(EXACT, -10 * float(np.log10(max(total / max(n, 1), 1e-12))))


def _pairs(
    gaussians: Gaussians, labels: IntArray | None, most: int
) -> Stage[tuple[LongArray, int]]:
    """For each splat the row that it is merged into (N,), and how many pairs there are."""
    from scipy.spatial import cKDTree

    n = len(gaussians)
    parents = np.arange(n, dtype=np.int64)
    good = np.flatnonzero(
        np.isfinite(gaussians.means.sum(axis=1) + gaussians.log_scales.sum(axis=1))
    )
    if len(good) < 2:
        return parents, 0
    k = min(_NEIGHBOURS + 1, len(good))
    finite = gaussians.means[good]
    _, near = cKDTree(finite).query(finite, k=k, workers=n_threads())
    yield Progress(STEP, 0, 0, f"{n:,} left")
    ones = np.repeat(np.arange(len(good)), k)
    others = near.ravel()
    ones, others = np.minimum(ones, others), np.maximum(ones, others)
    keys = np.unique(ones[ones != others] * len(good) + others[ones != others])
    first, second = good[keys // len(good)], good[keys % len(good)]
    if labels is not None:
        same = labels[first] == labels[second]
        first, second = first[same], second[same]
    covariances, weights = _moments(gaussians)
    costs = np.empty(len(first))
    colors = for_kernel(np.float32(SH_C0) * gaussians.sh[:, 0], np.float32)

    means = for_kernel(gaussians.means, np.float32)
    splats = means, covariances, weights, colors
    work = partial(pair_costs, *splats, first, second, _COLOR_WEIGHT, costs)
    run_chunks(work, len(first), _CHUNK)
    yield Progress(STEP, 0, 0, f"{n:,} left")
    order = np.argsort(costs, kind="stable")
    return parents, match_pairs(order, first, second, parents, np.zeros(n, np.bool_), most)


def _moments(gaussians: Gaussians) -> tuple[DoubleArray, DoubleArray]:
    """Covariances (N, 6) xx, xy, xz, yy, yz, zz, and weights (N,) opacity times surface."""
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(gaussians.log_scales.astype(np.float64))
        axes = quats_to_matrices(gaussians.quats) * sizes[:, None, :]
        a, b, c = sizes.T
        weights = gaussians.opacities * (a * b + b * c + c * a)
        rows = [(axes[:, i] * axes[:, j]).sum(axis=1) for i in range(3) for j in range(i, 3)]
    return np.stack(rows, axis=1), np.nan_to_num(weights, posinf=0.0)


# --- The edit.


SHARES = (0.75, 0.5, 0.25, 0.1, 0.05)  # at which a loss is estimated
_N_ESTIMATED = 100_000  # splats that an estimate merges; of more, some blocks are taken
_N_BLOCKS = 8
_N_VIEWS = 3  # of an estimate
_N_MOTIONS = 64  # that are distinguished: each is a separate addition
_OPAQUE = 0.5  # a pixel shows splats where they hide more than this
_ESTIMATE = "Estimate the loss"


@dataclass(frozen=True, eq=False)
class Reduction:
    """Input of a reduction."""

    removed: LongArray  # (K,) splats of the scene that are merged
    splats: Gaussians  # (M,) what they become, world
    labels: IntArray  # (M,)
    origins: LongArray  # (M,) splat of the scene that each is made of, among others
    n_before: int  # splats that were looked at
    psnr: float  # dB of pictures of after against those of before, 99 where nothing is lost
    is_selected: bool

    @property
    def n_after(self) -> int:
        """Number of the considered splats that are left."""
        return self.n_before - len(self.removed) + len(self.splats)


@dataclass(frozen=True)
class LossCurve:
    """An estimate of what is lost: PSNR in dB by the share of the splats that is kept."""

    points: tuple[tuple[float, float], ...]  # share and dB, the largest share first

    def at(self, share: float) -> float:
        """About how many dB are left at ``share`` (0..1]; linear in its logarithm."""
        if share >= 1 or not self.points:
            return EXACT
        shares, levels = (np.array(column) for column in zip(*self.points, strict=True))
        x, known = np.log(share), np.log(shares)
        if x > known[0] and len(known) > 1:  # the same slope goes on above the first
            slope = (levels[0] - levels[1]) / (known[0] - known[1])
            return float(min(levels[0] + slope * (x - known[0]), EXACT))
        return float(np.interp(x, known[::-1], levels[::-1]))


def reducible(scene: Scene, splats: AnyArray) -> LongArray:
    """Those of ``splats`` (rows or mask) that may be merged: visible and not locked."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[splats] = True
    free: BoolArray = chosen & scene.visible & ~scene.has(State.LOCKED)
    return np.flatnonzero(free)


def reduce_stage(
    scene: Scene,
    splats: AnyArray,
    share: float,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
) -> Stage[Reduction]:
    """Merge neighbours of ``splats`` (rows or mask) until about ``share`` (0..1) of them is left.

    Hidden and locked ones stay as they are, splats of different groups are never merged. The loss
    is measured from the photos' ``cameras`` when all that can be is merged, else from all around.
    Raises ``GagaError`` when there is nothing to merge.
    """
    rows = reducible(scene, splats)
    if len(rows) < 2:
        raise GagaError("There is nothing to merge: hidden and locked splats stay as they are.")
    stage = _reduced(scene, rows, share, cameras, rasterizer)
    return (yield from joined(stage, TITLE, _STEP_S))


def _reduced(
    scene: Scene,
    rows: LongArray,
    share: float,
    cameras: Sequence[Camera],
    rasterizer: Rasterizer,
) -> Stage[Reduction]:
    gaussians = yield from bake_stage(scene, indices=rows)
    labels = scene.labels[rows]
    fewer, places = yield from decimate_stage(gaussians, share, labels)
    is_merged = ~_same(fewer, gaussians, places)
    removed = np.setdiff1d(rows, rows[places[~is_merged]])
    views = _views(scene, rows, gaussians, cameras)
    psnr = yield from picture_loss_stage(gaussians, fewer, views, rasterizer)
    return Reduction(
        removed=removed,
        splats=fewer.take(np.flatnonzero(is_merged)),
        labels=labels[places[is_merged]],
        origins=rows[places[is_merged]],
        n_before=len(rows),
        psnr=psnr,
        is_selected=bool(scene.has(State.SELECTED)[rows].all()),
    )


def reduced_edit(scene: Scene, found: Reduction, title: str) -> Edit | None:
    """Replace what is merged by what it became; None when nothing was.

    ``scene``: as it was when ``found`` was computed.
    """
    scratch = replace(scene, revision=Revision())
    removing = delete(scratch, found.removed, title)
    if removing is None:
        return None
    removing.apply(scratch)
    state = State.SELECTED if found.is_selected else State(0)
    parts: list[Edit] = [removing]
    for motion, some in _by_motion(scene, found.origins):
        splats, labels = found.splats.take(some), found.labels[some]
        adding = append_made(scratch, splats, labels, title, state, merged_from=motion)
        if adding is not None:
            adding.apply(scratch)
            parts.append(adding)
    return together(title, parts)


def _by_motion(scene: Scene, origins: LongArray) -> Iterator[tuple[Frame, LongArray]]:
    """How splats were moved since they came, and places in ``origins`` (M,) of those moved so.

    What `reset_placement` and the pose of an object count from; one that was stretched or mirrored,
    and all where there are very many motions, count from now.
    """
    placed = scene.placement[origins]
    rows, first = np.unique(placed, return_index=True)
    alike: dict[object, tuple[Frame, list[int]]] = {}
    for row, place in zip(rows.tolist(), first.tolist(), strict=True):
        motion = _motion(scene, int(origins[place]))
        alike.setdefault(motion.rows, (motion, []))[1].append(row)
    if len(alike) > _N_MOTIONS:
        alike = {(): (scene.frame, rows.tolist())}
    for motion, members in alike.values():
        yield motion, np.flatnonzero(np.isin(placed, members))


def _motion(scene: Scene, splat: int) -> Frame:
    """The motion of the scene at which a splat would have come to be where it is unmoved."""
    now = np.eye(4)
    now[:3] = scene.placements.matrix[scene.placement[splat]]
    came = scene.motion_of(int(scene.source[splat]))
    if np.array_equal(now, came):
        return scene.frame
    try:
        return Frame(now @ np.linalg.inv(came) @ scene.frame.world)
    except ValueError:  # stretched or mirrored
        return scene.frame


def reduce_title(scene: Scene, splats: AnyArray, found: Reduction) -> str:
    """Title of the edit in the history, with the loss."""
    groups = np.unique(scene.labels[reducible(scene, splats)])
    name = f" of {group_name(scene, int(groups[0]))}" if len(groups) == 1 and groups[0] else ""
    return f"Reduce splats{name} to {found.n_after:,} ({loss_text(found.psnr)})"


def loss_text(psnr: float) -> str:
    """ "29.6 dB", or that nothing is lost."""
    return "nothing is lost" if psnr >= EXACT else f"{psnr:.1f} dB"


def estimate_stage(
    scene: Scene, splats: AnyArray, cameras: Sequence[Camera], rasterizer: Rasterizer
) -> Stage[LossCurve]:
    """About what `reduce_stage` would lose: few pictures, and of many splats some blocks."""
    rows = reducible(scene, splats)
    gaussians = yield from bake_stage(scene, indices=rows)
    if len(rows) < 2:
        return LossCurve(())
    views = _views(scene, rows, gaussians, cameras)
    views = views[:: -(-len(views) // _N_VIEWS)]
    labels, filled = scene.labels[rows], 1.0
    is_part = len(rows) > _N_ESTIMATED
    if is_part:  # judged where it is opaque; the whole fills so much of the pictures
        whole = [rasterizer.render(gaussians, view).alpha > _OPAQUE for view in views]
        filled = float(np.concatenate([drawn.ravel() for drawn in whole]).mean())
        some = _blocks(gaussians)
        gaussians, labels = gaussians.take(some), labels[some]
    before = []
    for view in views:
        yield Progress(_ESTIMATE, 0, len(SHARES), view.name)
        drawn = rasterizer.render(gaussians, view)
        where = drawn.alpha > _OPAQUE if is_part else np.ones_like(drawn.alpha, np.bool_)
        before.append((view, np.clip(drawn.image, 0, 1), where))
    n, fewer, points = len(gaussians), gaussians, []
    for k, share in enumerate(SHARES):
        yield Progress(_ESTIMATE, k, len(SHARES))
        target = max(share * n / len(fewer), 1e-9)
        if target < 1:
            merging = decimate_stage(fewer, target, labels)
            fewer, places = yield from part(merging, k, len(SHARES), _ESTIMATE)
            labels = labels[places]
        errors = [
            (np.clip(rasterizer.render(fewer, view).image, 0, 1) - picture)[where].ravel()
            for view, picture, where in before
        ]
        error = np.concatenate(errors).astype(np.float64)
        points.append((share, psnr_of(filled * float((error**2).sum()), error.size)))
    return LossCurve(tuple(points))


def _views(
    scene: Scene, rows: LongArray, gaussians: Gaussians, cameras: Sequence[Camera]
) -> Sequence[Camera]:
    """The photos' for all that can be merged, else all around the splats alone."""
    free = scene.visible & ~scene.has(State.LOCKED)
    is_whole = len(rows) == int(np.count_nonzero(free))
    return loss_views(cameras if is_whole else (), gaussians.means)


def _same(fewer: Gaussians, gaussians: Gaussians, places: LongArray) -> BoolArray:
    """Which of ``fewer`` (M,) have all numbers of the splat that they stand for."""
    same = np.ones(len(fewer), np.bool_)
    pairs: list[tuple[AnyArray, AnyArray]] = [
        (fewer.means, gaussians.means),
        (fewer.quats, gaussians.quats),
        (fewer.log_scales, gaussians.log_scales),
        (fewer.logit_opacities, gaussians.logit_opacities),
        (fewer.sh, gaussians.sh),
        *((column, gaussians.extra[name]) for name, column in fewer.extra.items()),
    ]
    for after, before in pairs:
        is_same = (after == before[places]) | (np.isnan(after) & np.isnan(before[places]))
        same &= is_same.reshape(len(same), -1).all(axis=1)
    return same


def _blocks(gaussians: Gaussians) -> LongArray:
    """Some splats in blocks of neighbours, evenly over the scene."""
    order, size = morton_order(gaussians.means), _N_ESTIMATED // _N_BLOCKS
    starts = np.linspace(0, len(order) - size, _N_BLOCKS).astype(np.int64)
    return np.unique(np.concatenate([order[start : start + size] for start in starts]))
