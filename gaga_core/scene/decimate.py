"""Fewer splats for the same look: neighbours that are alike become one, and what that loses.

Pairs of neighbours are merged with their moments kept (`merge_splats`), those first whose merged
splat is nearest to the two: the scheme of Hierarchical 3D Gaussians (Kerbl 2024) without its tree.
"""

from collections.abc import Sequence

import numpy as np

from gaga_core.arrays import DoubleArray, IntArray, LongArray, check_shape
from gaga_core.camera import Camera
from gaga_core.color import SH_C0
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import quats_to_matrices
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.merge_splats import merge_splats

STEP = "Merge splats"
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
        yield Progress("Compare pictures", k, len(cameras), camera.name)
        pictures = [np.clip(rasterizer.render(g, camera).image, 0, 1) for g in (before, after)]
        error = (pictures[0] - pictures[1]).astype(np.float64)
        total, n = total + float((error**2).sum()), n + error.size
    yield Progress("Compare pictures", len(cameras), len(cameras))
    return psnr_of(total, n)


def psnr_of(total: float, n: int) -> float:
    """PSNR in dB of ``n`` numbers whose squared errors make up ``total``; 99 at most."""
    return min(EXACT, -10 * float(np.log10(max(total / max(n, 1), 1e-12))))


def _pairs(
    gaussians: Gaussians, labels: IntArray | None, most: int
) -> Stage[tuple[LongArray, int]]:
    """For each splat the row that it is merged into (N,), and how many pairs there are."""
    from scipy.spatial import cKDTree

    from gaga_core.kernels import n_threads, run_chunks
    from gaga_core.raster.cpu.prepare import for_kernel
    from gaga_core.scene.decimate_kernels import match_pairs, pair_costs

    n = len(gaussians)
    parents = np.arange(n, dtype=np.int64)
    good = np.flatnonzero(
        np.isfinite(gaussians.means.sum(axis=1) + gaussians.log_scales.sum(axis=1))
    )
    if len(good) < 2:
        return parents, 0
    k = min(_NEIGHBOURS + 1, len(good))
    means = gaussians.means[good]
    _, near = cKDTree(means).query(means, k=k, workers=n_threads())
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

    def work(start: int, stop: int) -> None:
        pair_costs(
            for_kernel(gaussians.means, np.float32),
            covariances,
            weights,
            colors,
            first,
            second,
            _COLOR_WEIGHT,
            costs,
            start,
            stop,
        )

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
