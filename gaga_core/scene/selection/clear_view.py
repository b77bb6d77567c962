"""Which side is open: a room without photos is looked into, not at its back, and an object that was
found is not looked at through another one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray, IntArray
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import turned
from gaga_core.scene.frame import scale_of
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection.algebra import world_means

_SAMPLE = 8_000  # splats that are sampled; 20,000 in 64 cells choose the same on eight scenes
_FAINT = 0.05  # opacity from which on splats count: many of them are fog
_CORE = 0.6  # share of the sides of a scene's box that is its middle: no walls
# Cells across what is looked at, in which splats hide each other: from nearer a view has fewer of
# the same size, or more would seem to be seen there.
_CELLS, _FEWEST = 128, 16
_ROUGH = 32  # cells across a view of a single object
_LEVELS = 6  # sizes of cells, each twice the one before: a splat covers about one of its size
_BEHIND = 0.02  # of the size of what is looked at: what is so little behind a surface is part of it
_CLEARER = 0.05  # share of all splats that another view has to show more of in the middle
_HIDDEN = 0.5  # share of what the best view shows: the first is left where it shows less


@dataclass(frozen=True)
class Clearest:
    """The view that shows the most."""

    number: int
    share: float  # of the middle's splats that it shows
    covered: float  # share of the picture that splats cover


@dataclass(frozen=True, eq=False)
class _Sample:
    """Some splats (K,), each in place of several."""

    means: DoubleArray  # (K, 3) world
    sizes: DoubleArray  # (K,) standard deviations: larger, to cover as much as those left out
    opacities: DoubleArray  # (K,)
    is_wanted: BoolArray  # (K,) those that a view should show
    margin: float  # what is nearer by less hides nothing


def clearest_view(
    scene: Scene, box: tuple[DoubleArray, DoubleArray], views: Sequence[Camera]
) -> Clearest:
    """The view that shows the most of the middle of the box lo, hi (3,): the first, unless another
    one shows twice as much of it, or more by a twentieth of all splats.

    Splats are sampled; what lies behind others is seen through them as far as they are transparent.
    Where the whole scene was moved to counts, not what was done to its parts.
    """
    gaussians, world = scene.gaussians, scene.frame.world
    rows, sizes = _sampled(gaussians, gaussians.opacities >= _FAINT)
    means = turned(gaussians.means[rows].astype(np.float64), world[:3, :3]) + world[:3, 3]
    finite = np.isfinite(means).all(axis=1)
    rows, sizes, means = rows[finite], sizes[finite], means[finite]
    size = float(np.linalg.norm(box[1] - box[0]))
    if len(rows) == 0 or size == 0:
        return Clearest(0, 1.0, 0.0)
    middle, half = (box[0] + box[1]) / 2, _CORE * (box[1] - box[0]) / 2
    is_core: BoolArray = np.logical_and.reduce(np.abs(means - middle) <= half, axis=1)
    opacities = gaussians.opacities[rows].astype(np.float64)
    sample = _Sample(means, scale_of(world) * sizes, opacities, is_core, _BEHIND * size)
    cells = [round(_CELLS * float(np.linalg.norm(v.position - middle)) / size) for v in views]
    seen = [v.at_most(max(n, _FEWEST)) for v, n in zip(views, cells, strict=True)]
    shown, covered = zip(*(_shown(sample, view) for view in seen), strict=True)
    best = int(np.argmax(shown))
    is_hidden = shown[0] < _HIDDEN * shown[best]
    best = best if is_hidden or shown[best] - shown[0] > _CLEARER * len(rows) else 0
    return Clearest(best, shown[best] / max(int(is_core.sum()), 1), covered[best])


def clearest_view_of(scene: Scene, indices: IntArray, views: Sequence[Camera]) -> int:
    """Number of the view that shows the most of the visible splats ``indices`` (K,): the first, if
    it shows at least half as much. What is hidden or deleted hides nothing."""
    splats = scene.gaussians
    is_visible = scene.visible & (splats.opacities >= _FAINT)
    is_of = np.zeros(len(scene), bool)
    is_of[indices] = True
    parts = [_sampled(splats, part & is_visible) for part in (is_of, ~is_of)]
    rows, sizes = (np.concatenate(found) for found in zip(*parts, strict=True))
    means = world_means(scene, rows).astype(np.float64)
    scale = scale_of(scene.frame.world)
    own = means[is_of[rows]]
    if len(own) == 0:  # hidden, or too faint
        return 0
    size = float(np.linalg.norm(np.ptp(own, axis=0)))
    opacities = splats.opacities[rows].astype(np.float64)
    sample = _Sample(means, scale * sizes, opacities, is_of[rows], _BEHIND * size)
    shown = [_shown(sample, view.at_most(_ROUGH))[0] for view in views]
    best = int(np.argmax(shown))
    return best if shown[0] < _HIDDEN * shown[best] else 0


def _sampled(splats: Gaussians, chosen: BoolArray) -> tuple[IntArray, DoubleArray]:
    """Some of the ``chosen`` splats (N,), and their middle standard deviations, enlarged: fewer
    splats cover as much."""
    all_rows = np.flatnonzero(chosen).astype(np.int32)
    rows = all_rows[:: max(1, len(all_rows) // _SAMPLE)]
    middle = np.sort(splats.log_scales[rows], axis=1)[:, 1].astype(np.float64)
    return rows, np.exp(middle) * np.sqrt(len(all_rows) / max(len(rows), 1))


def _shown(sample: _Sample, view: Camera) -> tuple[float, float]:
    """How many of the wanted splats show in a view, each as far as light comes through what lies
    before it in its cell; and the share of the picture that is covered."""
    pixels, depths = view.project(sample.means)
    inside = np.flatnonzero(view.shows(pixels, depths))
    if len(inside) == 0:
        return 0.0, 0.0
    (u, v), depth = pixels[inside].T, depths[inside]
    areas = 2 * np.pi * (sample.sizes[inside] * view.K[0, 0] / depth) ** 2  # cells, of opacity 1
    level_of = np.ceil(np.log2(np.maximum(np.sqrt(areas), 1))).clip(max=_LEVELS - 1)
    # Optical depths: those of splats one behind another add up.
    thickness = areas * sample.opacities[inside].clip(max=0.99)
    wanted = np.flatnonzero(sample.is_wanted[inside])
    nearer = (depth - sample.margin).clip(min=0)
    before, of_cell = np.zeros(len(wanted)), np.zeros((view.height, view.width))
    for level in range(_LEVELS):
        side, own = 2**level, np.flatnonzero(level_of == level)
        across, down = -(-view.width // side), -(-view.height // side)
        cell = (v // side).astype(np.int64) * across + (u // side).astype(np.int64)
        far = 2 * depth.max()  # a key counts cells, and in each of them the depth
        order = own[np.argsort(cell[own] * far + depth[own])]
        keys, own_thickness = cell[order] * far + depth[order], thickness[order] / side**2
        sums = np.concatenate([[0.0], np.cumsum(own_thickness)])
        first = np.searchsorted(keys, cell[wanted] * far)
        last = np.searchsorted(keys, cell[wanted] * far + nearer[wanted])
        before += sums[np.maximum(last, first)] - sums[first]
        whole = np.bincount(cell[own], thickness[own] / side**2, down * across)
        whole = whole.reshape(down, across).repeat(side, axis=0).repeat(side, axis=1)
        of_cell += whole[: view.height, : view.width]
    return float(np.exp(-before).sum()), float(1 - np.exp(-of_cell).mean())
