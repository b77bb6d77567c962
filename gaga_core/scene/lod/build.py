"""Building the tree: one pass from the opened splats up, a chunk at a time."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.gaussians import Gaussians
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.progress import Progress, Stage
from gaga_core.scene.lod.build_kernels import cluster_windows, hilbert_keys
from gaga_core.scene.lod.tree import (
    CHUNK,
    FAN,
    FILE,
    FORMAT,
    NODE,
    NODES,
    ORDER,
    WINDOW,
    LodFile,
    LodTree,
    first_nodes,
    level_file,
    level_sizes,
    open_lod,
    read_rows,
    row_type,
    union_of_children,
)
from gaga_core.scene.merge_splats import kernel_columns, merge_runs
from gaga_core.threads import run_chunks

STAGE = "Build level of detail"
_REACH = 3.34  # standard deviations at which a splat ends
_SAMPLE = 1 << 16  # splats that say how large the scene is
_MOST_SPREAD = 90.0  # percentile of the sizes of a node's splats that is its detail
_KEY_CHUNK = 1 << 18
_WINDOWS = 64  # that one thread looks at at once
_GROWTH = 0.25  # log of size per log of opacity that has no room; 0.5 would keep all of it
_MOST_GROWTH = 0.5


def build_lod_stage(gaussians: Gaussians, folder: Path, digest: str) -> Stage[LodTree]:
    """Build the tree of ``gaussians`` in ``folder`` with progress; whole or not at all.

    ``digest`` is that of the model file, by which `open_lod` knows it again. Memory: about 20 bytes
    a splat more than the splats themselves. Raises ``GagaError`` when it cannot be written.
    """
    folder, sizes = Path(folder), level_sizes(len(gaussians))
    n_sh = gaussians.sh.shape[1]
    total = sum(sizes)
    yield Progress(STAGE, 0, total, "order")
    order = curve_order(gaussians.means)
    nodes: list[FloatArray] = []
    low, high = np.inf, -np.inf
    done = 0
    # The model's own folder may not be there yet; the tree replaces a former one as a whole.
    with staging_folder(folder.parent) as staging:
        target = staging / folder.name
        target.mkdir()
        order.astype("<i4").tofile(target / ORDER)
        for level, size in enumerate(sizes):
            # Level 0 has no file: the model is there.
            with (target / level_file(level) if level else Path(os.devnull)).open("wb") as file:
                for first in range(0, size, CHUNK):
                    end = min(first + CHUNK, size)
                    if level == 0:
                        splats = gaussians.bare(order[first:end])
                    else:
                        start, stop = first * FAN, min(end * FAN, sizes[level - 1])
                        rows = order[start:stop]
                        if level == 1:
                            below = gaussians.bare(rows)
                        else:
                            below, rows = read_rows(
                                *(target, level - 1, start, stop, n_sh), len(order)
                            )
                        splats, rows = merged_level(below, rows)
                        packed = np.empty(len(splats), row_type(n_sh))
                        packed["means"], packed["quats"] = splats.means, splats.quats
                        packed["log_scales"] = splats.log_scales
                        packed["logit"], packed["sh"] = splats.logit_opacities, splats.sh
                        packed["row"] = rows
                        file.write(packed.tobytes())
                    nodes.append(_nodes(splats, is_merged=level > 0))
                    finite = splats.log_scales[np.isfinite(splats.log_scales)]
                    low = min(low, float(finite.min(initial=np.inf)))
                    high = max(high, float(finite.max(initial=-np.inf)))
                    done += end - first
                    yield Progress(STAGE, done, total, f"level {level}")
        table = np.concatenate(nodes)
        union_of_children(table, first_nodes(sizes))
        np.save(target / NODES, table)
        sizes_range = (low, high) if low <= high else (0.0, 0.0)  # no splat has a finite size
        stored = LodFile(FORMAT, digest, sizes, n_sh, sizes_range)
        (target / FILE).write_bytes(msgspec.json.encode(stored))
        publish_all(staging, [folder.name], folder.parent)
    tree = open_lod(folder, digest, len(gaussians), n_sh)
    assert tree is not None
    return tree


def curve_order(means: FloatArray) -> IntArray:
    """Rows (N,) of ``means`` (N, 3) along a Hilbert curve through the scene."""
    sample = means[:: -(-len(means) // _SAMPLE)].astype(np.float64)
    low, middle, high = np.percentile(sample, [2, 50, 98], axis=0)
    half = max(float((high - low).max()) / 2, 1e-12)
    keys = np.empty(len(means), np.uint64)
    centre = middle.astype(np.float32)

    run_chunks(partial(hilbert_keys, means, centre, half, keys), len(means), _KEY_CHUNK)
    return np.argsort(keys, kind="stable").astype(np.int32)


def merged_level(below: Gaussians, rows: IntArray) -> tuple[Gaussians, IntArray]:
    """A `FAN`-th as many splats, and of the ``rows`` merged into each that of the heaviest.

    Of every `WINDOW` neighbours those become one that are most alike, few or many of them. Where
    one splat cannot be as opaque as they are together, it is larger than their moments say: a dense
    surface would let through what lies behind it.
    """
    named = replace(below, extra={"row": rows})
    order, starts = alike_runs(below)
    merged = merge_runs(named, starts, order)
    covered = (below.opacities * _faces(below.log_scales))[order]
    together = np.add.reduceat(covered, starts) if len(starts) else covered
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        lost = np.log(together / _faces(merged.log_scales))
    growth = np.clip(_GROWTH * np.nan_to_num(lost, posinf=0.0), 0, _MOST_GROWTH)
    larger = merged.log_scales + growth[:, None].astype(np.float32)
    return replace(merged, log_scales=larger), merged.extra["row"]


def alike_runs(splats: Gaussians) -> tuple[LongArray, LongArray]:
    """Rows (K,) of splats, those that become one next to each other, and where runs begin (P,)."""
    n = len(splats)
    order, starts = np.empty(n, np.int64), np.empty(-(-n // FAN), np.int64)
    work = partial(cluster_windows, *kernel_columns(splats), WINDOW, FAN, order, starts)
    run_chunks(work, -(-n // WINDOW), _WINDOWS)
    return order, starts


def _faces(log_scales: FloatArray) -> DoubleArray:
    """What splats cover (K,), of all directions, as `merge_splats` weights them."""
    a, b, c = np.exp(np.minimum(log_scales, np.float32(30)).astype(np.float64).T)
    return a * b + b * c + c * a


def _nodes(splats: Gaussians, *, is_merged: bool) -> FloatArray:
    """Box and detail (K, 7) of the nodes of a chunk."""
    n = len(splats)
    out = np.zeros((-(-n // NODE), 7), np.float32)
    longest = np.exp(np.minimum(splats.log_scales.max(axis=1), np.float32(30)))
    for k in range(len(out)):
        part = slice(k * NODE, min((k + 1) * NODE, n))
        out[k, :6] = box_of(splats.means[part], longest[part])
        if is_merged:
            out[k, 6] = 2 * np.percentile(longest[part], _MOST_SPREAD)
    return out


def box_of(means: FloatArray, longest: FloatArray) -> DoubleArray | FloatArray:
    """Box (6,) lo, hi of splats with these largest standard deviations (K,)."""
    reach = np.float32(_REACH) * longest[:, None]
    return np.concatenate([(means - reach).min(axis=0), (means + reach).max(axis=0)])
