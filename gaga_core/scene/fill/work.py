"""Fill what a part of an object hid, surface by surface, and take its shadow off them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from gaga_core.arrays import BoolArray, DoubleArray, IntArray
from gaga_core.color import dc_from_rgb, rgb_from_dc
from gaga_core.gaussians import Gaussians
from gaga_core.progress import Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.fill.chart import Chart, chart_of, tolerance_of
from gaga_core.scene.fill.check import accepted
from gaga_core.scene.fill.config import FillConfig
from gaga_core.scene.fill.inpaint import Inpainter
from gaga_core.scene.fill.smooth import smooth_base
from gaga_core.scene.fill.splats import new_splats
from gaga_core.scene.fill.stains import (
    foot_cells,
    gains,
    shadow_of,
    splat_gains,
    taken_cells,
)
from gaga_core.scene.fill.surfaces import surfaces_around
from gaga_core.scene.fill.texture import continued_color
from gaga_core.scene.fill.views import Seen

_RIM_SPLAT = 0.8  # spacings: largest deviation of a seen splat that is made again
_THING = 3.0  # sizes of the object: what is larger is no thing that stands on the surface
_BASE = 3.0  # cells: what is finer is texture


@dataclass(frozen=True, eq=False)
class _Shadow:
    """What takes it off."""

    factors: DoubleArray  # (H, W, 3)
    is_cast: bool  # its outline is that of the object


class Work:
    """What is found, part by part of the object."""

    def __init__(
        self,
        gaussians: Gaussians,
        labels: IntArray,
        is_object: BoolArray,
        seen: Seen,
        rasterizer: Rasterizer,
        config: FillConfig,
    ) -> None:
        self.gaussians, self.labels, self.is_object = gaussians, labels, is_object
        self.seen, self.rasterizer, self.config = seen, rasterizer, config
        self.is_known = seen.known
        self.points = gaussians.means.astype(np.float64)
        sizes = _sizes(self.points, labels)
        self.size = float(sizes[is_object].max())
        # Other things that the photos showed.
        self.is_thing = ~is_object & self.is_known & (sizes < _THING * self.size)
        self.inpainter: Inpainter | None = None  # None: colors continue the surroundings
        self.is_refused = False  # a hole that was found is left open
        self.made: list[Gaussians] = []
        self.groups: list[IntArray] = []
        self.gain = np.ones((len(gaussians), 3))
        self.dropped = np.zeros(len(gaussians), np.bool_)
        self.locked = np.zeros(len(gaussians), np.bool_)  # neither goes nor is lightened

    def fill(self, part: BoolArray) -> Stage[None]:
        """Fill behind the splats ``part`` (N,) of the object, surface by surface."""
        own = self.points[part]
        usable = self.is_known & ~self.is_object
        charts = [
            chart_of(self.gaussians, plane, own, self.seen.views, self.rasterizer, self.config)
            for plane in surfaces_around(self.gaussians, self.labels, part, usable, self.config)
        ]
        within = ~self.is_object & ~self.is_known & ~self.locked & _inside(own, self.points)
        for chart in charts:  # what lies on a surface is not in the object
            within &= ~_on_surface(chart, self.points)
        self.dropped |= within  # whether there is a hole or not: nothing is in an object's body
        yield from self._fill_charts(charts, within, own)

    def _fill_charts(self, charts: list[Chart], within: BoolArray, own: DoubleArray) -> Stage[None]:
        """Fill the holes of charts, without the splats ``within`` (N,), and lighten shadows.

        ``own``: (K, 3) the splats that cast them.
        """
        hidden = ~self.is_object & ~self.is_known
        n_filled = 0
        for chart in charts:
            shadow = self._shadow(chart, own)
            if not chart.hole.any() or n_filled == self.config.most_surfaces:
                if shadow.is_cast:
                    self.gain = self._lit_by(chart, shadow)
                continue
            # Seen splats at its rim are made again too, but for large ones: they reach far beyond.
            small = self.gaussians.scales.max(axis=1) < _RIM_SPLAT * chart.plane.spacing
            goes = (hidden | (small & ~self.is_object)) & _under(chart, self.points)
            goes |= within
            n_filled += yield from self._fill_chart(chart, goes & ~self.locked, shadow)

    def _fill_chart(self, chart: Chart, goes: BoolArray, shadow: _Shadow) -> Stage[bool]:
        """Fill a chart's hole, without the splats ``goes`` (N,); False when it does harm."""
        plane = chart.plane
        bright = replace(chart, color=chart.color * shadow.factors)
        surface = bright.color, chart.known, chart.hole
        if self.inpainter is None:
            color = continued_color(*surface)
        else:
            color = yield from self.inpainter.painted_stage(*surface)
        color = np.clip(color, 0, 1.5)
        height = _continued_height(chart)
        fresh = new_splats(self.gaussians, bright, color, height, self.rasterizer, self.config.seed)
        # What no photo showed is no surface to compare with.
        left = np.flatnonzero(~self.is_object & ~self.dropped & (self.is_known | ~goes))
        gain = self._lit_by(chart, shadow)
        rest = _lit(self.gaussians, gain).take(left)
        kept = accepted(rest, fresh, goes[left], chart, self.seen.views, self.rasterizer)
        if not kept.any():
            self.is_refused = True
            if shadow.is_cast:
                self.gain = gain
            return False
        fresh = fresh.take(np.flatnonzero(kept))
        self.dropped |= goes
        self.gain = gain
        self.made.append(fresh)
        self.groups.append(np.full(len(fresh), plane.label, np.int32))
        return True

    def _shadow(self, chart: Chart, own: DoubleArray) -> _Shadow:
        """What takes the shadow of the splats ``own`` (K, 3) off the chart that these stand on."""
        none = _Shadow(np.ones((*chart.shape, 3)), is_cast=False)
        if not self.config.lighten:
            return none
        foot = foot_cells(chart, own)
        if not foot.any():
            return none
        foot = chart.hole if chart.hole.any() else foot
        stands = self.is_thing & (self.labels != chart.plane.label)
        taken = taken_cells(chart, self.points[stands], self.size)
        cast = shadow_of(chart, foot, own, taken)
        return _Shadow(gains(chart, foot, taken, cast), is_cast=cast is not None)

    def _lit_by(self, chart: Chart, shadow: _Shadow) -> DoubleArray:
        """Factors (N, 3) of all splats when that shadow is taken off, too."""
        plane = chart.plane
        near = np.ones((len(self.gaussians), 3))
        rgb = rgb_from_dc(self.gaussians.sh[plane.splats, 0]).astype(np.float64)
        local = plane.local(self.points[plane.splats])
        near[plane.splats] = splat_gains(chart, shadow.factors, local, rgb)
        near[self.locked] = 1.0
        return np.maximum(self.gain, near)


def _sizes(points: DoubleArray, labels: IntArray) -> DoubleArray:
    """Extent (N,) of the group of each splat."""
    result = np.zeros(len(labels))
    for label in np.unique(labels):
        own = labels == label
        low, high = np.percentile(points[own], (2, 98), axis=0)
        result[own] = np.linalg.norm(high - low)
    return result


def _lit(gaussians: Gaussians, gain: DoubleArray) -> Gaussians:
    """The splats with their colors times ``gain`` (N, 3)."""
    sh = gaussians.sh * gain[:, None].astype(np.float32)
    sh[:, 0] = dc_from_rgb((rgb_from_dc(gaussians.sh[:, 0]) * gain).astype(np.float32))
    return replace(gaussians, sh=sh)


def _continued_height(chart: Chart) -> DoubleArray:
    """Height (H, W) with the hole filled."""
    height = smooth_base(chart.height[:, :, None], chart.known, chart.hole, _BASE)[:, :, 0]
    result: DoubleArray = np.where(chart.hole, height, chart.height)
    return result


def _under(chart: Chart, points: DoubleArray) -> BoolArray:
    """Splats at ``points`` (N, 3) that lie in the hole's place (N,)."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    near = np.abs(local[:, 2]) < max(chart.step, 4 * chart.plane.thickness)
    result: BoolArray = inside & near & chart.hole[row, column]
    return result


def _on_surface(chart: Chart, points: DoubleArray) -> BoolArray:
    """Which of ``points`` (N, 3) lie on the chart's surface, whether photos showed it or not."""
    local = chart.plane.local(points)
    row, column, inside = chart.cells(local)
    surface = ndimage.binary_fill_holes(chart.known | chart.hole)
    near = np.abs(local[:, 2] - chart.height[row, column]) < tolerance_of(chart)
    result: BoolArray = inside & near & surface[row, column]
    return result


def _inside(own: DoubleArray, points: DoubleArray) -> BoolArray:
    """Points (N,) in the convex hull of the object's splats ``own`` (K, 3)."""
    lo, hi = np.percentile(own, 1, axis=0), np.percentile(own, 99, axis=0)
    result: BoolArray = np.all((points > lo) & (points < hi), axis=1)
    own = own[((own >= lo) & (own <= hi)).all(axis=1)]
    if len(own) < 5 or not result.any():
        return np.zeros(len(points), np.bool_)
    try:
        planes = ConvexHull(own[:: max(1, len(own) // 3000)]).equations
    except QhullError:  # flat: nothing is inside
        return np.zeros(len(points), np.bool_)
    near, slack = np.flatnonzero(result), 1e-9 * float((hi - lo).max())
    for plane in planes:  # normals look outwards
        near = near[points[near] @ plane[:3] + plane[3] <= slack]
    result[:] = False
    result[near] = True
    return result
