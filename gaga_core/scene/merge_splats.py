"""Several splats become one with the same moments: the step of decimation and of level of detail.

The weights are those of Kerbl 2024 (A Hierarchical 3D Gaussian Representation, section 4.1): a
splat counts by its opacity times the surface of its ellipsoid, and the merged one is as opaque as
its surface leaves room for.
"""

from functools import partial
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray, IntArray, LongArray, check_shape
from gaga_core.gaussians import Gaussians
from gaga_core.raster.cpu.prepare import for_kernel
from gaga_core.scene.splat_kernels import merge_rows
from gaga_core.threads import run_chunks

_CHUNK = 1 << 13  # runs that one thread takes at once


def kernel_columns(
    g: Gaussians,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Means, quats, log scales, logit opacities and SH as kernels take them."""
    m, q, s, o, sh = (
        for_kernel(column, np.float32)
        for column in (g.means, g.quats, g.log_scales, g.logit_opacities, g.sh)
    )
    return m, q, s, o, sh


def merge_splats(gaussians: Gaussians, parents: IntArray | LongArray) -> Gaussians:
    """One splat for each value of ``parents`` (N,), in ascending order of these values (P,).

    See `merge_runs`.
    """
    check_shape("parents", parents, (len(gaussians),))
    order = np.argsort(parents, kind="stable")
    ordered = parents[order]
    starts = np.flatnonzero(np.r_[len(order) > 0, ordered[1:] != ordered[:-1]])
    return merge_runs(gaussians, starts, order)


def merge_runs(
    gaussians: Gaussians,
    starts: LongArray,  # (P,) ascending, the first is 0
    order: LongArray | None = None,  # (N,) rows, run after run; None: as they lie
) -> Gaussians:
    """One splat (P in all) for each run of rows, with the moments of its splats.

    Mean, covariance and SH are averages by weight (opacity times surface); the opacity keeps the
    summed weight, up to 1. Extra columns of floats are averaged too; of others the heaviest splat's
    value is taken. A run of one row keeps its exact bits. Memory: the result and a few bytes a row.
    """
    n, n_runs = len(gaussians), len(starts)
    order = np.arange(n) if order is None else np.ascontiguousarray(order, np.int64)
    ends = np.r_[starts, n].astype(np.int64)
    if n_runs and (ends[0] != 0 or not (np.diff(ends) > 0).all()):
        raise ValueError("starts: expected ascending rows from 0 on")
    averaged = [k for k, column in gaussians.extra.items() if column.dtype == np.float32]
    others = np.empty((n, len(averaged)), np.float32)
    for k, name in enumerate(averaged):
        others[:, k] = gaussians.extra[name]
    shapes = (3,), (4,), (3,), (), gaussians.sh.shape[1:]
    m, q, s, o, sh = (np.empty((n_runs, *shape), np.float32) for shape in shapes)
    merged = np.empty((n_runs, len(averaged)), np.float32)
    heaviest = np.empty(n_runs, np.int64)
    given = *kernel_columns(gaussians), others, order, ends
    work = partial(merge_rows, *(*given, m, q, s, o, sh, merged, heaviest))
    run_chunks(work, n_runs, _CHUNK)
    extra: dict[str, AnyArray] = {
        name: merged[:, averaged.index(name)].copy() if name in averaged else column[heaviest]
        for name, column in gaussians.extra.items()
    }
    return Gaussians(m, q, s, o, sh, MappingProxyType(extra), gaussians.comments)
