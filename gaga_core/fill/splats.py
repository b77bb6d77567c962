"""New splats for a hole: copies of pieces of the surface around it, in the colors of its chart."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from gaga_core.arrays import DoubleArray, LongArray
from gaga_core.color import dc_from_rgb
from gaga_core.fill.chart import Chart, drawn
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.edits.values import joined

_PIECE = 5.0  # side of a copied piece, spacings of the splats
_SMALL, _INWARD = 0.4, 0.5  # largest deviation: in spacings, and in ways to the hole's edge
_UNDER = 0.5  # spacings under the surface, so that what is there already is drawn over them
_ROUNDS = 3  # of correcting colors by what is drawn
_GAP_ROUNDS = 5  # of splats for what the pieces leave open
_THIN = 0.9  # alpha under which a cell gets a splat more
_MOST_GAIN = 0.5  # of a color, in a round


def new_splats(
    gaussians: Gaussians,
    chart: Chart,
    color: DoubleArray,
    height: DoubleArray,
    rasterizer: Rasterizer,
    seed: int,
) -> Gaussians:
    """Splats that show ``color`` (H, W, 3) at ``height`` (H, W) in the chart's hole.

    Density, sizes, opacities, view dependence and extra columns are those of the splats around:
    the hole is laid out in pieces, each with the splats of a piece of the known surface.
    """
    rng = np.random.default_rng(seed)
    donors, places = _laid_out(gaussians, chart, rng)
    usable = _usable(gaussians, chart)
    for _ in range(_GAP_ROUNDS):
        fresh = _placed(gaussians, chart, height, donors, places)
        gaps = _gaps(gaussians, fresh, chart, rasterizer)
        if len(gaps) == 0:
            break
        donors = np.concatenate([donors, rng.choice(usable, len(gaps))])
        places = np.concatenate([places, gaps])
    return _colored(_placed(gaussians, chart, height, donors, places), chart, color, rasterizer)


def _placed(
    gaussians: Gaussians,
    chart: Chart,
    height: DoubleArray,
    donors: LongArray,
    places: DoubleArray,
) -> Gaussians:
    """Copies of ``donors`` (K,) at ``places`` (K, 2) under the surface, as uneven as there."""
    local = chart.plane.local(gaussians.means[donors].astype(np.float64))
    most = 3 * chart.plane.thickness
    lift = np.clip(local[:, 2] - chart.at(chart.height, local), -most, most)
    under = _UNDER * chart.plane.spacing
    target = np.column_stack([places, chart.at(height, places) + lift - under])
    # Large splats would lie over what is known next to the hole.
    inward = chart.at(ndimage.distance_transform_edt(chart.hole) * chart.step, places)
    largest = np.log(np.maximum(_SMALL * chart.plane.spacing, _INWARD * inward))
    copies = gaussians.take(donors)
    return replace(
        copies,
        means=chart.plane.world(target).astype(np.float32),
        log_scales=np.minimum(copies.log_scales, largest[:, None]).astype(np.float32),
    )


def _gaps(
    gaussians: Gaussians, fresh: Gaussians, chart: Chart, rasterizer: Rasterizer
) -> DoubleArray:
    """Where on the plane the hole is still seen through (K, 2), a spacing apart."""
    both = joined(gaussians.take(chart.plane.splats), fresh)
    _, _, alpha = drawn(both, chart.plane, chart.corner, chart.step, chart.shape, rasterizer)
    thin = chart.hole & (alpha < _THIN)
    every = max(1, round(chart.plane.spacing / chart.step))
    # The thinnest cell of its surroundings; equal ones are told apart by their place.
    order = np.arange(thin.size).reshape(thin.shape) * 1e-9
    key = np.where(thin, 1 - alpha + order, 0)
    peak = thin & (key >= ndimage.maximum_filter(key, size=every))
    return chart.uv()[peak]


def _usable(gaussians: Gaussians, chart: Chart) -> LongArray:
    """Rows of the splats of the known surface (K,)."""
    splats = chart.plane.splats
    row, column, inside = chart.cells(chart.plane.local(gaussians.means[splats].astype(np.float64)))
    return splats[inside & chart.known[row, column]]


def _laid_out(
    gaussians: Gaussians, chart: Chart, rng: np.random.Generator
) -> tuple[LongArray, DoubleArray]:
    """Rows of donors (K,), and where on the plane their copies come (K, 2)."""
    plane = chart.plane
    rows = _usable(gaussians, chart)
    local = plane.local(gaussians.means[rows].astype(np.float64))[:, :2]
    side = max(3, round(_PIECE * plane.spacing / chart.step))
    solid = ndimage.minimum_filter(chart.known, size=side)
    if not solid.any():
        solid = chart.known
    middles = np.argwhere(solid)
    taken, places = [], []
    piece = side * chart.step
    for top in range(0, chart.shape[0], side):
        for left in range(0, chart.shape[1], side):
            part = chart.hole[top : top + side, left : left + side]
            if not part.any():
                continue
            middle = middles[rng.integers(len(middles))]
            from_uv = _uv(chart, middle[0] + 0.5, middle[1] + 0.5)
            to_uv = _uv(chart, top + side / 2, left + side / 2)
            near = (np.abs(local - from_uv) < piece / 2).all(axis=1)
            moved = local[near] + (to_uv - from_uv)
            r, c, ok = chart.cells(moved)
            ok &= chart.hole[r, c]
            taken.append(rows[near][ok])
            places.append(moved[ok])
    donors = np.concatenate(taken) if taken else np.zeros(0, np.int64)
    found = np.concatenate(places) if places else np.zeros((0, 2))
    return donors, found


def _uv(chart: Chart, row: float, column: float) -> DoubleArray:
    return np.array([chart.corner[0] + chart.step * column, chart.corner[1] - chart.step * row])


def _colored(
    fresh: Gaussians, chart: Chart, color: DoubleArray, rasterizer: Rasterizer
) -> Gaussians:
    """The splats in such colors that the chart, drawn from them, is ``color``."""
    local = chart.plane.local(fresh.means.astype(np.float64))
    rgb = chart.at(color, local)
    sh = fresh.sh.copy()
    for _ in range(_ROUNDS):
        sh[:, 0] = dc_from_rgb(rgb.astype(np.float32))
        fresh = replace(fresh, sh=sh.copy())
        shown, _, alpha = drawn(
            fresh, chart.plane, chart.corner, chart.step, chart.shape, rasterizer
        )
        wrong = np.where((alpha > 0.3)[:, :, None] & chart.hole[:, :, None], color - shown, 0)
        rgb = rgb + np.clip(chart.at(wrong, local), -_MOST_GAIN, _MOST_GAIN)
    sh[:, 0] = dc_from_rgb(rgb.astype(np.float32))
    return replace(fresh, sh=sh)
